"""Which edges get a middle where chosen triangles are to be bisected: longest-edge bisection, after Rivara.

Every triangle at an edge with a middle is cut at its own longest edge too, so that the middles chosen go on to
triangles with longer edges, until that is so of all. A triangle is cut in two at its longest edge, in three where one
of the halves is cut again at an edge of its parent, and in four like ones where all its edges have a middle. However
often this is done no angle falls below half of the smallest of the first mesh (M. C. Rivara, "Algorithms for refining
triangular grids suitable for adaptive and multigrid techniques", Int. J. Numer. Methods Eng. 20 (1984) 745-756).

Edges that a joint holds together are one: they are as long as the longer, and get a middle together.
"""

import jax
import numpy as np

from jaxshell.model.edges import Edges
from jaxshell.numerics.checks import is_concrete

_DIGITS = 9
"""Of the logarithm of a length: edges that differ by less are equally long, and the one of the higher number counts as
the longer."""


def bisected_edges(
    nodes, edges: Edges, elements: np.ndarray, joined: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """(k,) whether each edge gets a middle where these triangles are bisected, and (m,) which edge of each is longest.

    `joined` (j, 2) are pairs of edges that joints hold together. Raises ValueError while the places of the nodes are
    being traced by `jax.jit` or `jax.vmap`: what is cut follows from them.
    """
    x = jax.lax.stop_gradient(nodes)
    if not is_concrete(x):
        raise ValueError(
            "Which edges are bisected follows from the places of the nodes, and they are being traced by jax.jit or "
            "jax.vmap. Bisect outside of them (jax.grad and jax.jvp alone are allowed), or refine all elements."
        )
    places = np.asarray(x)
    length = np.linalg.norm(places[edges.ends[:, 1]] - places[edges.ends[:, 0]], axis=1)
    group = _groups(len(edges), np.zeros((0, 2), np.int64) if joined is None else joined)
    longest_of_group = np.zeros(len(edges))
    np.maximum.at(longest_of_group, group, length)
    rank = np.empty(len(edges), np.int64)
    rank[np.lexsort((group, np.round(np.log2(longest_of_group[group]), _DIGITS)))] = np.arange(len(edges))
    np.maximum.at(rank, group, rank)  # one rank for all of a group, that of its last
    longest = np.argmax(rank[group][edges.of_triangles], axis=1)
    own = edges.of_triangles[np.arange(len(longest)), longest]

    cut = np.zeros(len(edges), bool)
    cut[own[elements]] = True
    count = -1
    while count < (count := int(cut.sum())):
        of_group = np.zeros(len(edges), bool)
        of_group[group[cut]] = True
        cut = of_group[group]
        cut[own[np.any(cut[edges.of_triangles], axis=1)]] = True
    return cut, longest


def _groups(count: int, joined: np.ndarray) -> np.ndarray:
    """(k,) the lowest number of the edges that each of them is held together with."""
    group = np.arange(count)
    while len(joined):
        lowest = group[joined].min(axis=1)
        before = group.copy()
        for end in (0, 1):
            np.minimum.at(group, joined[:, end], lowest)
        if np.array_equal(group, before):
            break
    return group
