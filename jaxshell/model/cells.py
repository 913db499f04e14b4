"""Cells as mesh files hold them, made into the triangles of a shell; sets of points, cells and sides follow.

Kinds are named as meshlane names them: vertex, line, line3, triangle, quad, triangle6, quad8, quad9, tetra, ...
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from jaxshell.model.repair import edges_of, merged, only_used, oriented, split_quads

_LINEAR = {"triangle": ([[0, 1, 2]], []), "quad": ([], [[0, 1, 2, 3]])}
_SECOND_ORDER = {
    "triangle6": ([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]], []),
    "quad8": ([[0, 4, 7], [4, 1, 5], [5, 2, 6], [6, 3, 7]], [[4, 5, 6, 7]]),
    "quad9": ([], [[0, 4, 8, 7], [4, 1, 5, 8], [8, 5, 2, 6], [7, 8, 6, 3]]),
}
"""The triangles and quads between the nodes of a cell; those between its corners have the middle ones on its sides."""
LINES = {"line": [[0, 1]], "line3": [[0, 2], [2, 1]], "line4": [[0, 2], [2, 3], [3, 1]]}
SIDES = {
    kind: [
        [[i, i + corners], [i + corners, (i + 1) % corners]] if kind in _SECOND_ORDER else [[i, (i + 1) % corners]]
        for i in range(corners)
    ]
    for kind, corners in (("triangle", 3), ("quad", 4), ("triangle6", 3), ("quad8", 4), ("quad9", 4))
}
"""The sides of a cell, in the order of its corners: one edge each, or two that meet in the side's node."""
_CORNERS = {"vertex": 1, "line": 2, "line3": 3, "line4": 4, "triangle": 3, "quad": 4, "triangle6": 6, "quad8": 8,
            "quad9": 9}  # fmt: skip
"""How many nodes a cell has."""
_HARMLESS = ("vertex", *LINES)
"""Cells of lower dimension, which mark points and curves of the geometry."""


@dataclass(frozen=True)
class Cells:
    """What a mesh file holds.

    Arguments:
        points: (n, 2) or (n, 3) coordinates [length].
        blocks: [(kind, cells (k, c))] in the order of the file; points are counted from 0.
        node_sets: {name: numbers of points}.
        element_sets: {name: numbers of cells}, which are counted through all blocks. Those of a set that are lines make
            a side set of its name, and a node set where no other has the name; those that are points a node set.
        side_sets: {name: (k, 2) points}, edges of cells, in either order.
        notes: what of the file could not be taken; a warning tells of it.
    """

    points: np.ndarray
    blocks: Sequence[tuple[str, np.ndarray]]
    node_sets: Mapping[str, np.ndarray] = field(default_factory=dict)
    element_sets: Mapping[str, np.ndarray] = field(default_factory=dict)
    side_sets: Mapping[str, np.ndarray] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Numbering:
    """Where points and cells of a file are in the mesh.

    Arguments:
        nodes: (n,) the node that each point is, -1 where it is dropped. Points keep their order.
        first: (c + 1,) cell i is made of the triangles first[i] to first[i + 1] - 1: of none where it is no surface.
        turned: (m,) whether the triangle's normal is opposite to its cell's, as `orient` turns them.
    """

    nodes: np.ndarray
    first: np.ndarray
    turned: np.ndarray

    def triangles(self, cells) -> np.ndarray:
        """(k,) the triangles of some cells, cell by cell."""
        cells = np.asarray(cells, np.int64).ravel()
        count = self.first[cells + 1] - self.first[cells]
        within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        return np.repeat(self.first[cells], count) + within


@dataclass(frozen=True)
class Surface:
    """Nodes (n, 3), triangles (m, 3) and sets as `Mesh` takes them, and the numbering that leads there."""

    nodes: np.ndarray
    triangles: np.ndarray
    node_sets: dict[str, np.ndarray]
    element_sets: dict[str, np.ndarray]
    side_sets: dict[str, np.ndarray]
    numbering: Numbering


def surface(
    cells: Cells, where: str, *, quads: str, second_order: str, merge: float | None, orient: bool, stacklevel: int = 2
) -> Surface:
    """The shell that a file's triangles and quads make; elements keep the order of their cells.

    `where` names the file in messages. `quads`, `second_order`, `merge` and `orient` as in `Mesh.read`. A warning
    names cells that are left out, and sets of which all or a part is. Raises ValueError for cells that make no shell.
    """
    _check_kinds(cells.blocks, where, quads, second_order)
    points = _points(cells.points, where)
    _check_corners(cells.blocks, where, len(points))
    triangles, first = _cut(points, cells.blocks)
    nodes, triangles, number = only_used(points, triangles)
    try:
        if merge is not None:
            nodes, triangles, again = merged(nodes, triangles, merge)
            number = np.where(number < 0, -1, again[number])
        agreed = oriented(triangles) if orient else triangles
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
    numbering = Numbering(number, first, (agreed != triangles).any(axis=1))
    losses = _Losses(cells.notes)
    sets = _sets(cells, numbering, agreed, losses)
    losses.add_cells(cells)
    losses.warn(where, stacklevel + 1)
    return Surface(nodes, agreed, *sets, numbering)


# --- cells -----------------------------------------------------------------------------------------------


def _points(points, where: str) -> np.ndarray:
    points = np.asarray(points)
    if points.ndim != 2 or points.shape[1] not in (2, 3) or points.dtype.kind not in "fiu":
        raise ValueError(f"{where} is broken: its points have shape {points.shape}, not (n, 3).")
    points = np.asarray(points, float)
    if not np.isfinite(points).all():
        first = int(np.argmin(np.isfinite(points).all(axis=1)))
        raise ValueError(f"{where} is broken: its point {first} lies at {points[first].tolist()}.")
    return np.pad(points, ((0, 0), (0, 3 - points.shape[1])))


def _check_kinds(blocks, where: str, quads: str, second_order: str) -> None:
    number = _numbers(blocks)
    taken = ["triangle", *(["quad"] if quads == "split" else []), *(_SECOND_ORDER if second_order == "split" else [])]
    refused = [kind for kind in number if kind not in (*taken, *_HARMLESS)]
    if refused:
        raise ValueError(
            f"{where} holds {_listed(number, refused)} cells, which are no shell elements here. {_cure(refused)}"
        )
    if not any(kind in taken for kind in number):
        raise ValueError(f"{where} holds no triangles (it has: {_listed(number, number) or 'no cells'}). {_MESH_ANEW}")


_MESH_ANEW = "Mesh the surface with 3-node triangles or 4-node quads."


def _cure(refused: list[str]) -> str:
    cures = []
    if "quad" in refused:
        cures.append('quads="split" cuts quads in two.')
    if any(kind in _SECOND_ORDER for kind in refused):
        cures.append(
            'second_order="split" cuts cells of second order along the nodes on their sides: triangle6 in 4 triangles, '
            "quad8 in 6, quad9 in 8."
        )
    others = [kind for kind in refused if kind != "quad" and kind not in _SECOND_ORDER]
    return " ".join([*cures, _MESH_ANEW] if others or not cures else cures)


def _numbers(blocks) -> dict[str, int]:
    """How many cells there are of each kind that there is."""
    number: dict[str, int] = {}
    for kind, cells in blocks:
        if len(cells):
            number[kind] = number.get(kind, 0) + len(cells)
    return number


def _listed(number: Mapping[str, int], kinds) -> str:
    return ", ".join(f"{number[kind]} {kind}" for kind in kinds)


def _check_corners(blocks, where: str, n_points: int) -> None:
    for kind, cells in blocks:
        if len(cells) and np.shape(cells)[1:] != (_CORNERS[kind],):
            raise ValueError(f"{where} is broken: a {kind} does not have {_CORNERS[kind]} nodes.")
        if len(cells) and (cells.min() < 0 or cells.max() >= n_points):
            raise ValueError(f"{where} is broken: a {kind} names a node that it does not have.")


def _cut(points: np.ndarray, blocks) -> tuple[np.ndarray, np.ndarray]:
    """(m, 3) triangles of all cells, in their order, and (c + 1,) the first of each cell."""
    found, count = [np.zeros((0, 3), np.int64)], [np.zeros(0, np.int64)]
    for kind, cells in blocks:
        number = np.zeros(len(cells), np.int64)
        if len(cells) and kind not in _HARMLESS:
            triangles, owner = _cut_block(points, np.asarray(cells, np.int64), *(_LINEAR | _SECOND_ORDER)[kind])
            number = np.bincount(owner, minlength=len(cells))
            found.append(triangles)
        count.append(number)
    return np.concatenate(found), np.concatenate([[0], np.cumsum(np.concatenate(count))])


def _cut_block(points, cells: np.ndarray, triangles: list, quads: list) -> tuple[np.ndarray, np.ndarray]:
    """(m, 3) triangles of cells (k, c), and (m,) the cell of each, given the triangles and quads of one cell."""
    found, owner = [], []
    if triangles:
        found.append(cells[:, triangles].reshape(-1, 3))
        owner.append(np.repeat(np.arange(len(cells)), len(triangles)))
    if quads:
        halves, quad = split_quads(points, cells[:, quads].reshape(-1, 4))
        found.append(halves)
        owner.append(quad // len(quads))
    order = np.argsort(np.concatenate(owner), kind="stable")
    return np.concatenate(found)[order], np.concatenate(owner)[order]


# --- sets ------------------------------------------------------------------------------------------------


class _Losses:
    """What of a file is not in the mesh: cells, whole sets, parts of sets."""

    def __init__(self, notes: Sequence[str]):
        self.notes, self.cells, self.whole, self.partly = notes, "", [], []

    def add_set(self, what: str, name: str, kept: int, of: int, things: str) -> None:
        if not kept:
            self.whole.append(f"{what} set {name!r}")
        elif kept < of:
            self.partly.append(f"{what} set {name!r} ({of - kept} of {of} {things})")

    def add_cells(self, cells: Cells) -> None:
        """Points and lines that no set names."""
        named = np.zeros(sum(len(block) for _, block in cells.blocks), bool)
        for numbers in cells.element_sets.values():
            named[numbers] = True
        number: dict[str, int] = {}
        start = 0
        for kind, block in cells.blocks:
            alone = int((~named[start : start + len(block)]).sum())
            if kind in _HARMLESS and alone:
                number[kind] = number.get(kind, 0) + alone
            start += len(block)
        self.cells = _listed(number, number)

    def warn(self, where: str, stacklevel: int) -> None:
        said = []
        if self.cells:
            said.append(f"{self.cells} cells are left out; a shell is made of triangles and quads.")
        if self.whole:
            said.append(f"Left out, since no triangle or quad has any of it: {', '.join(self.whole)}.")
        if self.partly:
            said.append(f"Left out of sets, since no triangle or quad has it: {', '.join(self.partly)}.")
        said += [f"{note[0].upper()}{note[1:]}." for note in self.notes]
        if said:
            warnings.warn(f"{where}: {' '.join(said)}", stacklevel=stacklevel + 1)


def _sets(cells: Cells, numbering: Numbering, triangles: np.ndarray, losses: _Losses) -> tuple[dict, dict, dict]:
    """Node, element and side sets of the mesh."""
    points, elements = dict(cells.node_sets), dict(cells.element_sets)
    sides = dict(cells.side_sets)
    for name in list(elements):
        chosen, lines, corners = _by_dimension(cells.blocks, elements[name])
        lines = _through_middles(lines, cells.blocks)
        if len(chosen) < len(elements[name]) and not len(chosen):
            del elements[name]
        else:
            elements[name] = chosen
        if len(lines):
            sides[name] = np.concatenate([sides[name], lines]) if name in sides else lines
        if (len(lines) or len(corners)) and name not in cells.node_sets:
            points[name] = np.concatenate([lines.ravel(), corners])
    return (
        _node_sets(points, numbering.nodes, losses),
        _element_sets(elements, numbering, losses),
        _side_sets(sides, numbering.nodes, triangles, losses),
    )


def _by_dimension(blocks, numbers) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of some cells: (k,) those that are surfaces, (l, 2) pieces of the lines, (p,) the points."""
    numbers = np.unique(np.asarray(numbers, np.int64))
    chosen, lines, corners = [numbers[:0]], [np.zeros((0, 2), np.int64)], [numbers[:0]]
    start = 0
    for kind, block in blocks:
        here = numbers[(numbers >= start) & (numbers < start + len(block))]
        if kind in LINES:
            lines.append(block[here - start][:, LINES[kind]].reshape(-1, 2))
        elif kind == "vertex":
            corners.append(block[here - start].ravel())
        else:
            chosen.append(here)
        start += len(block)
    return np.concatenate(chosen), np.concatenate(lines), np.concatenate(corners)


def _through_middles(lines: np.ndarray, blocks) -> np.ndarray:
    """(k, 2) lines, those from corner to corner of a cell of second order in two, through the node on its side."""
    second = [block[:, SIDES[kind]].reshape(-1, 2, 2) for kind, block in blocks if kind in _SECOND_ORDER and len(block)]
    if not second or not len(lines):
        return lines
    sides = np.concatenate(second)
    count = int(max(sides.max(), lines.max())) + 1
    ends, first = np.unique(_keys(sides[:, [0, 1], [0, 1]], count), return_index=True)
    at = np.minimum(np.searchsorted(ends, _keys(lines, count)), len(ends) - 1)
    whole = ends[at] == _keys(lines, count)
    return np.concatenate([lines[~whole], sides[first[at[whole]]].reshape(-1, 2)])


def _node_sets(sets: Mapping, number: np.ndarray, losses: _Losses) -> dict[str, np.ndarray]:
    found = {}
    for name, points in sets.items():
        nodes = number[np.unique(np.asarray(points, np.int64))]
        losses.add_set("node", name, int((nodes >= 0).sum()), len(nodes), "nodes")
        found[name] = np.unique(nodes[nodes >= 0])
    return {name: nodes for name, nodes in found.items() if len(nodes)}


def _element_sets(sets: Mapping, numbering: Numbering, losses: _Losses) -> dict[str, np.ndarray]:
    found = {name: numbering.triangles(cells) for name, cells in sets.items()}
    for name, elements in found.items():
        losses.add_set("element", name, len(elements), 0, "cells")
    return {name: elements for name, elements in found.items() if len(elements)}


def _side_sets(sets: Mapping, number: np.ndarray, triangles: np.ndarray, losses: _Losses) -> dict[str, np.ndarray]:
    """Pairs of nodes that are edges of the mesh, each once."""
    count = len(number)
    edges = _keys(edges_of(triangles), count)
    found = {}
    for name, pairs in sets.items():
        pairs = np.unique(np.sort(np.asarray(pairs, np.int64).reshape(-1, 2), axis=1), axis=0)
        nodes = number[pairs]
        kept = nodes[(nodes >= 0).all(axis=1) & np.isin(_keys(nodes, count), edges)]
        losses.add_set("side", name, len(kept), len(pairs), "edges")
        found[name] = np.unique(np.sort(kept, axis=1), axis=0)
    return {name: kept for name, kept in found.items() if len(kept)}


def _keys(pairs: np.ndarray, count: int) -> np.ndarray:
    """(k,) one number for each pair of nodes, whichever is first."""
    pairs = np.sort(np.asarray(pairs, np.int64), axis=1)
    return pairs[:, 0] * count + pairs[:, 1]
