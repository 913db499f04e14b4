"""Prescribed motion of supports: where it is at a time, how far a step goes, and the rates with which it starts.

A displacement is a factor of time; an acceleration is integrated twice, exactly; a rotation turns nodes about a fixed
direction a by the angle φ(t), and with a point c of the axis moves them on circles:

    R(t) = exp(φ ~a),   x(t) = c + R(t) (x(0) - c),   ω = φ' a,   v = ω × (x - c)

The increments of a step are exact whatever its size: R(t₁) R(t₀)ᵀ is a turn about the same axis, for which a method has
its own parameters (`ImplicitMethod.size_of_turn`).
"""

import abc
import dataclasses
from collections.abc import Iterable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.history import History, Integrals
from jaxshell.model.scene import Initial
from jaxshell.model.supports import DOFS, Support
from jaxshell.numerics.frozen import Frozen
from jaxshell.numerics.rotations import exp


class Motion(eqx.Module):
    """The prescribed motion of k nodes of a support that names d degrees of freedom of each."""

    numbers: eqx.AbstractVar[Frozen]
    """(k, d) numbers 6·node + dof."""

    @property
    def turning(self) -> bool:
        """Whether it prescribes rotations."""
        return False

    def turns(self, time, dt, size) -> Float[Array, "k d"]:
        """Of what is turning, increments of the rotations in the step from `time`; zero at displacements.

        `size` makes of the angle of a turn that of the method's parameters.
        """
        raise NotImplementedError(f"{type(self).__name__} prescribes no rotations")

    @abc.abstractmethod
    def displacements(self, time) -> Float[Array, "k d"]:
        """Since the start; zero at rotations."""

    @abc.abstractmethod
    def rates(self, time) -> Float[Array, "k d"]:
        """Velocities and angular velocities from `time` on."""

    @abc.abstractmethod
    def accelerations(self, time) -> Float[Array, "k d"]:
        """Of the displacements from `time` on; zero at rotations, whose histories are linear between their samples."""


class Shifted(Motion):
    """Displacements in proportion to a history."""

    numbers: Frozen = eqx.field(static=True)
    amount: Float[Array, "k d"]
    history: History

    def displacements(self, time):
        return self.amount * self.history(time)

    def rates(self, time):
        return self.amount * self.history.rate(time)

    def accelerations(self, time):
        return jnp.zeros_like(self.amount)


class Accelerated(Motion):
    """Displacements that are the double integral of a record."""

    numbers: Frozen = eqx.field(static=True)
    amount: Float[Array, "k d"]
    history: History
    integrals: Integrals

    def displacements(self, time):
        return self.amount * self.integrals.double_integral(time)

    def rates(self, time):
        return self.amount * self.integrals.integral(time)

    def accelerations(self, time):
        return self.amount * self.history(time)


class Turned(Motion):
    """Rotations about a fixed axis, and displacements on circles where that has a place."""

    numbers: Frozen = eqx.field(static=True)
    columns: Frozen = eqx.field(static=True)
    """(d,) of the six degrees of freedom of a node, those that the support names."""
    axis: Float[Array, "3"]
    """Of length 1."""
    angle: Float[Array, ""]
    history: History
    arms: Float[Array, "k 3"]
    """From the axis' place to the nodes at the start; zero where the nodes turn in their own."""

    @property
    def turning(self) -> bool:
        return True

    def displacements(self, time):
        turned = exp(self._angle(time) * self.axis) - jnp.eye(3)
        return self._named(self.arms @ turned.T, jnp.zeros(3))

    def rates(self, time):
        omega = self._omega(time)
        return self._named(jnp.cross(omega, self._arms(time)), omega)

    def accelerations(self, time):
        omega = self._omega(time)
        return self._named(jnp.cross(omega, jnp.cross(omega, self._arms(time))), jnp.zeros(3))

    def turns(self, time, dt, size) -> Float[Array, "k d"]:
        """NaN where the step is half a turn or more: it would go the other way round."""
        angle = self._angle(time + dt) - self._angle(time)
        angle = jnp.where(jnp.abs(angle) < jnp.pi, angle, jnp.nan)
        return self._named(jnp.zeros(3), size(angle) * self.axis)

    def _angle(self, time) -> Float[Array, ""]:
        return self.angle * self.history(time)

    def _omega(self, time) -> Float[Array, "3"]:
        return self.angle * self.history.rate(time) * self.axis

    def _arms(self, time) -> Float[Array, "k 3"]:
        return self.arms @ exp(self._angle(time) * self.axis).T

    def _named(self, moved, turned) -> Float[Array, "k d"]:
        """Of displacements and rotations, (k, 3) or (3,) each, what the support names."""
        both = [jnp.broadcast_to(part, self.arms.shape) for part in (moved, turned)]
        return jnp.concatenate(both, axis=1)[:, self.columns.array]


class Alike(Motion):
    """Motions of one kind and as many nodes each, computed together: a program does not grow with their number."""

    numbers: Frozen = eqx.field(static=True)
    """(c k, d) of c motions."""
    each: Any
    """A motion whose arrays have a leading axis (c,), and whose numbers say nothing."""

    @property
    def turning(self) -> bool:
        return self.each.turning

    def displacements(self, time):
        return self._all(lambda motion: motion.displacements(time))

    def rates(self, time):
        return self._all(lambda motion: motion.rates(time))

    def accelerations(self, time):
        return self._all(lambda motion: motion.accelerations(time))

    def turns(self, time, dt, size) -> Float[Array, "k d"]:
        return self._all(lambda motion: motion.turns(time, dt, size))

    def _all(self, function) -> Float[Array, "k d"]:
        return jnp.concatenate(jax.vmap(function)(self.each))


def motions_of(supports: Iterable[Support], x0: Float[Array, "n 3"], initial: Initial | None) -> tuple[Motion, ...]:
    """The prescribed motions of the supports that move, those alike together."""
    kinds: dict[Any, list[tuple[Motion, Motion]]] = {}
    for support in supports:
        if support.moves:
            motion = motion_of(support, x0, initial)
            # Alike is what has, but for its numbers, the same structure and arrays of the same shapes.
            bare = dataclasses.replace(motion, numbers=Frozen(np.zeros_like(motion.numbers.array)))
            shapes = tuple(jnp.shape(leaf) for leaf in jax.tree.leaves(bare))
            kinds.setdefault((jax.tree.structure(bare), shapes), []).append((motion, bare))
    return tuple(_together(*zip(*kind, strict=True)) for kind in kinds.values())


def _together(motions: tuple[Motion, ...], bare: tuple[Motion, ...]) -> Motion:
    if len(motions) == 1:
        return motions[0]
    each = jax.tree.map(lambda *leaves: jnp.stack(leaves), *bare)
    return Alike(Frozen(np.concatenate([motion.numbers.array for motion in motions])), each)


def motion_of(support: Support, x0: Float[Array, "n 3"], initial: Initial | None) -> Motion:
    """The prescribed motion of a support that has one; nodes are turned from where they are at the start."""
    numbers, history = Frozen(support.dof_numbers), support.history
    assert history is not None
    if support.rotation is not None and support.angle is not None:
        axis = support.rotation / jnp.linalg.norm(support.rotation)
        placed = x0[support.nodes.array]
        if initial is not None and initial.displacements is not None:
            placed = placed + initial.displacements[support.nodes.array]
        arms = jnp.zeros_like(placed) if support.about is None else placed - support.about
        columns = Frozen([DOFS.index(name) for name in support.dofs])
        return Turned(numbers, columns, axis, support.angle, history, arms)
    if support.acceleration is not None:
        amount = jnp.broadcast_to(support.acceleration, numbers.array.shape)
        return Accelerated(numbers, amount, history, history.integrals())
    amount = jnp.broadcast_to(jnp.asarray(support.displacement), numbers.array.shape)
    return Shifted(numbers, amount, history)
