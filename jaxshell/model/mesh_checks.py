"""What a mesh must fulfil to be a shell: indices, neighbours, areas, sizes and places of its triangles."""

import numpy as np

from jaxshell.model import repair
from jaxshell.model.sets import Sets

_SLIVER = 2.5e4
"""Longest edge over height: statics solves a cantilever with one triangle of 2e4, and not with one of 3.3e4."""
_SIZES = (1e-50, 1e50)
"""Sizes of a shell whose fourth power, an area squared, is still a number."""


def triangle_areas(nodes: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(m,) areas [length²] of triangles (m, 3) between nodes (n, 3)."""
    a, b, c = np.moveaxis(nodes[triangles], 1, 0)
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def check_indices(triangles: np.ndarray, n_nodes: int, points: int = 0) -> None:
    if triangles.shape[0] == 0 and n_nodes > points:
        raise ValueError("The mesh has no triangle.")
    outside = (triangles < 0) | (triangles >= n_nodes)
    if outside.any():
        element, corner = np.argwhere(outside)[0]
        raise ValueError(
            f"Triangle {element} names node {triangles[element, corner]}, but the mesh has nodes 0 to {n_nodes - 1}."
        )


def check_connectivity(triangles: np.ndarray, n_nodes: int, points: int = 0) -> None:
    """`points` of the last nodes belong to no triangle."""
    check_indices(triangles, n_nodes, points)
    if (triangles >= n_nodes - points).any():
        raise ValueError(f"A triangle names node {triangles.max()}, which is one of the mesh's {points} points.")
    if not len(triangles):
        return
    ordered = np.sort(triangles, axis=1)
    twice = (ordered[:, 0] == ordered[:, 1]) | (ordered[:, 1] == ordered[:, 2])
    if twice.any():
        element = int(np.argmax(twice))
        raise ValueError(f"Triangle {element} names a node twice: {triangles[element].tolist()}.")
    order = np.lexsort(ordered.T)
    same = (ordered[order][1:] == ordered[order][:-1]).all(axis=1)
    if same.any():
        at = int(np.argmax(same))
        first, second = sorted(order[at : at + 2].tolist())
        raise ValueError(f"Triangles {first} and {second} are the same: {triangles[first].tolist()}. Remove one.")
    used = np.zeros(n_nodes - points, bool)
    used[triangles] = True
    if not used.all():
        raise ValueError(
            f"Node {int(np.argmin(used))} belongs to no triangle ({int((~used).sum())} such nodes): "
            "it would have no stiffness. Remove it or connect it."
        )
    first, second, agree = repair.neighbours(triangles)
    if not agree.all():
        at = int(np.argmin(agree))
        a, b = first[at], second[at]
        raise ValueError(
            f"Triangles {a} and {b} have opposite normals: {triangles[a].tolist()} and {triangles[b].tolist()} run "
            "along their common edge in the same direction. Invert one of them, or let "
            "Mesh.oriented(nodes, triangles) turn all that must be (orient=True in Mesh.read, orient = true in a "
            "scene file)."
        )


def check_sides(sets: Sets, triangles: np.ndarray) -> None:
    if not sets:
        return
    count = int(triangles.max()) + 1
    known = np.sort(repair.edges_of(triangles), axis=1) @ [count, 1]
    for name, sides in sets.items():
        strange = ~np.isin(sides @ [count, 1], known)
        if strange.any():
            side = sides[int(np.argmax(strange))].tolist()
            raise ValueError(f"side_sets {name!r} names the side {side}, which is no edge of a triangle.")


def check_shapes(nodes: np.ndarray, triangles: np.ndarray) -> None:
    size = float(np.linalg.norm(np.ptp(nodes, axis=0)))
    if not _SIZES[0] <= size <= _SIZES[1] and size > 0:
        raise ValueError(
            f"The nodes span {size:.3g}, which double precision does not bear: choose a unit of length in which the "
            f"shell's size lies between {_SIZES[0]:g} and {_SIZES[1]:g}."
        )
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
    aspect = longest / (2 * area)
    if (aspect > _SLIVER).any():
        element = int(np.argmax(aspect))
        raise ValueError(
            f"Triangle {element} {triangles[element].tolist()} is a sliver: its longest edge is {aspect[element]:.3g} "
            f"times its height, and above {_SLIVER:g} statics cannot be solved. Mesh anew there, or merge its nodes."
        )


def check_coincident(nodes: np.ndarray, triangles: np.ndarray) -> None:
    found = repair.coincident_nodes(nodes, triangles)
    if len(found):
        node, other = found[0]
        place = ", ".join(f"{value:.6g}" for value in nodes[node])
        raise ValueError(
            f"{len(found)} nodes coincide with another that no triangle joins them to, the first of them node {node} "
            f"with node {other} at ({place}): the shell is not connected there. Mesh.merged(nodes, triangles, "
            "tolerance) makes them one (merge=tolerance in Mesh.read, merge = tolerance in a scene file's [mesh]); "
            'coincident="allow" keeps them apart where a slit is meant.'
        )
