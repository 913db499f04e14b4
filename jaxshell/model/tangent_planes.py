"""Tangent planes at the nodes of the surface that a mesh stands for, from the nodes alone.

At every node, in each smooth patch of elements around it, the height over the mean plane is fitted by a quadratic
polynomial through the node (jet fitting: F. Cazals & M. Pouget, "Estimating differential quantities using polynomial
fitting of osculating jets", Comput. Aided Geom. Des. 22 (2005) 121-146). Its slopes are right to the second power of
the mesh size, at the boundary too, where the mean of the elements' normals is off by half a triangle's turn.
"""

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse
from jaxtyping import Array, Float

from jaxshell.model.normals import area_vectors

_LEAST = 5
"""Neighbours that determine a quadratic polynomial."""
_RIDGE = 1e-9
"""Of the weights: what keeps apart polynomials that the neighbours do not tell apart. The flattest is taken."""


def tangent_normals(nodes: Float[Array, "n 3"], triangles: np.ndarray, labels: np.ndarray) -> Float[Array, "m 3 3"]:
    """Unit normals of the surface at the corners of every element, (element, corner, 3). Differentiable by the nodes.

    `labels` (m, 3) are of `jaxshell.model.patches.smooth_labels`: across a fold each side has its own.
    """
    own, neighbours, known = _neighbours(triangles, labels)
    sums = jnp.zeros((len(own), 3))
    vectors = area_vectors(nodes, triangles)
    for corner in range(3):
        sums = sums.at[labels[:, corner]].add(vectors)

    def normal(mean, origin, points, known):
        mean = mean / jnp.linalg.norm(mean)
        aside = jnp.eye(3)[jnp.argmin(jnp.abs(mean))]
        first = jnp.cross(mean, aside)
        first = first / jnp.linalg.norm(first)
        second = jnp.cross(mean, first)
        local = (points - origin) @ jnp.stack([first, second, mean]).T
        squares = jnp.where(known, jnp.sum(local**2, axis=1), 1.0)
        size_sq = jnp.sum(jnp.where(known, squares, 0.0)) / jnp.sum(known)
        x, y, z = (local / jnp.sqrt(size_sq)).T
        weight = jnp.where(known, size_sq / squares, 0.0)
        terms = jnp.stack([x, y, 0.5 * x * x, x * y, 0.5 * y * y])
        matrix = (weight * terms) @ terms.T + _RIDGE * jnp.sum(weight) * jnp.eye(5)
        a, b, *_ = jnp.linalg.solve(matrix, (weight * terms) @ z)
        found = mean - a * first - b * second
        return found / jnp.linalg.norm(found)

    return jax.vmap(normal)(sums, nodes[own], nodes[neighbours], jnp.asarray(known))[labels]


def _neighbours(triangles: np.ndarray, labels: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of every patch its node, the nodes around it (q, k), and which of these there are (q, k).

    One ring of elements where it closes and says enough; two at boundaries and folds.
    """
    m, n, q = len(triangles), int(triangles.max()) + 1, int(labels.max()) + 1
    own = np.zeros(q, int)
    own[labels.ravel()] = triangles.ravel()
    elements = np.repeat(np.arange(m), 3)
    at = scipy.sparse.csr_matrix((np.ones(3 * m), (labels.ravel(), elements)), (q, m))  # patch by element
    holds = scipy.sparse.csr_matrix((np.ones(3 * m), (elements, triangles.ravel())), (m, n))
    one = (at @ holds).tocsr()
    alone = np.diff(one.indptr) - 1
    closed = (alone == np.asarray(at.sum(axis=1)).ravel()) & (alone >= _LEAST)
    two = (at[~closed] @ at.T @ at @ holds).tocsr()
    rows: list[np.ndarray] = [np.zeros(0, int)] * q
    for patches, ring in ((np.flatnonzero(closed), one[closed]), (np.flatnonzero(~closed), two)):
        for patch, start, end in zip(patches, ring.indptr[:-1], ring.indptr[1:], strict=True):
            found = ring.indices[start:end]
            rows[patch] = np.sort(found[found != own[patch]])
    most = max(len(row) for row in rows)
    neighbours = np.stack([np.pad(row, (0, most - len(row)), constant_values=own[p]) for p, row in enumerate(rows)])
    return own, neighbours, np.arange(most) < np.array([len(row) for row in rows])[:, None]
