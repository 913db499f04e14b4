"""A scene's elements: each from its nodes, its section, and the surface that it stands for."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.elements.corotational import Element
from jaxshell.elements.cubic_inertia import mass_of
from jaxshell.elements.shape import Tangents
from jaxshell.model.scene import Scene
from jaxshell.model.sections import SHAPES, Resultants
from jaxshell.model.tangent_planes import tangent_normals


def build_elements(
    scene: Scene, resultants: Resultants | None = None, build=Element.build, bends_mass: bool = False
) -> Element:
    """The elements, each field with a leading axis over them; `build` makes one of corners, section and tangents.

    `bends_mass` gives them the masses that follow rotations.
    """
    elements, normals = _elements(scene, resultants, build)
    if not bends_mass:
        return elements
    masses = jax.vmap(mass_of)(elements, normals)
    return eqx.tree_at(lambda e: e.mass, elements, masses, is_leaf=lambda leaf: leaf is None)


def _elements(scene: Scene, resultants: Resultants | None, build):
    """The elements, and the normals at their corners where some are curved."""
    nodes, triangles = scene.mesh.nodes, scene.mesh.triangles
    resultants = scene.section.resultants(scene.mesh) if resultants is None else resultants
    if scene.patches is None:
        return jax.vmap(build)(nodes[triangles], resultants), None
    shapes = scene.section.shapes(scene.mesh)
    curved, relaxed = (_chosen(shapes == SHAPES.index(shape)) for shape in ("curved", "relaxed"))
    normals = tangent_normals(nodes, triangles, scene.patches.array)
    elements = jax.vmap(build)(nodes[triangles], resultants, Tangents(normals, curved, relaxed))
    if curved is None:
        return elements, None
    return elements, jnp.where(curved[:, None, None] > 0, normals, elements.frame[:, None, 2])


def _chosen(some: np.ndarray) -> Float[Array, " m"] | None:
    """1 where they are and 0 elsewhere; None where there are none."""
    return jnp.asarray(some, float) if some.any() else None
