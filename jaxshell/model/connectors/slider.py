"""Sliders (prismatic joints)."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.connectors.joint import Conditions, Joint, named, twist
from jaxshell.model.contribution import Contribution, Place
from jaxshell.model.sets import SetName, nodes_or_name
from jaxshell.numerics.directions import across, unit_vector
from jaxshell.numerics.frozen import Frozen


class Slider(Joint):
    """A joint in which node `b` slides along an axis that node `a` carries, and turns with it (prismatic).

    Arguments:
        a, b: nodes, or names of sets, joined one by one. They may be apart: their distance across the axis stays.
        axis: (3,) in global components at the start; it turns with `a`. Differentiable.
        name: what watches call it.

    Enforced by multipliers: exact at the ends of steps. It does no work and keeps the momenta (`EnergyMomentum`).
    Raises ValueError for an axis of no length.
    """

    kind: ClassVar[str] = "slider"
    joins_places: ClassVar[bool] = False

    a: Frozen | SetName = eqx.field(static=True)
    b: Frozen | SetName = eqx.field(static=True)
    axis: Float[jax.Array, "3"]

    def __init__(self, a, b, axis, name: str | None = None):
        self.a, self.b = nodes_or_name("slider a", a), nodes_or_name("slider b", b)
        self.axis = unit_vector(axis, "slider axis")
        self.name = named(self.kind, name)

    @property
    def turning(self) -> np.ndarray:
        return self.pairs.array.ravel()

    def parts(self) -> tuple[Contribution, ...]:
        return OnLine(self.pairs, self.axis), Locked(self.pairs)


class OnLine(Conditions):
    """A second node that moves along an axis of the first."""

    axis: Float[jax.Array, "3"]

    @property
    def count(self) -> int:
        return 2

    def data(self, surface) -> tuple[Float[Array, "k 2 3"], Float[Array, "k 2"]]:
        x, (_, *directions) = surface.x0[self.nodes.array], across(self.axis)
        directions = jnp.stack(directions)
        return jnp.broadcast_to(directions, (len(x), 2, 3)), (x[:, 1] - x[:, 0]) @ directions.T

    def conditions(self, data, place: Place) -> Float[Array, "2"]:
        directions, offset = data
        return (directions @ place.R[0].T) @ (place.x[1] - place.x[0]) - offset


class Locked(Conditions):
    """Two nodes that turn together."""

    @property
    def count(self) -> int:
        return 3

    def data(self, surface) -> Float[Array, " k"]:
        return jnp.broadcast_to(surface.size, (len(self.nodes.array),))

    def conditions(self, data, place: Place) -> Float[Array, "3"]:
        return data * twist(place.R[0], place.R[1])
