"""Normals at nodes: the mean of those of the elements there, weighted by area."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.numerics.checks import is_concrete

_CANCELLED = 1e-9
"""Of the areas at a node: a sum of its elements' normals that is smaller says nothing."""


def summed_normals(vectors: Float[Array, "m 3"], triangles, n_nodes: int) -> Float[Array, "n 3"]:
    """Sums over the elements at every node of `vectors`, the elements' normals times their areas; no unit vectors."""
    normals = jnp.zeros((n_nodes, 3))
    for corner in range(3):
        normals = normals.at[triangles[:, corner]].add(vectors)
    return normals


def area_vectors(nodes: Float[Array, "n 3"], triangles) -> Float[Array, "m 3"]:
    """Normal times area of every element."""
    a, b, c = (nodes[triangles[:, corner]] for corner in range(3))
    return 0.5 * jnp.cross(b - a, c - a)


def unit_normals(nodes: Float[Array, "n 3"], triangles) -> Float[Array, "n 3"]:
    """The normal at every node, differentiable; zero at one without elements.

    Raises ValueError as `check_normals`.
    """
    check_normals(nodes, triangles, np.unique(triangles))
    normals = summed_normals(area_vectors(nodes, triangles), triangles, len(nodes))
    used = jnp.zeros(len(nodes), bool).at[triangles].set(True)[:, None]
    lengths = jnp.linalg.norm(jnp.where(used, normals, 1.0), axis=1, keepdims=True)
    return jnp.where(used, normals / lengths, 0.0)


def check_normals(nodes, triangles: np.ndarray, chosen: np.ndarray) -> None:
    """Raise ValueError naming one of the `chosen` nodes where the elements' normals cancel, or that has no elements.

    Nothing is checked while JAX traces the nodes.
    """
    if not is_concrete(nodes):
        return
    x = np.asarray(nodes)
    vectors = 0.5 * np.cross(x[triangles[:, 1]] - x[triangles[:, 0]], x[triangles[:, 2]] - x[triangles[:, 0]])
    sums, areas = np.zeros_like(x), np.zeros(len(x))
    np.add.at(sums, triangles, vectors[:, None])
    np.add.at(areas, triangles, np.linalg.norm(vectors, axis=1)[:, None])
    bad = ~(np.linalg.norm(sums[chosen], axis=1) > _CANCELLED * areas[chosen])
    if bad.any():
        node = int(chosen[np.argmax(bad)])
        why = "the normals of its elements cancel" if areas[node] else "it belongs to no element"
        raise ValueError(
            f"Node {node} has no normal: {why}. Choose other nodes, or state the direction in global axes."
        )
