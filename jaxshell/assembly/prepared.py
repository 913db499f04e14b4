"""Parts of a scene as the model has them: loads at the nodes, contributions on their groups, point masses, scales."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.assembly.acting import Acting
from jaxshell.assembly.elimination import Elimination
from jaxshell.assembly.lumps import Lumps, lumps_of
from jaxshell.assembly.structure import groups_of
from jaxshell.assembly.tables import Tables
from jaxshell.elements.element import Element, constant_strains
from jaxshell.model.contribution import Constraint, Surface
from jaxshell.model.loads import DeadLoad
from jaxshell.model.scene import Scene


def rest_deformations(scene: Scene, elements: Element) -> tuple[Float[Array, "m 12"], ...]:
    """Deformations at which the elements are free of stress, for every initial strain of the scene, for factor 1."""
    free = (load.strains(scene.section, scene.mesh) for load in scene.initial_strains)
    return tuple(jax.vmap(constant_strains)(elements.coordinates, *strains) for strains in free)


def elimination_of(scene: Scene, tables: Tables) -> Elimination | None:
    """What of a scene's nodes is no unknown; None where there is none such."""
    if tables.dependent is None:
        return None
    x0, dependent = scene.mesh.nodes, tables.dependent
    return Elimination(dependent, x0[dependent.followers] - x0[dependent.masters], scene.axes)


def size_of(scene: Scene) -> Float[Array, ""]:
    """The diagonal of the shell's bounding box, of the points' where there is no shell; 1 for a single one."""
    mesh = scene.mesh
    nodes = mesh.nodes[: mesh.n_nodes - mesh.points] if mesh.n_elements else mesh.nodes
    size = jnp.linalg.norm(jnp.max(nodes, axis=0) - jnp.min(nodes, axis=0))
    return size if mesh.n_elements else jnp.where(size > 0, size, 1.0)


def membrane_scale(elements: Element, lumps: Lumps | None) -> Float[Array, ""]:
    """The unit of multipliers [force/length]: about the membrane stiffness of an element; constant for derivatives."""
    if elements.area.size:
        found = jnp.mean(jnp.trace(elements.K_membrane[:, :3, :3], axis1=1, axis2=2)) / 3.0
    else:
        found = jnp.ones(()) if lumps is None else jnp.sum(lumps.mass)
    return jax.lax.stop_gradient(found)


def nodal_load(load: DeadLoad, x0, tables: Tables, elements: Element, lumps: Lumps | None) -> Float[Array, "n 6"]:
    """A dead load's forces and moments on the nodes, point masses among them."""
    total = load.nodal(x0, tables.triangles, elements.mass_per_area)
    on_masses = None if lumps is None else load.on_masses(lumps.mass)
    return total if lumps is None or on_masses is None else total.at[lumps.at, :3].add(on_masses)


def _places(tables: Tables) -> list[tuple[Any, Any]]:
    """The groups other than the elements' own, with their places in the sparse matrix."""
    return list(zip(tables.groups, tables.entries or (None,) * len(tables.groups), strict=True))


def lumps_in(scene: Scene, tables: Tables) -> Lumps | None:
    """The scene's point masses, whose groups are the last in the tables."""
    return None if scene.point_masses is None else lumps_of(scene, *_places(tables)[-1])


def acting_on_bending(scene: Scene, tables: Tables, surface: Surface) -> tuple[Acting, ...]:
    """What the loads add where masses follow rotations."""
    parts = (load.on_bending() for load in scene.loads if isinstance(load, DeadLoad))
    return tuple(Acting(p, p.data(surface), tables.triangles, None, True) for p in parts if p is not None)


def acting_in(scene: Scene, tables: Tables, surface: Surface, unit) -> tuple[Acting, ...]:
    """The scene's contributions; groups that are not the elements' own follow each other in the tables."""
    found, others = [], iter(_places(tables))
    for contribution, nodes in zip(scene.contributions, groups_of(scene), strict=True):
        own = nodes == scene.mesh.connectivity
        indices, entries = (tables.triangles, None) if own else next(others)
        data = contribution.data(surface)
        if isinstance(contribution, Constraint):
            data = data, jnp.broadcast_to(unit, indices.shape[:1])
        found.append(Acting(contribution, data, indices, entries, own))
    return tuple(found)
