"""Moments between the rotations of two nodes, or of a node and space, about an axis fixed in the first of them.

With orthonormal p, q and the axis n, all fixed in both nodes and at rest alike, the invariants

    c = ½ [(R_a p)·(R_b p) + (R_a q)·(R_b q)],      s = ½ [(R_a q)·(R_b p) - (R_a p)·(R_b q)]

are quadratic in the rotation matrices, and c + is = (w + i v_n)² = ρ e^(iφ) with the scalar part w and the part v_n
along n of the quaternion of R_aᵀR_b: φ is the twist of the relative rotation about the axis, however the nodes are
tilted against each other (swing and twist). The tilt is 2 acos √ρ. On a hinge ρ = 1, and φ is its angle.

∇φ = (c ∇s - s ∇c)/ρ². Over a step, c̄ ∇s̄ - s̄ ∇c̄ with the means of the ends does exactly the work c₀s₁ - s₀c₁ =
ρ₀ρ₁ sin Δφ. So with the energy V(φ) the moments

    -(ΔV/Δφ) (Δφ / ρ₀ρ₁ sin Δφ) (c̄ ∇s̄ - s̄ ∇c̄)

do exactly the work -ΔV, whether the nodes tilt or not. They turn both nodes against each other: no angular momentum.

φ lies within half a turn. Beyond `LIMIT` the moments are NaN, which ends the step as a failure: an angle that jumps
from π to -π is never used. That holds for a step that jumps over the gap too: φ is followed from where the step began
(by implicit methods and statics; central differences see places one by one, and their steps turn by far less).
"""

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.connectors.laws import mean_positive, positive
from jaxshell.model.contribution import Contribution, Elastic, Place, Resisting, Surface, between
from jaxshell.numerics.checks import floats
from jaxshell.numerics.directions import across
from jaxshell.numerics.frozen import Frozen

LIMIT = 3.1
"""The largest angle [rad] to either side that is told from the one that lies half a turn further."""
_NEAR = 0.02
"""Changes [rad] below this are small."""


class Twist(NamedTuple):
    """The invariants of a group at one place, and their derivatives by the spin of the second node."""

    c: Float[Array, ""]
    s: Float[Array, ""]
    c_spin: Float[Array, "3"]
    """∇c; by the spin of the first node it is the negative."""
    s_spin: Float[Array, "3"]

    @property
    def angle(self) -> Float[Array, ""]:
        """φ [rad], within half a turn. Where a tilt of half a turn leaves none, it is NaN."""
        defined = self.c**2 + self.s**2 > 0
        return jnp.where(defined, jnp.arctan2(self.s, jnp.where(defined, self.c, 1.0)), jnp.nan)

    @property
    def gradient(self) -> Float[Array, "3"]:
        """∇φ by the spin of the second node."""
        return (self.c * self.s_spin - self.s * self.c_spin) / (self.c**2 + self.s**2)


class TurningData(NamedTuple):
    """What one group needs."""

    across: Float[Array, "*k 2 3"]
    """p and q."""
    law: Any
    """What its moment depends on besides the angle."""


class Turning(Contribution):
    """What acts on the twist between pairs of nodes, (k, 2), or between nodes (k, 1) and space."""

    nodes: eqx.AbstractVar[Frozen]
    axis: eqx.AbstractVar[Float[Array, "k 3"]]
    """(k, 3) in global components, where no node has turned; of any length."""

    @abc.abstractmethod
    def law(self) -> Any:
        """Its parameters, a pytree of arrays () or (k,)."""

    def groups(self, triangles: np.ndarray) -> Frozen:
        return self.nodes

    def data(self, surface: Surface) -> TurningData:
        count = len(self.nodes.array)
        law = jax.tree.map(lambda value: jnp.broadcast_to(value, (count,)), self.law())
        return TurningData(jax.vmap(across)(self.axis)[:, 1:], law)

    def twist(self, data: TurningData, place: Place) -> Twist:
        """The invariants of one group."""
        (P, Q), (p, q) = data.across @ place.R[-1].T, data.across
        if self.nodes.array.shape[1] == 2:
            p, q = data.across @ place.R[0].T
        c, s = 0.5 * (p @ P + q @ Q), 0.5 * (q @ P - p @ Q)
        return Twist(c, s, 0.5 * (jnp.cross(P, p) + jnp.cross(Q, q)), 0.5 * (jnp.cross(P, q) - jnp.cross(Q, p)))

    def on_nodes(self, moment: Float[Array, "3"]) -> Float[Array, "c 6"]:
        """Of a moment on the second node."""
        moments = moment[None] if self.nodes.array.shape[1] == 1 else jnp.stack([-moment, moment])
        return jnp.concatenate([jnp.zeros_like(moments), moments], axis=1)


class ElasticTurning(Turning, Elastic):
    """An energy V of the twist."""

    @abc.abstractmethod
    def energy_at(self, angle: Float[Array, ""], law) -> Float[Array, ""]:
        """V(φ)."""

    @abc.abstractmethod
    def moment(self, before: Float[Array, ""], after: Float[Array, ""], law) -> Float[Array, ""]:
        """(V(φ₁) - V(φ₀))/(φ₁ - φ₀); V'(φ) where both are the same."""

    def energy(self, data: TurningData, place: Place) -> Float[Array, ""]:
        return self.energy_at(self.twist(data, place).angle, data.law)

    def force(self, data: TurningData, place: Place) -> Float[Array, "c 6"]:
        twist = self.twist(data, place)
        moment = _told(twist.angle, self.moment(twist.angle, twist.angle, data.law))
        return self.on_nodes(-moment * twist.gradient)

    def end_force(self, data: TurningData, start: Place, end: Place) -> Float[Array, "c 6"]:
        before, after = self.twist(data, start), self.twist(data, end)
        return _told(before.angle + _change(before, after)[0], self.force(data, end))

    def mean_force(self, data: TurningData, start: Place, end: Place) -> Float[Array, "c 6"]:
        before, after, middle = (self.twist(data, place) for place in (start, end, between(start, end)))
        change, over_sine = _change(before, after)
        followed = before.angle + change
        mean = _told(followed, self.moment(before.angle, followed, data.law))
        c, s = 0.5 * (before.c + after.c), 0.5 * (before.s + after.s)
        return self.on_nodes(-mean * over_sine * (c * middle.s_spin - s * middle.c_spin))

    def quantities(self) -> tuple[str, ...]:
        return ("angle", "moment", "energy")

    def read(self, data: TurningData, start: Place, end: Place, force, component: str) -> Float[Array, ""]:
        angle = self.twist(data, end).angle
        if component == "angle":
            return angle
        return self.energy_at(angle, data.law) if component == "energy" else self.moment(angle, angle, data.law)


class ResistingTurning(Turning, Resisting):
    """A moment against the rate of the twist."""

    @abc.abstractmethod
    def moment_at(self, rate: Float[Array, ""], law) -> Float[Array, ""]:
        """By dφ/dt; of its sign."""

    def resistance(
        self, data: TurningData, start: Place, end: Place, middle: Place, rates: Float[Array, "c 6"]
    ) -> Float[Array, "c 6"]:
        gradient = self.twist(data, middle).gradient
        spin = rates[-1, 3:] if self.nodes.array.shape[1] == 1 else rates[1, 3:] - rates[0, 3:]
        return self.on_nodes(-self.moment_at(gradient @ spin, data.law) * gradient)

    def quantities(self) -> tuple[str, ...]:
        return ("angle", "moment")

    def read(self, data: TurningData, start: Place, end: Place, force, component: str) -> Float[Array, ""]:
        if component == "angle":
            return self.twist(data, end).angle
        gradient = self.twist(data, between(start, end)).gradient
        return -(force[-1, 3:] @ gradient) / (gradient @ gradient)


class TorsionStiffness(ElasticTurning):
    """V = ½k(φ - φ₀)²."""

    nodes: Frozen = eqx.field(static=True)
    axis: Float[Array, "k 3"]
    k: Float[Array, "*k"] = eqx.field(converter=floats("stiffness"))
    """[moment/rad]."""
    rest: Float[Array, "*k"] = eqx.field(converter=floats("angle"), default=0.0)
    """φ₀ [rad]."""

    def law(self):
        return self.k, self.rest

    def energy_at(self, angle, law):
        k, rest = law
        return 0.5 * k * (angle - rest) ** 2

    def moment(self, before, after, law):
        k, rest = law
        return k * (0.5 * (before + after) - rest)


class TorsionStops(ElasticTurning):
    """V = ½k(⟨φ - high⟩² + ⟨low - φ⟩²): an end stop on either side, which is touched within a step too."""

    nodes: Frozen = eqx.field(static=True)
    axis: Float[Array, "k 3"]
    low: Float[Array, "*k"] = eqx.field(converter=floats("stops"))
    high: Float[Array, "*k"] = eqx.field(converter=floats("stops"))
    k: Float[Array, "*k"] = eqx.field(converter=floats("stiffness of stops"))

    def law(self):
        return self.low, self.high, self.k

    def energy_at(self, angle, law):
        low, high, k = law
        return 0.5 * k * (positive(angle - high) ** 2 + positive(low - angle) ** 2)

    def moment(self, before, after, law):
        low, high, k = law
        return k * (mean_positive(before - high, after - high) - mean_positive(low - before, low - after))


class TorsionDamping(ResistingTurning):
    """M = c dφ/dt."""

    nodes: Frozen = eqx.field(static=True)
    axis: Float[Array, "k 3"]
    coefficient: Float[Array, "*k"] = eqx.field(converter=floats("damping"))

    def law(self):
        return self.coefficient

    def moment_at(self, rate, law):
        return law * rate


class TorsionFriction(ResistingTurning):
    """M = m tanh((dφ/dt)/rate): Coulomb's, which creeps below about that rate instead of sticking."""

    nodes: Frozen = eqx.field(static=True)
    axis: Float[Array, "k 3"]
    friction: Float[Array, "*k"] = eqx.field(converter=floats("friction"))
    """m."""
    rate: Float[Array, "*k"] = eqx.field(converter=floats("rate of friction"))
    """[rad/time]."""

    def law(self):
        return self.friction, self.rate

    def moment_at(self, rate, law):
        moment, least = law
        return moment * jnp.tanh(rate / least)


def _told(angle: Float[Array, ""], value: Float[Array, "*s"]) -> Float[Array, "*s"]:
    """A value where the angle is within `LIMIT`; else NaN."""
    return jnp.where(jnp.abs(angle) <= LIMIT, value, jnp.nan)


def _change(before: Twist, after: Twist) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Δφ of a step, within half a turn, and Δφ/(ρ₀ρ₁ sin Δφ)."""
    sine, cosine = before.c * after.s - before.s * after.c, before.c * after.c + before.s * after.s
    near = jnp.abs(sine) < _NEAR * cosine
    x = jnp.where(near, sine / jnp.where(near, cosine, 1.0), 0.0)
    series = sum((-x * x) ** k / (2 * k + 1) for k in range(6))  # atan(x)/x
    safe_sine = jnp.where(near, 1.0, sine)
    far = jnp.arctan2(safe_sine, jnp.where(near, 1.0, cosine))
    return jnp.where(near, x * series, far), jnp.where(near, series / jnp.where(near, cosine, 1.0), far / safe_sine)
