"""The mesh's error by Zienkiewicz and Zhu: how far section forces are from the smooth field that they suggest.

The energy of the difference, in every element

    ½ ∫ (σ* - σ)ᵀ C⁻¹ (σ* - σ) dA,    σ = [N; M],  C = [A B; B D],

where σ are the section forces of the solution and σ* the recovered ones: the nodal values of `jaxshell.nodal`, linear
in every element, smooth within smooth patches and regions, with their jumps at folds and between sections. Both are
linear in an element, so that the rule of the three mid-edges integrates the energy exactly, and the strain energy
½ ∫ σᵀ C⁻¹ σ dA is the element's own. Membrane forces enter as they are, with the higher-order part that follows the
drilling rotations: where bending locks in it, as on a pinched hemisphere, it is most of the error. Source: O. C.
Zienkiewicz & J. Z. Zhu, "A simple error estimator and adaptive procedure for practical engineering analysis", Int. J.
Numer. Methods Eng. 24 (1987) 337-357.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.assembly.gauges import force_probe
from jaxshell.model.scene import Scene
from jaxshell.numerics.compiled import compiled_for_frames
from jaxshell.numerics.frozen import Frozen
from jaxshell.results.section_forces import Shape, elements_of, given_shape, over_frames, shape_of, strains_at_points
from jaxshell.results.smoothing import Patches, nodal, smooth_patches
from jaxshell.results.solution import Solution

_MIDPOINTS = ((0.5, 0.5, 0.0), (0.0, 0.5, 0.5), (0.5, 0.0, 0.5))
"""Rows: a linear field at the mid-edges 12, 23, 31 from its values at the corners."""


class MeshErrors(eqx.Module):
    """The recovered error of a mesh with m elements, of one frame or with an axis over frames before the others."""

    energy: Float[Array, "*m"]
    """Of the recovered less the computed section forces, in every element [force·length]."""
    strain_energy: Float[Array, "*m"]
    """Of the computed section forces, in every element [force·length]."""
    area: Float[Array, " m"]
    """Of the elements [length²]."""

    @property
    def relative(self) -> Float[Array, "*f"]:
        """The error in the norm of energy over the size of the solution: √(Σ energy / (Σ strain energy + Σ energy)).

        0 of a shell without stress. Its square is the relative error of the energy, and so of a single force's
        deflection.
        """
        return _root(jnp.sum(self.energy, axis=-1), self._whole)

    @property
    def local(self) -> Float[Array, "*m"]:
        """The same of single elements: error's energy per area over the shell's mean energy per area, under the root.

        Its mean square over the area is that of `relative`: it says where the mesh is too coarse, whatever the
        elements' sizes.
        """
        mean = self._whole[..., None] / jnp.sum(self.area)
        return _root(self.energy / self.area, mean)

    @property
    def _whole(self) -> Float[Array, "*f"]:
        return jnp.sum(self.strain_energy, axis=-1) + jnp.sum(self.energy, axis=-1)


def mesh_errors(solution: Solution, frame=-1, *, angle: float = 30.0, patches: Patches | None = None) -> MeshErrors:
    """The mesh's error of a solution, recovered from its section forces.

    Arguments:
        frame: the frame's number, or a list of them, which gives a leading axis.
        angle: edges at which normals differ by more [degrees] are folds, across which nothing is smoothed.
        patches: of `jaxshell.smooth_patches`, to find them once.

    Differentiable; by the mesh where `patches` are given. It sees what the mesh smears of the section forces, not what
    loads, supports or the step do (docs/errors.md). Raises ValueError for a frame that is none, and for nodes that JAX
    is tracing without `patches`, and for a scene without elements.
    """
    return _errors(solution.scene, shape_of(solution, frame), angle, patches)


def deflection_errors(solution: Solution, frame=-1) -> MeshErrors:
    """`mesh_errors` with the errors of moments by half: as much of them as deflections are wrong by, about.

    The plate's element is no Ritz method, and its deflections are better than its moments; those of membranes are as
    good as their forces. docs/adapting.md shows what this is worth.
    """
    return _errors(solution.scene, shape_of(solution, frame), 30.0, None, 0.5)


def mesh_errors_of(
    scene: Scene,
    displacements,
    rotations,
    time=0.0,
    *,
    static: bool = False,
    angle: float = 30.0,
    patches: Patches | None = None,
) -> MeshErrors:
    """`mesh_errors` of displacements (n, 3) and rotations (n, 3, 3) of all nodes at a time, with `static` the load
    factor. A pure function, for jax.grad, jax.vmap and jax.jit."""
    return _errors(scene, given_shape(scene, displacements, rotations, time, static), angle, patches)


def check_has_error(scene: Scene) -> None:
    """Raise ValueError for a scene without elements."""
    if not scene.mesh.n_elements:
        raise ValueError("The scene has no elements, and so its mesh has no error.")


def local_in_shape(scene: Scene, shape: Shape, labels: Frozen) -> Float[Array, " m"]:
    """`MeshErrors.local` of one shape, with the labels of `jaxshell.smooth_patches`."""
    return MeshErrors(*_energies(scene, shape, labels, jnp.ones(()))).local


def _errors(scene: Scene, shape: Shape, angle: float, patches: Patches | None, moments: float = 1.0) -> MeshErrors:
    check_has_error(scene)
    patches = smooth_patches(scene, angle) if patches is None else patches
    energy, strain_energy, area = over_frames(_energies, scene, shape, patches.labels, jnp.asarray(moments))
    return MeshErrors(energy, strain_energy, area if area.ndim == 1 else area[0])


@compiled_for_frames
def _energies(scene: Scene, shape: Shape, labels: Frozen, moments: Float[Array, ""]):
    """Energies of the error, in which moments' errors have a factor, and of the section forces, and the areas."""
    elements = elements_of(scene)
    matrix = elements.section.matrix
    forces = force_probe(scene, matrix)(strains_at_points(scene, elements, shape), shape.factors)
    parts = forces.reshape(*forces.shape[:2], 2, 3)
    smooth = nodal(scene, parts, components="forces", patches=Patches(labels)).reshape(forces.shape)
    error = jnp.einsum("pc,mci->mpi", jnp.asarray(_MIDPOINTS), smooth) - forces
    error = error * jnp.ones(6).at[3:].set(moments)

    def energy(values):
        strains = jnp.linalg.solve(matrix, jnp.swapaxes(values, 1, 2))
        return elements.area / 6.0 * jnp.einsum("mpi,mip->m", values, strains)

    return energy(error), energy(forces), elements.area


def _root(part, whole):
    """√(part / whole), and 0 where there is nothing; differentiable there."""
    some = (part > 0) & (whole > 0)
    return jnp.where(some, jnp.sqrt(jnp.where(some, part, 1.0) / jnp.where(some, whole, 1.0)), 0.0)
