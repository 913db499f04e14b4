"""What a run's energies and momenta are measured against: balance, scales, drifts, and when the loads end."""

from typing import NamedTuple

import numpy as np

from jaxshell.model.mesh_checks import triangle_areas
from jaxshell.model.scene import Scene
from jaxshell.results.solution import Solution


def energy_balance(run: Solution) -> np.ndarray:
    """(k,) change of K + S + D - W since the start, as a fraction of the largest K + S."""
    energy = run.energy
    balance = np.asarray(energy.total + energy.dissipated - energy.external_work)
    largest = np.max(np.abs(np.asarray(energy.total)))
    return (balance - balance[0]) / (largest if largest > 0 else 1.0)


def momentum_scales(run: Solution) -> tuple[float, float]:
    """√(2 M K), the most linear momentum that the largest kinetic energy can carry (M the shell's mass), and that
    times the shell's size (the diagonal of its bounding box): what a change of the momenta is measured against."""
    mesh = run.scene.mesh
    nodes = np.asarray(mesh.nodes)
    mass = float(np.asarray(run.scene.section.area_masses(mesh)) @ triangle_areas(nodes, mesh.triangles))
    linear = float(np.sqrt(2 * mass * np.max(np.asarray(run.energy.kinetic))))
    return linear, linear * float(np.linalg.norm(np.ptp(nodes, axis=0)))


class Drift(NamedTuple):
    """How far the momenta of a free shell are from those that they had when the loads ended."""

    since: float
    """When the loads ended [time]."""
    times: np.ndarray
    """(j,) from then on."""
    linear: np.ndarray
    """(j,) as a fraction of the first of `momentum_scales`."""
    angular: np.ndarray
    """(j,) as a fraction of the second."""


def momentum_drift(run: Solution) -> Drift | None:
    """The drift of both momenta; None of a shell that supports hold or that may touch obstacles, and where loads act to
    the end."""
    since, times = loads_end(run.scene), np.asarray(run.times)
    late = times >= since * (1 + 1e-12)
    if run.scene.supports or run.scene.obstacles or late.sum() < 2:
        return None
    found = []
    for name, scale in zip(("linear", "angular"), momentum_scales(run), strict=True):
        values = np.asarray(getattr(run.momentum, name))[late]
        drift = np.linalg.norm(values - values[0], axis=1)
        found.append(drift / scale if scale > 0 else 0.0 * drift)
    return Drift(since, times[late], *found)


def loads_end(scene: Scene) -> float:
    """The time from which on no load acts; infinity when one never ends."""
    end = 0.0
    for load in scene.loads:
        times, values = np.asarray(load.history.times), np.asarray(load.history.values)
        acting = np.flatnonzero(values)
        if acting.size:
            end = max(end, np.inf if acting[-1] == len(values) - 1 else times[acting[-1] + 1])
    return float(end)
