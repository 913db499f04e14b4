"""The edges of triangles and how triangles meet at them, as static tables."""

import numpy as np

from jaxshell.model import repair


class Edges:
    """The k edges of triangles (m, 3) between n nodes.

    `ends` (k, 2), the lower number first; `of_triangles` (m, 3), edge c from corner c to the next; `count` (k,), how
    many triangles have each; `is_line` (k,), whether other than two do: those of the boundary and of T-junctions.
    """

    def __init__(self, triangles: np.ndarray):
        number, self.count, _ = repair.numbered_edges(triangles)
        ends = np.sort(repair.edges_of(triangles), axis=1)
        self.ends = np.zeros((len(self.count), 2), np.int64)
        self.ends[number] = ends
        self.triangles = np.asarray(triangles, np.int64)
        self.of_triangles = number.reshape(-1, 3)
        self.is_line = self.count != 2
        self._size = int(triangles.max(initial=0)) + 1
        self._keys = ends_key(self.ends, self._size)

    def __len__(self) -> int:
        return len(self.ends)

    def neighbours(self) -> np.ndarray:
        """(m, 3) the triangle across each edge of a triangle; itself where there is none, or more than one."""
        across = np.repeat(np.arange(len(self.triangles))[:, None], 3, axis=1)
        flat, owner = self.of_triangles.ravel(), np.repeat(np.arange(len(self.triangles)), 3)
        inner = np.flatnonzero(self.count[flat] == 2)
        pairs = inner[np.argsort(flat[inner], kind="stable")].reshape(-1, 2)
        across.ravel()[pairs[:, 0]], across.ravel()[pairs[:, 1]] = owner[pairs[:, 1]], owner[pairs[:, 0]]
        return across

    def numbers(self, pairs: np.ndarray) -> np.ndarray:
        """(p,) the edges between pairs of nodes (p, 2); -1 for a pair that is no edge."""
        if not len(self) or not len(pairs):
            return np.full(len(pairs), -1)
        inside = np.all(pairs < self._size, axis=1)
        keys = ends_key(np.where(inside[:, None], pairs, 0), self._size)
        at = np.minimum(np.searchsorted(self._keys, keys), len(self) - 1)
        return np.where(inside & (self._keys[at] == keys), at, -1)


def ends_key(pairs: np.ndarray, size: int) -> np.ndarray:
    """(p,) one number for each pair of nodes below `size`, whichever is first; ascending with the lower, the upper."""
    pairs = np.sort(np.asarray(pairs, np.int64), axis=1)
    return pairs[:, 0] * size + pairs[:, 1]
