"""What `jaxshell run --errors` says after a run: the errors of its mesh and of its step."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxshell.analyses.richardson import percent, richardson
from jaxshell.analyses.step_control import StepControl
from jaxshell.model.refinement import coarsen
from jaxshell.model.scene import Scene
from jaxshell.results.mesh_errors import mesh_errors
from jaxshell.results.solution import Solution

CONTOUR = "mesh error"
"""What the run's shapes are coloured by besides."""
_HALVED = 8
"""A tolerance of the local error, which goes with the third power of the step, for half of it."""


def describe_errors(
    scene: Scene, found: Any, again: Callable[[Scene], Any], half_step: Callable[[Scene], Any] | None, say: Callable
) -> list[str]:
    """Lines on what an analysis found in a scene: a `Solution`, or {name: number}.

    `again` does it in another scene and `half_step` with half the step. The other mesh has twice the element size where
    the mesh can be coarsened, and half of it elsewhere. What cannot be told is said with its reason.
    """
    coarse = _coarser(scene)
    count = scene.mesh.n_elements
    other = 4 * count if coarse is None else coarse.mesh.n_elements
    more = " and with half the step" if half_step is not None else ""
    say(f"  errors: the same on {other} triangles{more} ...")
    lines = []
    try:
        # The run itself is not made again.
        study = richardson(
            scene if coarse is None else [coarse, scene],
            lambda each: found if each is scene else again(each),
            coarser=0,
            half_step=half_step,
        )
        peaks = {name: _peak(estimate.values[study.level]) for name, estimate in study.mesh.items()}
        lines += [f"    {study.line(name).replace(':', f': {peak:.6g},', 1)}" for name, peak in peaks.items()]
    except (ValueError, RuntimeError) as error:
        lines.append(f"    not known: {error}")
    return lines + (recovered(found) if isinstance(found, Solution) else [])


def recovered(run: Solution) -> list[str]:
    """The mesh's error by recovered section forces, at the frame with the most strain energy."""
    if not len(run.frame_times) or not run.scene.mesh.n_elements:
        return []
    times, at = np.asarray(run.frame_times), np.asarray(run.times)
    strain = np.asarray(run.energy.strain)[np.abs(at[:, None] - times).argmin(axis=0)]
    frame = int(strain.argmax())
    errors = mesh_errors(run, frame)
    where = "load factor" if run.analysis == "static" else "t ="
    return [
        f"    section forces: {percent(float(errors.relative))} off in the norm of energy, by recovery, at {where} "
        f"{times[frame]:.6g}; most in element {int(np.asarray(errors.local).argmax())}"
    ]


def with_half_step(dt: float | StepControl) -> float | StepControl:
    """Half of a step; of step control the tolerance of half the steps."""
    if not isinstance(dt, StepControl):
        return 0.5 * dt
    return dataclasses.replace(dt, tolerance=dt.tolerance / _HALVED, initial=0.5 * dt.initial)


def _coarser(scene: Scene) -> Scene | None:
    """The scene on the coarser mesh; None where there is none."""
    try:
        return coarsen(scene)
    except ValueError:
        return None


def _peak(values: np.ndarray) -> float:
    """The value of the largest size."""
    flat = np.ravel(values)
    return float(flat[np.abs(flat).argmax()])
