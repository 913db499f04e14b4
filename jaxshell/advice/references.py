"""Converged references: what a scene's answer is, and how far a run is from it.

The answer of a scene is a handful of signals in time, its figure of merit:

    spherical_cap   deflection of the apex over the first swing
    opened_cap      deflection of A before and through buckling
    free_plate      centre of mass, orientation and tip (corner) of the flying plate
    any other       its watched displacements; without any, the displacements of all nodes

The error of a run is the largest distance from the reference's signal at any of the run's times, over the
signal's largest size (an orientation's: in radians); of several signals, the worst. The three scenes' references
lie in `jaxshell/data` and are made by `benchmarks/references.py`: `EnergyMomentum` with the step halved until
Richardson's extrapolation stands. They are converged in time on the scene's default mesh, and end where the
response becomes chaotic; what the mesh itself contributes is recorded beside them.
"""

from collections.abc import Mapping
from importlib import resources
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from jaxshell.model.loads import DeadLoad
from jaxshell.model.mesh_checks import triangle_areas
from jaxshell.model.scene import Scene
from jaxshell.numerics.extrapolation import extrapolated
from jaxshell.results.solution import Solution

Signals = Mapping[str, Float[np.ndarray, "k q"]]

ORIENTATION = "orientation"
"""The signal measured in radians, whatever its size."""


class Reference(NamedTuple):
    """Signals at the times (k,), known to `uncertainty` (in the measure of `error`)."""

    times: Float[np.ndarray, " k"]
    signals: dict[str, Float[np.ndarray, "k q"]]
    uncertainty: float
    origin: str
    """How it was made, for people."""


def signals(scene: Scene, displacements: Float[np.ndarray, "k n 3"]) -> Signals:
    """A scene's figure of merit from the displacements of all its nodes at some times."""
    if scene.name == "free_plate":
        weights = nodal_weights(scene)
        x0 = np.asarray(scene.mesh.nodes)
        centre = weights @ displacements
        tip = int(scene.watch[0][1])
        return {
            "centre": centre,
            ORIENTATION: orientations(x0, x0 + displacements, weights),
            "tip": displacements[:, tip],
        }
    nodes = [(label, node, c) for label, node, c in scene.watch if isinstance(node, int)]
    watched = [(label, node, "xyz".index(c[1])) for label, node, c in nodes if c[0] == "u"]
    if watched:
        return {label: displacements[:, node, axis, None] for label, node, axis in watched}
    return {"displacements": displacements.reshape(len(displacements), -1)}


def error(
    scene: Scene,
    reference: Reference,
    times: Float[np.ndarray, " k"],
    displacements: Float[np.ndarray, "k n 3"],
) -> float:
    """How far a run is from the reference over the time that both cover; infinite where it is not finite."""
    within = times <= reference.times[-1] * (1 + 1e-12)
    found = signals(scene, displacements[within])
    return signal_error(reference, times[within], found)


def signal_error(
    reference: Reference, times: Float[np.ndarray, " k"], found: Signals, everywhere: bool = False
) -> float:
    """`error` of signals at `times`, which lie within the reference's.

    Compared at the times that both have; between the reference's times (by a cubic spline, which waves shorter
    than its spacing escape) only where they share no more than half of what they could, or `everywhere`.
    """
    spacing = reference.times[-1] / max(1, len(reference.times) - 1)
    nearest = np.abs(reference.times[:, None] - times).argmin(axis=0)
    shared = np.abs(reference.times[nearest] - times) <= 1e-6 * spacing
    if everywhere or 2 * shared.sum() <= min(len(times), len(reference.times)):
        shared[:] = True
    worst = 0.0
    for name, values in found.items():
        known = reference.signals[name]
        expected = CubicSpline(reference.times, known)(times[shared])
        values = values[shared]
        distance = np.linalg.norm(values - expected, axis=1).max(initial=0.0)
        worst = max(worst, float(distance / signal_size(name, known)) if np.isfinite(distance) else np.inf)
    return worst


def signal_size(name: str, values: Float[np.ndarray, "k q"]) -> float:
    """What a signal's error is measured against: its largest size, or one radian."""
    largest = float(np.linalg.norm(values, axis=1).max(initial=0.0))
    return 1.0 if name == ORIENTATION or largest == 0 else largest


def extrapolate(
    coarse: Signals, fine: Signals, order: int = 2, ratio: float = 2.0
) -> dict[str, Float[np.ndarray, "k q"]]:
    """Richardson's extrapolation of two runs, the step halved, or the mesh or step made smaller by `ratio`."""
    return {name: extrapolated(coarse[name], fine[name], order, ratio) for name in fine}


def agreement(times, one: Signals, other: Signals) -> Float[np.ndarray, " k"]:
    """The largest difference up to each time, in the measure of `error`."""
    worst = np.zeros(len(times))
    for name in one:
        distance = np.linalg.norm(one[name] - other[name], axis=1)
        worst = np.maximum(worst, distance / signal_size(name, other[name]))
    return np.maximum.accumulate(worst)


def run_error(reference: Reference, run: Solution) -> float:
    """`error` of a solution that kept every step as a frame, or every so many."""
    return error(run.scene, reference, np.asarray(run.frame_times), np.asarray(run.displacements))


def shipped_reference(scene: Scene) -> Reference | None:
    """The reference in `jaxshell/data` of exactly this scene; None where there is none, or none for its mesh."""
    file = resources.files("jaxshell") / "data" / f"{scene.name}.npz"
    if not file.is_file():
        return None
    with file.open("rb") as opened, np.load(opened) as stored:
        if stored["fingerprint"].shape != (7,) or not np.allclose(stored["fingerprint"], fingerprint(scene), rtol=1e-9):
            return None
        named = {name[7:]: stored[name] for name in stored.files if name.startswith("signal ")}
        return Reference(stored["times"], named, float(stored["uncertainty"]), str(stored["origin"]))


def fingerprint(scene: Scene) -> Float[np.ndarray, "7"]:
    """Numbers that change with a scene's mesh, section and loads: whether a stored reference is of this scene."""
    x0, triangles = np.asarray(scene.mesh.nodes), scene.mesh.connectivity.array
    section = scene.section.resultants(scene.mesh)
    area = 2.0 * triangle_areas(x0, triangles)  # The files were made with twice the areas.
    A, D, mass = (np.asarray(a) for a in (section.A, section.D, section.mass_per_area))
    nu = A[:, 0, 1] / A[:, 0, 0]
    h = np.sqrt(12.0 * D[:, 0, 0] / A[:, 0, 0])
    load = sum(
        np.abs(load.nodal(scene.mesh.nodes, triangles, mass)).sum() * np.abs(load.history.values).sum()
        for load in scene.loads
        if isinstance(load, DeadLoad)
    )
    return np.array(
        [
            scene.mesh.n_nodes,
            np.linalg.norm(x0),
            len(scene.held_dofs),
            area @ (A[:, 0, 0] * (1 - nu**2)),
            area @ mass * (1 + nu.mean()),
            area @ h**3,
            float(load),
        ]
    )


def nodal_weights(scene: Scene) -> Float[np.ndarray, " n"]:
    """Each node's share of the mass, for linear displacements: a third of its elements'."""
    x0, triangles = np.asarray(scene.mesh.nodes), scene.mesh.connectivity.array
    mass = triangle_areas(x0, triangles) * np.asarray(scene.section.area_masses(scene.mesh))
    share = np.zeros(len(x0))
    np.add.at(share, triangles.ravel(), np.repeat(mass, 3))
    return share / share.sum()


def orientations(
    x0: Float[np.ndarray, "n 3"], x: Float[np.ndarray, "k n 3"], weights: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "k 9"]:
    """The rotation matrices that best carry x0 to each x about their centres (Kabsch), over √2.

    The distance of two such rows is, for nearby rotations, the angle between them in radians.
    """
    a, b = x0 - weights @ x0, x - (weights @ x)[:, None]
    moments = np.einsum("kni,nj,n->kij", b, a, weights)
    moments = np.where(np.isfinite(moments), moments, 0.0)
    u, _, vt = np.linalg.svd(moments)
    u[:, :, 2] *= np.linalg.det(u @ vt)[:, None]  # no reflection: a flat body's third axis is free
    return (u @ vt).reshape(-1, 9) / np.sqrt(2.0)
