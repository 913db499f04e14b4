"""The shell elements of a Nastran file as a mesh, as `Mesh.read` has it: each property makes an element set."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxshell.files.draft import Notes, Target, only
from jaxshell.model.mesh import mesh_of_cells
from jaxshell.model.mesh_files.bulk_data import Card, File
from jaxshell.model.mesh_files.nastran import bulk_of_file

SHELLS = {
    "CTRIA3": 3,
    "CTRIAR": 3,
    "CQUAD4": 4,
    "CQUADR": 4,
    "CTRIA6": 6,
    "CQUAD8": 8,
}
"""Cards that are carried over, and how many nodes they have."""


@dataclass
class Element:
    """A shell element of the file."""

    label: int
    card: Card
    corners: int

    @property
    def section(self) -> int:
        """The number of its property (PID)."""
        return self.card.whole(2, self.label)

    @property
    def theta(self) -> str:
        """THETA or MCID as it is written."""
        return self.card.text(self._after)

    @property
    def offset(self) -> float:
        """ZOFFS [length]."""
        return self.card.number(self._after + 1, 0.0)

    @property
    def thicknesses(self) -> list[str]:
        """T1 to T4 where they are given."""
        count = 4 if self.corners in (4, 8) else 3
        return [text for text in (self.card.text(11 + i) for i in range(count)) if text]

    @property
    def relative(self) -> bool:
        """Whether the thicknesses are factors of the property's (TFLAG)."""
        at = {6: 14, 8: 17}.get(self.corners, 10)
        return self.card.text(at) not in ("", "0")

    @property
    def _after(self) -> int:
        return 15 if self.corners == 8 else 3 + self.corners


class Geometry:
    """The mesh of a file, and what its grid points and elements are in it."""

    def __init__(self, path: Path, file: File, notes: Notes, second_order: str):
        bulk = bulk_of_file(file)
        cards = [card for card in file.cards if card.name in SHELLS]
        if not cards:
            raise ValueError(f"{path} has no shell elements ({', '.join(SHELLS)}).")
        self.systems = bulk.systems
        self.elements = [Element(card.whole(1), card, SHELLS[card.name]) for card in cards]
        shells = {element.label for element in self.elements}
        kept = np.isin(np.arange(len(bulk.elements)), [bulk.elements[label] for label in shells])
        number = np.cumsum(kept) - 1
        self._points = bulk.points
        self._cells = {label: int(number[bulk.elements[label]]) for label in shells}
        cells = bulk.cells if kept.all() else only(bulk.cells, kept)
        self.mesh, self._numbering = mesh_of_cells(cells, str(path), second_order=second_order)
        kinds = Counter(card.name for card in cards)
        notes.carried.update({f"{name} elements of the file": count for name, count in kinds.items()})

    def nodes(self, labels, missing_ok: bool, card: Card) -> tuple[Target, np.ndarray]:
        """Numbers in the mesh of grid points that shells use, twice over. Raises ValueError for those that there are
        not, unless `missing_ok`."""
        found = []
        for label in labels:
            if label in self._points:
                found.append(int(self._numbering.nodes[self._points[label]]))
            elif not missing_ok:
                raise ValueError(f"{card.where}: there is no GRID {label}.")
        numbers = np.array(sorted({number for number in found if number >= 0}), int)
        return tuple(numbers.tolist()), numbers

    def triangles(self, labels) -> np.ndarray:
        """(k,) triangles of elements of the file, those that are shells."""
        return self._numbering.triangles([self._cells[label] for label in labels if label in self._cells])

    def is_shell(self, label: int) -> bool:
        return label in self._cells

    def named(self, triangles: np.ndarray) -> Any:
        """What a table says for elements: the name of a property's set, else numbers."""
        for name, numbers in self.mesh.element_sets.items():
            if np.array_equal(numbers, np.sort(triangles)):
                return name
        return np.sort(triangles).tolist()

    def corners(self, element: Element) -> np.ndarray:
        """(3 or 4, 3) the corners of an element."""
        count = {6: 3, 8: 4}.get(element.corners, element.corners)
        return np.array([self.systems.grid(element.card.whole(3 + i), element.card) for i in range(count)])
