"""What of a shell belongs to a set of nodes: edges, whose middles do too, and triangles, whose insides do.

docs/refinement.md has the rule. It looks at a mesh as a whole, so that it is applied to the mesh that is refined first;
on the meshes that come of it edges and triangles have it from those that they are parts of. A corner between two lines,
cut in some way, would be a face otherwise.
"""

from typing import NamedTuple

import numpy as np

from jaxshell.model.edges import Edges


class Membership(NamedTuple):
    """Of a set of nodes, on one mesh."""

    edges: np.ndarray
    """(k,) whether the middle of every edge belongs to the set."""
    faces: np.ndarray
    """(m,) whether what is inside of every triangle does."""
    doubtful: np.ndarray
    """(m,) triangles of the set beside each other, between lines of it: it may mean these alone."""
    untold: np.ndarray
    """(m,) the triangle of the first mesh that is alone in the set and has more of it around, so that the rule does not
    tell whether it is of a face; else -1."""


def membership(nodes: np.ndarray, edges: Edges) -> Membership:
    """By the rule. Points, which no triangle uses, are left aside."""
    size = int(edges.triangles.max(initial=-1)) + 1
    held, runs = np.zeros(size, bool), np.zeros(size, bool)
    held[nodes[nodes < size]] = True
    both = np.all(held[edges.ends], axis=1)
    runs[edges.ends[both & edges.is_line]] = True
    whole, bordered = np.all(both[edges.of_triangles], axis=1), np.all(runs[edges.triangles], axis=1)
    beside = edges.neighbours()
    alone = whole & ~np.any(whole[beside] & (beside != np.arange(len(whole))[:, None]), axis=1)

    inner, around, at_alone = both & ~edges.is_line, np.zeros(len(edges), np.int64), np.zeros(len(edges), bool)
    np.add.at(around, edges.of_triangles, whole[:, None])
    across = inner & (around == 0) & ~np.all(runs[edges.ends], axis=1)
    at_alone[edges.of_triangles[alone]] = True
    degree = np.bincount(edges.ends[both].ravel(), minlength=size)
    single = alone & ~bordered
    untold = single & np.any(degree[edges.triangles] > 2, axis=1)
    of_single = np.zeros(len(edges), bool)
    of_single[edges.of_triangles[single & ~untold]] = True

    found = (both & edges.is_line) | across | (inner & (around > 0) & ~at_alone) | (inner & of_single)
    return Membership(
        found,
        whole & np.all(found[edges.of_triangles], axis=1),
        whole & bordered & ~alone,
        np.where(untold, np.arange(len(whole)), -1),
    )


def untold_message(corners: np.ndarray, element: int) -> str:
    """What a set must say where the rule does not tell; of a triangle of the first mesh."""
    return (
        f"nodes {corners.tolist()} are those of element {element}, but of none beside it: whether the set goes on "
        "across it or turns a corner there cannot be told. State lines that meet as sets of their own, or refine the "
        "mesh first and state the set on that."
    )
