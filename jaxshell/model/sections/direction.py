"""Directions on the shell: from which way on it the angles of plies and the components of strains are counted."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.numerics.checks import check_choice, check_finite, check_shape, float_array, is_concrete
from jaxshell.numerics.triangles import local_frame

_NORMAL = 1e-6
"""A direction whose part in the plane of an element is a smaller fraction of it is normal to it."""


class Cylindrical(eqx.Module):
    """The directions of a cylinder: at every element along its axis, or around it.

    Arguments:
        axis: (3,) the axis' direction, of any length.
        origin: (3,) a point on it.
        along: "axis", or "circumference", which runs counter-clockwise about the axis.

    Raises ValueError for an axis of no length.
    """

    axis: Float[jax.Array, "3"]
    origin: Float[jax.Array, "3"]
    along: str = eqx.field(static=True)

    def __init__(self, axis, origin=(0.0, 0.0, 0.0), along: str = "axis"):
        self.axis, self.origin = float_array(axis, "axis"), float_array(origin, "origin")
        self.along = along
        check_choice("along", along, ("axis", "circumference"))
        for name in ("axis", "origin"):
            check_shape(name, getattr(self, name), (3,))
            check_finite(name, getattr(self, name))
        if is_concrete(self.axis) and not np.any(np.asarray(self.axis)):
            raise ValueError("axis must have a length, but it is [0, 0, 0].")

    def vectors(self, centres: Float[Array, "m 3"]) -> Float[Array, "m 3"]:
        """The direction at each of the points."""
        if self.along == "axis":
            return jnp.broadcast_to(self.axis, centres.shape)
        return jnp.cross(self.axis, centres - self.origin)


def given_direction(value):
    """A direction as it was given, checked: a vector (3,), one for each element (m, 3), or a `Cylindrical`."""
    if isinstance(value, Cylindrical):
        return value
    vectors = float_array(value, "direction")
    if vectors.shape != (3,) and (vectors.ndim != 2 or vectors.shape[1] != 3):
        raise ValueError(f"direction must have shape (3,) or (m, 3), but it has shape {vectors.shape}.")
    check_finite("direction", vectors)
    return vectors


def vectors_at(direction, mesh) -> Float[Array, "m 3"]:
    """The direction at every element of a mesh. Raises ValueError for a field of another length."""
    x = mesh.nodes[mesh.triangles]
    if isinstance(direction, Cylindrical):
        return direction.vectors(jnp.mean(x, axis=1))
    if direction.shape not in ((3,), (len(x), 3)):
        raise ValueError(
            f"direction must be one vector or one per element ({len(x)}), but it has shape {direction.shape}."
        )
    return jnp.broadcast_to(direction, (len(x), 3))


def check_direction(direction, mesh) -> None:
    """Raise ValueError naming an element to which a known direction is normal; no program is compiled."""
    if not all(map(is_concrete, (mesh.nodes, *jax.tree.leaves(direction)))):
        return
    x = np.asarray(mesh.nodes)[mesh.triangles]
    normals = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    vectors = np.asarray(vectors_at(direction, mesh))
    sizes = np.linalg.norm(vectors, axis=1)
    inside = np.linalg.norm(np.cross(normals, vectors), axis=1) / np.linalg.norm(normals, axis=1)
    bad = ~(inside > _NORMAL * sizes)
    if bad.any():
        element = int(np.argmax(bad))
        raise ValueError(
            f"The direction {vectors[element].tolist()} is normal to element {element} (and to {int(bad.sum()) - 1} "
            "others), where no angle can be counted from it: choose another there, as a field (m, 3) or a Cylindrical, "
            "or make regions."
        )


def angles(direction, mesh) -> Float[Array, " m"]:
    """Angle [rad] in every element from its axis e1 to the direction projected onto it, counter-clockwise about e3."""
    frames, _ = jax.vmap(local_frame)(mesh.nodes[mesh.triangles])
    along = jnp.einsum("mij,mj->mi", frames, vectors_at(direction, mesh))
    return jnp.arctan2(along[:, 1], along[:, 0])
