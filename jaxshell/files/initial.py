"""Motions at the start of a scene file.

    [initial]     velocity, angular_velocity, about: a rigid motion of the shell, or of the nodes that selectors choose
    [[initial]]   several: each the same, of other nodes

`about` is the point that moves with `velocity`; where it is left out, the mean of the nodes that are meant. No node may
be in two tables, so that what two sets share has one velocity.
"""

import numpy as np

from jaxshell.files.selectors import NODE_SELECTORS, chosen_nodes
from jaxshell.files.tables import Table
from jaxshell.model.initial import Initial
from jaxshell.model.mesh import Mesh

MOTION = ("velocity", "angular_velocity", "about")


def read_initial(top: Table, mesh: Mesh) -> Initial | None:
    """The motion at the start; None where the file has none. Raises ValueError for a node in two tables."""
    several = isinstance(top.content.get("initial"), list)
    tables = top.tables("initial") if several else [top.table("initial", optional=True)]
    if not several and not tables[0].content:
        return None
    motions = [_motion(table, mesh) for table in tables]
    return Table("[[initial]]" if several else "[initial]", {}).call(Initial.of, mesh, *motions)


def _motion(table: Table, mesh: Mesh) -> tuple:
    """One of the motions of `Initial.of`."""
    table.only(*MOTION, *NODE_SELECTORS)
    chosen = set(NODE_SELECTORS) & set(table.content)
    nodes = chosen_nodes(table, mesh) if chosen else np.arange(mesh.n_nodes)
    return nodes, *(table.vectors(name, (3,)) if name in table.content else None for name in MOTION)
