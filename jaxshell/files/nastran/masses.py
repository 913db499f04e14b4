"""CONM2 as tables [[masses]] of a scene file."""

from typing import Any

import numpy as np

from jaxshell.files.draft import Notes
from jaxshell.files.nastran.control import Deck
from jaxshell.files.nastran.geometry import Geometry
from jaxshell.model.mesh_files.bulk_data import Card

MASSES = ("CONM2",)


def masses_of(deck: Deck, geometry: Geometry, notes: Notes, factor: float) -> dict[str, Any]:
    """[[masses]]; `factor` is PARAM,WTMASS. A note for each that jaxshell cannot have where it is."""
    found = []
    for card in deck.named(*MASSES):
        nodes, _ = geometry.nodes([card.whole(2)], False, card)
        reason = _beyond(card) if nodes else "at a grid point that no shell has"
        if reason:
            notes.missing.append(f"{card}: {reason}")
            continue
        table: dict[str, Any] = {"nodes": list(nodes), "mass": factor * card.number(4, 0.0)}
        inertia = factor * _tensor(card)
        if inertia.any():
            table["inertia"] = inertia.tolist()
        found.append(table)
        notes.carried["point masses"] += 1
    return {"masses": found} if found else {}


def _beyond(card: Card) -> str:
    """Why it cannot be carried over; empty where it can."""
    if card.whole(3, 0) < 0 or any(card.number(k, 0.0) for k in (5, 6, 7)):
        return "beside its grid point (X1, X2, X3): make the place a point, which a RigidBody carries"
    if card.whole(3, 0) and _tensor(card).any():
        return f"inertia in the axes of system {card.whole(3)}"
    return ""


def _tensor(card: Card) -> np.ndarray:
    """I11, I21, I22, I31, I32, I33; the off-diagonal ones with the sign of ∫ρ x y dV, which the tensor has negative."""
    a, ab, b, ac, bc, c = (card.number(k, 0.0) for k in range(9, 15))
    return np.array([[a, -ab, -ac], [-ab, b, -bc], [-ac, -bc, c]])
