"""Triangles cut at the middles of edges: the numbers of nodes, triangles and edges afterwards, and what of them belongs
to a set.

Every edge gets a middle, and all triangles are cut in four, or some edges do. Nodes keep their numbers; the middles
follow in the order of their edges, and points that no triangle uses come last. The children of a triangle stand where
it stood, in the order of `PATTERNS`.
"""

import numpy as np

from jaxshell.model.edges import Edges
from jaxshell.model.mesh import Mesh
from jaxshell.model.refinement.membership import Membership, membership, untold_message

CHILDREN = 4
"""Of a triangle all of whose edges have a middle."""
MIDDLE = 3
"""That of the four which has the middle of its parent."""

PATTERNS: dict[tuple[int, ...], tuple[tuple[int, int, int], ...]] = {
    (): ((0, 1, 2),),
    (0,): ((0, 3, 2), (3, 1, 2)),
    (1,): ((0, 1, 4), (0, 4, 2)),
    (2,): ((0, 1, 5), (5, 1, 2)),
    (0, 1): ((0, 3, 2), (3, 1, 4), (3, 4, 2)),
    (0, 2): ((0, 3, 5), (3, 1, 2), (5, 3, 2)),
    (1, 0): ((0, 3, 4), (3, 1, 4), (0, 4, 2)),
    (1, 2): ((0, 1, 4), (4, 5, 0), (5, 4, 2)),
    (2, 0): ((0, 3, 5), (3, 1, 5), (5, 1, 2)),
    (2, 1): ((0, 1, 5), (4, 5, 1), (5, 4, 2)),
    (0, 1, 2): ((0, 3, 5), (3, 1, 4), (5, 4, 2), (4, 5, 3)),
}
"""The children by which edges of a triangle have a middle; of two edges the first is the longest of the triangle, and
its middle joined to the other's. Corners are 0, 1, 2, middles 3 of edge 0-1, 4 of 1-2, 5 of 2-0. The first child has
its first edge along that of the parent, as have all of four, so that components in its axes mean the same."""


class Split:
    """Tables of a mesh some of whose edges get a middle."""

    def __init__(
        self,
        mesh: Mesh,
        cut: np.ndarray | None = None,
        longest: np.ndarray | None = None,
        before: "Split | None" = None,
    ):
        """`cut` (k,) are the edges that get a middle, None all. `longest` (m,), which of its edges 0, 1, 2 is the
        longest of every triangle, is asked for where two have one. `before` is the split that the mesh comes of, by
        which sets go on as they began."""
        self.edges = Edges(mesh.triangles)
        self.n_shell, self.points = mesh.n_nodes - mesh.points, mesh.points
        cut = np.ones(len(self.edges), bool) if cut is None else cut
        self.cut = np.flatnonzero(cut)
        self.middle = np.full(len(self.edges), -1)
        self.middle[self.cut] = self.n_shell + np.arange(len(self.cut))
        self.triangles, self.parent = self._children(cut, longest)
        self.counts = np.bincount(self.parent, minlength=mesh.n_elements)
        self._first = np.cumsum(self.counts) - self.counts
        self._before, self._known = before, dict[bytes, Membership]()

    def _children(self, cut: np.ndarray, longest: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Triangles (c, 3) afterwards, those of one parent together, and (c,) their parents."""
        edges = self.edges
        local = np.concatenate([edges.triangles, self.middle[edges.of_triangles]], axis=1)
        middles = cut[edges.of_triangles]
        first = np.zeros(len(middles), np.int64) if longest is None else longest
        triangles, parents = [], []
        for pattern, children in PATTERNS.items():
            chosen = (middles == np.isin(np.arange(3), pattern)).all(axis=1)
            if len(pattern) == 2:
                chosen &= first == pattern[0]
            numbers = np.flatnonzero(chosen)
            triangles.append(local[numbers][:, children].reshape(-1, 3))
            parents.append(np.repeat(numbers, len(children)))
        parent = np.concatenate(parents)
        order = np.argsort(parent, kind="stable")
        return np.concatenate(triangles)[order], parent[order]

    def nodes(self, numbers: np.ndarray) -> np.ndarray:
        """What nodes are called afterwards."""
        return np.where(numbers < self.n_shell, numbers, numbers + len(self.cut))

    def elements(self, numbers: np.ndarray) -> np.ndarray:
        """The children of triangles, in their order."""
        rows = self.rows_of_elements(numbers)
        within = np.arange(len(rows)) - np.searchsorted(rows, rows)
        return self._first[numbers][rows] + within

    def gauged(self, number: int) -> int:
        """The child that a gauge on a triangle goes to: that with its middle, or the one beside it along its axes."""
        return int(self._first[number]) + (MIDDLE if self.counts[number] == CHILDREN else 0)

    def halves(self, pairs: np.ndarray) -> np.ndarray:
        """(q, 2) the parts of edges (p, 2), in their order and direction. Raises ValueError for what is no edge."""
        middle = self.middle[self._numbers(pairs)]
        parts = np.stack([pairs[:, 0], middle, middle, pairs[:, 1]], 1).reshape(-1, 2, 2)
        parts[middle < 0] = pairs[middle < 0][:, None]
        kept = np.ones(parts.shape[:2], bool)
        kept[middle < 0, 1] = False
        return parts[kept]

    def rows_of_elements(self, numbers: np.ndarray | None = None) -> np.ndarray:
        """Where in triangles (None: all of them) the parent of each of their children stands."""
        counts = self.counts if numbers is None else self.counts[numbers]
        return np.repeat(np.arange(len(counts)), counts)

    def rows_of_edges(self, pairs: np.ndarray) -> np.ndarray:
        """Where in edges (p, 2) that of each of their parts stands. Raises ValueError for what is no edge."""
        return np.repeat(np.arange(len(pairs)), np.where(self.middle[self._numbers(pairs)] < 0, 1, 2))

    def _numbers(self, pairs: np.ndarray) -> np.ndarray:
        number = self.edges.numbers(pairs)
        if (number < 0).any():
            raise ValueError(f"{pairs[np.argmax(number < 0)].tolist()} is no edge of a triangle, and has no halves.")
        return number

    def membership(self, nodes: np.ndarray) -> Membership:
        """What of the mesh belongs to a set that these nodes are."""
        key = np.asarray(nodes, np.int64).tobytes()
        if key not in self._known:
            before = self._before
            if before is None:
                self._known[key] = membership(nodes, self.edges)
            else:
                self._known[key] = before.passed_on(before.membership(nodes[nodes < before.n_shell]), self.edges)
        return self._known[key]

    def passed_on(self, of: Membership, edges: Edges) -> Membership:
        """A set's membership on the mesh afterwards, whose edges are given."""
        middle_of = np.full(self.n_shell + len(self.cut), -1)
        middle_of[self.n_shell :] = self.cut
        owner = np.zeros(len(edges), np.int64)
        owner[edges.of_triangles] = self.parent[:, None]
        low, high = edges.ends.T  # of the two the middle is the higher
        cut = middle_of[high]
        kept = cut < 0
        half = ~kept & np.any(self.edges.ends[cut] == low[:, None], axis=1)
        whole = np.where(kept, self.edges.numbers(np.where(kept[:, None], edges.ends, 0)), cut)
        belongs = np.where(kept | half, of.edges[whole], of.faces[owner])
        return Membership(belongs, of.faces[self.parent], of.doubtful[self.parent], of.untold[self.parent])

    def between(self, nodes: np.ndarray) -> np.ndarray:
        """The edges (numbers) with a middle that belongs to a set that these nodes are.

        Raises ValueError where it cannot be told: one triangle alone is in the set and has other nodes of it around.
        """
        of = self.membership(nodes)
        untold = (of.untold >= 0) & self._cut_inside()
        if untold.any():
            element = int(of.untold[np.argmax(untold)])
            raise ValueError(untold_message(self._first_mesh.edges.triangles[element], element))
        return self.cut[of.edges[self.cut]]

    def may_mean_lines(self, nodes: np.ndarray) -> bool:
        """Whether triangles are cut of which a set holds all nodes, but may mean the lines around them alone."""
        return bool(np.any(self.membership(nodes).doubtful & self._cut_inside()))

    def _cut_inside(self) -> np.ndarray:
        """(m,) triangles of which an edge gets a middle that is on no line of the shell."""
        inner = (self.middle >= 0) & ~self.edges.is_line
        return np.any(inner[self.edges.of_triangles], axis=1)

    @property
    def _first_mesh(self) -> "Split":
        return self if self._before is None else self._before._first_mesh
