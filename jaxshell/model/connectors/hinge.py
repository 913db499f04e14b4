"""Hinges."""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.connectors.joint import Conditions, Joint, Together
from jaxshell.model.connectors.torsion import TorsionDamping, TorsionFriction, TorsionStiffness, TorsionStops
from jaxshell.model.contribution import Contribution, Place
from jaxshell.model.sets import SetName, nodes_or_name
from jaxshell.numerics.checks import (
    check_finite,
    check_number,
    check_positive_number,
    check_shape,
    float_array,
    is_concrete,
)
from jaxshell.numerics.directions import across, unit_vector
from jaxshell.numerics.frozen import Frozen


class Hinge(Joint):
    """A joint about which two nodes turn against each other about one axis.

    Arguments:
        a, b: nodes, or names of sets, joined one by one; in one place at the start.
        axis: (3,) in global components at the start; it turns with both. Differentiable.
        stiffness: of a torsion spring [force·length/rad]; None is none. Differentiable.
        angle: at which the spring is at rest [rad], of b against a by the right-hand rule; 0 is the start's.
            Differentiable.
        damping: viscous friction [force·length·time/rad]; None is none. Differentiable.
        friction: a moment [force·length] against the turning, m tanh((dφ/dt)/friction_rate); None is none.
        friction_rate: the rate [rad/time] below which friction creeps in place of sticking; needed with friction.
        stops: (low, high) angles [rad] that end stops keep it between; None is none.
        stop_stiffness: of the stops [force·length/rad]; needed with stops.
        name: what watches call it: "angle" (of b against a, within half a turn), with a spring "moment" and "energy".

    Enforced by multipliers: exact at the ends of steps. The joint does no work and carries no moment about its axis but
    for what its options say; their energies and losses are as those of `TorsionSpring`, exact with `EnergyMomentum`,
    which keeps the momenta too. With a spring or stops the angle must stay within 3.1 rad: beyond it the step fails.
    Raises ValueError for nodes that are apart, an axis of no length, and options that need each other.
    """

    kind: ClassVar[str] = "hinge"

    a: Frozen | SetName = eqx.field(static=True)
    b: Frozen | SetName = eqx.field(static=True)
    axis: Float[jax.Array, "3"]
    stiffness: Float[jax.Array, ""] | None
    angle: Float[jax.Array, ""]
    damping: Float[jax.Array, ""] | None
    friction: Float[jax.Array, ""] | None
    friction_rate: Float[jax.Array, ""] | None
    stops: Float[jax.Array, "2"] | None
    stop_stiffness: Float[jax.Array, ""] | None

    def __init__(
        self,
        a,
        b,
        axis,
        stiffness=None,
        angle: Any = 0.0,
        damping=None,
        friction=None,
        friction_rate=None,
        stops=None,
        stop_stiffness=None,
        name: str | None = None,
    ):
        self.a, self.b = nodes_or_name("hinge a", a), nodes_or_name("hinge b", b)
        self.axis = unit_vector(axis, "hinge axis")
        given = {"stiffness": stiffness, "damping": damping, "friction": friction, "friction_rate": friction_rate}
        given |= {"stops": stops, "stop_stiffness": stop_stiffness}
        for key, value in given.items():
            setattr(self, key, None if value is None else float_array(value, f"hinge {key}"))
        self.angle = float_array(angle, "hinge angle")
        self.name = name

    def __check_init__(self):
        for key in ("stiffness", "damping", "friction", "friction_rate", "stop_stiffness"):
            value = getattr(self, key)
            if value is not None:
                check_positive_number(f"hinge {key}", value)
        check_number("hinge angle", self.angle)
        for one, other in (("friction", "friction_rate"), ("stops", "stop_stiffness")):
            if (getattr(self, one) is None) != (getattr(self, other) is None):
                raise ValueError(f"A hinge has {one} and {other} together, or neither.")
        if self.stops is not None:
            check_shape("hinge stops", self.stops, (2,))
            check_finite("hinge stops", self.stops)
            if is_concrete(self.stops) and not self.stops[0] < self.stops[1]:
                raise ValueError(f"hinge stops must be (low, high), but they are {np.asarray(self.stops).tolist()}.")

    @property
    def turning(self) -> np.ndarray:
        return self.pairs.array.ravel()

    def parts(self) -> tuple[Contribution, ...]:
        pairs, axis = self.pairs, jnp.broadcast_to(self.axis, (len(self.a.array), 3))
        found: list[Contribution] = [Together(pairs), Aligned(pairs, self.axis)]
        if self.stiffness is not None:
            found.append(TorsionStiffness(pairs, axis, self.stiffness, self.angle))
        if self.damping is not None:
            found.append(TorsionDamping(pairs, axis, self.damping))
        if self.friction is not None:
            found.append(TorsionFriction(pairs, axis, self.friction, self.friction_rate))
        if self.stops is not None:
            found.append(TorsionStops(pairs, axis, self.stops[0], self.stops[1], self.stop_stiffness))
        return tuple(found)


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

    def quantities(self) -> tuple[str, ...]:
        return ("angle",)

    def read(self, data, start: Place, end: Place, force, component: str) -> Float[Array, ""]:
        """The angle of the second node against the first, within half a turn."""
        (_, p, q), _ = data
        (p, q), turned = (p @ end.R[0].T, q @ end.R[0].T), end.R[1] @ p
        return jnp.arctan2(turned @ q, turned @ p)
