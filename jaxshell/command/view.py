"""`jaxshell view`: a window on result files, with a slider for the time."""

import argparse

from jaxshell.command.result_files import add_field, add_files, read_runs
from jaxshell.command.start import prepare_jax


def add(commands) -> None:
    view = commands.add_parser("view", help="look at result files in a window: turn, zoom, move in time")
    view.set_defaults(command=_view)
    add_files(view, "result files, side by side; a run and its continuation are one")
    add_field(view)


def _view(options: argparse.Namespace) -> int:
    prepare_jax()
    from jaxshell.plotting import view

    view(read_runs(options.files), options.field, notebook=False)
    return 0
