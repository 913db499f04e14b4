"""`jaxshell export`: a result file for other programs."""

import argparse
import sys
from pathlib import Path

from jaxshell.command.start import prepare_jax
from jaxshell.results.export.kinds import KINDS


def add(commands) -> None:
    export = commands.add_parser("export", help="write a result file for other programs: ParaView, spreadsheets")
    export.set_defaults(command=_export)
    export.add_argument("files", nargs="+", type=Path, metavar="FILE.h5")
    kinds = "; ".join(f"{name}: {kind.says}" for name, kind in KINDS.items())
    export.add_argument("--to", required=True, choices=tuple(KINDS), help=kinds)
    export.add_argument("--output", type=Path, metavar="PATH", help="a file, or a folder (default: beside the file)")
    export.add_argument(
        "--fields",
        nargs="+",
        metavar="FIELD",
        help='vtkhdf: which fields, as default, all, "von mises top", "s11 ply 0 top" (docs/export.md lists them)',
    )
    export.add_argument("--axes", choices=("global", "element", "material"), help="vtkhdf: axes of N, M and stresses")
    export.add_argument(
        "--failure",
        nargs="+",
        metavar=("CRITERION", "STRENGTH=VALUE"),
        action="append",
        help="vtkhdf: a failure index, as tsai-wu X_t=1.5e9 X_c=1.2e9 Y_t=5e7 Y_c=2e8 S=7e7; may be repeated",
    )
    export.add_argument("--overwrite", action="store_true", help="vtkhdf: replace a file that is not jaxshell's too")


def _export(options: argparse.Namespace) -> int:
    prepare_jax()
    from jaxshell.results.solution import Solution

    kind = KINDS[options.to]
    arguments = _arguments(options)
    if arguments and not kind.has_fields:
        raise ValueError(f"--{next(iter(arguments))} is not for {options.to}, which has histories only.")
    for path in options.files:
        solution = Solution.load(path)
        if solution.message:
            print(f"jaxshell: {path}: {solution.message}", file=sys.stderr)
        written = _target(options, path, kind.suffix)
        getattr(solution, kind.method)(written, **arguments)
        print(written)
    return 0


def _arguments(options: argparse.Namespace) -> dict:
    """What is said of fields, as arguments of `Solution.to_vtkhdf`."""
    failure = None if options.failure is None else dict(_strengths(words) for words in options.failure)
    given = {"fields": options.fields, "axes": options.axes, "failure": failure, "overwrite": options.overwrite or None}
    return {name: value for name, value in given.items() if value is not None}


def _strengths(words: list[str]) -> tuple[str, dict[str, float]]:
    """(criterion, strengths) of words such as tsai-wu X_t=1.5e9."""
    criterion, *pairs = words
    found = {}
    for pair in pairs:
        name, _, value = pair.partition("=")
        try:
            found[name] = float(value)
        except ValueError:
            raise ValueError(f"--failure {criterion}: {pair!r} is not NAME=NUMBER, as X_t=1.5e9 is.") from None
    return criterion, found


def _target(options: argparse.Namespace, path: Path, suffix: str) -> Path:
    """Where the export of a result file goes."""
    output = options.output
    if output is None:
        return path.with_suffix(suffix)
    if output.suffix == suffix and not output.is_dir():
        if len(options.files) > 1:
            raise ValueError(
                f"--output {output} is one file, but {len(options.files)} are to be exported: name a folder."
            )
        output.parent.mkdir(parents=True, exist_ok=True)
        return output
    output.mkdir(parents=True, exist_ok=True)
    return output / f"{path.stem}{suffix}"
