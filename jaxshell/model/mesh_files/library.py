"""Mesh files through meshlane, which knows many formats: what it found, and errors that name the file."""

import contextlib
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxshell.model.cells import Cells

_STREAMED = {"ply": "rb", "su2": "r", "avsucd": "r", "tecplot": "r", "mdpa": "rb"}
"""Formats whose reader takes an open file, and whether of bytes or text: some never stop at the file's end."""
_UNREAD = ("svg", "wkt", "openfoam")
"""Formats that are only written, whose reader may never end, and that are folders."""
_GROUPS = {"gmsh:physical", "medit:ref", "su2:tag", "CellEntityIds"}
"""Values of cells that number their groups. Those of other whole numbers are called by the name of the values too."""
_NO_GROUPS = {
    "gmsh:geometrical",
    "cell_tags",
    "obj:group_ids",
    "vtkOriginalCellIds",
    "GlobalElementId",
    "GlobalCellIds",
}
_MOST_GROUPS = 200
"""Whole numbers that take more values are no groups but numbers of cells."""


def broken(path, reason: str = "") -> ValueError:
    """The error for a mesh file that cannot be read; the text names it and says why."""
    return ValueError(
        f"{path} cannot be read as a mesh file: it is empty, broken, or of another kind than its name says"
        f"{f' ({reason})' if reason else ''}."
    )


def endings() -> list[str]:
    """Ends of names of the formats that meshlane reads."""
    import meshlane

    return sorted(end for end, formats in meshlane.extension_to_filetypes.items() if formats[0] not in _UNREAD)


def read_cells(path) -> Cells:
    """What a file holds, with those of its sets that meshlane finds. Raises ValueError."""
    import meshlane

    path = Path(path)
    end = next(end for end in reversed(endings()) if path.name.lower().endswith(end))
    return cells_of(*read(path, meshlane.extension_to_filetypes[end][0]))


def read(path: Path, file_format: str, content: Path | None = None) -> tuple[Any, tuple[str, ...]]:
    """A `meshlane.Mesh` and what meshlane warned of. `content`: where the content of `path` is.

    Raises ValueError, and ImportError for formats that need a package more, such as Exodus.
    """
    import meshlane

    heard = io.StringIO()
    try:
        with contextlib.redirect_stdout(heard), contextlib.redirect_stderr(heard), contextlib.ExitStack() as stack:
            source: Any = content or path
            if file_format in _STREAMED:
                source = stack.enter_context(_Bytes(io.FileIO(source)))
                source = source if _STREAMED[file_format] == "rb" else _Text(source, encoding="utf-8", errors="replace")
            found = meshlane.read(source, file_format)
    except ImportError as error:
        raise ImportError(f"Reading {path} needs {error.name}: pip install {error.name}.") from error
    # meshlane's readers leave by whatever a broken file leads them into, SystemExit among it.
    except (Exception, SystemExit) as error:
        known = isinstance(error, meshlane.ReadError | SystemExit)
        raise broken(path, _said(heard.getvalue() or str(error)) if known else "") from error
    return found, tuple(filter(None, [_said(heard.getvalue())]))


def _said(text: str) -> str:
    """What meshlane printed, in one line; not that it could not read the file, which is said anyway."""
    lines = [" ".join(line.split()) for line in text.replace("Warning:", "").splitlines()]
    return " ".join(line for line in lines if line and not line.startswith("Error:")).rstrip(".")[:300]


class _Ending:
    """A file whose end is an error for who goes on reading there."""

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


class _Text(_Ending, io.TextIOWrapper):
    """Of text."""


# --- sets ------------------------------------------------------------------------------------------------


def cells_of(found: Any, notes: tuple[str, ...] = ()) -> Cells:
    """Points, cells and sets of a `meshlane.Mesh`: its own sets, and cells that have the same whole number."""
    blocks = [(block.type, np.asarray(block.data)) for block in found.cells]
    start = np.cumsum([0, *(len(block) for _, block in blocks)])
    element_sets = {}
    for name, parts in found.cell_sets.items():
        if not name.startswith("gmsh:"):
            numbers = [
                first + np.asarray(part, np.int64)
                for first, part in zip(start, parts, strict=False)
                if part is not None
            ]
            element_sets[name] = np.concatenate(numbers) if numbers else np.zeros(0, np.int64)
    names = {int(tag[0]): name for name, tag in found.field_data.items() if np.shape(tag) == (2,)}
    for name, parts in found.cell_data.items():
        if len(parts) and all(np.ndim(part) < 3 and np.size(part) == len(part) for part in parts):
            values = np.concatenate([np.ravel(part) for part in parts])
            if len(values) == start[-1]:
                element_sets = numbered_sets(name, values, names) | element_sets
    node_sets = {name: np.asarray(numbers, np.int64) for name, numbers in found.point_sets.items()}
    return Cells(found.points, blocks, node_sets, element_sets, {}, notes)


def numbered_sets(array: str, values: np.ndarray, names: Mapping[int, str] | None = None) -> dict[str, np.ndarray]:
    """Element sets of cells with the same whole number, of an array of values (c,); of other values none.

    A set is called by its number where the array is known to number groups, or by what `names` calls it, and else by
    the array's name and the number.
    """
    if array in _NO_GROUPS or values.dtype.kind not in "iu":
        return {}
    different = np.unique(values)
    if len(different) > _MOST_GROUPS or len(different) == len(values) > 1:
        return {}
    if array not in _GROUPS:
        return {f"{array} {value}": np.flatnonzero(values == value) for value in different}
    called = {int(value): (names or {}).get(int(value), str(value)) for value in different if value}
    return {name: np.flatnonzero(values == value) for value, name in called.items()}
