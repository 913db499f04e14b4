"""The shell elements of an input file as a mesh, and what the file's numbers and names are in it.

Nodes, elements and sets are read as `Mesh.read` reads them. The cards beside them belong to the whole file, or to an
instance of the part in which they stand, at its place.
"""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from jaxshell.files.draft import Notes, Target, only
from jaxshell.model.mesh import mesh_of_cells
from jaxshell.model.mesh_files.abaqus import inp_of_cards
from jaxshell.model.mesh_files.cards import Card, Line

SHELLS = (
    "S3", "S3R", "S3RS", "STRI3", "S4", "S4R", "S4RS", "S4RSW", "S4R5", "S6", "STRI65", "S8", "S8R", "S8R5", "S9R5",
)  # fmt: skip
"""Element types that are carried over."""
LUMPS = ("MASS", "ROTARYI")
"""Element types of one node, which are carried over as point masses."""
_OF_MESH = ("NODE", "ELEMENT", "NSET", "ELSET", "SURFACE", "ASSEMBLY", "ENDASSEMBLY")


@dataclass(frozen=True)
class Scope:
    """Where a card stands: in the file ("") or in an instance, in capitals, moved by `place` and then turned."""

    name: str = ""
    place: np.ndarray = field(default_factory=lambda: np.zeros(3))
    turn: np.ndarray = field(default_factory=lambda: np.eye(3))

    def moved(self, points) -> np.ndarray:
        """Points (..., 3) of the part where the instance has them."""
        return (np.asarray(points, float) + self.place) @ self.turn.T


class Geometry:
    """The mesh of a file, and what the file's numbers and names of sets are in it."""

    def __init__(self, cards: list[Card], where: str, notes: Notes, second_order: str):
        inp = inp_of_cards(cards)
        shell = np.array([kind in SHELLS for kind in inp.types], bool)
        if not shell.any():
            kinds = ", ".join(sorted(set(inp.types))) or "none"
            raise ValueError(f"{where} has no shell elements such as S3, S4 and S4R; its element types: {kinds}.")
        kinds = Counter(inp.types)
        notes.missing += [
            f"{number} elements of type {kind}, which are no shells"
            for kind, number in kinds.items()
            if kind not in SHELLS and kind not in LUMPS
        ]
        notes.carried.update({f"{kind} elements of the file": kinds[kind] for kind in kinds if kind in SHELLS})
        self._inp, self._shell = inp, shell
        self._cell = np.cumsum(shell) - 1
        cells = inp.cells if shell.all() else only(inp.cells, shell)
        self.mesh, self._numbering = mesh_of_cells(cells, where, second_order=second_order)
        self._node_sets = {name.upper(): name for name in inp.cells.node_sets}
        self._element_sets = {name.upper(): name for name in inp.cells.element_sets}

    def nodes(self, text: str, scope: Scope, where: str) -> tuple[Target, np.ndarray]:
        """What a table says for a node or a set of the file, and its (k,) numbers in the mesh; none where no shell has
        them. Raises ValueError for what there is not."""
        for name, label in _readings(text, scope):
            if label is not None and (name, label) in self._inp.points:
                point = self._inp.points[name, label]
                numbers = self._numbering.nodes[[point]]
            elif label is None and name in self._node_sets:
                name = self._node_sets[name]
                numbers = self._numbering.nodes[np.unique(self._inp.cells.node_sets[name])]
                if name in self.mesh.node_sets:
                    return name, np.sort(numbers[numbers >= 0])
            else:
                continue
            numbers = np.sort(numbers[numbers >= 0])
            return tuple(numbers.tolist()), numbers
        raise ValueError(f"{where}: there is no node {'' if text.isdigit() else 'set '}{text}.")

    def elements(self, text: str, scope: Scope, where: str) -> tuple[Target, np.ndarray]:
        """The same of elements, as triangles of the mesh."""
        for name, label in _readings(text, scope):
            if label is not None and (name, label) in self._inp.elements:
                return self._target("", np.array([self._inp.elements[name, label]]))
            if label is None and name in self._element_sets:
                name = self._element_sets[name]
                return self._target(name, np.unique(self._inp.cells.element_sets[name]))
        raise ValueError(f"{where}: there is no element {'' if text.isdigit() else 'set '}{text}.")

    def has(self, kind: str) -> bool:
        """Whether the file has elements of a type."""
        return kind in self._inp.types

    def lumped(self, text: str, scope: Scope, where: str, kind: str) -> tuple[np.ndarray, int]:
        """The nodes (k,) of the mesh that the elements of one node of this type have in a set, and how many elements
        are at nodes of no shell. Raises ValueError where there is no such set."""
        for name, label in _readings(text, scope):
            if label is None and name in self._element_sets:
                cells = np.unique(self._inp.cells.element_sets[self._element_sets[name]])
                break
        else:
            raise ValueError(f"{where}: there is no element set {text}.")
        start, points = 0, np.zeros(len(self._inp.types), int)
        for _, block in self._inp.cells.blocks:
            points[start : start + len(block)] = block[:, 0]
            start += len(block)
        chosen = [cell for cell in cells if self._inp.types[cell] == kind]
        nodes = self._numbering.nodes[points[chosen]]
        return nodes[nodes >= 0], int(np.sum(nodes < 0))

    def surface(self, text: str, scope: Scope, where: str) -> list[tuple[Target, np.ndarray, str]]:
        """(table's word, triangles, face) of each face by which a surface has elements: SPOS, SNEG or another.

        Raises ValueError where there is no surface of the name.
        """
        for name, _ in _readings(text, scope):
            found = next((key for key in self._inp.faces if key.upper() == name), None)
            if found is None:
                continue
            faces: dict[str, list[int]] = {}
            for cell, face in self._inp.faces[found]:
                faces.setdefault(face, []).append(cell)
            named = [found, f"{found} (surface)"] if len(faces) == 1 else []
            return [(*self._surface_target(named, np.unique(cells)), face) for face, cells in faces.items()]
        raise ValueError(f"{where}: there is no surface {text}.")

    def label(self, triangle: int) -> str:
        """The file's number of an element of the mesh."""
        cell = int(np.searchsorted(self._numbering.first, triangle, side="right")) - 1
        for (instance, label), number in self._inp.elements.items():
            if self._shell[number] and self._cell[number] == cell:
                return f"{instance}.{label}" if instance else str(label)
        return str(triangle)

    def _surface_target(self, names: list[str], cells: np.ndarray) -> tuple[Target, np.ndarray]:
        for name in names:
            if np.array_equal(np.unique(self._inp.cells.element_sets.get(name, [])), cells):
                return self._target(name, cells)
        return self._target("", cells)

    def _target(self, name: str, cells: np.ndarray) -> tuple[Target, np.ndarray]:
        """Of cells of the file, and the name of their set."""
        numbers = np.sort(self._numbering.triangles(self._cell[cells[self._shell[cells]]]))
        return name if name in self.mesh.element_sets else tuple(numbers.tolist()), numbers


def _readings(text: str, scope: Scope) -> Iterable[tuple[str, int | None]]:
    """What a word may stand for, in the order of looking it up: (instance, number), or (name of a set, None)."""
    text = text.strip("\"'")
    instance, _, inner = text.rpartition(".")
    if inner.isdigit():
        yield (instance.upper() or scope.name), int(inner)
        return
    if instance.upper() == "ASSEMBLY":
        text, instance = inner, ""
    yield (f"{scope.name}.{text}" if scope.name else text).upper(), None
    yield text.upper(), None
    yield inner.upper(), None


def beside_the_mesh(cards: list[Card]) -> list[tuple[Card, Scope]]:
    """The cards that do not make the mesh, those of a part once for each of its instances. Raises ValueError with file
    and line for a rotation that is none."""
    parts: dict[str, list[Card]] = {}
    found: list[tuple[Card, Scope]] = []
    placed: set[str] = set()
    part, scope = None, Scope()
    for card in cards:
        if card.keyword == "PART":
            part = parts.setdefault(card.option("NAME").upper(), [])
        elif card.keyword == "INSTANCE":
            scope = _scope(card)
            placed.add(card.choice("PART", ""))
            found += [(inner, scope) for inner in parts.get(card.choice("PART", ""), [])]
        elif card.keyword in ("ENDPART", "ENDINSTANCE"):
            part, scope = None, Scope()
        elif card.keyword in _OF_MESH:
            continue
        elif part is not None:
            part.append(card)
        else:
            found.append((card, scope))
    alone = [(card, Scope(name)) for name, inner in parts.items() if name not in placed for card in inner]
    return alone + found


def _scope(card: Card) -> Scope:
    place, turn = np.zeros(3), np.eye(3)
    if card.lines:
        place = np.array([card.lines[0].number(i, 0.0) for i in range(3)])
    if len(card.lines) > 1:
        turn, start = _turn(card.lines[1])
        # x -> start + R (x + place - start)
        place = place - start + turn.T @ start
    return Scope(card.option("NAME").upper(), place, turn)


def _turn(line: Line) -> tuple[np.ndarray, np.ndarray]:
    start, end = (np.array([line.number(i + 3 * k) for i in range(3)]) for k in (0, 1))
    if not np.any(end - start):
        raise ValueError(f"{line.where}: the axis of the instance's rotation has no length.")
    return rotation(end - start, np.deg2rad(line.number(6))), start


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """(3, 3) the turn by `angle` [rad] about an axis of any length (Rodrigues)."""
    x, y, z = axis / np.linalg.norm(axis)
    W = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * W + (1 - np.cos(angle)) * W @ W
