"""Where the node in the middle of an edge goes: on the true surface, on a smooth one, or halfway.

On a smooth surface an edge is the cubic with tangents t_a, t_b at its ends, whose middle is

    ½ (a + b) + ⅛ (T_a - T_b),   T = 2 l t/(1 + t·d),

l its length and d its direction; with this length of T the middle is that of the arc where the edge is the chord of a
circle. Inside a smooth part t is d projected into the plane across the normal at the end. An edge of a line (a
boundary, a T-junction, a crease) goes by the line alone: t is the tangent of the circle through a node and both its
neighbours on the line, unless the line ends, branches or has a corner there; then it is the mirror image of that at the
other end. So a hole stays round, and a straight edge straight.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.corner_normals import corner_normals, smooth_edges
from jaxshell.model.edges import Edges
from jaxshell.model.normals import area_vectors
from jaxshell.model.surface import TrueSurface
from jaxshell.numerics.compiled import compiled
from jaxshell.numerics.frozen import Frozen

WAYS = ("smooth", "flat")
CORNER = 50.0
"""Angle [degrees] between neighbours on a line above which it has a corner: an octagon is round, a hexagon is not."""


def middles(
    nodes: Float[Array, "n 3"],
    edges: Edges,
    cut: np.ndarray,
    surface: TrueSurface | str,
    crease: float,
    groups: np.ndarray | None,
) -> Float[Array, "c 3"]:
    """The places of new nodes, one for each of the edges `cut`; differentiable in nodes and in the surface's floats.

    `surface` is the true one, or one of `WAYS`; `crease` and `groups` as in `corner_normals`.
    """
    a, b = (nodes[edges.ends[cut, end]] for end in (0, 1))
    if isinstance(surface, TrueSurface):
        return _on_surface(surface, a, b)
    if surface == "flat":
        return 0.5 * (a + b)
    groups_or_none = None if groups is None else Frozen(groups)
    return _smooth(nodes, Frozen(edges.triangles), jnp.asarray(float(crease)), groups_or_none)[cut]


@compiled
def _on_surface(surface: TrueSurface, a: Float[Array, "k 3"], b: Float[Array, "k 3"]) -> Float[Array, "k 3"]:
    return surface.middles(a, b)


@compiled
def _smooth(nodes: Float[Array, "n 3"], triangles: Frozen, crease, groups: Frozen | None) -> Float[Array, "k 3"]:
    edges = Edges(triangles.array)
    a, b = (nodes[edges.ends[:, end]] for end in (0, 1))
    normals = corner_normals(nodes, edges, None, crease, None if groups is None else groups.array).normals
    facets = area_vectors(nodes, edges.triangles)
    # A line where sections meet is a crease of normals, and no curve of its own: on a plate it stays where it is.
    smooth = smooth_edges(_unit(facets), edges, crease)
    along = b - a
    length = jnp.linalg.norm(along, axis=1, keepdims=True)
    d = along / length
    inside = _across_normals(d, edges, normals)
    on_line = _along_lines(nodes, d, length, edges, smooth)
    tangents = [jnp.where(smooth[:, None], t, s) for t, s in zip(inside, on_line, strict=True)]
    T_a, T_b = (2.0 * length * t / (1.0 + jnp.sum(t * d, axis=1, keepdims=True)) for t in tangents)
    return 0.5 * (a + b) + 0.125 * (T_a - T_b)


def _across_normals(d: Float[Array, "k 3"], edges: Edges, normals: Float[Array, "m 3 3"]):
    """Unit tangents at both ends of every edge, from b to a's side and on: across the normals of a triangle at it."""
    first, last = np.zeros((2, len(edges), 2), np.int64)
    m = np.arange(len(edges.triangles))
    for corner in range(3):
        number, after = edges.of_triangles[:, corner], (corner + 1) % 3
        up = edges.triangles[:, corner] == edges.ends[number, 0]
        first[number] = np.stack([m, np.where(up, corner, after)], 1)
        last[number] = np.stack([m, np.where(up, after, corner)], 1)
    found = []
    for element, corner in (first.T, last.T):
        n = normals[element, corner]
        found.append(_unit(d - jnp.sum(d * n, axis=1, keepdims=True) * n))
    return found


def _along_lines(nodes, d, length, edges: Edges, smooth):
    """Unit tangents at both ends of the edges of lines; of other edges they say nothing."""
    count = jnp.where(smooth, 0.0, 1.0)[:, None]
    (first, second), n = edges.ends.T, len(nodes)

    def at_nodes(outwards):
        """Sums over the lines' edges at every node of what is (k, c), and its negative at the second end."""
        sums = jnp.zeros((n, outwards.shape[1])).at[first].add(count * outwards)
        return sums.at[second].add(-count * outwards)

    number = jnp.zeros((n, 1)).at[first].add(count).at[second].add(count)
    directions, bent = at_nodes(d), at_nodes(d / length)
    tangents, smooth_ends = [], []
    for node, sign in ((first, 1.0), (second, -1.0)):
        own = sign * d
        cosine = -jnp.sum(own * (directions[node] - own), axis=1, keepdims=True)
        goes_on = (number[node] == 2) & (cosine >= np.cos(np.radians(CORNER)))
        tangent = sign * (2.0 * own / length - bent[node])
        tangents.append(_unit(jnp.where(goes_on, tangent, d)))
        smooth_ends.append(goes_on)
    (t_a, t_b), (smooth_a, smooth_b) = tangents, smooth_ends
    mirrored = [2.0 * jnp.sum(t * d, axis=1, keepdims=True) * d - t for t in (t_b, t_a)]
    return jnp.where(smooth_a, t_a, mirrored[0]), jnp.where(smooth_b, t_b, mirrored[1])


def _unit(vectors):
    return vectors / jnp.linalg.norm(vectors, axis=1, keepdims=True)
