"""Normals of the shell at the corners of its elements: of the true surface, or the mean of a smooth part around a node.

Triangles that share an edge are of one smooth part unless they meet at an angle above `crease`, belong to different
`groups`, or are more than two. The triangles around a node fall into fans of such parts; each fan has one normal there,
so that across a fold each side has its own.

The mean is that of N. Max, "Weights for computing vertex normals from facet normals", J. Graphics Tools 4 (1999):
Σ a × b / |a|²|b|² over the corners of a fan, with the edges a, b from the node; exact on spheres. At the end of a
smooth part, where a fan is open, it would lag by half an element: there the normal n is turned until the edges to
neighbours of closed fans are chords of arcs, n·d = -n_k·d, in the mean of least squares.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxshell.model.edges import Edges
from jaxshell.model.normals import area_vectors
from jaxshell.model.surface import TrueSurface

CREASE = 30.0
"""Angle between normals of neighbours [degrees] above which their common edge is a crease."""
_ROUNDS = 3
"""How often open fans are turned: first those that have neighbours of closed fans, which is linearised and so repeated;
then besides those at corners, which have neighbours of the first kind."""
_AT_LIMIT = 1e-9
"""Of cosines: twelve sides of a cylinder meet at 30 degrees, and it is round."""
_LEAST = 1e-6
"""Part of the mean stiffness of the fit that holds the component which no edge says anything about."""


class Corners(NamedTuple):
    """Normals of elements at their corners, and which of their edges are smooth."""

    normals: Float[Array, "m 3 3"]
    """Unit vectors, one for each corner, on the side of the element's own."""
    smooth: Array
    """(k,) of every edge, whether the surface goes on across it without a crease."""


def corner_normals(
    nodes: Float[Array, "n 3"], edges: Edges, surface: TrueSurface | None = None, crease: Any = CREASE, groups=None
) -> Corners:
    """The normals at the corners of triangles; differentiable in nodes and surface.

    Arguments:
        nodes: (n, 3).
        edges: those of the triangles.
        surface: the true surface that the nodes are on; None takes means of the triangles.
        crease: in degrees.
        groups: (m,) whole numbers; where two triangles' differ there is a crease. None is one group.
    """
    triangles = edges.triangles
    facets = _unit(area_vectors(nodes, triangles))
    smooth = smooth_edges(facets, edges, crease, groups)
    if surface is not None:
        normals = surface.normals(nodes[triangles.ravel()]).reshape(-1, 3, 3)
        turned = jnp.sum(normals * facets[:, None], axis=2, keepdims=True) < 0
        return Corners(jnp.where(turned, -normals, normals), smooth)
    fans = fans_of(edges, smooth)
    return Corners(_fan_normals(nodes, edges, smooth, fans)[fans].reshape(-1, 3, 3), smooth)


def smooth_edges(facets: Float[Array, "m 3"], edges: Edges, crease: Any, groups=None) -> Array:
    """(k,) whether the surface goes on across an edge; `facets` are the triangles' unit normals."""
    owner, across = _sides(edges)
    facets = jax.lax.stop_gradient(facets)
    near = jnp.sum(facets[owner] * facets[across], axis=1) >= jnp.cos(jnp.radians(crease)) - _AT_LIMIT
    alike = True if groups is None else np.asarray(groups)[owner] == np.asarray(groups)[across]
    return near & alike & ~edges.is_line


def _sides(edges: Edges) -> tuple[np.ndarray, np.ndarray]:
    """(k,) a triangle of every edge, and the one on its other side."""
    owner, across = np.zeros(len(edges), np.int64), np.zeros(len(edges), np.int64)
    owner[edges.of_triangles] = np.arange(len(edges.triangles))[:, None]
    across[edges.of_triangles] = edges.neighbours()
    # Of the two writes to an edge the same one is kept: the neighbour of the owner.
    return owner, across


def fans_of(edges: Edges, smooth) -> Int[Array, " c"]:
    """(3m,) the fan that each corner of each triangle is in, by the least number 3 k + c of its corners."""
    m = len(edges.triangles)
    labels = jnp.arange(3 * m)
    links, over = _links(edges)
    joined = smooth[over]
    rounds = int(np.bincount(edges.triangles.ravel(), minlength=1).max(initial=1))
    for _ in range(rounds):
        labels = jnp.min(jnp.where(joined, labels[links], labels[:, None]), axis=1)
    return labels


def _links(edges: Edges) -> tuple[np.ndarray, np.ndarray]:
    """(3m, 3) the corner itself and the corners at the same node across its two edges; and the edges between."""
    triangles, across = edges.triangles, edges.neighbours()
    m, corner = len(triangles), np.arange(3)
    found, over = [np.arange(3 * m).reshape(m, 3)], [edges.of_triangles]
    for edge in (corner, (corner + 2) % 3):  # that which leaves the corner, and that which comes to it
        other = across[:, edge]
        same = np.argmax(triangles[other] == triangles[:, :, None], axis=2)
        found.append(3 * other + same)
        over.append(edges.of_triangles[:, edge])
    # Over a line a triangle is its own neighbour: the corner is linked with itself, whatever stands here.
    return np.stack(found, 2).reshape(-1, 3), np.stack(over, 2).reshape(-1, 3)


def _fan_normals(nodes, edges: Edges, smooth, fans) -> Float[Array, "c 3"]:
    """Unit normals of all fans, at the places of their numbers."""
    triangles = edges.triangles
    m, corner = len(triangles), np.arange(3)
    here = triangles.ravel()
    ahead, behind = (nodes[triangles[:, (corner + k) % 3].ravel()] - nodes[here] for k in (1, 2))
    sizes = jnp.sum(ahead**2, axis=1) * jnp.sum(behind**2, axis=1)
    normals = jnp.zeros((3 * m, 3)).at[fans].add(jnp.cross(ahead, behind) / sizes[:, None])
    normals = _unit(normals)
    # Both ends of every directed edge of a triangle, as fans; over a smooth edge two triangles say the same.
    ends = fans.reshape(-1, 3)
    start, end = ends.ravel(), ends[:, (corner + 1) % 3].ravel()
    start, end = jnp.concatenate([start, end]), jnp.concatenate([end, start])
    chords = _unit(jnp.concatenate([ahead, -ahead]))
    inner = jnp.tile(smooth[edges.of_triangles].ravel(), 2)
    known, tells = ~jnp.zeros(3 * m, bool).at[start].max(~inner), jnp.zeros(len(start), bool)
    for _ in range(_ROUNDS):
        tells = tells | (known[end] & ~known[start])
        weight = jnp.where(tells, 1.0, 0.0)
        wanted = -jnp.sum((normals[end] + normals[start]) * chords, axis=1)
        told = jnp.zeros(3 * m).at[start].add(weight)
        normals = jnp.where(told[:, None] > 0, _turned(normals, start, chords, weight, wanted), normals)
        known = known | (told > 2)  # inner edges are told twice, and a single one says one component
    return normals


def _turned(normals, start, chords, weight, wanted) -> Float[Array, "c 3"]:
    """Normals turned by δ ⊥ n so that δ·d is what is wanted along the chords of each, by least squares."""
    along = chords - jnp.sum(chords * normals[start], axis=1, keepdims=True) * normals[start]
    square = weight[:, None, None] * along[:, :, None] * along[:, None, :]
    matrix = jnp.zeros((len(normals), 3, 3)).at[start].add(square)
    right = jnp.zeros_like(normals).at[start].add((weight * wanted)[:, None] * along)
    trace = jnp.trace(matrix, axis1=1, axis2=2)[:, None, None]
    good = trace > 0
    # The normal's own direction gets a stiffness, so that the three equations can be solved.
    own = normals[:, :, None] * normals[:, None, :]
    matrix = jnp.where(good, matrix + trace * (_LEAST * jnp.eye(3) + own), jnp.eye(3))
    change = jnp.linalg.solve(matrix, right[:, :, None])[:, :, 0]
    return _unit(normals + jnp.where(good[:, :, 0], change, 0.0))


def _unit(vectors):
    """Unit vectors along these; zero for one of no length."""
    square = jnp.sum(vectors * vectors, axis=1, keepdims=True)
    good = square > 0
    return jnp.where(good, vectors / jnp.sqrt(jnp.where(good, square, 1.0)), 0.0)
