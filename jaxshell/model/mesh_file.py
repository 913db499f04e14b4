"""Mesh files through meshio: which of their cells make a shell, and errors that name the file."""

import builtins
import contextlib
import io
import unittest.mock
from pathlib import Path
from typing import Any

import numpy as np

from jaxshell.model.cells import Cells


def read_cells(path) -> Cells:
    """What a mesh file holds. Raises FileNotFoundError, and ValueError naming the file where it cannot be read."""
    content = _content(path)
    return Cells(content.points, [(block.type, np.asarray(block.data)) for block in content.cells])


def _content(path) -> Any:
    try:
        import meshio
    except ImportError as error:
        raise ImportError("Reading mesh files needs meshio: pip install meshio.") from error
    if not isinstance(path, str | Path):
        raise ValueError(f"The mesh file must be given by its path, but it is {path!r}.")
    if not is_file(path):
        raise FileNotFoundError(f"There is no mesh file {path}.")
    if not str(path).lower().endswith(tuple(meshio.extension_to_filetypes)):
        known = ", ".join(sorted(meshio.extension_to_filetypes))
        raise ValueError(f"{path} is of no kind that meshio reads, which it tells by the name's end ({known}).")
    quiet = io.StringIO()
    try:
        with (
            contextlib.redirect_stdout(quiet),
            contextlib.redirect_stderr(quiet),
            unittest.mock.patch.object(builtins, "open", _open_with_an_end),
        ):
            return meshio.read(path)
    # meshio's readers leave by whatever a broken file leads them into, SystemExit among it.
    except (Exception, SystemExit) as error:
        raise ValueError(
            f"{path} cannot be read as a mesh file: it is empty, broken, or of another kind than its name says."
        ) from error


class _Ending:
    """A file whose end is an error for who goes on reading there: some of meshio's readers never stop."""

    ends = 0

    def readline(self, size=-1, /):
        return self._counted(super().readline(size))  # pyright: ignore[reportAttributeAccessIssue]

    def read(self, size=-1, /):
        return self._counted(super().read(size))  # pyright: ignore[reportAttributeAccessIssue]

    def _counted(self, found):
        self.ends = 0 if found else self.ends + 1
        if self.ends > 1000:
            raise EOFError("The file ends too early.")
        return found


class _Bytes(_Ending, io.BufferedReader):
    """Of bytes."""


class _Characters(_Ending, io.TextIOWrapper):
    """Of text."""


def _open_with_an_end(file, mode="r", *arguments, **named):
    """`open`, whose files to read end with an error where they are read on and on."""
    if mode not in ("r", "rb", "rt") or arguments or named:
        return open(file, mode, *arguments, **named)
    binary = _Bytes(io.FileIO(file))
    return binary if mode == "rb" else _Characters(binary)


def is_file(path) -> bool:
    """Whether `path` is a file; False for what cannot be a path at all."""
    try:
        return Path(path).is_file()
    except (OSError, ValueError):
        return False
