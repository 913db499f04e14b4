"""Contributions: whatever acts on the shell besides its elements, each one kind of thing that the methods sum.

A contribution acts on k groups of c nodes each: a follower pressure on the three of every element, a force that
turns with the surface on single nodes, a spring on pairs. It states the forces on ONE group; tangents follow by
`jax.jacfwd` unless it gives them in closed form. Assembly finds its place in the sparsity pattern from its groups.

Time integration sees it in two ways. The methods at force level (`Newmark`, central differences, statics, the
paper's) take `force` at the ends of the step. `EnergyMomentum` takes `mean_force` over the step, whose work on the
step's increments is what the energy balance holds: the energy of the shell changes by exactly that, whatever the
contribution is; a `mean_force` that is also the mean in time of the force makes it second order.
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
from jaxshell.numerics.rotations import exp


class Surface(NamedTuple):
    """The shell before it moves, for contributions that prepare what they need of it."""

    x0: Float[Array, "n 3"]
    triangles: Any
    """(m, 3) node indices."""
    mass_per_area: Float[Array, " m"]
    area: Float[Array, " m"]
    normals: Float[Array, "m 3"]


class Place(NamedTuple):
    """A group of c nodes at one time."""

    x: Float[Array, "c 3"]
    R: Float[Array, "c 3 3"]
    time: Float[Array, ""]


class Contribution(eqx.Module):
    """Forces on groups of nodes that follow the motion. Each of the loads, joints, ... that do is one."""

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

    def mean_force(self, data, start: Place, end: Place) -> Float[Array, "c 6"]:
        """Force and moment over a step, for methods that conserve energy: by default half the sum of the ends'."""
        return 0.5 * (self.force(data, start) + self.force(data, end))

    def mean_stiffness(self, data, start: Place, end: Place) -> Float[Array, "d d"]:
        """Derivative of `mean_force` by displacements and spins of the end of the step."""
        return _derivative(lambda end: self.mean_force(data, start, end), end)


def _derivative(force: Callable[[Place], Array], place: Place) -> Float[Array, "d d"]:
    """Of `force` by displacements and spins (δx, δω) of the group at `place`."""

    def moved(change):
        change = change.reshape(-1, 6)
        turned = jax.vmap(lambda spin, R: exp(spin) @ R)(change[:, 3:], place.R)
        return force(place._replace(x=place.x + change[:, :3], R=turned)).reshape(-1)

    return jax.jacfwd(moved)(jnp.zeros(6 * place.x.shape[0]))
