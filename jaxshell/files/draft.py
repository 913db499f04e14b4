"""What a model file of another program becomes: the tables of a scene file, its mesh, and what is not carried over."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxshell.model.cells import Cells
from jaxshell.model.mesh import Mesh
from jaxshell.model.supports import DOFS

Target = str | tuple[int, ...]
"""Nodes or elements as a table of a scene file has them: the name of a set, or numbers."""

_HOLDS = {
    DOFS: "clamped",
    DOFS[:3]: "pinned",
    ("ux", "ry", "rz"): "symmetry x",
    ("uy", "rx", "rz"): "symmetry y",
    ("uz", "rx", "ry"): "symmetry z",
}


@dataclass
class Notes:
    """What was carried over, and what was not."""

    carried: Counter = field(default_factory=Counter)
    """How many of each kind of thing."""
    left_out: list[str] = field(default_factory=list)
    """A line for each thing that has no counterpart, but leaves the answer what it is."""
    remarks: list[str] = field(default_factory=list)
    """A line for each thing that is taken in a way that is not the file's, or that the file does not say."""
    missing: list[str] = field(default_factory=list)
    """A line for each thing without which the answer is another."""

    def settle(self, path: Path, partial: bool) -> None:
        """Raise ValueError that lists what is missing, or move it to what is left out where `partial`."""
        if self.missing and not partial:
            raise ValueError(
                f"{path}: without what jaxshell has no counterpart of, the answer would be another:\n"
                + "".join(f"  {line}\n" for line in self.missing)
                + "partial=True (--partial on the command line) carries over the rest."
            )
        self.left_out[:0] = self.missing
        self.missing = []

    def lines(self) -> list[str]:
        """What was not carried over, and the remarks, one line each."""
        return [f"not carried over: {line}" for line in self.left_out] + [f"note: {line}" for line in self.remarks]


@dataclass
class Draft:
    """A model as a scene: the tables of its file but [mesh], and the mesh."""

    path: Path
    mesh: Mesh
    tables: dict[str, Any]
    notes: Notes
    reading: dict[str, Any] = field(default_factory=dict)
    """What `Mesh.read` would have to be told for the same mesh."""


def only(cells: Cells, kept: np.ndarray) -> Cells:
    """The cells of a file that are kept (c,), with their new numbers in the sets."""
    number, blocks, start = np.cumsum(kept) - 1, [], 0
    for kind, block in cells.blocks:
        here = kept[start : start + len(block)]
        start += len(block)
        if here.any():
            blocks.append((kind, block[here]))
    every = {name: np.unique(numbers) for name, numbers in cells.element_sets.items()}
    sets = {name: number[numbers[kept[numbers]]] for name, numbers in every.items()}
    return replace(cells, blocks=blocks, element_sets={name: found for name, found in sets.items() if len(found)})


class Holds:
    """Degrees of freedom (0 to 5) of nodes that are held, or moved; a later word on one replaces an earlier one."""

    def __init__(self) -> None:
        self._held: dict[tuple[Target, tuple[int, ...]], set[int]] = {}
        self._moved: dict[tuple[Target, tuple[int, ...], Any], dict[int, float]] = {}

    def hold(self, target: Target, nodes: np.ndarray, dofs: Iterable[int]) -> None:
        """`nodes` are the numbers that `target` stands for."""
        dofs = set(dofs)
        self._held.setdefault((target, tuple(nodes.tolist())), set()).update(dofs)

    def move(self, target: Target, nodes: np.ndarray, dof: int, value: float, history: Any) -> None:
        """`history` is (name, table): the table of a scene file under a name to tell it by."""
        chosen = tuple(nodes.tolist())
        for (other, numbers), dofs in list(self._held.items()):
            if dof in dofs and set(numbers) & set(chosen):
                self._release(other, numbers, dof, set(chosen))
        self._moved.setdefault((target, chosen, history), {})[dof] = value

    def _release(self, target: Target, numbers: tuple[int, ...], dof: int, taken: set[int]) -> None:
        self._held[target, numbers].discard(dof)
        rest = tuple(node for node in numbers if node not in taken)
        if rest:
            self._held.setdefault((rest, rest), set()).add(dof)

    def tables(self, histories: dict) -> list[dict[str, Any]]:
        """[[supports]]: one for each set, and one for all single nodes that are held alike."""
        alike: dict[tuple[int, ...], set[int]] = {}
        found = []
        for (target, numbers), dofs in self._held.items():
            if not dofs:
                continue
            if isinstance(target, str):
                found.append({"nodes": target, "hold": _hold(dofs)})
            else:
                alike.setdefault(tuple(sorted(dofs)), set()).update(numbers)
        found += [{"nodes": sorted(nodes), "hold": _hold(dofs)} for dofs, nodes in alike.items()]
        for (target, _, history), values in self._moved.items():
            dofs = sorted(values)
            found.append(
                {
                    "nodes": target if isinstance(target, str) else list(target),
                    "hold": [DOFS[dof] for dof in dofs],
                    "displacement": [values[dof] for dof in dofs],
                    "history": histories[history],
                }
            )
        return found


def _hold(dofs: Iterable[int]) -> str | list[str]:
    names = tuple(DOFS[dof] for dof in sorted(dofs))
    return _HOLDS.get(names, list(names))


_VALUES = {"follower force": "components"}
"""Keys of a load's value, where that is not its kind."""


class Forces:
    """Forces and moments on nodes, which add up."""

    def __init__(self) -> None:
        self._of_sets: dict[tuple[str, str, Any], np.ndarray] = {}
        self._of_nodes: dict[tuple[str, Any], dict[int, np.ndarray]] = {}

    def add(self, kind: str, target: Target, vector, history: Any) -> None:
        """`kind` is "force", "moment" or "follower force", `history` a name to tell it by."""
        vector = np.asarray(vector, float)
        if isinstance(target, str):
            self._of_sets[kind, target, history] = self._of_sets.get((kind, target, history), np.zeros(3)) + vector
            return
        nodes = self._of_nodes.setdefault((kind, history), {})
        for node in target:
            nodes[node] = nodes.get(node, np.zeros(3)) + vector

    def tables(self, histories: dict) -> list[dict[str, Any]]:
        """[[loads]]: one for each set, and one for all single nodes of a history."""
        found = []
        for (kind, target, history), vector in self._of_sets.items():
            table = {"kind": kind, "nodes": target, _VALUES.get(kind, kind): vector.tolist()}
            found.append(with_history(table, histories[history]))
        for (kind, history), nodes in self._of_nodes.items():
            order = sorted(nodes)
            vectors = [nodes[node].tolist() for node in order]
            value = vectors[0] if all(vector == vectors[0] for vector in vectors) else vectors
            table = {"kind": kind, "nodes": order, _VALUES.get(kind, kind): value}
            found.append(with_history(table, histories[history]))
        return found


def with_history(table: dict[str, Any], history: dict[str, Any] | None) -> dict[str, Any]:
    """The table with a history, where it has one that is not 1 throughout."""
    return table if history is None else {**table, "history": history}
