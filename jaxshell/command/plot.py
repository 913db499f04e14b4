"""`jaxshell plot`: draw result files, several of them together."""

import argparse
from pathlib import Path

from jaxshell.command.result_files import add_files, add_renderer, common_stem, read_runs
from jaxshell.command.start import prepare_jax


def add(commands) -> None:
    plot = commands.add_parser("plot", help="draw result files, several of them together")
    plot.set_defaults(command=_plot)
    add_files(plot, "result files: of several methods to compare, or of a run and its continuation, drawn as one")
    plot.add_argument("--output", type=Path, metavar="DIR", help="where pictures go (default: beside the file)")
    plot.add_argument(
        "--contour",
        action="append",
        default=[],
        metavar="WHAT",
        help='colour the shapes by velocity, the mesh\'s error, a stress or a section force: "mesh error", '
        '"von mises top", "sxx bottom", "Mxx"; may be repeated',
    )
    add_renderer(plot)


def _plot(options: argparse.Namespace) -> int:
    prepare_jax()
    from jaxshell.plotting import plot
    from jaxshell.plotting.modes import plot_modes
    from jaxshell.results.eigenmodes import eigenmodes_in

    directory = options.output or options.files[0].parent
    if len(options.files) == 1 and (found := eigenmodes_in(options.files[0])) is not None:
        for path in plot_modes(found, directory, options.files[0].stem, options.renderer):
            print(path)
        return 0
    runs = read_runs(options.files)
    for path in plot(runs, directory, common_stem(options.files, runs), options.contour, options.renderer):
        print(path)
    return 0
