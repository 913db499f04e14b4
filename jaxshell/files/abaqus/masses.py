"""*MASS and *ROTARY INERTIA as tables [[masses]] of a scene file."""

from typing import Any

import numpy as np

from jaxshell.files.abaqus.geometry import LUMPS, Geometry, Scope
from jaxshell.files.draft import Notes
from jaxshell.model.mesh_files.cards import Card, Line

MASSES = ("MASS", "ROTARYINERTIA")
_TYPES = {"MASS": "MASS", "ROTARYINERTIA": "ROTARYI"}


class Masses:
    """The point masses of a file, at nodes that shells use."""

    def __init__(self, geometry: Geometry, notes: Notes):
        self._geometry, self._notes = geometry, notes
        self._tables: list[dict[str, Any]] = []
        self._seen: set[str] = set()

    def add(self, card: Card, scope: Scope) -> None:
        """A card. Raises ValueError with file and line for what is wrong in it."""
        kind = _TYPES[card.keyword]
        self._seen.add(kind)
        unknown = [key for key in ("ALPHA", "COMPOSITE", "ORIENTATION", "TYPE") if key in card.options]
        if unknown:
            self._notes.missing.append(f"{card}, {', '.join(unknown)}")
            return
        nodes, lost = self._geometry.lumped(card.option("ELSET"), scope, card.where, kind)
        if lost:
            self._notes.missing.append(f"{card}: {lost} at nodes that no shell has")
        if not len(nodes):
            return
        line = card.line(0)
        if kind == "MASS":
            table = {"nodes": nodes.tolist(), "mass": line.number(0)}
        else:
            table = {"nodes": nodes.tolist(), "mass": 0.0, "inertia": _tensor(line, scope)}
        self._tables.append(table)
        self._notes.carried["point masses"] += len(nodes)

    def tables(self) -> dict[str, Any]:
        """[[masses]]; a note for elements that no card gives a value."""
        for kind in LUMPS:
            if self._geometry.has(kind) and kind not in self._seen:
                self._notes.missing.append(f"elements of type {kind}, which no card gives a value")
        return {"masses": self._tables} if self._tables else {}


def _tensor(line: Line, scope: Scope) -> list[list[float]]:
    """I11, I22, I33, I12, I13, I23 are the tensor's components, I12 = -∫ρ x₁ x₂ dV; in a part along the part's axes."""
    a, b, c, ab, ac, bc = (line.number(i, 0.0) for i in range(6))
    tensor = np.array([[a, ab, ac], [ab, b, bc], [ac, bc, c]])
    return (scope.turn @ tensor @ scope.turn.T).tolist()
