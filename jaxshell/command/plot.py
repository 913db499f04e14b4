"""`jaxshell plot`: draw result files, several of them together."""

import argparse
import itertools
import sys
from pathlib import Path

from jaxshell.command.start import prepare_jax
from jaxshell.files.quoted import file_part


def add(commands) -> None:
    plot = commands.add_parser("plot", help="draw result files, several of them together")
    plot.set_defaults(command=_plot)
    plot.add_argument("files", nargs="+", type=Path, metavar="FILE.h5")
    plot.add_argument("--output", type=Path, metavar="DIR", help="where pictures go (default: beside the file)")
    plot.add_argument(
        "--contour",
        action="append",
        default=[],
        metavar="WHAT",
        help='colour the shapes by a stress or section force: "von mises top", "sxx bottom", "Mxx"; may be repeated',
    )


def _plot(options: argparse.Namespace) -> int:
    prepare_jax()
    from jaxshell.command.method_names import method_label, parse_method
    from jaxshell.plotting import plot
    from jaxshell.results.solution import Solution

    loaded = {path: Solution.load(path) for path in options.files}
    labels = []
    for path, solution in loaded.items():
        if solution.message:
            print(f"jaxshell: {path}: {solution.message}", file=sys.stderr)
        try:
            labels.append(method_label(parse_method(solution.stats.get("method", "")), solution.scene))
        except ValueError:
            labels.append(path.stem)
    if len(set(labels)) < len(labels):
        labels = [path.stem for path in loaded]
    if len(set(labels)) < len(labels):
        labels = [str(path) for path in loaded]
    first = options.files[0]
    stem = first.stem if len(loaded) == 1 else f"{_common_stem(loaded)}_compared"
    runs = dict(zip(labels, loaded.values(), strict=True))
    for path in plot(runs, options.output or first.parent, stem, options.contour):
        print(path)
    return 0


def _common_stem(loaded: dict) -> str:
    """The first words that all files' names share, or else the scene's name."""
    words = zip(*(path.stem.split("_") for path in loaded), strict=False)
    shared = [same[0] for same in itertools.takewhile(lambda same: len(set(same)) == 1, words)]
    return "_".join(shared) or file_part(next(iter(loaded.values())).scene.name)
