"""Contributions: whatever acts on the shell besides its elements, each one kind of thing that the methods sum.

A contribution acts on k groups of c nodes each: a follower pressure on the three of every element, a force that
turns with the surface on single nodes, a spring on pairs. It states the forces on ONE group; tangents follow by
`jax.jacfwd` unless it gives them in closed form. Assembly finds its place in the sparsity pattern from its groups.

Time integration sees it in two ways. The methods at force level (`Newmark`, central differences, statics, the
paper's) take `force` at the ends of the step. `EnergyMomentum` takes `mean_force` over the step, whose work on the
step's increments is what the energy balance holds: the energy of the shell changes by exactly that, whatever the
contribution is; a `mean_force` that is also the mean in time of the force makes it second order.

What a contribution does to the energy is its class: the work of a plain `Contribution` is external work; `Elastic` has
an energy of its own, which counts with the strain energy; `Resisting` takes energy, which counts as dissipated; a
`Constraint` does no work.

Exact energy comes from one fact. For a function g that is at most quadratic in positions and rotation matrices, its
derivative at their means over the step, with δR = ~δω R̄, times the step's increments (Δx, Cayley vectors θ) is Δg.
"""

import abc
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.numerics.frozen import Frozen
from jaxshell.numerics.rotations import exp, skew


class Surface(NamedTuple):
    """The shell before it moves, for contributions that prepare what they need of it."""

    x0: Float[Array, "n 3"]
    triangles: Any
    """(m, 3) node indices."""
    mass_per_area: Float[Array, " m"]
    area: Float[Array, " m"]
    normals: Float[Array, "m 3"]
    size: Float[Array, ""]
    """Of the shell [length], constant for derivatives."""
    membrane_stiffness: Any = None
    """(m, 3, 3) A of the sections [force/length]. This and what follows is there of a whole scene only."""
    layers: Callable[[], Any] = lambda: None
    """Gives the sections' `Layers`, or None where a section has none: called by those that need a thickness."""
    connectivity: Any = None
    """`triangles` as static numbers."""
    rotary_inertia: Any = None
    """(m,) ∫ρ z² dz."""
    first_moment: Any = None
    """(m,) ∫ρ z dz; None where it vanishes."""
    levers: Any = None
    """(m, 3, 3) of `jaxshell.elements.cubic_inertia.levers`, where masses follow rotations."""


class Place(NamedTuple):
    """A group of c nodes at one time."""

    x: Float[Array, "c 3"]
    R: Float[Array, "c 3 3"]
    time: Float[Array, ""]


class Contribution(eqx.Module):
    """Forces on groups of nodes that follow the motion. Each of the loads, joints, ... that do is one."""

    def parts(self) -> tuple["Contribution", ...]:
        """What the methods sum: itself, where it is one thing."""
        return (self,)

    @abc.abstractmethod
    def groups(self, triangles: np.ndarray) -> Frozen:
        """(k, c) nodes of the groups; static."""

    @abc.abstractmethod
    def data(self, surface: Surface) -> Any:
        """What the groups need besides their nodes: a pytree of arrays with a leading axis over the k groups."""

    @abc.abstractmethod
    def force(self, data, place: Place) -> Float[Array, "c 6"]:
        """Force and moment on every node of one group; `data` is the group's own."""

    def stiffness(self, data, place: Place) -> Float[Array, "d d"]:
        """Derivative of `force` by displacements and spins (δx, δω) of the group."""
        return _derivative(lambda place: self.force(data, place), place)

    def end_force(self, data, start: Place, end: Place) -> Float[Array, "c 6"]:
        """Force and moment at the end of a step, which begins at `start`: `force`, unless that must know it."""
        return self.force(data, end)

    def mean_force(self, data, start: Place, end: Place) -> Float[Array, "c 6"]:
        """Force and moment over a step, for methods that conserve energy: by default half the sum of the ends'."""
        return 0.5 * (self.force(data, start) + self.force(data, end))

    def mean_stiffness(self, data, start: Place, end: Place) -> Float[Array, "d d"]:
        """Derivative of `mean_force` by displacements and spins of the end of the step."""
        return _derivative(lambda end: self.mean_force(data, start, end), end)

    def quantities(self) -> tuple[str, ...]:
        """What of it can be watched: words out of `jaxshell.model.quantities`."""
        return ()

    def read(self, data, start: Place, end: Place, force: Float[Array, "c 6"], component: str) -> Float[Array, ""]:
        """One of its `quantities`, of one group, in the step from `start` to `end`.

        `force` is what it puts on every node: in `EnergyMomentum` the mean over the step, in other methods that of the
        step's end, and for what resists that of the step's mean rates. At the start of a run both places are the start.
        """
        raise NotImplementedError(f"{type(self).__name__} has no {component}.")


class Elastic(Contribution):
    """Forces with a potential: its energy counts with the strain energy, and their work is no external work.

    `mean_force` must do the work of the change of the energy, exactly, on the increments of a step.
    """

    @property
    def driven(self) -> bool:
        """Static: whether time enters the energy, as by an anchor that moves. What moves it then does work."""
        return False

    @abc.abstractmethod
    def energy(self, data, place: Place) -> Float[Array, ""]:
        """Of one group [force·length]."""

    def force(self, data, place: Place) -> Float[Array, "c 6"]:
        """Minus the derivative of the energy by displacements and spins."""
        still = jnp.zeros(6 * place.x.shape[0])
        return -jax.grad(lambda change: self.energy(data, displaced(place, change)))(still).reshape(-1, 6)

    @abc.abstractmethod
    def mean_force(self, data, start: Place, end: Place) -> Float[Array, "c 6"]:
        """Force and moment over a step, whose work on its increments is minus the change of the energy."""

    def stiffest(self, data, place: Place) -> Float[Array, "d d"]:
        """The stiffness that limits the steps of central differences: by default the one at the start."""
        return -self.stiffness(data, place)


class Resisting(Contribution):
    """Forces against the motion, by the rates of the nodes: what they take counts as dissipated energy."""

    @abc.abstractmethod
    def resistance(
        self, data, start: Place, end: Place, middle: Place, rates: Float[Array, "c 6"]
    ) -> Float[Array, "c 6"]:
        """Force and moment on every node of one group, where the balance of a step stands.

        `start` and `end` are the ends of the step and `middle` the place of the balance between them, whose R are
        weighted means and no rotations. `rates` are velocities and angular velocities there: in `EnergyMomentum` the
        increments of the step over Δt. Energy is never made where -force·rates >= 0.
        """

    def iterated(self, data, start: Place, end: Place, middle: Place, rates, last) -> Float[Array, "c 6"]:
        """What Newton's iteration differentiates: `resistance`, unless its derivative leads in circles.

        `last` are the rates of the iterate before, `rates` those of the last.
        """
        return self.resistance(data, start, end, middle, rates)

    @property
    def driven(self) -> bool:
        """Static: whether what the nodes move against moves itself. Its motion then does work."""
        return False

    def carried(self, data, start: Place, end: Place) -> Float[Array, "c 6"]:
        """Increments over a step of what the nodes move against, where it is driven.

        With rates taken against it, -force·(increments - carried) is dissipated, and force·carried is external work.
        """
        return jnp.zeros((start.x.shape[0], 6))

    def force(self, data, place: Place) -> Float[Array, "c 6"]:
        """None at rest."""
        return jnp.zeros((place.x.shape[0], 6))


class Constraint(Contribution):
    """Conditions g(x, R) = 0, at most quadratic, which multipliers λ enforce by the forces -λ ∂g: a joint.

    ∂g is that at the mean of the ends of the step, weighted as the balance is: in `EnergyMomentum` λ ∂g does the work
    λ Δg = 0. A g that stays where all move and turn alike, of whatever matrices R, keeps the momenta; it is not enough
    that it stays zero, which it is at the ends of a step and not at their mean. Conditions hold at the ends of steps.
    """

    @property
    @abc.abstractmethod
    def count(self) -> int:
        """Static: the number of conditions."""

    @abc.abstractmethod
    def conditions(self, data, place: Place) -> Float[Array, " p"]:
        """What vanishes [length], of one group; those of rotations times a length of the shell's size."""

    def force(self, data, place: Place) -> Float[Array, "c 6"]:
        """None without a multiplier."""
        return jnp.zeros((place.x.shape[0], 6))

    @property
    def multipliers(self) -> int:
        """How many nodes that no mesh has hold the multipliers of a group, three each as displacements."""
        return -(-self.count // 3)

    def balanced(self, data, start: Place, end: Place, weight) -> Float[Array, "c 6"]:
        """What stands in the balance of a step on the nodes of one group, those of the multipliers being the last.

        `data` holds its own and the unit of the multipliers [force/length], `weight` where between the ends of the step
        the balance stands. At the multipliers' nodes stand the conditions at the end, times that unit.
        """
        (own, unit), real = data, end.x.shape[0] - self.multipliers
        values = end.x[real:].reshape(-1)[: self.count]
        start, end = (Place(place.x[:real], place.R[:real], place.time) for place in (start, end))
        slopes = gradient_between(lambda place: self.conditions(own, place), between(start, end, weight))
        forces = -unit * jnp.tensordot(values, slopes, 1)
        open_by = jnp.zeros(3 * self.multipliers).at[: self.count].set(-unit * self.conditions(own, end))
        rows = jnp.concatenate([open_by.reshape(-1, 3), jnp.zeros((self.multipliers, 3))], axis=1)
        return jnp.concatenate([forces, rows])


def displaced(place: Place, change: Float[Array, " d"]) -> Place:
    """A group after displacements and spins (δx, δω)."""
    change = change.reshape(-1, 6)
    turned = jax.vmap(lambda spin, R: exp(spin) @ R)(change[:, 3:], place.R)
    return place._replace(x=place.x + change[:, :3], R=turned)


def between(start: Place, end: Place, weight: Any = 0.5) -> Place:
    """The weighted mean of two places, `weight` that of the end; its R are no rotations."""
    return jax.tree.map(lambda a, b: (1.0 - weight) * a + weight * b, start, end)


def mean_rates(start: Place, end: Place) -> Float[Array, "c 6"]:
    """Velocities and angular velocities (Cayley vectors) of a step over its time; zero where it takes none."""

    def turn(before, after):  # cay(θ) = R₁ R₀ᵀ
        Q = after @ before.T
        axial = jnp.stack([Q[2, 1] - Q[1, 2], Q[0, 2] - Q[2, 0], Q[1, 0] - Q[0, 1]])
        return 2.0 * axial / (1.0 + jnp.trace(Q))

    dt = end.time - start.time
    moved = jnp.concatenate([end.x - start.x, jax.vmap(turn)(start.R, end.R)], axis=1)
    return jnp.where(dt > 0, moved / jnp.where(dt > 0, dt, 1.0), 0.0)


def gradient_between(function: Callable, place: Place) -> Float[Array, "*s c 6"]:
    """Derivative of function(place), a scalar or several, at a weighted mean of places, by δx and δω, δR = ~δω R."""

    def moved(change):
        turned = place.R + jax.vmap(lambda spin, R: skew(spin) @ R)(change[:, 3:], place.R)
        return function(place._replace(x=place.x + change[:, :3], R=turned))

    return jax.jacrev(moved)(jnp.zeros((place.x.shape[0], 6)))


def secant(function: Callable, before, after) -> Float[Array, ""]:
    """(f(after) - f(before))/(after - before) of a smooth scalar function, to all digits.

    For a small change it is the mean of f' by Gauss's rule with three points, whose error is below round-off.
    """
    change, middle = after - before, 0.5 * (before + after)
    near = jnp.abs(change) <= _NEAR * (jnp.abs(before) + jnp.abs(after))
    safe = jnp.where(near, 1.0, change)
    slope = jax.grad(function)
    mean = sum(w * slope(middle + 0.5 * p * change) for p, w in zip(*_GAUSS, strict=True))
    return jnp.where(near, mean, (function(after) - function(before)) / safe)


_NEAR = 0.01
"""Changes below this part of a value are small."""
_GAUSS = ((-np.sqrt(0.6), 0.0, np.sqrt(0.6)), (5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0))


def _derivative(force: Callable[[Place], Array], place: Place) -> Float[Array, "d d"]:
    """Of `force` by displacements and spins (δx, δω) of the group at `place`."""

    def moved(change):
        return force(displaced(place, change)).reshape(-1)

    return jax.jacfwd(moved)(jnp.zeros(6 * place.x.shape[0]))
