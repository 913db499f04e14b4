"""Mesh files through meshio: which of their cells make a shell, and errors that name the file."""

import builtins
import contextlib
import io
import unittest.mock
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from jaxshell.model.repair import only_used, split_quads

_HARMLESS = ("vertex", "line", "line3", "line4")
"""Cells of lower dimension, which mark points and curves of the geometry: left out, with a warning."""


def read_cells(path, quads: str) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (n, 3) that triangles use, and triangles (m, 3), of a mesh file; quads are cut in two ("split").

    Warns of points and lines that are left out. Raises ImportError without meshio, FileNotFoundError, and ValueError
    naming the file where it cannot be read, holds quads with quads="error", other cells, or nothing.
    """
    content = _content(path)
    blocks = [(block.type, np.asarray(block.data)) for block in content.cells]
    number: dict[str, int] = {}
    for kind, cells in blocks:
        number[kind] = number.get(kind, 0) + len(cells)
    taken = ("triangle", "quad") if quads == "split" else ("triangle",)
    refused = [kind for kind in number if kind not in (*taken, *_HARMLESS)]
    if refused:
        cure = 'quads="split" cuts quads in two. ' if refused == ["quad"] else ""
        raise ValueError(
            f"{path} holds {_listed(number, refused)} cells, which are no shell elements here. {cure}"
            "Mesh the surface with 3-node triangles or 4-node quads."
        )
    if not any(number.get(kind) for kind in taken):
        raise ValueError(
            f"{path} holds no triangles (it has: {_listed(number, list(number)) or 'no cells'}). "
            "Mesh the surface with 3-node triangles or 4-node quads."
        )
    nodes = _points(path, content)
    triangles = []
    for kind, cells in blocks:
        if kind in taken and len(cells):
            if cells.min() < 0 or cells.max() >= len(nodes):
                raise ValueError(f"{path} is broken: a {kind} names a node that it does not have.")
            triangles.append(cells if kind == "triangle" else split_quads(nodes, cells))
    if any(kind in _HARMLESS for kind in number):
        left_out = _listed(number, [kind for kind in number if kind in _HARMLESS])
        warnings.warn(f"{path}: {left_out} cells are left out; a shell is made of triangles and quads.", stacklevel=4)
    return only_used(nodes, np.concatenate(triangles).astype(np.int64))


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


def _points(path, content) -> np.ndarray:
    points = np.asarray(content.points)
    if points.ndim != 2 or points.shape[1] not in (2, 3) or points.dtype.kind not in "fiu":
        raise ValueError(f"{path} is broken: its points have shape {points.shape}, not (n, 3).")
    points = np.asarray(points, float)
    return np.pad(points, ((0, 0), (0, 3 - points.shape[1])))


def _listed(number: dict[str, int], kinds: list[str]) -> str:
    return ", ".join(f"{number[kind]} {kind}" for kind in kinds)
