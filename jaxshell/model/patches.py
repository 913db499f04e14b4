"""Smooth patches: which elements around a node are one smooth surface there."""

import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import connected_components

FOLD = 30.0
"""By how many degrees the normals of neighbours may differ in a smooth surface, unless said otherwise."""


def smooth_labels(nodes: np.ndarray, triangles: np.ndarray, region: np.ndarray, angle: float) -> np.ndarray:
    """(m, 3) number of the smooth patch around its node that an element's corner belongs to.

    A patch are the elements that hang together at the node through edges of just two elements, across which the
    normals turn by at most `angle` [degrees] and `region` (m,) is the same.
    """
    x = nodes[triangles]
    normals = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)

    # Every edge as two places (element, corner), in the order of its nodes; those that two elements share follow.
    ends = np.stack([[0, 1], [1, 2], [2, 0]])
    corners = 3 * np.arange(len(triangles))[:, None, None] + ends
    of_nodes = triangles[:, ends]
    order = np.argsort(of_nodes, axis=2)
    corners = np.take_along_axis(corners, order, 2).reshape(-1, 2)
    edges = np.take_along_axis(of_nodes, order, 2).reshape(-1, 2)
    _, inverse, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    shared = np.flatnonzero(count[inverse.ravel()] == 2)
    shared = shared[np.argsort(inverse.ravel()[shared], kind="stable")].reshape(-1, 2)
    first, second = (corners[shared[:, side]] for side in (0, 1))
    a, b = first[:, 0] // 3, second[:, 0] // 3
    smooth = (np.einsum("ei,ei->e", normals[a], normals[b]) >= np.cos(np.radians(angle))) & (region[a] == region[b])
    rows, columns = first[smooth].ravel(), second[smooth].ravel()
    size = 3 * len(triangles)
    graph = scipy.sparse.coo_matrix((np.ones(len(rows)), (rows, columns)), (size, size))
    _, labels = connected_components(graph, directed=False)
    return labels.reshape(-1, 3)
