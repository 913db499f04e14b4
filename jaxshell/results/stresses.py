"""Stresses in the layers of a deformed shell: σ = C (ε + z κ - e⁰(z)), plane in every layer.

e⁰(z) is the strain at which the layer's material is free of stress: that of its temperature, or of how it was made. So
a heated laminate's plies have stresses although its section forces vanish. Transverse stresses are not known to
Kirchhoff's theory. See `jaxshell.results.section_forces` for what ε and κ are, and how accurate.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.assembly.gauges import Spot, picked, probe_of, spot_of, stress_probe
from jaxshell.model.gauge import At, Gauge, check_at, check_gauge, gauge_of
from jaxshell.model.mesh import Mesh
from jaxshell.model.scene import Scene
from jaxshell.numerics.checks import check_switch, shown, whole_array
from jaxshell.numerics.compiled import compiled_for_frames
from jaxshell.results.section_forces import (
    Shape,
    elements_of,
    given_shape,
    in_space,
    over_frames,
    shape_of,
    strains_at_points,
    turning,
)
from jaxshell.results.solution import Solution


def stresses(
    solution: Solution, frame=-1, at: At = "top", *, axes="element", mean: bool = False, elements=None
) -> Float[Array, "*m 3"]:
    """Stresses (σxx, σyy, τxy) of a solution [force/length²].

    Arguments:
        frame: the frame's number, or a list of them, which gives a leading axis.
        at: where in the thickness: "top" (to which the normal points), "bottom", "middle" of the thickness; the number
            of a ply, counted from 0 at the bottom, for its middle; or (number, "top"), (number, "bottom").
        axes: as of `section_forces`, and "ply", those of the ply's material. "global" gives tensors (..., 3, 3) in
            space.
        mean: (m, 3) at the elements' middles in place of (m, 3, 3) at their mid-edges 12, 23, 31.
        elements: only of these, numbers or the name of a set.

    Differentiable; `stresses_of` computes them from arrays. Raises ValueError for a section without layers, a ply that
    an element does not have, and as `section_forces`.
    """
    return _stresses_at(solution.scene, shape_of(solution, frame), at, axes, mean, elements)


def stresses_of(
    scene: Scene,
    displacements,
    rotations,
    time=0.0,
    at: At = "top",
    *,
    static: bool = False,
    axes="element",
    mean: bool = False,
    elements=None,
) -> Float[Array, "*m 3"]:
    """`stresses` of displacements (n, 3) and rotations (n, 3, 3) of all nodes at a time.

    With `static` the time is the load factor. A pure function, for jax.grad, jax.vmap and jax.jit.
    """
    return _stresses_at(scene, given_shape(scene, displacements, rotations, time, static), at, axes, mean, elements)


def gauge_field(solution: Solution, component: str, frame=-1) -> Float[Array, "*f m 3"]:
    """What a gauge's text, such as "von mises top" or "Mxx", names, at the three mid-edges of all elements.

    `jaxshell.model.gauge` lists the texts. Raises ValueError for a text that is none, or asks for what the section does
    not have.
    """
    gauge = checked_gauge(solution.scene, component)
    return over_frames(_gauge_field, solution.scene, shape_of(solution, frame), gauge)


class Largest(NamedTuple):
    """Von Mises' stress where it is largest."""

    value: float
    element: int
    face: str


def largest_von_mises(solution: Solution, frame=-1) -> Largest:
    """Von Mises' stress [force/length²] at the element, and at its top or bottom, where it is largest, of the elements'
    middles. Raises ValueError for a section without layers."""
    faces = ("top", "bottom")
    gauges = tuple(checked_gauge(solution.scene, f"von mises {face}") for face in faces)
    values = _middles(solution.scene, shape_of(solution, frame), gauges)
    found = dict(zip(faces, map(np.asarray, values), strict=True))
    face = max(found, key=lambda name: found[name].max())
    element = int(np.argmax(found[face]))
    return Largest(float(found[face][element]), element, face)


def checked_gauge(scene: Scene, component: str) -> Gauge:
    """The gauge of a text. Raises ValueError for one that is none, or asks for what the section does not have."""
    gauge = gauge_of(component)
    if gauge is None:
        raise ValueError(
            f"{shown(component)} names no stress and no section force, as "
            '"von mises top", "sxx bottom", "s11 ply 0 top" and "Mxx" do.'
        )
    check_gauge(repr(component), gauge, scene.section, scene.mesh)
    return gauge


def chosen_elements(mesh: Mesh, elements) -> np.ndarray:
    """Numbers of elements that are given as such, or by the name of a set."""
    if isinstance(elements, str):
        return np.asarray(mesh.element_set(elements))
    numbers = np.atleast_1d(whole_array("elements", elements))
    outside = (numbers < 0) | (numbers >= mesh.n_elements)
    if outside.any():
        raise ValueError(f"elements names {numbers[outside][0]}, but the mesh has elements 0 to {mesh.n_elements - 1}.")
    return numbers


def _stresses_at(scene: Scene, shape: Shape, at: At, axes, mean: bool, elements):
    check_switch("mean", mean)
    chosen = None if elements is None else chosen_elements(scene.mesh, elements)
    check_at("stresses", at, scene.section, scene.mesh, chosen)
    named = axes if isinstance(axes, str) else ""
    angle = None if named == "ply" else turning(scene, axes)
    spot = spot_of(at)
    if isinstance(spot, Spot):
        spot = Spot(*map(jnp.asarray, spot))
    found = over_frames(_stresses, scene, shape, spot, angle, named)
    found = jnp.mean(found, axis=shape.displacements.ndim - 1) if mean else found
    return found if chosen is None else jnp.take(found, chosen, axis=shape.displacements.ndim - 2)


@compiled_for_frames
def _stresses(scene: Scene, shape: Shape, at, angle, named: str) -> Float[Array, "m 3 *c"]:
    strains = strains_at_points(scene, elements_of(scene), shape)
    probe = stress_probe(scene, at, ply_axes=named == "ply")
    probe = probe if angle is None else probe.turned(angle)
    found = probe(strains, shape.factors)
    return in_space(scene, shape, found) if named == "global" else found


@compiled_for_frames
def _gauge_field(scene: Scene, shape: Shape, gauge: Gauge) -> Float[Array, "m 3"]:
    elements = elements_of(scene)
    found = probe_of(scene, elements, gauge)(strains_at_points(scene, elements, shape), shape.factors)
    return picked(found, gauge)


@compiled_for_frames
def _middles(scene: Scene, shape: Shape, gauges: tuple[Gauge, ...]) -> list[Float[Array, " m"]]:
    elements = elements_of(scene)
    strains = jnp.mean(strains_at_points(scene, elements, shape), axis=1, keepdims=True)
    return [picked(probe_of(scene, elements, gauge)(strains, shape.factors)[:, 0], gauge) for gauge in gauges]
