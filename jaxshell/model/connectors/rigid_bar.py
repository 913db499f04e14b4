"""Rigid bars."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.connectors.joint import Conditions, Joint, named
from jaxshell.model.contribution import Contribution, Place
from jaxshell.model.sets import SetName, nodes_or_name
from jaxshell.numerics.frozen import Frozen


class RigidBar(Joint):
    """A bar without mass that keeps the distance that two nodes have at the start.

    Arguments:
        a, b: nodes, or names of sets, joined one by one.
        name: what watches call it.

    Enforced by multipliers: exact at the ends of steps. It does no work and keeps the momenta (`EnergyMomentum`).
    Raises ValueError for nodes in one place.
    """

    kind: ClassVar[str] = "rigid bar"
    joins_places: ClassVar[bool] = False

    a: Frozen | SetName = eqx.field(static=True)
    b: Frozen | SetName = eqx.field(static=True)

    def __init__(self, a, b, name: str | None = None):
        self.a, self.b = nodes_or_name("rigid bar a", a), nodes_or_name("rigid bar b", b)
        self.name = named(self.kind, name)

    def check_places(self, apart: np.ndarray, near: float) -> None:
        if (apart <= near).any():
            k = int(np.argmin(apart))
            raise ValueError(f"A rigid bar between nodes {self.a.array[k]} and {self.b.array[k]} has no length.")

    def parts(self) -> tuple[Contribution, ...]:
        return (Distance(self.pairs),)


class Distance(Conditions):
    """Two nodes that keep their distance: (|r|² - l²)/2l."""

    @property
    def count(self) -> int:
        return 1

    def data(self, surface) -> Float[Array, " k"]:
        x = surface.x0[self.nodes.array]
        return jnp.linalg.norm(x[:, 1] - x[:, 0], axis=1)

    def conditions(self, data, place: Place) -> Float[Array, "1"]:
        along = place.x[1] - place.x[0]
        return ((along @ along) / data - data)[None] / 2.0
