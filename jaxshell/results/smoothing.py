"""Nodal values from the elements' own, smoothed where the shell is smooth.

At a node the values of the elements around it, each drawn on linearly from its three mid-edges, are averaged, weighted
by the elements' areas. Only within a smooth patch: elements that hang together at the node through edges across which
the section is the same region, and the normals of the mesh turn by less than a limit. So stresses keep their jumps at
folds, where shells meet, and where the thickness changes.

The elements' own moments converge with the first power of the mesh size, nodal ones with the power 1.5
(docs/stresses.md).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.elements.strains import CORNERS_OF_MIDPOINTS
from jaxshell.model.corner_normals import fans_of, smooth_edges
from jaxshell.model.edges import Edges
from jaxshell.model.materials.base import strain_rotation, stress_rotation
from jaxshell.model.mesh import Mesh
from jaxshell.model.scene import Scene
from jaxshell.model.sections.regions import region_of_elements
from jaxshell.numerics.checks import check_choice, check_kind, check_within, float_array, is_concrete
from jaxshell.numerics.compiled import compiled_for_frames
from jaxshell.numerics.frozen import Frozen
from jaxshell.numerics.triangles import local_frame

_TURNS = {"forces": stress_rotation, "strains": strain_rotation}


class Patches(NamedTuple):
    """Which corners of elements share a value."""

    labels: Frozen
    """(m, 3) number of the smooth patch around its node that an element's corner belongs to."""


def smooth_patches(scene: Scene | Mesh, angle: float = 30.0) -> Patches:
    """The smooth patches of a mesh, or of a scene, whose regions are not mixed.

    `angle` [degrees] is the most by which the normals of neighbours may differ. Raises ValueError for nodes that JAX is
    tracing.
    """
    check_kind("scene", scene, Scene | Mesh, "a jaxshell.Scene or a jaxshell.Mesh")
    check_within("angle", angle, 0.0, 180.0)
    mesh = scene.mesh if isinstance(scene, Scene) else scene
    if not is_concrete(mesh.nodes):
        raise ValueError(
            "Patches are found by the shape: give nodal(patches=smooth_patches(scene)) where it is traced."
        )
    region = region_of_elements(scene.section, mesh) if isinstance(scene, Scene) else None
    fans = _fans(mesh.nodes, mesh.connectivity, jnp.asarray(float(angle)), None if region is None else Frozen(region))
    _, labels = np.unique(np.asarray(fans), return_inverse=True)
    return Patches(Frozen(labels.reshape(-1, 3)))


@compiled_for_frames
def _fans(nodes: Float[Array, "n 3"], triangles: Frozen, angle, region: Frozen | None):
    edges = Edges(triangles.array)
    facets = jax.vmap(local_frame)(nodes[triangles.array])[0][:, 2]
    return fans_of(edges, smooth_edges(facets, edges, angle, None if region is None else region.array))


def nodal(
    scene: Scene | Mesh,
    values,
    *,
    at: str = "points",
    components: str | None = None,
    angle: float = 30.0,
    patches: Patches | None = None,
) -> Float[Array, "m 3 *c"]:
    """Smoothed values at the corners of every element: (m, 3, ...), equal at the corners of a smooth patch.

    Arguments:
        values: (m, 3, ...) at the elements' mid-edges, or with at="mean" (m, ...) constant in each; the former are far
            better at the boundary.
        components: None for what needs no common axes: scalars, and components in axes that vary smoothly (a vector's,
            a cylinder's, "global"). "forces" or "strains" for components (..., 3) in the elements' axes: they are
            turned into those of one element of the patch, as its e1 projected onto the others shows, averaged there and
            turned back, so that the result is in the elements' axes again.
        angle: limit of the angle between neighbours' normals [degrees]; above it an edge is a fold.
        patches: of `smooth_patches`, to find them once.

    Differentiable by the values, and by the mesh where `patches` are given. Raises ValueError for values of another
    shape.
    """
    check_kind("scene", scene, Scene | Mesh, "a jaxshell.Scene or a jaxshell.Mesh")
    check_choice("at", at, ("points", "mean"))
    if components is not None:
        check_choice("components", components, tuple(_TURNS))
    mesh = scene.mesh if isinstance(scene, Scene) else scene
    values = float_array(values, "values")
    wanted = (mesh.n_elements, 3) if at == "points" else (mesh.n_elements,)
    if values.shape[: len(wanted)] != wanted:
        raise ValueError(f"values must have shape {wanted} and more, but they have shape {values.shape}.")
    if components is not None and (values.ndim == len(wanted) or values.shape[-1] != 3):
        raise ValueError(f"values must end in 3 components, xx, yy, xy, but they have shape {values.shape}.")
    patches = smooth_patches(scene, angle) if patches is None else patches
    if at == "points":
        values = jnp.einsum("cp,mp...->mc...", jnp.asarray(CORNERS_OF_MIDPOINTS), values)
    else:
        values = jnp.repeat(values[:, None], 3, axis=1)
    return _nodal(mesh, values, components, patches.labels)


@compiled_for_frames
def _nodal(mesh: Mesh, values, components, labels: Frozen):
    x = mesh.nodes[mesh.triangles]
    frames, coordinates = jax.vmap(local_frame)(x)
    area = 0.5 * coordinates[:, 0] * coordinates[:, 2]
    flat = labels.array.ravel()
    corner = values.reshape(-1, *values.shape[2:])
    rotation, turn = None, jnp.zeros(flat.shape)
    if components is not None:
        # Of every patch the first element, from whose e1 the others' axes are counted.
        _, first = np.unique(flat, return_index=True)
        seen = jnp.einsum("cij,cj->ci", jnp.repeat(frames, 3, axis=0), frames[first[flat] // 3, 0])
        turn = jnp.arctan2(seen[:, 1], seen[:, 0])
        rotation = jax.vmap(_TURNS[components])
        corner = jnp.einsum("cij,c...j->c...i", rotation(turn), corner)
    weight = jnp.repeat(area, 3)

    def summed(a):
        return jnp.zeros((int(flat.max()) + 1, *a.shape[1:])).at[flat].add(a)

    weights = weight.reshape(-1, *[1] * (corner.ndim - 1))
    found = (summed(weights * corner) / summed(weights))[flat]
    if rotation is not None:
        found = jnp.einsum("cij,c...j->c...i", rotation(-turn), found)
    return found.reshape(values.shape)
