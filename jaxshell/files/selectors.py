"""What tables of a scene file choose nodes and elements by."""

from typing import Any

import numpy as np

from jaxshell.files.tables import Table
from jaxshell.model.mesh import Mesh
from jaxshell.numerics.checks import shown, whole_array

NODE_SELECTORS = ("nodes", "nearest", "plane", "box", "boundary")
_WITHIN = 1e-6
"""Of the mesh's largest extent: what lies no further from a plane or outside a box is chosen."""


def chosen_nodes(table: Table, mesh: Mesh) -> np.ndarray:
    """Indices of the nodes that fulfil all of the table's selectors."""
    x = np.asarray(mesh.nodes)
    chosen = np.ones(len(x), bool)
    given = [name for name in NODE_SELECTORS if name in table.content]
    if not given:
        raise ValueError(f"{table.name} chooses no nodes; give one of {', '.join(NODE_SELECTORS)}.")
    for name in given:
        if name == "nodes" and isinstance(table.get(name), str):
            mask = np.isin(np.arange(len(x)), table.call(mesh.node_set, table.get(name)))
        elif name == "nodes":
            mask = _numbered(table, name, len(x))
        elif name == "nearest":
            mask = np.arange(len(x)) == mesh.nearest_node(table.vectors(name, (3,)))
        elif name == "boundary":
            if table.get(name) is not True:
                raise ValueError(f"{table.name} boundary must be true or left out, but it is {shown(table.get(name))}.")
            mask = np.isin(np.arange(len(x)), mesh.boundary_edges())
        else:
            mask = _placed(table, name, x, x)
        chosen &= mask
    if not chosen.any():
        raise ValueError(f"{table.name} No node fulfils {' and '.join(given)}; the mesh spans {_span(x)}.")
    return np.flatnonzero(chosen)


def chosen_elements(table: Table, key: str, mesh: Mesh) -> np.ndarray:
    """Elements by a set's name, by numbers, or by the place of their centroids: `{ plane = ..., box = ... }`."""
    value = table.get(key)
    if isinstance(value, str):
        return table.call(mesh.element_set, value)
    if not isinstance(value, dict):
        return np.flatnonzero(_numbered(table, key, mesh.n_elements))
    inner = table.table(key)
    inner.only("plane", "box")
    if not value:
        raise ValueError(f"{inner.name} chooses no elements; give plane or box.")
    x = np.asarray(mesh.nodes)
    centroids, chosen = x[mesh.triangles].mean(axis=1), np.ones(mesh.n_elements, bool)
    for name in value:
        chosen &= _placed(inner, name, centroids, x)
    if not chosen.any():
        raise ValueError(
            f"{inner.name} No element's centroid fulfils {' and '.join(value)}; the mesh spans {_span(x)}."
        )
    return np.flatnonzero(chosen)


def chosen_edges(table: Table, mesh: Mesh) -> Any:
    """(k, 2) edges by the name of a set of sides, as pairs of nodes, or those of the boundary between chosen nodes.

    With `inner = true` those between chosen nodes that triangles share.
    """
    if "edges" in table.content:
        if stray := [name for name in (*NODE_SELECTORS, "inner") if name in table.content]:
            raise ValueError(f"{table.name} chooses edges by edges or by {stray[0]}, not by both.")
        edges = table.get("edges")
        return table.call(mesh.side_set, edges) if isinstance(edges, str) else edges
    inner = table.content.get("inner", False)
    if not isinstance(inner, bool):
        raise ValueError(f"{table.name} inner must be true or false, but it is {shown(inner)}.")
    nodes, edges = chosen_nodes(table, mesh), mesh.inner_edges() if inner else mesh.boundary_edges()
    edges = edges[np.isin(edges, nodes).all(axis=1)]
    if not len(edges):
        which = "inner edge of the mesh" if inner else "edge of the mesh's boundary"
        cure = "" if inner else " (inner = true looks for edges that two triangles share)"
        raise ValueError(f"{table.name} No {which} has both its ends among the chosen nodes{cure}.")
    return edges


def _numbered(table: Table, key: str, count: int) -> np.ndarray:
    wanted = f"numbers from 0 to {count - 1}"
    numbers = np.atleast_1d(table.call(whole_array, key, table.get(key), wanted))
    if numbers.ndim > 1 or np.any((numbers < 0) | (numbers >= count)):
        raise ValueError(f"{table.name} {key} must be {wanted}, but are {shown(table.get(key))}.")
    return np.isin(np.arange(count), numbers)


def _placed(table: Table, name: str, points: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Which of the points lie in the plane or the box of this name; `x` are the mesh's nodes."""
    tolerance = _WITHIN * np.ptp(x, axis=0).max()
    if name == "box":
        low, high = table.vectors(name, (2, 3))
        return np.all((points >= low - tolerance) & (points <= high + tolerance), axis=1)
    plane = table.table(name)
    plane.only("x", "y", "z")
    mask = np.ones(len(points), bool)
    for axis in plane.content:
        mask &= np.abs(points[:, "xyz".index(axis)] - plane.vectors(axis, ())) <= tolerance
    return mask


def _span(x: np.ndarray) -> str:
    return ", ".join(f"{a} {low:g} to {high:g}" for a, low, high in zip("xyz", x.min(0), x.max(0), strict=True))
