"""A scene's elements: each from its nodes, its section, and the surface that it stands for."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.elements.cubic_inertia import mass_of
from jaxshell.elements.element import Element
from jaxshell.elements.shape import Tangents
from jaxshell.model.corner_normals import corner_normals
from jaxshell.model.edges import Edges
from jaxshell.model.scene import Scene
from jaxshell.model.sections import SHAPES, Resultants
from jaxshell.model.sections.regions import region_of_elements
from jaxshell.numerics.kernels import each


def build_elements(
    scene: Scene, resultants: Resultants | None = None, build=Element.build, bends_mass: bool = False, triangles=None
) -> Element:
    """The elements, each field with a leading axis over them; `build` makes one of corners, section and tangents.

    `bends_mass` gives them the masses that follow rotations. `triangles` are the mesh's as arrays, where one program is
    to serve every connectivity.
    """
    mesh = scene.mesh
    corners = mesh.nodes[mesh.triangles if triangles is None else triangles]
    resultants = scene.section.resultants(mesh) if resultants is None else resultants
    elements, normals = _elements(scene, corners, resultants, build)
    if not bends_mass:
        return elements
    masses = jax.vmap(mass_of)(elements, normals)
    return eqx.tree_at(lambda e: e.mass, elements, masses, is_leaf=lambda leaf: leaf is None)


def _elements(scene: Scene, corners: Float[Array, "m 3 3"], resultants: Resultants, build):
    """The elements, and the normals at their corners where some are curved."""
    mesh, shapes = scene.mesh, scene.section.shapes(scene.mesh)
    if not shapes.any():
        return each(build)(corners, resultants), None
    curved, relaxed = (_chosen(shapes == SHAPES.index(shape)) for shape in ("curved", "relaxed"))
    # Of the nodes, not of the surface that the mesh may remember: nodes may have been moved off it.
    normals = corner_normals(mesh.nodes, Edges(mesh.triangles), groups=region_of_elements(scene.section, mesh)).normals
    elements = jax.vmap(build)(corners, resultants, Tangents(normals, curved, relaxed))
    if curved is None:
        return elements, None
    return elements, jnp.where(curved[:, None, None] > 0, normals, elements.frame[:, None, 2])


def _chosen(some: np.ndarray) -> Float[Array, " m"] | None:
    """1 where they are and 0 elsewhere; None where there are none."""
    return jnp.asarray(some, float) if some.any() else None
