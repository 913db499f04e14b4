"""Answers of continuous problems, mesh and step extrapolated away: those of some scenes of the library.

`benchmarks/continuous.py` makes them, by two discretisations on refined meshes. They hold for a scene with the same
sizes, section and loads on any mesh, and say at every time how well they are known up to it.
"""

from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxshell.advice.references import Reference
from jaxshell.model.loads import DeadLoad, Pressure
from jaxshell.model.mesh_checks import triangle_areas
from jaxshell.model.scene import Scene

_LIKE = 0.02
"""A mesh's area, and what acts on it, may differ by so much from those of the mesh that the answer was made with."""


def limit_reference(scene: Scene, t_end: float = np.inf) -> Reference | None:
    """The answer of the continuous problem up to t_end, with its uncertainty there; None where there is none.

    It is chosen by the scene's name, and taken only when thickness, moduli, density, area and loads are those that it
    was made with.
    """
    file = resources.files("jaxshell") / "data" / f"{scene.name}_limit.npz"
    if not file.is_file():
        return None
    with file.open("rb") as opened, np.load(opened) as stored:
        mine, theirs = fingerprint(scene), stored["fingerprint"]
        if mine.shape != theirs.shape or not np.allclose(mine, theirs, rtol=_LIKE, atol=0.0):
            return None
        within = stored["times"] <= t_end * (1 + 1e-9)
        named = {name[7:]: stored[name][within] for name in stored.files if name.startswith("signal ")}
        known = float(stored["uncertainty"][within][-1])
        return Reference(stored["times"][within], named, known, str(stored["origin"]))


def write_limit(folder: Path, scene: Scene, reference: Reference, uncertainty: Float[np.ndarray, " k"]) -> None:
    """Store an answer, known to `uncertainty` up to each of its times, as data of the package in `folder`."""
    named: dict[str, Any] = {f"signal {key}": value for key, value in reference.signals.items()}
    np.savez_compressed(
        folder / f"{scene.name}_limit.npz",
        times=reference.times,
        uncertainty=uncertainty,
        origin=reference.origin,
        fingerprint=fingerprint(scene),
        **named,
    )


def fingerprint(scene: Scene) -> Float[np.ndarray, " q"]:
    """Numbers that change with what the scene is, and hardly with its mesh: stiffness, mass, thickness, area, loads."""
    x0, triangles = np.asarray(scene.mesh.nodes), scene.mesh.connectivity.array
    section = scene.section.resultants(scene.mesh)
    A, D, mass = (np.asarray(a) for a in (section.A, section.D, section.mass_per_area))
    areas = triangle_areas(x0, triangles)
    strength = []
    for load in scene.loads:
        at_rest = 0.0
        if isinstance(load, DeadLoad):
            at_rest = float(np.abs(np.asarray(load.nodal(scene.mesh.nodes, triangles, mass))).sum())
        elif isinstance(load, Pressure):
            at_rest = float(np.abs(np.asarray(load.pressure)).mean())
        strength.append(at_rest * float(np.abs(np.asarray(load.history.values)).sum()))
    return np.array([A[:, 0, 0].mean(), A[:, 0, 1].mean(), D[:, 0, 0].mean(), mass.mean(), areas.sum(), *strength])
