"""A scene's elements: each from its nodes, its section, and the surface that it stands for."""

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxshell.elements.corotational import Element
from jaxshell.elements.shape import Shape
from jaxshell.model.scene import Scene
from jaxshell.model.sections import Resultants
from jaxshell.model.tangent_planes import tangent_normals


def build_elements(scene: Scene, resultants: Resultants | None = None, build=Element.build) -> Element:
    """The elements, each field with a leading axis over them; `build` makes one of corners, section and normals."""
    nodes, triangles = scene.mesh.nodes, scene.mesh.triangles
    resultants = scene.section.resultants(scene.mesh) if resultants is None else resultants
    if scene.patches is None:
        return jax.vmap(build)(nodes[triangles], resultants)
    normals = tangent_normals(nodes, triangles, scene.patches.array)
    elements = jax.vmap(build)(nodes[triangles], resultants, normals)
    curved = scene.section.curved(scene.mesh)
    if curved.all():
        return elements
    return eqx.tree_at(lambda e: e.shape, elements, _where(elements.shape, curved))


def _where(shape: Shape, curved) -> Shape:
    """Shapes with no curvature and no slopes where elements are not curved: flat ones among curved ones."""
    kept = jnp.asarray(curved, float)
    found = kept[:, None, None] * shape.J, kept[:, None, None, None] * shape.P
    return eqx.tree_at(lambda s: (s.J, s.P), shape, found)
