"""What connectors and obstacles have in common: a name, and contributions that they are made of."""

import abc
from typing import ClassVar

import equinox as eqx
import numpy as np

from jaxshell.model.contribution import Contribution
from jaxshell.model.mesh import Mesh
from jaxshell.model.quantities import QUANTITIES
from jaxshell.model.sets import OfSets
from jaxshell.numerics.checks import check_text, shown
from jaxshell.numerics.nearest import meant


class Item(OfSets):
    """Something that a scene has several of, each made of contributions."""

    kind: ClassVar[str]
    """Its name in scene files."""

    name: str | None = eqx.field(static=True, default=None, kw_only=True)
    """By which it is watched; None where it is not."""

    @abc.abstractmethod
    def parts(self) -> tuple[Contribution, ...]:
        """The contributions that it is made of."""

    def check(self, mesh: Mesh) -> None:
        """Raise ValueError where it does not fit the mesh; called when the scene is made."""

    def holds(self, mesh: Mesh) -> list[tuple[np.ndarray, np.ndarray]]:
        """What motions it resists by an energy, without which statics has no answer: nodes (c,) of a group, and rows
        (r, 6c) by their velocities and spins. None where that is not sure. Called of concrete items only."""
        return []

    def segments(self, mesh: Mesh) -> np.ndarray:
        """(k, 2, 3) lines from end to end by which pictures show it; one of no length marks a node."""
        return np.zeros((0, 2, 3))

    def quantities(self) -> tuple[str, ...]:
        """What of it can be watched: what its parts measure."""
        return tuple(dict.fromkeys(word for part in self.parts() for word in part.quantities()))


def check_names(items: tuple[Item, ...]) -> None:
    """Raise ValueError for a name that is no text, and for one that two items have."""
    names = [item.name for item in items if item.name is not None]
    for name in names:
        check_text("The name of a connector or an obstacle", name)
        if names.count(name) > 1:
            raise ValueError(f"Two connectors or obstacles have the name {shown(name)}.")


def named(what: str, items: tuple[Item, ...], name: str) -> Item:
    """The item of that name. Raises ValueError, which begins with `what`, that lists the names that there are."""
    found = {item.name: item for item in items if item.name is not None}
    if name not in found:
        known = f"those of the scene are {', '.join(map(repr, found))}" if found else "none has a name (name=...)"
        raise ValueError(f"{what}: there is no connector or obstacle {shown(name)}: {known}.{meant(name, found)}")
    return found[name]


def check_quantity(what: str, item: Item, component, triangles: np.ndarray) -> None:
    """Raise ValueError, which begins with `what`, where an item does not have what is watched of it."""
    if component not in item.quantities():
        choices = ", ".join(item.quantities()) or "nothing"
        raise ValueError(
            f"{what}: the {item.kind} {item.name!r} has no {shown(component)}; what can be watched of it is {choices}."
        )
    if QUANTITIES[component].over == "one":
        counts = [len(part.groups(triangles).array) for part in item.parts() if component in part.quantities()]
        if max(counts) > 1:
            raise ValueError(
                f"{what}: the {item.kind} {item.name!r} is {max(counts)} of its kind, and the {component} of one is "
                f"watched: state that one by itself, with a name of its own."
            )
