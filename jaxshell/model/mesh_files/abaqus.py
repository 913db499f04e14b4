"""Meshes of Abaqus and CalculiX input files: nodes, elements, sets and surfaces, with parts and their instances."""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxshell.model.cells import SIDES, Cells
from jaxshell.model.mesh_files.cards import Card, Line, read_cards

_KINDS = {
    # Shells, membranes, rigid surfaces, plane stress and strain: the digit counts the nodes.
    r"(U?S|STRI|DS|M3D|SFM3D|R3D|CPS|CPE)3": ("triangle", 3),
    r"(U?S|DS|M3D|SFM3D|R3D|CPS|CPE)4": ("quad", 4),
    r"(U?S|STRI|DS|M3D|CPS|CPE)6": ("triangle6", 6),
    r"(U?S|DS|M3D|SFM3D|CPS|CPE)8": ("quad8", 8),
    r"(U?S|M3D)9": ("quad9", 9),
    # Beams, trusses, rigid lines, connectors and springs.
    r"(B|PIPE|ELBOW)[23]2|T[23]D3": ("line3", 3),
    r"(B|PIPE|ELBOW)[23][13]|T[23]D2|RB?[23]D2|CONN|SPRING[A2]|DASHPOT[A2]|GAP|JOINT|ITS": ("line", 2),
    r"MASS|ROTARYI|HEATCAP|SPRING1|DASHPOT1|DCOUP": ("vertex", 1),
}
_PLANE = ("CPS", "CPE")
_GENERATING = ("NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY")


@dataclass(frozen=True)
class Inp:
    """The mesh of an input file, and where its numbers are.

    Arguments:
        cells: points in the order in which nodes are defined, blocks in that of the elements, and all sets. Sets keep
            the name's first spelling; where several instances, or an instance and the assembly, have one of a name,
            that of an instance is called "instance.name". The faces of a surface are an element set of its name, its
            edges a side set.
        points: {(instance, node): point}, the instance in capitals, "" without one.
        elements: {(instance, element): cell}.
        types: the Abaqus type of each cell, in capitals.
        faces: {surface: [(cell, face)]}, faces in capitals as they are written: "SPOS", "SNEG", "E2", "S1" or "".
    """

    cells: Cells
    points: dict[tuple[str, int], int]
    elements: dict[tuple[str, int], int]
    types: list[str]
    faces: dict[str, list[tuple[int, str]]]


def read_cells(path) -> Cells:
    """What an input file holds. Raises ValueError with file and line."""
    return inp_of_cards(read_cards(Path(path))).cells


def inp_of_cards(cards: Iterable[Card]) -> Inp:
    """The mesh that cards state. Raises ValueError with file and line for what cannot be right, and for nodes and
    elements that are to be generated."""
    reading = _Reading()
    reading.read_model(cards)
    return reading.result()


class _Set:
    """A set that grows: its name as first written, and numbers of points or cells, or faces of cells."""

    def __init__(self, name: str):
        self.name, self.members = name, []


class _Reading:
    """The model as far as it is read. Everything is kept by instance ("" for none) and name or number."""

    def __init__(self):
        self.coordinates: list[list[float]] = []
        self.blocks: list[tuple[str, list[list[int]]]] = []
        self.types: list[str] = []
        self.points: dict[tuple[str, int], int] = {}
        self.elements: dict[tuple[str, int], int] = {}
        self.corners: list[list[int]] = []
        self.node_sets: dict[tuple[str, str], _Set] = {}
        self.element_sets: dict[tuple[str, str], _Set] = {}
        self.surfaces: dict[tuple[str, str], _Set] = {}
        self.missing: dict[str, int] = {}

    def read_model(self, cards: Iterable[Card]) -> None:
        """Parts are read once for every instance, at its place; a part without any where it is."""
        parts: dict[str, list[Card]] = {}
        placed: set[str] = set()
        inside, instance = None, None
        for card in cards:
            if card.keyword == "PART":
                inside = parts.setdefault(card.option("NAME").upper(), [])
            elif card.keyword in ("ENDPART", "ENDINSTANCE"):
                if instance is not None:
                    self._read_instance(instance, parts, inside or [])
                    placed.add(instance.choice("PART", ""))
                inside, instance = None, None
            elif card.keyword == "INSTANCE":
                inside, instance = [], card
            elif inside is not None:
                inside.append(card)
            else:
                self._read_card(card, "")
        for name, content in parts.items():
            if name not in placed:
                first = len(self.coordinates)
                self._read_all(content, name)
                self._place(first, [])

    def _read_instance(self, card: Card, parts: dict[str, list[Card]], more: list[Card]) -> None:
        part = card.choice("PART", "")
        if part and part not in parts:
            raise ValueError(f"{card.where}: there is no *PART {card.options['PART']}.")
        first = len(self.coordinates)
        self._read_all([*parts.get(part, []), *more], card.option("NAME").upper())
        self._place(first, card.lines)

    def _place(self, first: int, lines: list[Line]) -> None:
        """Move the points from `first` on: by the first line, then turned about the axis of the second."""
        x = np.array(self.coordinates[first:]).reshape(-1, 3)
        if lines:
            x = x + [lines[0].number(i, 0.0) for i in range(3)]
        if len(lines) > 1:
            a, b = (np.array([lines[1].number(i + 3 * end) for i in range(3)]) for end in (0, 1))
            x = _turned(x, a, b, lines[1].number(6), lines[1].where)
        self.coordinates[first:] = x.tolist()

    def _read_all(self, cards: list[Card], scope: str) -> None:
        for card in cards:
            self._read_card(card, scope)

    def _read_card(self, card: Card, scope: str) -> None:
        if card.keyword in _GENERATING:
            raise ValueError(f"{card.where}: {card.title} is not read; write all nodes and elements in full.")
        read = {"NODE": self._nodes, "ELEMENT": self._elements, "NSET": self._nset, "ELSET": self._elset,
                "SURFACE": self._surface}.get(card.keyword)  # fmt: skip
        if read is not None:
            if "INPUT" in card.options:
                raise ValueError(f"{card.where}: INPUT= is not read in {card.title}; use *INCLUDE.")
            read(card, scope)

    # --- nodes and elements ---

    def _nodes(self, card: Card, scope: str) -> None:
        if card.choice("SYSTEM", "R") != "R":
            raise ValueError(f"{card.where}: only rectangular coordinates (SYSTEM=R) are read.")
        found = []
        for line in card.lines:
            label, x = line.whole(0), [line.number(i, 0.0) for i in (1, 2, 3)]
            key = scope, label
            if key in self.points and self.coordinates[self.points[key]] != x:
                raise ValueError(f"{line.where}: node {label} is defined twice, at two places.")
            if key not in self.points:
                self.points[key] = len(self.coordinates)
                self.coordinates.append(x)
            found.append(self.points[key])
        if card.options.get("NSET"):
            self._add(self.node_sets, scope, card.options["NSET"], found)

    def _elements(self, card: Card, scope: str) -> None:
        kind_of_card = card.option("TYPE").upper()
        kind, count = next((k for pattern, k in _KINDS.items() if re.match(pattern, kind_of_card)), (kind_of_card, 0))
        if card.lines and (not self.blocks or self.blocks[-1][0] != kind):
            self.blocks.append((kind, []))
        found = []
        for fields, where in _rows(card, count):
            label = fields[0]
            if (scope, label) in self.elements:
                raise ValueError(f"{where}: element {label} is defined twice.")
            corners = [self._point(scope, node, f"{where}: element {label}") for node in fields[1 : count + 1]]
            if kind == "line3":
                corners = _middle_last(corners, np.array([self.coordinates[i] for i in corners]))
            self.elements[scope, label] = len(self.types)
            found.append(len(self.types))
            self.types.append(kind_of_card)
            self.corners.append(corners)
            self.blocks[-1][1].append(corners or [0])
        if card.options.get("ELSET"):
            self._add(self.element_sets, scope, card.options["ELSET"], found)

    def _point(self, scope: str, node: int, who: str) -> int:
        """The point of a node, which an instance may have from the assembly."""
        point = self.points.get((scope, node))
        if point is None:
            raise ValueError(f"{who} names node {node}, which is not defined before it.")
        return point

    # --- sets ---

    @staticmethod
    def _add(sets: dict[tuple[str, str], _Set], scope: str, name: str, members: list) -> None:
        sets.setdefault((scope, name.upper()), _Set(name)).members.extend(members)

    def _nset(self, card: Card, scope: str) -> None:
        found = self._members(card, scope, self.points, self.node_sets, "node")
        if card.options.get("ELSET"):
            cells = self._known(self.element_sets, scope, card.options["ELSET"], card.where)
            found += [point for cell in cells for point in self.corners[cell]]
        self._add(self.node_sets, scope, card.option("NSET"), found)

    def _elset(self, card: Card, scope: str) -> None:
        found = self._members(card, scope, self.elements, self.element_sets, "element")
        self._add(self.element_sets, scope, card.option("ELSET"), found)

    def _members(self, card: Card, scope: str, numbers: dict, sets: dict, what: str) -> list[int]:
        """Points or cells that the data lines of a set name: by number, by the name of a set, or from-to-step."""
        inner = card.choice("INSTANCE", "") or scope
        found: list[int] = []
        for line in card.lines:
            if "GENERATE" in card.options:
                step = line.whole(2, 1)
                if step < 1:
                    raise ValueError(f"{line.where}: the step of GENERATE must be 1 or more, but it is {step}.")
                chosen = _between(numbers, inner, line.whole(0), line.whole(1), step)
                found.extend(chosen)
                continue
            for field in filter(None, line.fields):
                found.extend(self._named(field, inner, numbers, sets, f"{what} set {_name(card)!r}", line.where))
        return found

    def _named(self, field: str, scope: str, numbers: dict, sets: dict, who: str, where: str) -> list[int]:
        field = field.strip("\"'")
        instance, _, inner = field.rpartition(".")
        for place, text in ((scope, field), (instance.upper(), inner)):
            if text.lstrip("+").isdigit():
                if (place, int(text)) in numbers:
                    return [numbers[place, int(text)]]
                self.missing[who] = self.missing.get(who, 0) + 1
                return []
            if (place, text.upper()) in sets:
                return sets[place, text.upper()].members
        if ("", field.upper()) in sets:
            return sets["", field.upper()].members
        raise ValueError(f"{where}: {who} names {field}, which is no number and no set that is defined before it.")

    @staticmethod
    def _known(sets: dict, scope: str, name: str, where: str) -> list[int]:
        found = sets.get((scope, name.upper())) or sets.get(("", name.upper()))
        if found is None:
            raise ValueError(f"{where}: there is no set {name} before it.")
        return found.members

    def _surface(self, card: Card, scope: str) -> None:
        if card.choice("TYPE", "ELEMENT") == "NODE":
            found = self._members(card, scope, self.points, self.node_sets, "node")
            self._add(self.node_sets, scope, card.option("NAME"), found)
        elif card.choice("TYPE", "ELEMENT") == "ELEMENT" and "COMBINE" not in card.options:
            for line in card.lines:
                who = f"surface {card.option('NAME')!r}"
                cells = self._named(line.text(0), scope, self.elements, self.element_sets, who, line.where)
                faces = [(cell, line.text(1).upper()) for cell in cells]
                self._add(self.surfaces, scope, card.option("NAME"), faces)

    # --- the result ---

    def result(self) -> Inp:
        nodes, elements, surfaces = map(_by_name, (self.node_sets, self.element_sets, self.surfaces))
        sides: dict[str, list] = {}
        strange: list[str] = []
        for name, faces in surfaces.items():
            on, edges = [], []
            for cell, face in faces:
                self._take_face(cell, face, on, edges, strange)
            if on:
                free = name if name not in elements or set(elements[name]) == set(on) else f"{name} (surface)"
                elements[free] = on
            if edges:
                sides[name] = edges
        notes = [f"{who} names {count} that the file does not have" for who, count in self.missing.items()]
        if strange:
            notes.append(f"faces of surfaces are left out: {', '.join(dict.fromkeys(strange))}")
        cells = Cells(
            np.array(self.coordinates).reshape(-1, 3),
            [(kind, np.array(rows, np.int64)) for kind, rows in self.blocks],
            {name: np.array(found, np.int64) for name, found in nodes.items()},
            {name: np.array(found, np.int64) for name, found in elements.items()},
            {name: np.array(found, np.int64) for name, found in sides.items()},
            tuple(notes),
        )
        return Inp(cells, self.points, self.elements, self.types, surfaces)

    def _take_face(self, cell: int, face: str, on: list, edges: list, strange: list) -> None:
        """Into `on` where it is the shell's face, into `edges` where it is an edge.

        S1, S2, ... are the edges of plane elements; of shells S1 and S2 are the faces and S3, S4, ... the edges, as in
        CalculiX. E1, E2, ... are edges everywhere.
        """
        sides = SIDES.get(self._kind(cell), [])
        plane = self.types[cell].startswith(_PLANE)
        if face in ("", "SPOS", "SNEG", "N", "P", "SN", "SP") or (face in ("S1", "S2") and not plane):
            on.append(cell)
            return
        number = int(face[1:]) if re.fullmatch(r"[ES]\d", face) else 0
        number -= 2 if face.startswith("S") and not plane else 0
        if 1 <= number <= len(sides):
            edges.extend([self.corners[cell][i] for i in pair] for pair in sides[number - 1])
        else:
            strange.append(f"{face} of {self.types[cell]}")

    def _kind(self, cell: int) -> str:
        return next((k for pattern, (k, _) in _KINDS.items() if re.match(pattern, self.types[cell])), "")


def _by_name(sets: dict[tuple[str, str], _Set]) -> dict[str, list]:
    """Sets by their name alone where no other has it or it is the model's own, else by "instance.name"."""
    count: dict[str, int] = {}
    for _, upper in sets:
        count[upper] = count.get(upper, 0) + 1
    return {
        found.name if not scope or count[upper] == 1 else f"{scope}.{found.name}": found.members
        for (scope, upper), found in sets.items()
    }


def _name(card: Card) -> str:
    return card.options.get("NSET") or card.options.get("ELSET") or card.options.get("NAME") or ""


def _between(numbers: dict, scope: str, first: int, last: int, step: int) -> list[int]:
    """Those there are of the numbers first, first + step, ... to last."""
    if (last - first) // step > 2 * len(numbers):
        labels = (
            label for at, label in numbers if at == scope and first <= label <= last and not (label - first) % step
        )
    else:
        labels = range(first, last + 1, step)
    return [numbers[scope, label] for label in labels if (scope, label) in numbers]


def _rows(card: Card, count: int) -> Iterable[tuple[list[int], str]]:
    """Each element's number and nodes, which go on in the next line until there are enough, or after a comma."""
    row: list[int] = []
    for line in card.lines:
        fields = line.fields[:-1] if line.fields[-1] == "" else line.fields
        row += [line.whole(i) for i in range(len(fields))]
        if len(row) <= count if count else line.fields[-1] == "":
            continue
        yield row, line.where
        row = []
    if row:
        raise ValueError(f"{card.lines[-1].where}: element {row[0]} has {len(row) - 1} nodes, not {count}.")


def _middle_last(corners: list[int], x: np.ndarray) -> list[int]:
    """Three nodes of a line with the middle one last, which some programs write second: the ends are furthest apart."""
    a, b = max(((0, 1), (0, 2), (1, 2)), key=lambda pair: float(np.linalg.norm(x[pair[0]] - x[pair[1]])))
    return [corners[a], corners[b], corners[3 - a - b]]


def _turned(x: np.ndarray, a: np.ndarray, b: np.ndarray, degrees: float, where: str) -> np.ndarray:
    """Points x (n, 3) turned about the axis from a to b."""
    length = np.linalg.norm(b - a)
    if length == 0:
        raise ValueError(f"{where}: the axis of the instance's rotation has no length.")
    axis, angle, arm = (b - a) / length, np.radians(degrees), x - a
    along = np.outer(arm @ axis, axis)
    return a + along + np.cos(angle) * (arm - along) + np.sin(angle) * np.cross(axis, arm)
