"""Motions at the start of a scene file.

    [initial]     velocity, angular_velocity, about: a rigid motion of the shell, or of the nodes that selectors choose
    [[initial]]   several: each the same, of other nodes

`about` is the point that moves with `velocity`; where it is left out, the mean of the nodes that are meant. No node may
be in two tables, so that what two sets share has one velocity.
"""

import numpy as np

from jaxshell.files.selectors import NODE_SELECTORS, chosen_nodes
from jaxshell.files.tables import Table
from jaxshell.model.mesh import Mesh
from jaxshell.model.scene import Initial

MOTION = ("velocity", "angular_velocity", "about")


def read_initial(top: Table, mesh: Mesh) -> Initial | None:
    """The motion at the start; None where the file has none. Raises ValueError for a node in two tables."""
    several = isinstance(top.content.get("initial"), list)
    tables = top.tables("initial") if several else [top.table("initial", optional=True)]
    velocities, spins = np.zeros((mesh.n_nodes, 3)), np.zeros((mesh.n_nodes, 3))
    moved_by = np.zeros(mesh.n_nodes, int)
    for number, table in enumerate(tables, start=1):
        table.only(*MOTION, *NODE_SELECTORS)
        if not table.content and not several:
            return None
        if several and not {"velocity", "angular_velocity"} & set(table.content):
            raise ValueError(f"{table.name} says no motion: give velocity or angular_velocity.")
        named = {name: table.vectors(name, (3,)) for name in MOTION if name in table.content}
        if not set(NODE_SELECTORS) & set(table.content):
            nodes = np.arange(mesh.n_nodes)
        else:
            nodes = chosen_nodes(table, mesh)
            named.setdefault("about", np.asarray(mesh.nodes)[nodes].mean(axis=0))
        taken = nodes[moved_by[nodes] > 0]
        if taken.size:
            raise ValueError(
                f"{table.name} moves node {taken[0]} (and {taken.size - 1} others), which number {moved_by[taken[0]]} "
                "moves already: choose each node once."
            )
        motion = table.call(Initial.rigid, mesh, **named)
        velocities[nodes] = np.asarray(motion.velocities)[nodes]
        spins[nodes] = np.asarray(motion.angular_velocities)[nodes]
        moved_by[nodes] = number
    return Initial(velocities, spins)
