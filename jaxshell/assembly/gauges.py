"""What turns the strains of elements into stresses and section forces, and the gauges that a run reads in every step.

All of them are y = P [ε; κ] - Σ h q: linear in the strain and the curvature of the mesh's shape, less what the initial
strains of the scene, each with its history h, take away. For section forces P are rows of [A B; B D]; for the stress at
a height z of a ply P = [C, z C] and q = C e⁰(z), with the strain e⁰(z) at which the ply's material is free of stress.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxshell.elements.element import Element
from jaxshell.elements.strains import section_strains
from jaxshell.model.gauge import At, Gauge, gauge_of
from jaxshell.model.history import History
from jaxshell.model.materials.base import stress_rotation
from jaxshell.model.scene import Scene
from jaxshell.model.sections import Layers
from jaxshell.numerics.plane_stress import principal, von_mises


class Probe(eqx.Module):
    """Linear maps from strains to stresses or section forces, of one element or with an axis over all."""

    P: Float[Array, "*m k 6"]
    free: tuple[Float[Array, "*m k"], ...]
    """For every initial strain of the scene, for factor 1."""

    def __call__(self, strains: Float[Array, "*m p 6"], factors) -> Float[Array, "*m p k"]:
        """At p points of the elements; `factors` of the initial strains."""
        found = jnp.einsum("...ki,...pi->...pk", self.P, strains)
        for factor, free in zip(factors, self.free, strict=True):
            found = found - factor * free[..., None, :]
        return found

    def turned(self, angle: Float[Array, "*m"]) -> "Probe":
        """A stress, or several below each other, in axes turned by `angle` [rad]."""
        T = jax.vmap(stress_rotation)(angle)
        blocks = self.P.shape[1] // 3

        def turn(values):
            return jnp.einsum("mij,mbj...->mbi...", T, values.reshape(len(T), blocks, 3, *values.shape[2:])).reshape(
                values.shape
            )

        return Probe(turn(self.P), tuple(turn(free) for free in self.free))


def force_probe(scene: Scene, matrix: Float[Array, "m 6 6"]) -> Probe:
    """(Nxx, Nyy, Nxy, Mxx, Myy, Mxy) in the elements' axes; `matrix` is [A B; B D]."""
    free = (jnp.concatenate(load.strains(scene.section, scene.mesh), axis=1) for load in scene.initial_strains)
    return Probe(matrix, tuple(jnp.einsum("mij,mj->mi", matrix, strain) for strain in free))


def stress_probe(scene: Scene, at: "At | Spot", ply_axes: bool = False) -> Probe:
    """(σxx, σyy, τxy) at a place in the thickness, in the elements' axes or in those of the ply."""
    layers = scene.section.layers(scene.mesh)
    if layers is None:
        raise ValueError("The section has no layers, and so no stresses; it has section forces.")
    number, z = place(layers, at)
    every = jnp.arange(len(z))
    C = layers.C[every, number]
    heights = jnp.broadcast_to(z[:, None], layers.angle.shape)
    free = (load.in_layers(scene.mesh, layers, heights)[every, number] for load in scene.initial_strains)
    probe = Probe(
        jnp.concatenate([C, z[:, None, None] * C], axis=2),
        tuple(jnp.einsum("mij,mj->mi", C, strain) for strain in free),
    )
    return probe.turned(layers.angle[every, number]) if ply_axes else probe


class Spot(NamedTuple):
    """A place in the thickness as numbers, so that one program reads all of them."""

    ply: Any
    """-1 is the uppermost."""
    height: Any
    """0 at the ply's bottom, 1 at its top."""


def spot_of(at: At) -> "Spot | str":
    """A place by its words; "middle", that of the thickness, stays as it is."""
    if isinstance(at, str):
        return {"top": Spot(-1, 1.0), "bottom": Spot(0, 0.0)}.get(at, "middle")
    ply, face = at if isinstance(at, tuple) else (at, "middle")
    return Spot(int(ply), {"bottom": 0.0, "middle": 0.5, "top": 1.0}[face])


def place(layers: Layers, at: At | Spot) -> tuple[Int[Array, " m"], Float[Array, " m"]]:
    """Number of the ply and height of a place. The middle of the thickness, where it lies between two plies, is the
    upper one's."""
    m, plies = layers.angle.shape
    if isinstance(at, str) and at == "middle":
        low, high = layers.z[:, 0, 0], layers.z[:, -1, 1]
        z = 0.5 * (low + high)
        below = layers.z[:, :, 1] <= (z + 1e-9 * (high - low))[:, None]
        return jnp.minimum(jnp.sum(below, axis=1), plies - 1), z
    spot = at if isinstance(at, Spot) else spot_of(at)
    assert isinstance(spot, Spot)
    number = jnp.where(spot.ply < 0, spot.ply + plies, spot.ply)
    bottom, top = layers.z[:, number, 0], layers.z[:, number, 1]
    return jnp.broadcast_to(number, (m,)), (1.0 - spot.height) * bottom + spot.height * top


def probe_of(scene: Scene, elements: Element, gauge: Gauge) -> Probe:
    """The probe of a gauge, for all elements: three rows, in the gauge's axes."""
    if gauge.quantity == "stress":
        assert gauge.at is not None
        probe = stress_probe(scene, gauge.at, gauge.axes == "ply")
    else:
        rows = slice(0, 3) if gauge.quantity == "N" else slice(3, 6)
        both = force_probe(scene, elements.section.matrix)
        probe = Probe(both.P[:, rows], tuple(free[:, rows] for free in both.free))
    if gauge.axes != "material":
        return probe
    angle = scene.section.direction_angles(scene.mesh)
    assert angle is not None  # checked when the scene was made
    return probe.turned(angle)


def picked(values: Float[Array, "*b 3"], gauge: Gauge) -> Float[Array, "*b"]:
    """The gauge's component or invariant."""
    if isinstance(gauge.pick, int):
        return values[..., gauge.pick]
    if gauge.pick == "von mises":
        return von_mises(values)
    return principal(values).values[..., 0 if gauge.pick == "smax" else 1]


class Watching(eqx.Module):
    """A gauge at one element."""

    probe: Probe
    histories: tuple[History, ...]
    element: int = eqx.field(static=True)
    gauge: Gauge = eqx.field(static=True)

    def read(self, x0, triangles, elements: Element, d, R, time) -> Float[Array, ""]:
        """At the middle of the element; from the shape x0, displacements d and rotations R of all nodes."""
        nodes = triangles[self.element]
        element = jax.tree.map(lambda values: values[self.element], elements)
        strains = section_strains(x0[nodes], d[nodes], R[nodes], element)
        factors = [history(time) for history in self.histories]
        return picked(self.probe(jnp.mean(strains, axis=0, keepdims=True), factors)[0], self.gauge)


def watching(scene: Scene, elements: Element) -> tuple[Watching, ...]:
    """The scene's gauges, in the order in which it watches them; none where it names none."""
    histories = tuple(load.history for load in scene.initial_strains)
    found = []
    for _, number, component in scene.watch:
        gauge = gauge_of(component)
        if gauge is not None and isinstance(number, int):
            probe = jax.tree.map(lambda values, e=number: values[e], probe_of(scene, elements, gauge))
            found.append(Watching(probe, histories, number, gauge))
    return tuple(found)
