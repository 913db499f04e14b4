"""Meshes of Nastran bulk data: grid points, in any coordinate systems, elements, and a set for each property."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxshell.model.cells import Cells
from jaxshell.model.mesh_files.files import is_file, text_of

ENDINGS = (".bdf", ".nas", ".fem")
_ELEMENTS = {
    # Kind, the field of the property (0 for none) and those of the nodes, counted from the element's number in 1.
    "CTRIA3": ("triangle", 2, range(3, 6)),
    "CTRIAR": ("triangle", 2, range(3, 6)),
    "CQUAD4": ("quad", 2, range(3, 7)),
    "CQUADR": ("quad", 2, range(3, 7)),
    "CSHEAR": ("quad", 2, range(3, 7)),
    "CTRIA6": ("triangle6", 2, range(3, 9)),
    "CQUAD8": ("quad8", 2, range(3, 11)),
    "CQUAD": ("quad9", 2, range(3, 12)),
    "CBAR": ("line", 2, range(3, 5)),
    "CBEAM": ("line", 2, range(3, 5)),
    "CROD": ("line", 2, range(3, 5)),
    "CTUBE": ("line", 2, range(3, 5)),
    "CONROD": ("line", 0, range(2, 4)),
    "PLOTEL": ("line", 0, range(2, 4)),
    "CONM1": ("vertex", 0, range(2, 3)),
    "CONM2": ("vertex", 0, range(2, 3)),
}
_SOLIDS = ("CTETRA", "CHEXA", "CPENTA", "CPYRAM", "CTRIAX", "CTRIAX6", "CQUADX", "CQUADX4", "CQUADX8")
_NAMES = (
    r'\$HMNAME PROP\s+(?P<number>\d+)\s*"(?P<name>[^"]+)"',
    r"\$ANSA_NAME_COMMENT;(?P<number>\d+);P\w+;(?P<name>[^;]+)",
    r"\$\s*Femap Property (?P<number>\d+)\s*:\s*(?P<name>.+)",
)
"""Names of properties in the comments of HyperMesh, ANSA and Femap."""


@dataclass(frozen=True)
class Bulk:
    """The mesh of a bulk data file, and where its numbers are.

    Arguments:
        cells: points and blocks in the order of the file; an element set for each property, which is called as
            HyperMesh, ANSA and Femap name it in a comment, else by its card: "PSHELL 1", and "property 1" without one.
        points: {grid point: point}.
        elements: {element: cell}.
    """

    cells: Cells
    points: dict[int, int]
    elements: dict[int, int]


def read_cells(path) -> Cells:
    """What a bulk data file holds. Raises ValueError with file and line."""
    return read_bulk(path).cells


def read_bulk(path) -> Bulk:
    """The mesh of a bulk data file. Raises ValueError with file and line for what cannot be right."""
    path = Path(path)
    lines = list(_bulk_lines(path, ()))
    reading = _Reading()
    for card in _cards(lines):
        reading.read_card(card)
    return reading.result(_names([text for text, _ in lines]))


# --- cards -----------------------------------------------------------------------------------------------


@dataclass
class _Card:
    name: str
    fields: list[str]
    where: str

    def text(self, position: int) -> str:
        """A field, counted from 1; "" where it is empty or not there."""
        return self.fields[position - 1] if position <= len(self.fields) else ""

    def whole(self, position: int, default: int | None = None) -> int:
        text = self.text(position)
        if not text and default is not None:
            return default
        if not re.fullmatch(r"[+-]?\d+", text):
            raise ValueError(f"{self.where}: field {position} of {self.name}, {text!r}, should be a whole number.")
        return int(text)

    def real(self, position: int) -> float:
        """A field as a number; exponents may lack their e, as in 1.5-3."""
        text = self.text(position)
        try:
            return float(text or 0.0)
        except ValueError:
            pass
        try:
            return float(re.sub(r"(?<=[\d.])([+-])", r"e\1", text.lower().replace("d", "e")))
        except ValueError:
            raise ValueError(f"{self.where}: field {position} of {self.name}, {text!r}, should be a number.") from None


def _bulk_lines(path: Path, above: tuple[Path, ...]) -> Iterator[tuple[str, str]]:
    """(text, place) of the lines of the bulk data, with those of included files."""
    lines = text_of(path).splitlines()
    words = [text.split(None, 1)[0].upper() if text[:8].strip() else "" for text in lines]
    begin = words.index("BEGIN") + 1 if "BEGIN" in words else 0
    for number, text in enumerate(lines[begin:], begin):
        if words[number] == "ENDDATA":
            return
        where = f"{path.name}, line {number + 1}"
        if words[number] != "INCLUDE":
            yield text.expandtabs(8), where
            continue
        included = re.match(r"\s*INCLUDE\s+['\"]?([^'\"]+?)['\"]?\s*$", text, re.IGNORECASE)
        if included is None:
            raise ValueError(f"{where}: INCLUDE needs the name of a file, in one line.")
        inner = path.parent / included[1]
        if inner.resolve() in (*above, path.resolve()):
            raise ValueError(f"{where}: {inner.name} includes itself.")
        if not is_file(inner):
            raise ValueError(f"{where}: there is no file {included[1]} to include.")
        yield from _bulk_lines(inner, (*above, path.resolve()))


def _cards(lines: list[tuple[str, str]]) -> Iterator[_Card]:
    """Cards with all their fields: of 8 or 16 columns, or between commas; a line that goes on begins with +, * or
    nothing."""
    card = None
    for text, where in lines:
        text = text.split("$", 1)[0].rstrip()
        if not text:
            continue
        name, fields = _fields(text)
        if name in ("", "+", "*") or name[0] in "+*":
            if card is not None:
                card.fields += fields
            continue
        if card is not None:
            yield card
        card = _Card(name.rstrip("*").upper(), fields, where)
    if card is not None:
        yield card


def _fields(text: str) -> tuple[str, list[str]]:
    """The name in a line's first field, and its fields, of which there are always 8, or 4 of the large ones."""
    if "," in text:
        name, *fields = (part.strip() for part in text.split(","))
    else:
        name = text[:8].strip()
        width = 16 if "*" in name else 8
        fields = [text[at : at + width].strip() for at in range(8, 72, width)]
    count = 4 if "*" in name else 8
    return name, (fields + [""] * count)[:count]


def _names(lines: list[str]) -> dict[int, str]:
    """Names of properties in comments."""
    found = {}
    for text in lines:
        if text.startswith("$"):
            for pattern in _NAMES:
                match = re.match(pattern, text, re.IGNORECASE)
                if match:
                    found[int(match["number"])] = match["name"].strip()
    return found


# --- the mesh --------------------------------------------------------------------------------------------


class _Reading:
    """The bulk data as far as they are read."""

    def __init__(self):
        self.grids: dict[int, _Card] = {}
        self.systems: dict[int, _Card] = {}
        self.elements: dict[int, _Card] = {}
        self.properties: dict[int, str] = {}
        self.left_out: dict[str, int] = {}

    def read_card(self, card: _Card) -> None:
        if card.name == "GRID":
            self._take(card, self.grids, "grid point")
        elif card.name in _ELEMENTS or card.name in _SOLIDS:
            self._take(card, self.elements, "element")
        elif card.name in ("CORD2R", "CORD2C", "CORD2S"):
            self._take(card, self.systems, "coordinate system")
        elif re.fullmatch(r"CORD1[RCS]|GRDSET", card.name):
            raise ValueError(f"{card.where}: {card.name} is not read; CORD2R, CORD2C and CORD2S are.")
        elif re.fullmatch(r"P(SHELL|COMP|COMPG|BAR|BARL|BEAM|BEAML|ROD|TUBE|SHEAR|SOLID|LPLANE)", card.name):
            self.properties[card.whole(1)] = card.name
        elif re.fullmatch(r"C(ELAS|BUSH|GAP|DAMP|VISC|WELD|FAST|SEAM|MASS)\w*|RB(AR|E)\w*|RROD|RTRPLT", card.name):
            self.left_out[card.name] = self.left_out.get(card.name, 0) + 1

    @staticmethod
    def _take(card: _Card, taken: dict[int, _Card], what: str) -> None:
        number = card.whole(1)
        if number in taken and (taken[number].name, taken[number].fields) != (card.name, card.fields):
            raise ValueError(f"{card.where}: {what} {number} is defined twice.")
        taken[number] = card

    def result(self, names: dict[int, str]) -> Bulk:
        points = {number: point for point, number in enumerate(self.grids)}
        x = [self._moved(card, 2, [card.real(i) for i in (3, 4, 5)], ()) for card in self.grids.values()]
        blocks: list[tuple[str, list[list[int]]]] = []
        members: dict[int, list[int]] = {}
        for cell, card in enumerate(self.elements.values()):
            kind, field, nodes = _ELEMENTS.get(card.name, (card.name, 0, ()))
            if not blocks or blocks[-1][0] != kind:
                blocks.append((kind, []))
            blocks[-1][1].append([self._point(card, i, points) for i in nodes] or [0])
            if field:
                members.setdefault(card.whole(field, card.whole(1)), []).append(cell)
        sets: dict[str, np.ndarray] = {}
        for number, cells in members.items():
            plain = f"{self.properties.get(number, 'property')} {number}"
            name = names.get(number, plain)
            sets[plain if name in sets else name] = np.array(cells, np.int64)
        arrays = [(kind, np.array(rows, np.int64)) for kind, rows in blocks]
        notes = tuple(f"{count} {name} are left out" for name, count in self.left_out.items())
        cells = Cells(np.array(x).reshape(-1, 3), arrays, element_sets=sets, notes=notes)
        return Bulk(cells, points, {number: cell for cell, number in enumerate(self.elements)})

    @staticmethod
    def _point(card: _Card, position: int, points: dict[int, int]) -> int:
        node = card.whole(position, 0)
        if node not in points:
            said = f"grid point {node}, which is not there" if node else f"no grid point in field {position}"
            raise ValueError(f"{card.where}: {card.name} {card.text(1)} names {said}.")
        return points[node]

    def _moved(self, card: _Card, position: int, x: list[float], inside: tuple[int, ...]) -> np.ndarray:
        """A point of the coordinate system that a card's field names, in the basic system."""
        number = card.whole(position, 0)
        if number == 0:
            return np.array(x)
        system = self.systems.get(number)
        if system is None or number in inside:
            said = "which is not there" if system is None else "which is defined by itself"
            raise ValueError(f"{card.where}: {card.name} {card.text(1)} is in coordinate system {number}, {said}.")
        corners = ([system.real(i) for i in range(first, first + 3)] for first in (3, 6, 9))
        a, b, c = (self._moved(system, 2, corner, (*inside, number)) for corner in corners)
        axes = _axes(a, b, c, system.where)
        first, angle, third = x[0], np.radians(x[1]), x[2]
        if system.name == "CORD2C":
            x = [first * np.cos(angle), first * np.sin(angle), third]
        elif system.name == "CORD2S":
            turn = np.radians(third)
            x = [first * np.sin(angle) * np.cos(turn), first * np.sin(angle) * np.sin(turn), first * np.cos(angle)]
        return a + np.array(x) @ axes


def _axes(a: np.ndarray, b: np.ndarray, c: np.ndarray, where: str) -> np.ndarray:
    """(3, 3) the axes, one a row: z from a to b, and c in the plane of x and z."""
    z = b - a
    y = np.cross(z, c - a)
    if not np.linalg.norm(y) > 0:
        raise ValueError(f"{where}: the three points of the coordinate system lie on one line.")
    x = np.cross(y, z)
    return np.stack([v / np.linalg.norm(v) for v in (x, y, z)])
