"""Section strains and section forces of a deformed shell: [N; M] = [A B; B D] ([ε; κ] - [ε⁰; κ⁰]).

ε and κ are those of the element's own strain matrices, whose products integrated over the element are its stiffness.
They are linear in it, so that the values at its three mid-edges 12, 23, 31 are the whole field, and their mean is the
value at its middle. Axes turn with the element. Sources: Felippa 2003 (membrane), Batoz, Bathe & Ho 1980 (DKT).
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.assembly.elements import build_elements
from jaxshell.assembly.gauges import force_probe
from jaxshell.assembly.prepared import rest_deformations
from jaxshell.elements import corotational
from jaxshell.elements.element import Element
from jaxshell.elements.strains import section_strains as strains_of_element
from jaxshell.model.materials.base import strain_rotation
from jaxshell.model.scene import Scene
from jaxshell.model.sections.direction import angles, check_direction, given_direction
from jaxshell.numerics.checks import check_choice, check_kind, check_shape, shown
from jaxshell.numerics.compiled import compiled_for_frames
from jaxshell.numerics.triangles import local_frame
from jaxshell.results.solution import Solution


class SectionForces(eqx.Module):
    """Forces and moments on a unit of width of the shell's section, m elements at three points or at their middle.

    Components are (xx, yy, xy), or of axes="global" 3×3 tensors in space. There are no transverse forces Q: the element
    knows none, and div M in single elements does not come nearer on finer meshes (docs/stresses.md).
    """

    N: Float[Array, "*m 3"]
    """Membrane forces ∫σ dz [force/length]."""
    M: Float[Array, "*m 3"]
    """Moments ∫σ z dz about the surface of the nodes [force]; Mxx > 0 stretches the side that the normal points to."""


class SectionStrains(eqx.Module):
    """Strains of the surface of the nodes, from the mesh's shape, of m elements at three points or at their middle."""

    strain: Float[Array, "*m 3"]
    """(εxx, εyy, γxy); of axes="global" tensors in space, with γ/2."""
    curvature: Float[Array, "*m 3"]
    """(κxx, κyy, 2κxy) [1/length]; a fibre at a height z is strained by ε + z κ."""


class Shape(NamedTuple):
    """What stresses are computed from: a shape, and the factors of the scene's initial strains."""

    displacements: Float[Array, "*f n 3"]
    rotations: Float[Array, "*f n 3 3"]
    factors: tuple[Float[Array, "*f"], ...]


# --- of a solution ----------------------------------------------------------------------------------------


def section_forces(solution: Solution, frame=-1, *, axes="element", at: str = "points") -> SectionForces:
    """Section forces of a solution.

    Arguments:
        frame: the frame's number, or a list of them, which gives a leading axis.
        axes: "element": e1 along the edge 1-2 of each; "material": from the section's direction; a vector (3,), one for
            each element (m, 3) or a `jaxshell.Cylindrical`, projected onto the mesh's elements; "global": tensors in
            space.
        at: "points", N and M (m, 3, 3) at the mid-edges 12, 23, 31; or "mean", (m, 3) at the middles, where they are
            more accurate.

    Differentiable; `section_forces_of` computes them from arrays. Raises ValueError for a frame that is none, for
    "material" of a section without direction, for a direction normal to an element.
    """
    return _forces(solution.scene, shape_of(solution, frame), axes, at)


def section_strains(
    solution: Solution, frame=-1, *, axes="element", at: str = "points", elastic: bool = False
) -> SectionStrains:
    """Section strains of a solution, as `SectionStrains`; arguments and errors as of `section_forces`.

    They are those of the deformation from the mesh's shape, whatever it came from; `elastic` leaves away the scene's
    initial strains: what makes stresses, in sections in which a heated laminate's plies do not strive apart.
    """
    return _strains(solution.scene, shape_of(solution, frame), axes, at, elastic)


def section_forces_of(
    scene: Scene, displacements, rotations, time=0.0, *, static: bool = False, axes="element", at: str = "points"
) -> SectionForces:
    """`section_forces` of displacements (n, 3) and rotations (n, 3, 3) of all nodes at a time.

    With `static` the time is the load factor. A pure function, for jax.grad, jax.vmap and jax.jit.
    """
    return _forces(scene, given_shape(scene, displacements, rotations, time, static), axes, at)


def section_strains_of(
    scene: Scene,
    displacements,
    rotations,
    time=0.0,
    *,
    static: bool = False,
    axes="element",
    at: str = "points",
    elastic: bool = False,
) -> SectionStrains:
    """`section_strains` of displacements (n, 3) and rotations (n, 3, 3) of all nodes at a time; see
    `section_forces_of`."""
    return _strains(scene, given_shape(scene, displacements, rotations, time, static), axes, at, elastic)


def strain_energies(solution: Solution, frame=-1) -> Float[Array, "*f m"]:
    """Strain energy of every element [force·length]; their sum is the frame's entry of `solution.energy.strain`.

    ½ (e - e⁰)ᵀ K̂ (e - e⁰), eq. (61) of Yang & Xia 2014. Differentiable. Raises ValueError for a frame that is none.
    """
    return over_frames(energies_of_elements, solution.scene, shape_of(solution, frame))


# --- shapes -----------------------------------------------------------------------------------------------


def shape_of(solution: Solution, frame) -> Shape:
    """One frame of a solution, or several; in statics every initial strain follows the load factor."""
    check_kind("solution", solution, Solution, "a jaxshell.Solution")
    count = len(solution.frame_times)
    numbers = np.asarray(frame)
    if numbers.dtype.kind not in "iu" or numbers.ndim > 1 or np.any((numbers < -count) | (numbers >= count)):
        raise ValueError(f"frame must be the number of a frame, 0 to {count - 1}, or a list, but it is {shown(frame)}.")
    frames = solution.frame(numbers.tolist())
    times = jnp.asarray(solution.frame_times)[numbers]
    return Shape(
        jnp.asarray(frames.displacements),
        jnp.asarray(frames.rotations),
        strain_factors(solution.scene, times, solution.analysis == "static"),
    )


def given_shape(scene: Scene, displacements, rotations, time, static: bool) -> Shape:
    """A shape of arrays. Raises ValueError for those of another number of nodes."""
    check_kind("scene", scene, Scene, "a jaxshell.Scene")
    displacements, rotations = jnp.asarray(displacements, float), jnp.asarray(rotations, float)
    check_shape("displacements", displacements, (scene.mesh.n_nodes, 3))
    check_shape("rotations", rotations, (scene.mesh.n_nodes, 3, 3))
    return Shape(displacements, rotations, strain_factors(scene, jnp.asarray(time, float), static))


def strain_factors(scene: Scene, times, static: bool) -> tuple:
    """Factors of the scene's initial strains at times, or with `static` at load factors."""
    if static:
        return tuple(times for _ in scene.initial_strains)
    return tuple(load.history(times) for load in scene.initial_strains)


def over_frames(function, scene: Scene, shape: Shape, *arguments):
    """`function(scene, shape, *arguments)`, of every frame where the shape has several."""
    if shape.displacements.ndim == 2:
        return function(scene, shape, *arguments)
    return jax.vmap(lambda shape: function(scene, shape, *arguments))(shape)


# --- computed ---------------------------------------------------------------------------------------------


def elements_of(scene: Scene) -> Element:
    """The scene's elements for their strains: without stiffness, which takes as long to compile as all else here."""

    def one(x, section, tangents=None):
        frame, coordinates = local_frame(x)
        area, none = 0.5 * coordinates[0] * coordinates[2], jnp.zeros((6, 6))
        return Element(coordinates, frame, none, none, area, section).shaped(tangents)

    return build_elements(scene, build=one)


def strains_at_points(scene: Scene, elements: Element, shape: Shape) -> Float[Array, "m 3 6"]:
    """Strains and curvatures of all elements from the mesh's shape, in their axes."""
    x0, d, R = _corners(scene, shape)
    return jax.vmap(strains_of_element)(x0, d, R, elements)


def turning(scene: Scene, axes) -> Float[Array, " m"] | None:
    """Angle from every element's e1 to the axis x that is asked for [rad]; None of "element" and "global" axes."""
    if isinstance(axes, str):
        check_choice("axes", axes, ("element", "material", "global"))
        if axes != "material":
            return None
        found = scene.section.direction_angles(scene.mesh)
        if found is None:
            raise ValueError('axes="material" needs a section with a direction; a vector states axes without one.')
        return found
    direction = given_direction(axes)
    check_direction(direction, scene.mesh)
    return angles(direction, scene.mesh)


def in_space(scene: Scene, shape: Shape, tensors: Float[Array, "m *p 3"]) -> Float[Array, "m *p 3 3"]:
    """Plane tensors (xx, yy, xy) in the deformed elements' axes as 3×3 tensors in space."""
    plane = deformed_frames(scene, shape)[:, :2]
    matrices = jnp.stack([tensors[..., jnp.array([0, 2])], tensors[..., jnp.array([2, 1])]], axis=-2)
    return jnp.einsum("mai,m...ab,mbj->m...ij", plane, matrices, plane)


def deformed_frames(scene: Scene, shape: Shape) -> Float[Array, "m 3 3"]:
    """Axes e1, e2, e3 (rows) of the deformed elements."""
    x, d, _ = _corners(scene, shape)
    return jax.vmap(local_frame)((x - x[:, :1]) + (d - d[:, :1]))[0]


def _forces(scene, shape, axes, at) -> SectionForces:
    check_choice("at", at, ("points", "mean"))
    angle = turning(scene, axes)
    whole = isinstance(axes, str) and axes == "global"
    return _averaged(over_frames(_section_forces, scene, shape, angle, whole), shape, at)


def _strains(scene, shape, axes, at, elastic) -> SectionStrains:
    check_choice("at", at, ("points", "mean"))
    angle = turning(scene, axes)
    whole = isinstance(axes, str) and axes == "global"
    return _averaged(over_frames(strains_in_axes, scene, shape, angle, whole, elastic), shape, at)


def _averaged(found, shape: Shape, at: str):
    """Values at three points, or their mean."""
    return found if at == "points" else jax.tree.map(lambda a: jnp.mean(a, axis=shape.displacements.ndim - 1), found)


@compiled_for_frames
def _section_forces(scene: Scene, shape: Shape, angle, whole: bool) -> SectionForces:
    elements = elements_of(scene)
    strains = strains_at_points(scene, elements, shape)
    probe = force_probe(scene, elements.section.matrix)
    both = (probe if angle is None else probe.turned(angle))(strains, shape.factors)
    N, M = both[..., :3], both[..., 3:]
    if whole:
        return SectionForces(in_space(scene, shape, N), in_space(scene, shape, M))
    return SectionForces(N, M)


@compiled_for_frames
def strains_in_axes(scene: Scene, shape: Shape, angle, whole: bool, elastic: bool) -> SectionStrains:
    strains = strains_at_points(scene, elements_of(scene), shape)
    if elastic:
        for factor, load in zip(shape.factors, scene.initial_strains, strict=True):
            free = jnp.concatenate(load.strains(scene.section, scene.mesh), axis=1)
            strains = strains - factor * free[:, None]
    strain, curvature = strains[..., :3], strains[..., 3:]
    if whole:
        halved = jnp.array([1.0, 1.0, 0.5])
        return SectionStrains(in_space(scene, shape, halved * strain), in_space(scene, shape, halved * curvature))
    if angle is None:
        return SectionStrains(strain, curvature)
    turn = jax.vmap(strain_rotation)(angle)
    return SectionStrains(jnp.einsum("mij,m...j->m...i", turn, strain), jnp.einsum("mij,m...j->m...i", turn, curvature))


@compiled_for_frames
def energies_of_elements(scene: Scene, shape: Shape) -> Float[Array, " m"]:
    elements = build_elements(scene)
    if scene.initial_strains:
        rests = zip(shape.factors, rest_deformations(scene, elements), strict=True)
        elements = elements.resting_at(sum((factor * rest for factor, rest in rests), jnp.zeros(())))

    def one(x0, d, R, element):
        e = corotational.kinematics((x0 - x0[:1]) + (d - d[:1]), R, element).deformations
        return corotational.strain_energy(e, element)

    x0, d, R = _corners(scene, shape)
    return jax.vmap(one)(x0, d, R, elements)


def _corners(scene: Scene, shape: Shape):
    """Places in the mesh, displacements and rotations of the elements' corners."""
    triangles = scene.mesh.triangles
    return scene.mesh.nodes[triangles], shape.displacements[triangles], shape.rotations[triangles]
