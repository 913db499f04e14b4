"""Triangle meshes: nodes, connectivity, the checks that a shell needs, selections, and import through meshio."""

from collections.abc import Callable

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from jaxshell.numerics.checks import check_finite, check_shape, float_array, is_concrete, require_float64
from jaxshell.numerics.frozen import Frozen


class Mesh(eqx.Module):
    """A surface mesh of three-node triangles.

    Arguments:
        nodes: (n, 3) coordinates of the stress-free shape, in the user's unit of length. Differentiable.
        triangles: (m, 3) node indices, counted from 0. The right-hand rule gives the element's normal;
            neighbours must agree on it. The element's first axis is parallel to its edge 1-2.

    Raises ValueError for indices out of range, repeated nodes or triangles, zero areas, neighbours with
    opposite normals, unused nodes, NaN; RuntimeError when JAX has float64 switched off.
    """

    nodes: Float[jax.Array, "n 3"] = eqx.field(converter=float_array)
    connectivity: Frozen = eqx.field(static=True)

    def __init__(self, nodes, triangles):
        require_float64()
        self.nodes = float_array(nodes)
        triangles = triangles.array if isinstance(triangles, Frozen) else np.asarray(triangles)
        if not np.issubdtype(triangles.dtype, np.integer):
            raise ValueError(f"triangles must be integers, but their type is {triangles.dtype}.")
        self.connectivity = Frozen(triangles)

    def __check_init__(self):
        check_shape("nodes", self.nodes, (None, 3))
        check_shape("triangles", self.triangles, (None, 3))
        check_finite("nodes", self.nodes)
        _check_connectivity(self.triangles, self.n_nodes)
        if is_concrete(self.nodes):
            _check_areas(np.asarray(self.nodes), self.triangles)

    @property
    def triangles(self) -> np.ndarray:
        """(m, 3) node indices of the elements."""
        return self.connectivity.array

    @property
    def n_nodes(self) -> int:
        return self.nodes.shape[0]

    @property
    def n_elements(self) -> int:
        return self.triangles.shape[0]

    def nodes_where(self, condition: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Indices of the nodes whose coordinates fulfil `condition(x)`, x of shape (3, n).

        Raises ValueError when there is none.
        """
        found = np.flatnonzero(condition(np.asarray(self.nodes).T))
        if found.size == 0:
            raise ValueError("nodes_where: no node fulfils the condition; widen its tolerance or check it.")
        return found

    def nearest_node(self, point) -> int:
        """Index of the node nearest to `point` (3,)."""
        return int(np.argmin(np.linalg.norm(np.asarray(self.nodes) - np.asarray(point), axis=1)))

    def boundary_edges(self) -> np.ndarray:
        """(k, 2) node indices of the edges that belong to one triangle only."""
        edges, count = np.unique(np.sort(_edges(self.triangles), axis=1), axis=0, return_counts=True)
        return edges[count == 1]

    @classmethod
    def read(cls, path) -> "Mesh":
        """Read the triangles of a mesh file (Gmsh, VTK, STL, Abaqus, ...) with meshio.

        Nodes that belong to no triangle are dropped. Raises ImportError without meshio
        (`pip install meshio`), ValueError when the file holds no triangle.
        """
        try:
            import meshio
        except ImportError as error:
            raise ImportError("Reading mesh files needs meshio: pip install meshio.") from error
        content = meshio.read(path)
        triangles = content.cells_dict.get("triangle")
        if triangles is None:
            kinds = ", ".join(content.cells_dict) or "no cells"
            raise ValueError(f"{path} holds no triangles (it has: {kinds}). Mesh the surface with 3-node triangles.")
        used, compact = np.unique(triangles, return_inverse=True)
        return cls(content.points[used, :3], compact.reshape(triangles.shape))


def grid(first, second) -> tuple[np.ndarray, np.ndarray]:
    """Both coordinates (n·k,) of the nodes of a grid of n by k values, numbered as `structured_triangles` does."""
    first, second = np.meshgrid(first, second, indexing="ij")
    return first.ravel(), second.ravel()


def chain(nodes: np.ndarray) -> np.ndarray:
    """Edges (n - 1, 2) between neighbours in a list of nodes (n,)."""
    return np.stack([nodes[:-1], nodes[1:]], 1)


def structured_triangles(rows: int, columns: int, periodic: bool = False) -> np.ndarray:
    """Connectivity of a rows × columns grid of quads, each cut along its (i, j)-(i+1, j+1) diagonal.

    Node (i, j) has index i·(columns+1) + j, or i·columns + j where the second direction closes on itself
    (`periodic`). Returns (2·rows·columns, 3).
    """
    width = columns if periodic else columns + 1
    i, j = grid(np.arange(rows), np.arange(columns))
    after = (j + 1) % width
    a, b, c, d = i * width + j, (i + 1) * width + j, (i + 1) * width + after, i * width + after
    return np.stack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)], 1).reshape(-1, 3)


def triangle_areas(nodes: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(m,) areas [length²] of triangles (m, 3) between nodes (n, 3)."""
    a, b, c = np.moveaxis(nodes[triangles], 1, 0)
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def _edges(triangles: np.ndarray) -> np.ndarray:
    return triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)


def _check_connectivity(triangles: np.ndarray, n_nodes: int) -> None:
    if triangles.shape[0] == 0:
        raise ValueError("The mesh has no triangle.")
    outside = (triangles < 0) | (triangles >= n_nodes)
    if outside.any():
        element, corner = np.argwhere(outside)[0]
        raise ValueError(
            f"Triangle {element} names node {triangles[element, corner]}, but the mesh has nodes 0 to {n_nodes - 1}."
        )
    ordered = np.sort(triangles, axis=1)
    twice = (ordered[:, 0] == ordered[:, 1]) | (ordered[:, 1] == ordered[:, 2])
    if twice.any():
        element = int(np.argmax(twice))
        raise ValueError(f"Triangle {element} names a node twice: {triangles[element].tolist()}.")
    _, first, inverse, count = np.unique(ordered, axis=0, return_index=True, return_inverse=True, return_counts=True)
    if (count > 1).any():
        same = np.flatnonzero(inverse.ravel() == np.argmax(count > 1))
        raise ValueError(f"Triangles {same[0]} and {same[1]} are the same: {triangles[same[0]].tolist()}. Remove one.")
    used = np.zeros(n_nodes, bool)
    used[triangles] = True
    if not used.all():
        raise ValueError(
            f"Node {int(np.argmin(used))} belongs to no triangle ({int((~used).sum())} such nodes): "
            "it would have no stiffness. Remove it or connect it."
        )
    edges = _edges(triangles)
    _, inverse, count = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True)
    forward = np.bincount(inverse.ravel(), weights=edges[:, 0] < edges[:, 1])
    same_way = (count == 2) & (forward != 1)
    if same_way.any():
        first, second = np.flatnonzero(inverse.ravel() == np.argmax(same_way))[:2] // 3
        raise ValueError(
            f"Triangles {first} and {second} have opposite normals: {triangles[first].tolist()} and "
            f"{triangles[second].tolist()} run along their common edge in the same direction. Invert one of them."
        )


def _check_areas(nodes: np.ndarray, triangles: np.ndarray) -> None:
    a, b = nodes[triangles[:, 1]] - nodes[triangles[:, 0]], nodes[triangles[:, 2]] - nodes[triangles[:, 0]]
    area = triangle_areas(nodes, triangles)
    longest = np.max([np.sum(v * v, axis=1) for v in (a, b, b - a)], axis=0)
    flat = area <= 1e-8 * longest
    if flat.any():
        element = int(np.argmax(flat))
        raise ValueError(
            f"Triangle {element} {triangles[element].tolist()} is degenerate: its area {area[element]:.3g} is below "
            f"1e-8 of its longest edge squared ({longest[element]:.3g})."
        )
