"""The files that `jaxshell run` writes as it goes."""

import argparse
from pathlib import Path


def outputs(path: Path, options: argparse.Namespace, *more) -> list:
    """The result file, what is asked for besides, and `more` outputs."""
    from jaxshell.results.export.vtkhdf import VTKHDFWriter
    from jaxshell.results.hdf5 import ResultWriter

    found: list = [ResultWriter(path, overwrite=options.overwrite)]
    if options.vtkhdf:
        found.append(VTKHDFWriter(path.with_suffix(".vtkhdf"), overwrite=options.overwrite))
    return [*found, *more]


def say_besides(path: Path, options: argparse.Namespace, say) -> None:
    """A line for each file that was written besides the result file."""
    if options.vtkhdf:
        say(f"  {path.with_suffix('.vtkhdf')}")
