"""Legacy VTK files, of unstructured grids and of polygons (POLYDATA), with text or binary numbers.

meshlane 5.5 refuses polygons, and grids with normals. Whole numbers of cells that take few values make element sets.
"""

from pathlib import Path

import numpy as np

from jaxshell.model.cells import Cells
from jaxshell.model.mesh_files.library import broken, cells_of, numbered_sets, read

_TYPES = {"unsigned_char": "u1", "char": "i1", "unsigned_short": "u2", "short": "i2", "unsigned_int": "u4",
          "int": "i4", "vtktypeint32": "i4", "vtkidtype": "i4", "long": "i8", "unsigned_long": "u8",
          "vtktypeint64": "i8", "vtktypeuint64": "u8", "float": "f4", "double": "f8"}  # fmt: skip
_KINDS = {1: "vertex", 3: "line", 5: "triangle", 9: "quad", 10: "tetra", 12: "hexahedron", 13: "wedge", 14: "pyramid",
          21: "line3", 22: "triangle6", 23: "quad8", 28: "quad9"}  # fmt: skip
_OF_SIZE = {1: "vertex", 2: "line", 3: "triangle", 4: "quad"}
_COMPONENTS = {"NORMALS": 3, "VECTORS": 3, "TENSORS": 9, "TENSORS6": 6, "GLOBAL_IDS": 1, "PEDIGREE_IDS": 1}


def read_cells(path) -> Cells:
    """What a legacy VTK file holds. Raises ValueError."""
    path = Path(path)
    try:
        reading = _Reading(path.read_bytes())
        found = reading.result() if reading.dataset in ("UNSTRUCTURED_GRID", "POLYDATA") else None
    except (ValueError, IndexError, KeyError, OverflowError, MemoryError) as error:
        raise broken(path) from error
    return cells_of(*read(path, "vtk")) if found is None else found


class _Reading:
    """The file as far as it is read: `at` is the place of the next byte."""

    def __init__(self, data: bytes):
        self.data, self.at = data, 0
        if not self._line().startswith("# vtk DataFile Version"):
            raise ValueError("The first line is not that of a VTK file.")
        self._line()
        self.binary = {"ASCII": False, "BINARY": True}[self._words()[0].upper()]
        self.dataset = self._words()[1].upper()
        self.points = np.zeros((0, 3))
        self.lists: dict[str, list[np.ndarray]] = {}
        self.types = np.zeros(0, int)
        self.values: dict[str, np.ndarray] = {}
        self.notes: tuple[str, ...] = ()

    def _line(self) -> str:
        end = self.data.find(b"\n", self.at)
        end = len(self.data) if end < 0 else end
        line, self.at = self.data[self.at : end], end + 1
        return line.decode("utf-8", "replace").strip()

    def _words(self) -> list[str]:
        """The words of the next line that has any; none at the file's end."""
        while self.at < len(self.data):
            words = self._line().split()
            if words:
                return words
        return []

    def _numbers(self, count: int, kind: str) -> np.ndarray:
        """The numbers that come next, from a new line on. Raises ValueError where there are fewer."""
        dtype = np.dtype(_TYPES[kind.lower()])
        if self.binary:
            size = count * dtype.itemsize
            if count < 0 or self.at + size > len(self.data):
                raise ValueError("The file ends too early.")
            found = np.frombuffer(self.data, dtype.newbyteorder(">"), count, self.at)
            self.at += size
            return found.astype(dtype)
        words: list[str] = []
        while len(words) < count:
            words += self._words() or _ended()
        return np.array(words[:count], dtype)

    def _read_sections(self) -> None:
        where, count = "", 0
        while words := self._words():
            key = words[0].upper()
            if key == "POINTS":
                self.points = self._numbers(3 * int(words[1]), words[2]).astype(float).reshape(-1, 3)
            elif key in ("CELLS", "VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS"):
                self.lists[key] = self._lists(int(words[1]), int(words[2]))
            elif key == "CELL_TYPES":
                self.types = self._numbers(int(words[1]), "int")
            elif key in ("CELL_DATA", "POINT_DATA"):
                where, count = key, int(words[1])
            elif key == "METADATA":
                while self.at < len(self.data) and self._line():
                    pass
            elif not self._take_values(key, words, where == "CELL_DATA", count):
                self.notes = (f"values of cells from {words[0]} on are not read",)
                return

    def _lists(self, count: int, size: int) -> list[np.ndarray]:
        """Points of each cell: after their number, or, since VTK 5.1, with all offsets before them."""
        place = self.at
        words = self._words()
        if words and words[0].upper() == "OFFSETS":
            offsets = self._numbers(count, words[1])
            points = self._numbers(size, (self._words() or _ended())[1])
        else:
            self.at = place
            flat = self._numbers(size, "int")
            offsets, kept = [0], np.ones(size, bool)
            at = 0
            for _ in range(count):
                kept[at] = False
                at += int(flat[at]) + 1
                offsets.append(at - len(offsets))
            points = flat[kept]
        return [points[first:last] for first, last in zip(offsets[:-1], offsets[1:], strict=True)]

    def _take_values(self, key: str, words: list[str], of_cells: bool, count: int) -> bool:
        """Values of points or cells; those of cells that are one whole number are kept. False for what is unknown."""
        if key == "FIELD":
            for _ in range(int(words[2])):
                name, components, tuples, kind = (self._words() + 4 * [""])[:4]
                if kind.lower() not in _TYPES:
                    return False
                self._keep(name, self._numbers(int(components) * int(tuples), kind), of_cells, int(components))
        elif key == "SCALARS" and words[2].lower() in _TYPES:
            components = int(words[3]) if len(words) > 3 else 1
            place = self.at
            if (self._words() or [""])[0].upper() != "LOOKUP_TABLE":
                self.at = place
            self._keep(words[1], self._numbers(components * count, words[2]), of_cells, components)
        elif key in _COMPONENTS and words[2].lower() in _TYPES:
            self._keep(words[1], self._numbers(_COMPONENTS[key] * count, words[2]), False, _COMPONENTS[key])
        else:
            return False
        return True

    def _keep(self, name: str, values: np.ndarray, of_cells: bool, components: int) -> None:
        if of_cells and components == 1:
            self.values[name] = values

    def result(self) -> Cells:
        self._read_sections()
        if self.dataset == "POLYDATA":
            kinds = [
                _OF_SIZE.get(len(cell), "polygon" if key == "POLYGONS" else "polyline")
                for key in ("VERTICES", "LINES", "POLYGONS")
                for cell in self.lists.get(key, [])
            ]
            cells = [cell for key in ("VERTICES", "LINES", "POLYGONS") for cell in self.lists.get(key, [])]
            kinds += ["triangle strip"] * len(self.lists.get("TRIANGLE_STRIPS", []))
            cells += self.lists.get("TRIANGLE_STRIPS", [])
        else:
            cells = self.lists.get("CELLS", [])
            if len(self.types) != len(cells):
                raise ValueError("Not every cell has a type.")
            kinds = [_kind(int(kind), len(cell)) for kind, cell in zip(self.types, cells, strict=True)]
        sets: dict[str, np.ndarray] = {}
        for name, values in self.values.items():
            if len(values) == len(cells):
                sets = numbered_sets(name, values) | sets
        return Cells(self.points, _blocks(kinds, cells), element_sets=sets, notes=self.notes)


def _ended() -> list[str]:
    raise ValueError("The file ends too early.")


def _kind(number: int, size: int) -> str:
    if number == 7:
        return _OF_SIZE.get(size, "polygon")
    return _KINDS.get(number, f"VTK type {number}")


def _blocks(kinds: list[str], cells: list[np.ndarray]) -> list[tuple[str, np.ndarray]]:
    """Blocks of neighbouring cells of a kind, and of as many points."""
    rows: list[tuple[str, list[np.ndarray]]] = []
    for kind, cell in zip(kinds, cells, strict=True):
        if not rows or rows[-1][0] != kind or len(rows[-1][1][-1]) != len(cell):
            rows.append((kind, []))
        rows[-1][1].append(cell)
    return [(kind, np.array(block, np.int64).reshape(len(block), -1)) for kind, block in rows]
