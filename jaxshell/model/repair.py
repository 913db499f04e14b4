"""Cures of meshes as programs write them: nodes that coincide are merged, triangles turned, larger cells cut.

All on arrays, since a mesh that needs a cure is refused by `Mesh`: nodes (n, 3) [length], triangles (m, 3) node indices
from 0. None takes more than n log n operations.
"""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

COINCIDENT = 1e-6
"""Nodes closer than this fraction of the shortest edge at them coincide."""


def edges_of(triangles: np.ndarray) -> np.ndarray:
    """(3m, 2) directed edges, three of each triangle in turn."""
    return triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)


def numbered_edges(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(3m,) the number of each undirected edge, (k,) how many triangles have it, (3m,) whether it runs upwards."""
    edges = edges_of(triangles).astype(np.int64)
    low, high = edges.min(axis=1), edges.max(axis=1)
    _, number, count = np.unique(low * (edges.max(initial=0) + 1) + high, return_inverse=True, return_counts=True)
    return number.ravel(), count, edges[:, 0] < edges[:, 1]


def neighbours(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of triangles that share an edge which is no other's: (k,) first, (k,) second, (k,) whether they agree."""
    number, count, upwards = numbered_edges(triangles)
    inner = np.flatnonzero(count[number] == 2)
    pairs = inner[np.argsort(number[inner], kind="stable")].reshape(-1, 2)
    return pairs[:, 0] // 3, pairs[:, 1] // 3, upwards[pairs[:, 0]] != upwards[pairs[:, 1]]


def oriented(triangles: np.ndarray) -> np.ndarray:
    """The triangles, turned where they must be for neighbours to agree on the normal; each part goes by its first.

    Raises ValueError for a surface without an orientation, such as a Möbius strip.
    """
    count = len(triangles)
    first, second, agree = neighbours(triangles)
    # Every triangle twice, as it is and turned: the two lie in one part where a way round turns the normal.
    across = np.where(agree, 0, count)
    rows = np.concatenate([first, first + count])
    columns = np.concatenate([second + across, second + count - across])
    links = coo_matrix((np.ones(len(rows), np.int8), (rows, columns)), (2 * count, 2 * count))
    _, side = connected_components(links, directed=False)
    as_is, inverted = side[:count], side[count:]
    one_sided = as_is == inverted
    if one_sided.any():
        raise ValueError(
            f"The mesh has no orientation: as on a Möbius strip, a way round from triangle {int(np.argmax(one_sided))} "
            "comes back to it with the opposite normal. Cut the mesh along a line of edges, with its own nodes on "
            "either side."
        )
    # A part and its inverted twin have the same triangles, the first of which is kept as it is.
    leader = np.full(2 * count, count)
    np.minimum.at(leader, as_is, np.arange(count))
    np.minimum.at(leader, inverted, np.arange(count))
    turned = as_is != as_is[leader[as_is]]
    return np.where(turned[:, None], triangles[:, [0, 2, 1]], triangles)


def shortest_edges(nodes: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(n,) the length of the shortest edge at each node."""
    edges = edges_of(triangles)
    length = np.linalg.norm(nodes[edges[:, 0]] - nodes[edges[:, 1]], axis=1)
    shortest = np.full(len(nodes), np.inf)
    for end in (0, 1):
        np.minimum.at(shortest, edges[:, end], length)
    return shortest


def coincident_nodes(nodes: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(k, 2) each node that coincides with one before it which no edge joins it to, beside that one."""
    number, points = _same_points(nodes)
    first = np.unique(number, return_index=True)[1]
    partner = first[number]
    repeated = np.flatnonzero(partner != np.arange(len(nodes)))
    found = [np.stack([repeated, partner[repeated]], 1)]
    if len(points) > 1:
        distance, nearest = map(np.asarray, KDTree(points).query(points, k=2))
        other = first[nearest[:, 1]]
        near = (distance[:, 1] <= COINCIDENT * shortest_edges(nodes, triangles)[first]) & (other < first)
        found.append(np.stack([first[near], other[near]], 1))
    return np.concatenate(found)


def merged(nodes: np.ndarray, triangles: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes and triangles with nodes no further apart than `tolerance` made one, the first of them; unused ones go.

    And (n,) the number that each node has afterwards, -1 for those that go. Raises ValueError where the tolerance
    reaches the shortest edge.
    """
    shortest = shortest_edges(nodes, triangles)
    if not tolerance < shortest.min():
        node = int(np.argmin(shortest))
        raise ValueError(
            f"Merging within {tolerance:g} would collapse triangles: the shortest edge at node {node} is "
            f"{shortest[node]:.6g} long. Choose a smaller tolerance."
        )
    group = np.arange(len(nodes))
    while True:
        kept = np.unique(group)
        leader = _leaders(nodes[kept], tolerance)
        if np.array_equal(leader, np.arange(len(kept))):
            break
        group = kept[leader][np.searchsorted(kept, group)]
    nodes, triangles, number = only_used(nodes, group[triangles])
    return nodes, triangles, number[group]


def _leaders(nodes: np.ndarray, tolerance: float) -> np.ndarray:
    """(n,) the node that each becomes one with, in one round: at least half of those that have a partner go."""
    number, points = _same_points(nodes)
    if len(points) == len(nodes) > 1:
        distance, nearest = map(np.asarray, KDTree(nodes).query(nodes, k=2))
        near = np.flatnonzero(distance[:, 1] <= tolerance)
        links = coo_matrix((np.ones(len(near), np.int8), (near, nearest[near, 1])), (len(nodes), len(nodes)))
        number = connected_components(links, directed=False)[1]
    return np.unique(number, return_index=True)[1][number]


def only_used(nodes: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Without the nodes that belong to no triangle; and (n,) the number that each has now, -1 for those."""
    used, compact = np.unique(triangles, return_inverse=True)
    number = np.full(len(nodes), -1)
    number[used] = np.arange(len(used))
    return nodes[used], compact.reshape(triangles.shape), number


def split_quads(nodes: np.ndarray, quads: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(k, 3) triangles of quads (q, 4), each cut along its shorter diagonal, and (k,) the quad that each is of.

    Of two like diagonals that from corner 1 to 3. Where the shorter one lies outside of a quad that is not convex, the
    other. A quad with two neighbouring corners in one node is a triangle.
    """
    # Sizes near the largest number, which no mesh may have, are no business of the cut.
    with np.errstate(over="ignore", invalid="ignore"):
        triangles = _halves(nodes, quads)
    distinct = np.diff(np.sort(quads, axis=1), axis=1) != 0
    side = (quads == np.roll(quads, 1, axis=1)).sum(axis=1)
    is_triangle = (distinct.sum(axis=1) == 2) & (side == 1)
    empty = (triangles == np.roll(triangles, 1, axis=2)).any(axis=2) & is_triangle[:, None]
    return triangles[~empty], np.nonzero(~empty)[0]


def _halves(nodes: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """(q, 2, 3) the two triangles of each quad."""
    x = nodes[quads]
    one, other = (np.linalg.norm(x[:, b] - x[:, a], axis=1) for a, b in ((0, 2), (1, 3)))
    along_first = one <= other * (1 + 1e-9)
    cut = {True: [[0, 1, 2], [0, 2, 3]], False: [[0, 1, 3], [1, 2, 3]]}
    folded = {way: _opposite(x[:, corners]) for way, corners in cut.items()}
    along_first = np.where(along_first, ~folded[True] | folded[False], folded[False] & ~folded[True])
    return np.where(along_first[:, None, None], quads[:, cut[True]], quads[:, cut[False]])


def _opposite(x: np.ndarray) -> np.ndarray:
    """(q,) whether the two triangles x (q, 2, 3, 3) of a quad have opposite normals."""
    normals = np.cross(x[:, :, 1] - x[:, :, 0], x[:, :, 2] - x[:, :, 0])
    return np.sum(normals[:, 0] * normals[:, 1], axis=1) < 0


def _same_points(nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n,) the number of each node's point, counted in the order of the points (k, 3) that differ."""
    order = np.lexsort(nodes.T)
    fresh = np.ones(len(nodes), bool)
    fresh[1:] = (nodes[order][1:] != nodes[order][:-1]).any(axis=1)
    number = np.empty(len(nodes), np.int64)
    number[order] = np.cumsum(fresh) - 1
    return number, nodes[order][fresh]
