"""Dashpots between nodes, or between nodes and points of space."""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.connectors.ends import End, Link, Nodes, check_each, end_of, nodes_of
from jaxshell.model.connectors.laws import length_of, ratio
from jaxshell.model.contribution import Contribution, Place, Resisting, Surface, between
from jaxshell.numerics.checks import float_array
from jaxshell.numerics.frozen import Frozen


class Dashpot(Link):
    """Dashpots along the line between two places: a force c d|r|/dt against its change, r from a to b.

    Arguments:
        a: a node, a list of nodes, or the name of a set of them.
        b: as many nodes, joined with those of `a` one by one; or a point of space, floats (3,), or (k, 3), which is
            differentiable. Whole numbers are nodes: the point (0, 0, 1) is (0.0, 0.0, 1.0).
        coefficient: c [force·time/length], one value or one for each. Differentiable.
        name: by which it is watched: "force" (tension is positive), of the mean rate of a step, and "length" at its
            end.

    What it takes is never negative and counts as dissipated energy; `EnergyMomentum` has it exactly. It acts along
    the line, and changes no momentum of what it joins. In statics it has no force. Where both ends are at one place it
    has no direction, and no force.
    """

    kind: ClassVar[str] = "dashpot"

    a: Nodes
    b: End
    coefficient: Float[Array, "*k"]

    def __init__(self, a, b, coefficient, name: str | None = None):
        self.a, self.b = nodes_of("a", a), end_of("b", b)
        self.coefficient = float_array(coefficient, "coefficient")
        self.name = name

    def __check_init__(self):
        check_each("coefficient", self.coefficient, self.count)

    def parts(self) -> tuple[Contribution, ...]:
        return (Drag(self.nodes, self.points, self.coefficient),)


class DragData(NamedTuple):
    """What one dashpot needs."""

    coefficient: Float[Array, "*k"]
    point: Float[Array, "*k 3"] | None


class Drag(Resisting):
    """The force of dashpots on pairs of nodes (k, 2), or on nodes (k, 1) that points (k, 3) hold."""

    nodes: Frozen = eqx.field(static=True)
    points: Float[Array, "k 3"] | None
    coefficient: Float[Array, "*k"]

    def groups(self, triangles: np.ndarray) -> Frozen:
        return self.nodes

    def data(self, surface: Surface) -> DragData:
        return DragData(jnp.broadcast_to(self.coefficient, (len(self.nodes.array),)), self.points)

    def resistance(
        self, data: DragData, start: Place, end: Place, middle: Place, rates: Float[Array, "c 6"]
    ) -> Float[Array, "c 6"]:
        n = _direction(data, middle)
        faster = (rates[1, :3] if self.points is None else 0.0) - rates[0, :3]
        pull = data.coefficient * (faster @ n) * n
        forces = pull[None] if self.points is not None else jnp.stack([pull, -pull])
        return jnp.concatenate([forces, jnp.zeros_like(forces)], axis=1)

    def quantities(self) -> tuple[str, ...]:
        return ("force", "length")

    def read(self, data: DragData, start: Place, end: Place, force, component: str) -> Float[Array, ""]:
        if component == "length":
            return length_of(_along(data, end))
        return force[0, :3] @ _direction(data, between(start, end))


def _along(data: DragData, place: Place) -> Float[Array, "3"]:
    return (place.x[1] if data.point is None else data.point) - place.x[0]


def _direction(data: DragData, place: Place) -> Float[Array, "3"]:
    r = _along(data, place)
    return ratio(jnp.ones(()), length_of(r)) * r
