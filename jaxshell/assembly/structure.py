"""What of a scene is static and decides on the sparsity: nodes, groups of nodes, what is held, what follows."""

import numpy as np

from jaxshell.assembly.lumps import lumped_nodes
from jaxshell.assembly.tables import Structure
from jaxshell.model.contribution import Constraint
from jaxshell.model.scene import Scene
from jaxshell.numerics.frozen import Frozen


def structure_of(scene: Scene) -> Structure:
    """The static part of a scene that the sparsity depends on."""
    groups = tuple(nodes for nodes in groups_of(scene) if nodes != scene.mesh.connectivity)
    if (lumped := lumped_nodes(scene)).size:
        groups = (*groups, Frozen(lumped[:, None]))
    held, unused, mesh = scene.held, _unused(scene), scene.mesh
    return Structure(
        mesh.connectivity,
        mesh.n_nodes + _multipliers(scene),
        Frozen(np.concatenate([held.array, unused])) if unused.size else held,
        groups,
        _extended(scene.masters, scene),
        scene.turned,
        _multipliers(scene),
        len(held.array),
    )


def _multipliers(scene: Scene) -> int:
    """How many nodes hold the multipliers of a scene's constraints."""
    own = scene.mesh.triangles
    return sum(c.multipliers * len(c.groups(own).array) for c in scene.contributions if isinstance(c, Constraint))


def _unused(scene: Scene) -> np.ndarray:
    """Degrees of freedom of the multipliers' nodes that hold none."""
    found, node = [np.zeros(0, int)], scene.mesh.n_nodes
    for contribution in scene.contributions:
        if isinstance(contribution, Constraint):
            k, m = len(contribution.groups(scene.mesh.triangles).array), contribution.multipliers
            slots = 6 * (node + np.arange(k * m).reshape(k, m))[:, :, None] + np.arange(6)
            is_used = np.zeros((m, 6), bool)
            is_used[:, :3].flat[: contribution.count] = True
            found.append(slots[:, ~is_used].ravel())
            node += k * m
    return np.sort(np.concatenate(found))


def _extended(masters: Frozen | None, scene: Scene) -> Frozen | None:
    """With the multipliers' nodes, which follow none."""
    if masters is None or not _multipliers(scene):
        return masters
    return Frozen(np.concatenate([masters.array, scene.mesh.n_nodes + np.arange(_multipliers(scene))]))


def groups_of(scene: Scene) -> list[Frozen]:
    """Of the contributions, with the nodes of multipliers behind those of the mesh."""
    found, node = [], scene.mesh.n_nodes
    for contribution in scene.contributions:
        nodes = contribution.groups(scene.mesh.triangles)
        if isinstance(contribution, Constraint):
            k, m = len(nodes.array), contribution.multipliers
            nodes = Frozen(np.concatenate([nodes.array, node + np.arange(k * m).reshape(k, m)], axis=1))
            node += k * m
        found.append(nodes)
    return found
