"""The state at the start of a run, where it differs from rest in the stress-free shape."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxshell.model.connectors import RigidBody
from jaxshell.model.mesh import Mesh
from jaxshell.model.sets import check_on_mesh, nodes_or_name
from jaxshell.numerics.checks import (
    check_finite,
    check_kind,
    check_shape,
    float_array,
    is_concrete,
    optional_floats,
    shown,
)


class Initial(eqx.Module):
    """The state at the start, where it differs from rest in the stress-free shape.

    Arguments (each may be None; all differentiable):
        velocities: (n, 3) nodal velocities [length/time].
        angular_velocities: (n, 3) nodal angular velocities in space [rad/time].
        displacements: (n, 3) nodal displacements from the stress-free shape [length].
        rotations: (n, 3, 3) nodal rotation matrices from the stress-free shape.

    Raises ValueError for NaN and for matrices that are no rotations.
    """

    velocities: Float[jax.Array, "n 3"] | None = eqx.field(
        converter=optional_floats("initial velocities"), default=None
    )
    angular_velocities: Float[jax.Array, "n 3"] | None = eqx.field(
        converter=optional_floats("initial angular_velocities"), default=None
    )
    displacements: Float[jax.Array, "n 3"] | None = eqx.field(
        converter=optional_floats("initial displacements"), default=None
    )
    rotations: Float[jax.Array, "n 3 3"] | None = eqx.field(
        converter=optional_floats("initial rotations"), default=None
    )

    def __check_init__(self):
        for name in ("velocities", "angular_velocities", "displacements", "rotations"):
            if getattr(self, name) is not None:
                check_shape(f"initial {name}", getattr(self, name), (None, 3, 3) if name == "rotations" else (None, 3))
                check_finite(f"initial {name}", getattr(self, name))
        if self.rotations is not None and is_concrete(self.rotations):
            _check_rotations(np.asarray(self.rotations))

    def check(self, n_nodes: int) -> None:
        """Raise ValueError for values of another number of nodes; called when the scene is made."""
        for name in ("velocities", "angular_velocities", "displacements", "rotations"):
            value = getattr(self, name)
            if value is not None:
                check_shape(f"initial {name}", value, (n_nodes, *value.shape[1:]))

    def completed(self, mesh: Mesh, bodies: Sequence[RigidBody]) -> "Initial":
        """With rows for the mesh's points where there are none: references move with the nodes of their bodies.

        Other points are at rest.
        """
        given = {name: getattr(self, name) for name in ("velocities", "angular_velocities", "displacements")}
        given["rotations"] = self.rotations
        known = {len(value) for value in given.values() if value is not None and value.ndim > 1}
        if known != {mesh.n_nodes - mesh.points} or not mesh.points:
            return self
        n, points = mesh.n_nodes - mesh.points, mesh.points
        zeros, eyes = jnp.zeros((points, 3)), jnp.broadcast_to(jnp.eye(3), (points, 3, 3))
        for name, value in given.items():
            if value is not None:
                given[name] = jnp.concatenate([value, eyes if name == "rotations" else zeros])
        for body in bodies:
            nodes = body.followers[body.followers < n]
            if body.master >= n and nodes.size:
                _follow(given, mesh, body.master, nodes)
        return Initial(**given)

    @classmethod
    def rigid(cls, mesh: Mesh, velocity=(0.0, 0.0, 0.0), angular_velocity=(0.0, 0.0, 0.0), about=None) -> "Initial":
        """A rigid motion: `velocity` (3,) of the point `about` (3,) (default: the mean of the nodes), and a spin."""
        check_kind("mesh", mesh, Mesh, "a jaxshell.Mesh")
        velocity, spin = _vector("velocity", velocity), _vector("angular_velocity", angular_velocity)
        centre = jnp.mean(mesh.nodes, axis=0) if about is None else _vector("about", about)
        return cls(*_rigid(mesh.nodes, velocity, spin, centre))

    @classmethod
    def of(cls, mesh: Mesh, *motions) -> "Initial":
        """Rigid motions of parts of the shell: a hub that spins, a plate that flies; all other nodes are at rest.

        Each of the `motions` is (nodes, velocity, angular_velocity, about), with the nodes' numbers or the name of a
        set, and as in `rigid` what follows; the last ones may be left out, or be None: no velocity, no spin, about the
        mean of these nodes. Differentiable in all of them.

        Raises ValueError for a node in two motions, so that what two sets share has one velocity, and for a motion that
        says no velocity and no spin.
        """
        check_kind("mesh", mesh, Mesh, "a jaxshell.Mesh")
        velocities = spins = jnp.zeros((mesh.n_nodes, 3))
        moved_by = np.zeros(mesh.n_nodes, int)
        for number, motion in enumerate(motions, start=1):
            try:
                nodes, velocity, spin, about = _motion(motion, mesh)
                _check_free(nodes, moved_by)
            except ValueError as error:
                raise ValueError(f"motion number {number}: {error}") from error
            these = _rigid(mesh.nodes[nodes], velocity, spin, about)
            velocities, spins = velocities.at[nodes].set(these[0]), spins.at[nodes].set(these[1])
            moved_by[nodes] = number
        return cls(velocities, spins)


def _follow(given: dict, mesh: Mesh, master: int, nodes: np.ndarray) -> None:
    """Put into `given` the motion of a reference that moves with these nodes of its body, as their mean says."""
    arms = mesh.nodes[nodes] - mesh.nodes[master]
    if given["rotations"] is not None:
        turned = given["rotations"][nodes[0]]
        given["rotations"] = given["rotations"].at[master].set(turned)
        arms = arms @ turned.T
    if given["displacements"] is not None:
        places = mesh.nodes[nodes] + given["displacements"][nodes] - arms
        given["displacements"] = given["displacements"].at[master].set(places.mean(axis=0) - mesh.nodes[master])
    spin = jnp.zeros(3)
    if given["angular_velocities"] is not None:
        spin = given["angular_velocities"][nodes].mean(axis=0)
        given["angular_velocities"] = given["angular_velocities"].at[master].set(spin)
    if given["velocities"] is not None:
        moved = given["velocities"][nodes] - jnp.cross(spin, arms)
        given["velocities"] = given["velocities"].at[master].set(moved.mean(axis=0))


def _rigid(places: Float[jax.Array, "k 3"], velocity, spin, about) -> tuple[jax.Array, jax.Array]:
    """Velocities and angular velocities (k, 3) each."""
    return velocity + jnp.cross(spin, places - about), jnp.broadcast_to(spin, places.shape)


def _motion(motion: Any, mesh: Mesh):
    """(nodes, velocity, angular velocity, about) of one motion. Raises ValueError for anything that is none."""
    if not isinstance(motion, list | tuple) or not 2 <= len(motion) <= 4:
        raise ValueError(f"must be (nodes, velocity, angular_velocity, about), but it is {shown(motion)}.")
    chosen = nodes_or_name("its nodes", motion[0])
    nodes = mesh.node_set(chosen) if isinstance(chosen, str) else np.unique(chosen.array)
    check_on_mesh("its list", "node", nodes, mesh.n_nodes)
    velocity, spin, about = (*motion[1:], None, None)[:3]
    if velocity is None and spin is None:
        raise ValueError("says no motion: give velocity or angular_velocity.")
    still = jnp.zeros(3)
    return (
        nodes,
        still if velocity is None else _vector("velocity", velocity),
        still if spin is None else _vector("angular_velocity", spin),
        jnp.mean(mesh.nodes[nodes], axis=0) if about is None else _vector("about", about),
    )


def _check_free(nodes: np.ndarray, moved_by: np.ndarray) -> None:
    """Raise ValueError where one of the nodes is moved already; `moved_by` (n,) are numbers of motions, 0 is none."""
    taken = nodes[moved_by[nodes] > 0]
    if taken.size:
        raise ValueError(
            f"moves node {taken[0]} (and {taken.size - 1} others), which number {moved_by[taken[0]]} moves already: "
            "choose each node once."
        )


def _vector(name: str, value) -> Float[jax.Array, "3"]:
    vector = float_array(value, name)
    check_shape(name, vector, (3,))
    check_finite(name, vector)
    return vector


def _check_rotations(R: np.ndarray) -> None:
    error = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2))
    bad = (error > 1e-8) | (np.linalg.det(R) < 0)
    if bad.any():
        node = int(np.argmax(bad))
        raise ValueError(f"initial rotations: the matrix of node {node} is no rotation: {R[node].tolist()}.")
