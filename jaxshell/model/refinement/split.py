"""Every triangle in four: the numbers of nodes, triangles and edges afterwards, and what of them belongs to a set.

Nodes keep their numbers; that in the middle of edge e is n + e, and points that no triangle uses come last. Of triangle
k the children 4k, 4k + 1, 4k + 2 have its corners and 4k + 3 its middle, all with axes along those of the parent.
"""

import numpy as np

from jaxshell.model.edges import Edges
from jaxshell.model.mesh import Mesh

CHILDREN = 4
MIDDLE = 3
"""The child that has the middle of its parent."""


class Split:
    """Tables of a mesh whose triangles are cut in four."""

    def __init__(self, mesh: Mesh):
        self.edges = Edges(mesh.triangles)
        self.n_shell, self.points = mesh.n_nodes - mesh.points, mesh.points
        self._neighbours = self.edges.neighbours()

    @property
    def triangles(self) -> np.ndarray:
        """(4m, 3) of the children."""
        a, b, c = self.edges.triangles.T
        ab, bc, ca = self.n_shell + self.edges.of_triangles.T
        children = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (bc, ca, ab)]
        return np.stack([np.stack(child, 1) for child in children], 1).reshape(-1, 3)

    def nodes(self, numbers: np.ndarray) -> np.ndarray:
        """What nodes are called afterwards."""
        return np.where(numbers < self.n_shell, numbers, numbers + len(self.edges))

    def elements(self, numbers: np.ndarray) -> np.ndarray:
        """The children of triangles, in their order."""
        return (CHILDREN * numbers[:, None] + np.arange(CHILDREN)).ravel()

    def halves(self, pairs: np.ndarray) -> np.ndarray:
        """(2p, 2) of edges (p, 2), in their order and direction. Raises ValueError for what is no edge."""
        number = self.edges.numbers(pairs)
        if (number < 0).any():
            raise ValueError(f"{pairs[np.argmax(number < 0)].tolist()} is no edge of a triangle, and has no halves.")
        middle = self.n_shell + number
        return np.stack([pairs[:, 0], middle, middle, pairs[:, 1]], 1).reshape(-1, 2)

    def between(self, nodes: np.ndarray) -> np.ndarray:
        """The edges (numbers) whose middles belong to a set that these nodes are; docs/refinement.md has the rule.

        Raises ValueError where it cannot be told: one triangle alone is in the set and has other nodes of it around.
        """
        edges = self.edges
        runs, both, whole = self._of_set(nodes)
        inner, around = both & ~edges.is_line, np.zeros(len(edges), np.int64)
        np.add.at(around, edges.of_triangles, whole[:, None])
        across = inner & (around == 0) & ~np.all(runs[edges.ends], axis=1)
        alone = whole & ~self._has_whole_neighbour(whole)
        at_alone = np.zeros(len(edges), bool)
        at_alone[edges.of_triangles[alone]] = True
        in_face = inner & (around > 0) & ~at_alone
        single = inner & self._of_single(np.flatnonzero(alone & ~np.all(runs[edges.triangles], axis=1)), both)
        return np.flatnonzero((both & edges.is_line) | across | in_face | single)

    def may_mean_lines(self, nodes: np.ndarray) -> bool:
        """Whether a set holds neighbouring triangles that lie between its own lines: it may mean these alone."""
        runs, _, whole = self._of_set(nodes)
        whole = whole & np.all(runs[self.edges.triangles], axis=1)
        return bool(np.any(whole & self._has_whole_neighbour(whole)))

    def _of_set(self, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of a set: nodes (n,) on lines of the shell that are in it, and edges (k,) and triangles (m,) that are.

        Points are left aside.
        """
        edges = self.edges
        held, runs = np.zeros(self.n_shell, bool), np.zeros(self.n_shell, bool)
        held[nodes[nodes < self.n_shell]] = True
        both = np.all(held[edges.ends], axis=1)
        runs[edges.ends[both & edges.is_line]] = True
        return runs, both, np.all(both[edges.of_triangles], axis=1)

    def _has_whole_neighbour(self, whole: np.ndarray) -> np.ndarray:
        other = self._neighbours != np.arange(len(whole))[:, None]
        return np.any(whole[self._neighbours] & other, axis=1)

    def _of_single(self, alone: np.ndarray, both: np.ndarray) -> np.ndarray:
        """(k,) the edges of triangles that are alone in a set. Raises ValueError where more of it is around them."""
        edges, found = self.edges, np.zeros(len(self.edges), bool)
        degree = np.bincount(edges.ends[both].ravel(), minlength=self.n_shell)
        for element in alone:
            corners = edges.triangles[element]
            if (degree[corners] > 2).any():
                raise ValueError(
                    f"nodes {corners.tolist()} are those of element {element}, but of none beside it: whether the set "
                    "goes on across it or turns a corner there cannot be told. State lines that meet as sets of their "
                    "own, or refine the mesh first and state the set on that."
                )
            found[edges.of_triangles[element]] = True
        return found
