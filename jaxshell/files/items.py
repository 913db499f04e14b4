"""Connectors and obstacles of a scene file, and whatever else a scene has several of.

    [[connectors]]   kind = "spring", "dashpot", "torsion spring", ..., and the arguments of its class; name, by which
                     it is watched. Its nodes are a number, a list of them, the name of a set, or a table of selectors
                     such as { nearest = [x, y, z] }; an end may be { point = [x, y, z] } of space, or "space"
    [[obstacles]]    the same of obstacles
    [[masses]]       nodes, mass, inertia, name: see `PointMass`

Which keys choose nodes, elements or sides says the class (`sets`).
"""

from typing import Any

import numpy as np

from jaxshell.files.history import read_history
from jaxshell.files.sections import chosen_kind
from jaxshell.files.selectors import NODE_SELECTORS, chosen_edges, chosen_elements, chosen_nodes
from jaxshell.files.tables import Table
from jaxshell.model.connectors import CONNECTORS
from jaxshell.model.masses import PointMass
from jaxshell.model.mesh import Mesh
from jaxshell.model.obstacles import OBSTACLES
from jaxshell.model.sets import OfSets
from jaxshell.numerics.checks import check_finite, float_array

ITEM_KINDS: dict[str, dict[str, type[OfSets]]] = {
    "connectors": {kind.kind: kind for kind in CONNECTORS},
    "obstacles": {kind.kind: kind for kind in OBSTACLES},
    "masses": {PointMass.kind: PointMass},
}
"""The kinds of each array of tables by their names in scene files."""
POINT = "point"


def read_items(top: Table, key: str, mesh: Mesh) -> list[Any]:
    """What the tables `[[key]]` of the file state, none where there are none."""
    return [_item(table, ITEM_KINDS[key], mesh) for table in top.tables(key)]


def _item(table: Table, kinds: dict[str, type[OfSets]], mesh: Mesh) -> Any:
    # Where there is one kind only, its name may be left out.
    kind = kinds[chosen_kind(table, kinds, next(iter(kinds)) if len(kinds) == 1 else None)]
    choosing = {
        "node": lambda table, key: _nodes(table, key, mesh),
        "element": lambda table, key: chosen_elements(table, key, mesh),
        "side": lambda table, key: _sides(table, key, mesh),
    }
    readers = {key: choosing[what] for key, what in kind.sets.items()}
    return table.fields(kind, "kind", history=lambda table, _: read_history(table), **readers)


def _nodes(table: Table, key: str, mesh: Mesh) -> Any:
    """Nodes as a class takes them, in the order in which a list names them; or points of space."""
    value = table.get(key)
    if not isinstance(value, dict):
        return value
    inner = table.table(key)
    if POINT in inner.content:
        inner.only(POINT)
        points = inner.call(float_array, inner.get(POINT), POINT)
        inner.call(check_finite, POINT, points)
        if points.shape[-1:] != (3,):
            raise ValueError(f"{inner.name} {POINT} must be [x, y, z], or a list of them.")
        return np.asarray(points)
    inner.only(*NODE_SELECTORS)
    return chosen_nodes(inner, mesh)


def _sides(table: Table, key: str, mesh: Mesh) -> Any:
    value = table.get(key)
    if not isinstance(value, dict):
        return value
    inner = table.table(key)
    inner.only(*NODE_SELECTORS, "inner")
    return chosen_edges(inner, mesh)
