"""Loads and how they vary in time: nodal forces and moments, edge forces, gravity, follower pressure."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxshell.checks import check_finite, check_shape, float_array, is_concrete, node_indices
from jaxshell.frozen import Frozen


class History(eqx.Module):
    """A piecewise linear factor of time, constant before its first and after its last sample.

    Arguments:
        times: (k,) increasing sample times.
        values: (k,) factors at these times. Differentiable.
    """

    times: Float[jax.Array, " k"] = eqx.field(converter=float_array)
    values: Float[jax.Array, " k"] = eqx.field(converter=float_array)

    def __check_init__(self):
        check_shape("history times", self.times, (None,))
        check_shape("history values", self.values, self.times.shape)
        check_finite("history times", self.times)
        check_finite("history values", self.values)
        if is_concrete(self.times) and np.any(np.diff(np.asarray(self.times)) <= 0):
            raise ValueError(f"history times must increase, but they are {np.asarray(self.times).tolist()}.")

    def __call__(self, time) -> Float[jax.Array, ""]:
        return jnp.interp(time, self.times, self.values)

    @classmethod
    def constant(cls) -> "History":
        """Factor 1 at all times: the load is there, whole, from the start."""
        return cls([0.0], [1.0])

    @classmethod
    def ramp(cls, end) -> "History":
        """Factor t/end up to t = end, then 1."""
        return cls([0.0, end], [0.0, 1.0])


class NodalForce(eqx.Module):
    """Forces with a fixed direction on nodes. `force`: (3,) for each of the nodes, or (k, 3) [force]."""

    nodes: Frozen = eqx.field(static=True)
    force: Float[jax.Array, "*k 3"]
    history: History

    def __init__(self, nodes, force, history: History | None = None):
        self.nodes = Frozen(node_indices("force nodes", nodes))
        self.force = float_array(force)
        self.history = History.constant() if history is None else history

    def __check_init__(self):
        _check_vectors("force", self.force, self.nodes.array.size)

    def nodal(self, x0, triangles, mass_per_area) -> Float[jax.Array, "n 6"]:
        """(n, 6) force and moment on each node for factor 1."""
        return jnp.zeros((x0.shape[0], 6)).at[self.nodes.array, :3].add(self.force)


class NodalMoment(eqx.Module):
    """Moments with a fixed direction in space on nodes. `moment`: (3,) or (k, 3) [force·length]."""

    nodes: Frozen = eqx.field(static=True)
    moment: Float[jax.Array, "*k 3"]
    history: History

    def __init__(self, nodes, moment, history: History | None = None):
        self.nodes = Frozen(node_indices("moment nodes", nodes))
        self.moment = float_array(moment)
        self.history = History.constant() if history is None else history

    def __check_init__(self):
        _check_vectors("moment", self.moment, self.nodes.array.size)

    def nodal(self, x0, triangles, mass_per_area) -> Float[jax.Array, "n 6"]:
        """(n, 6) force and moment on each node for factor 1."""
        return jnp.zeros((x0.shape[0], 6)).at[self.nodes.array, 3:].add(self.moment)


class EdgeForce(eqx.Module):
    """A force with a fixed direction per reference length of edges.

    Arguments:
        edges: (k, 2) node indices of the edges' ends.
        force: (3,) or (k, 3) [force/length]; half of each edge's resultant goes to each of its ends.
    """

    edges: Frozen = eqx.field(static=True)
    force: Float[jax.Array, "*k 3"]
    history: History

    def __init__(self, edges, force, history: History | None = None):
        check_shape("edges", edges, (None, 2))
        node_indices("edge nodes", np.asarray(edges).ravel())
        self.edges = Frozen(edges)
        self.force = float_array(force)
        self.history = History.constant() if history is None else history

    def __check_init__(self):
        _check_vectors("edge force", self.force, self.edges.array.shape[0])

    @property
    def nodes(self) -> Frozen:
        return Frozen(self.edges.array.ravel())

    def nodal(self, x0, triangles, mass_per_area) -> Float[jax.Array, "n 6"]:
        """(n, 6) force and moment on each node for factor 1."""
        first, second = self.edges.array.T
        length = jnp.linalg.norm(x0[second] - x0[first], axis=1, keepdims=True)
        share = 0.5 * length * jnp.broadcast_to(self.force, length.shape[:1] + (3,))
        return jnp.zeros((x0.shape[0], 6)).at[first, :3].add(share).at[second, :3].add(share)


class Gravity(eqx.Module):
    """A uniform acceleration field, `acceleration` (3,) [length/time²]."""

    acceleration: Float[jax.Array, "3"]
    history: History

    def __init__(self, acceleration, history: History | None = None):
        self.acceleration = float_array(acceleration)
        self.history = History.constant() if history is None else history

    def __check_init__(self):
        check_shape("acceleration", self.acceleration, (3,))
        check_finite("acceleration", self.acceleration)

    def nodal(self, x0, triangles, mass_per_area) -> Float[jax.Array, "n 6"]:
        """(n, 6) force and moment on each node for factor 1."""
        a, b, c = x0[triangles[:, 0]], x0[triangles[:, 1]], x0[triangles[:, 2]]
        area = 0.5 * jnp.linalg.norm(jnp.cross(b - a, c - a), axis=1)
        share = (mass_per_area * area / 3)[:, None] * self.acceleration
        forces = jnp.zeros((x0.shape[0], 6))
        for corner in range(3):
            forces = forces.at[triangles[:, corner], :3].add(share)
        return forces


class Pressure(eqx.Module):
    """A pressure that follows the deformed surface, positive along the elements' normals.

    `pressure`: scalar or (m,) one per element [force/length²], acting on the deformed area.
    """

    pressure: Float[jax.Array, "*m"]
    history: History

    def __init__(self, pressure, history: History | None = None):
        self.pressure = float_array(pressure)
        self.history = History.constant() if history is None else history

    def __check_init__(self):
        check_finite("pressure", self.pressure)


Load = NodalForce | NodalMoment | EdgeForce | Gravity | Pressure


def _check_vectors(name: str, value, count: int) -> None:
    check_finite(name, value)
    if value.shape not in ((3,), (count, 3)):
        raise ValueError(f"{name} must have shape (3,) or ({count}, 3), but it has shape {value.shape}.")
