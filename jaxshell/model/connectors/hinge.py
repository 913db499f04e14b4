"""Hinges."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.connectors.joint import Conditions, Joint, Together, named
from jaxshell.model.contribution import Contribution, Place
from jaxshell.model.sets import SetName, nodes_or_name
from jaxshell.numerics.directions import across, unit_vector
from jaxshell.numerics.frozen import Frozen


class Hinge(Joint):
    """A joint about which two nodes turn against each other about one axis.

    Arguments:
        a, b: nodes, or names of sets, joined one by one; in one place at the start.
        axis: (3,) in global components at the start; it turns with both. Differentiable.
        name: what watches call it.

    Enforced by multipliers: exact at the ends of steps. It carries no moment about its axis, does no work and keeps the
    momenta (`EnergyMomentum`). Raises ValueError for nodes that are apart and an axis of no length.
    """

    kind: ClassVar[str] = "hinge"

    a: Frozen | SetName = eqx.field(static=True)
    b: Frozen | SetName = eqx.field(static=True)
    axis: Float[jax.Array, "3"]
    name: str | None = eqx.field(static=True)

    def __init__(self, a, b, axis, name: str | None = None):
        self.a, self.b = nodes_or_name("hinge a", a), nodes_or_name("hinge b", b)
        self.axis = unit_vector(axis, "hinge axis")
        self.name = named(self.kind, name)

    @property
    def turning(self) -> np.ndarray:
        return self.pairs.array.ravel()

    def parts(self) -> tuple[Contribution, ...]:
        return Together(self.pairs), Aligned(self.pairs, self.axis)


class Aligned(Conditions):
    """An axis that two nodes share: that of the first stays perpendicular to two directions of the second."""

    axis: Float[jax.Array, "3"]

    @property
    def count(self) -> int:
        return 2

    def data(self, surface) -> tuple[Float[Array, "k 3 3"], Float[Array, " k"]]:
        k = len(self.nodes.array)
        return jnp.broadcast_to(across(self.axis), (k, 3, 3)), jnp.broadcast_to(surface.size, (k,))

    def conditions(self, data, place: Place) -> Float[Array, "2"]:
        axes, size = data
        return size * (axes[1:] @ place.R[1].T) @ (place.R[0] @ axes[0])
