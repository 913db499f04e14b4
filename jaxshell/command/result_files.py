"""The result files that `plot`, `animate` and `view` are given: read, continuations joined, named by their methods."""

import argparse
import itertools
import sys
from collections.abc import Sequence
from pathlib import Path

from jaxshell.files.quoted import file_part


def add_files(command: argparse.ArgumentParser, help: str) -> None:
    """The files' argument."""
    command.add_argument("files", nargs="+", type=Path, metavar="FILE.h5", help=help)


def add_field(command: argparse.ArgumentParser) -> None:
    """What colours shapes."""
    command.add_argument(
        "--field",
        default="displacement",
        metavar="WHAT",
        help='what colours the shapes: displacement (the default), velocity, "mesh error", "von mises top", '
        '"sxx bottom", "Mxx", ...',
    )


def add_renderer(command: argparse.ArgumentParser) -> None:
    """What draws shapes."""
    command.add_argument(
        "--renderer",
        choices=("auto", "vtk", "matplotlib"),
        default="auto",
        help="what draws shapes: vtk (true depth, needs PyVista), matplotlib, or the first of them that works (auto)",
    )


def read_runs(paths: Sequence[Path]) -> dict:
    """{label: solution} of result files, a run and its continuation as one; tells of runs that did not end well."""
    from jaxshell.results.joined import join_continuations
    from jaxshell.results.solution import Solution

    loaded = {str(path): Solution.load(path) for path in paths}
    for path, solution in loaded.items():
        if solution.message:
            print(f"jaxshell: {path}: {solution.message}", file=sys.stderr)
    runs = join_continuations(loaded)
    methods = [_method(solution) for solution in runs.values()]
    stems = [Path(path).stem for path in runs]
    if len(set(methods)) == len(methods) and all(methods):
        labels = methods
    else:
        names = stems if len(set(stems)) == len(stems) else list(runs)
        labels = [f"{name} ({method})" if method else name for name, method in zip(names, methods, strict=True)]
    return dict(zip(labels, runs.values(), strict=True))


def common_stem(paths: Sequence[Path], runs: dict) -> str:
    """Of one run, its file's, the first of a chain; of several, the first words that all files' names share, or else
    the scene's name."""
    if len(runs) == 1:
        return min((path.stem for path in paths), key=len)
    words = zip(*(path.stem.split("_") for path in paths), strict=False)
    shared = [same[0] for same in itertools.takewhile(lambda same: len(set(same)) == 1, words)]
    return f"{'_'.join(shared) or file_part(next(iter(runs.values())).scene.name)}_compared"


def _method(solution) -> str:
    """The short name of a run's method; empty where the file names none that there is."""
    from jaxshell.command.method_names import method_label, parse_method

    try:
        return method_label(parse_method(solution.stats.get("method", "")), solution.scene)
    except ValueError:
        return ""
