"""Meshes of Nastran bulk data: grid points, in any coordinate systems, elements, and a set for each property."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxshell.model.cells import Cells
from jaxshell.model.mesh_files.bulk_data import Card, File, read_file
from jaxshell.model.mesh_files.coordinates import Systems, taken

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
_PROPERTY = re.compile("P(SHELL|COMP|COMPG|BAR|BARL|BEAM|BEAML|ROD|TUBE|SHEAR|SOLID|LPLANE)")
_LEFT_OUT = re.compile(r"C(ELAS|BUSH|GAP|DAMP|VISC|WELD|FAST|SEAM|MASS)\w*|RB(AR|E)\w*|RROD|RTRPLT")
"""Springs, rigid bodies and their like, which are no part of a mesh."""


@dataclass(frozen=True)
class Bulk:
    """The mesh of a bulk data file, and where its numbers are.

    Arguments:
        cells: points and blocks in the order of the file; an element set for each property, which is called as
            HyperMesh, ANSA and Femap name it in a comment, else by its card: "PSHELL 1", and "property 1" without one.
        points: {grid point: point}.
        elements: {element: cell}.
        systems: the grid points and coordinate systems.
    """

    cells: Cells
    points: dict[int, int]
    elements: dict[int, int]
    systems: Systems


def read_cells(path) -> Cells:
    """What a bulk data file holds. Raises ValueError with file and line."""
    return bulk_of_file(read_file(Path(path))).cells


def bulk_of_file(file: File) -> Bulk:
    """The mesh that bulk data state. Raises ValueError with file and line for what cannot be right."""
    elements: dict[int, Card] = {}
    properties: dict[int, str] = {}
    left_out: dict[str, int] = {}
    for card in file.cards:
        if card.name in _ELEMENTS or card.name in _SOLIDS:
            taken(elements, card, "element")
        elif _PROPERTY.fullmatch(card.name):
            properties[card.whole(1)] = card.name
        elif _LEFT_OUT.fullmatch(card.name):
            left_out[card.name] = left_out.get(card.name, 0) + 1
    systems = Systems(file.cards)
    grids = systems.grids()
    points = {label: point for point, label in enumerate(grids)}
    cells = Cells(
        np.array(list(grids.values())).reshape(-1, 3),
        _blocks(elements, points),
        element_sets=_sets(elements, properties, file.names),
        notes=tuple(f"{count} {name} are left out" for name, count in left_out.items()),
    )
    return Bulk(cells, points, {number: cell for cell, number in enumerate(elements)}, systems)


def _blocks(elements: dict[int, Card], points: dict[int, int]) -> list[tuple[str, np.ndarray]]:
    blocks: list[tuple[str, list[list[int]]]] = []
    for card in elements.values():
        kind, _, nodes = _ELEMENTS.get(card.name, (card.name, 0, ()))
        if not blocks or blocks[-1][0] != kind:
            blocks.append((kind, []))
        blocks[-1][1].append([_point(card, i, points) for i in nodes] or [0])
    return [(kind, np.array(rows, np.int64)) for kind, rows in blocks]


def _point(card: Card, position: int, points: dict[int, int]) -> int:
    node = card.whole(position, 0)
    if node not in points:
        said = f"grid point {node}, which is not there" if node else f"no grid point in field {position}"
        raise ValueError(f"{card.where}: {card.name} {card.text(1)} names {said}.")
    return points[node]


def _sets(elements: dict[int, Card], properties: dict[int, str], names: dict[int, str]) -> dict[str, np.ndarray]:
    """{name: cells} of each property."""
    members: dict[int, list[int]] = {}
    for cell, card in enumerate(elements.values()):
        field = _ELEMENTS.get(card.name, ("", 0, ()))[1]
        if field:
            members.setdefault(card.whole(field, card.whole(1)), []).append(cell)
    sets: dict[str, np.ndarray] = {}
    for number, cells in members.items():
        plain = f"{properties.get(number, 'property')} {number}"
        name = names.get(number, plain)
        sets[plain if name in sets else name] = np.array(cells, np.int64)
    return sets
