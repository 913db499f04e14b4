"""Four triangles in one: which of a mesh belong together, where it was refined or is a regular grid."""

import numpy as np

from jaxshell.model.edges import Edges
from jaxshell.model.grids import structured_triangles
from jaxshell.model.mesh import Mesh
from jaxshell.model.refinement.split import CHILDREN, Split

_TURNED = ([0, 1, 2], [0, 2, 1])


class Family:
    """A mesh as the refinement of a coarser one, but for the numbers of its nodes and triangles.

    `kept` are the nodes of the coarse mesh; `number` (n,) what each node is called there, and -1 for one in the middle
    of an edge, whose ends on the coarse mesh are `ends` (n, 2); `children` (m, 4); `parent` of each triangle.
    """

    def __init__(self, mesh: Mesh):
        """Raises ValueError for a mesh that is no refinement."""
        found = _of_refined(mesh.triangles) or _of_grid(mesh.triangles)
        if found is None:
            raise ValueError(
                "The mesh can not be coarsened: it was not refined, and is no grid of generated triangles with even "
                "divisions."
            )
        corners, self.children = found
        n_shell = mesh.n_nodes - mesh.points
        self.kept = np.concatenate([np.unique(corners), np.arange(n_shell, mesh.n_nodes)])
        self.number = np.full(mesh.n_nodes, -1)
        self.number[self.kept] = np.arange(len(self.kept))
        self.triangles = self.number[corners]
        self.parent = np.zeros(mesh.n_elements, np.int64)
        self.parent[self.children] = np.arange(len(corners))[:, None]
        self.ends = np.full((mesh.n_nodes, 2), -1)
        self._edges = Edges(self.triangles)
        self.middles = self._middles(mesh.triangles)
        self.ends[self.middles] = self._edges.ends

    def _middles(self, triangles: np.ndarray) -> np.ndarray:
        """(k,) the node in the middle of each coarse edge: that which the children at its ends share."""
        found = np.zeros(len(self._edges), np.int64)
        for corner in range(3):
            one, other = (triangles[self.children[:, c]] for c in (corner, (corner + 1) % 3))
            shared = (one[:, :, None] == other[:, None, :]).any(axis=2)
            found[self._edges.of_triangles[:, corner]] = np.take_along_axis(
                one, np.argmax(shared, axis=1)[:, None], axis=1
            )[:, 0]
        return found

    def fine(self, split: Split, numbers: np.ndarray) -> np.ndarray:
        """What nodes of the coarse mesh refined are called here."""
        return np.concatenate([self.kept[: split.n_shell], self.middles, self.kept[split.n_shell :]])[numbers]


def _of_refined(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Corners (m, 3) and children (m, 4), where triangles stand as `refine` leaves them."""
    if not len(triangles) or len(triangles) % CHILDREN:
        return None
    a, b, c, middle = np.moveaxis(triangles.reshape(-1, CHILDREN, 3), 1, 0)
    agree = (a[:, 1] == b[:, 0]) & (b[:, 2] == c[:, 1]) & (c[:, 0] == a[:, 2])
    agree &= (middle == np.stack([b[:, 2], a[:, 2], a[:, 1]], 1)).all(axis=1)
    if not agree.all():
        return None
    return np.stack([a[:, 0], b[:, 1], c[:, 2]], 1), np.arange(len(triangles)).reshape(-1, CHILDREN)


def _of_grid(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """The same of a grid as `structured_triangles` numbers it, turned or not, with even divisions."""
    for turn in _TURNED:
        width = int(triangles[0][turn][1]) if len(triangles) else 0
        for columns, periodic in ((width - 1, False), (width, True)):
            rows, rest = divmod(len(triangles), 2 * columns) if columns > 0 else (0, 1)
            if rest or rows % 2 or columns % 2:
                continue
            if not np.array_equal(structured_triangles(rows, columns, periodic)[:, turn], triangles):
                continue
            i, j = (index.ravel() for index in np.mgrid[0:rows:2, 0:columns:2])
            after = (j + 2) % width

            def cell(di, dj, upper, i=i, j=j, columns=columns):
                return 2 * ((i + di) * columns + j + dj) + upper

            a, b, c, d = i * width + j, (i + 2) * width + j, (i + 2) * width + after, i * width + after
            lower = [cell(0, 0, 0), cell(1, 0, 0), cell(1, 1, 0)], cell(1, 0, 1)
            upper = [cell(0, 0, 1), cell(1, 1, 1), cell(0, 1, 1)], cell(0, 1, 0)
            corners = np.stack([np.stack([a, b, c], 1)[:, turn], np.stack([a, c, d], 1)[:, turn]], 1)
            children = [np.stack([*(at[k] for k in turn), middle], 1) for at, middle in (lower, upper)]
            return corners.reshape(-1, 3), np.stack(children, 1).reshape(-1, CHILDREN)
    return None
