"""What `jaxshell run --errors` says after a run: the errors of its mesh and of its step."""

import contextlib
import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxshell.analyses.richardson import percent, richardson
from jaxshell.analyses.step_control import StepControl
from jaxshell.model.refinement import coarsen, refine
from jaxshell.model.scene import Scene
from jaxshell.results.mesh_errors import mesh_errors
from jaxshell.results.solution import Solution

CONTOUR = "mesh error"
"""What the run's shapes are coloured by besides."""
_COARSER = 2
"""Meshes: three in all show whether there is an order, and the coarser ones are cheap."""
_HALVED = 8
"""A tolerance of the local error, which goes with the third power of the step, for half of it."""


def describe_errors(
    scene: Scene, found: Any, again: Callable[[Scene], Any], half_step: Callable[[Scene], Any] | None, say: Callable
) -> list[str]:
    """Lines on what an analysis found in a scene: a `Solution`, or {name: number}.

    `again` does it in another scene, `half_step` with half the step. The other meshes are coarser, up to two of them,
    where the mesh can be coarsened; else there is a finer one. What cannot be told is said with its reason.
    """
    family, others = _family(scene)
    more = " and with half the step" if half_step is not None else ""
    say(f"  errors: the same on {' and '.join(str(each.mesh.n_elements) for each in others)} triangles{more} ...")
    # Nothing is made twice, the run itself among it.
    known = {scene.mesh.n_elements: found}
    steps: list[Any] = []

    def once(each: Scene) -> Any:
        count = each.mesh.n_elements
        if count not in known:
            known[count] = again(each)
        return known[count]

    def halved(each: Scene) -> Any:
        if not steps:
            steps.append(half_step(each))  # pyright: ignore[reportOptionalCall]
        return steps[0]

    study = None
    while study is None:
        try:
            study = richardson(family, once, coarser=0, half_step=None if half_step is None else halved)
        except (ValueError, RuntimeError) as error:
            if not isinstance(family, list) or len(family) <= 2:
                return [f"    not known: {error}", *recovered(found)]
            family = family[1:]  # The coarsest may be too coarse to run.
    peaks = {name: _peak(estimate.values[study.level]) for name, estimate in study.mesh.items()}
    lines = [f"    {name}: {peak:.6g}, {study.words(name)}" for name, peak in peaks.items()]
    return lines + recovered(found)


def _family(scene: Scene) -> tuple[Any, list[Scene]]:
    """Meshes from coarse to fine, the scene's the last; or the scene, to be refined. And those that are to be run."""
    family = [scene]
    with contextlib.suppress(ValueError):
        for _ in range(_COARSER):
            family.insert(0, coarsen(family[0]))
    return (family, family[:-1]) if len(family) > 1 else (scene, [refine(scene)])


def recovered(run: Any) -> list[str]:
    """The mesh's error by recovered section forces, at the frame with the most strain energy; of a `Solution`."""
    if not isinstance(run, Solution) or not len(run.frame_times) or not run.scene.mesh.n_elements:
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
    first = 0.5 * dt.initial
    smallest = jnp.minimum(dt.smallest, first)
    return dataclasses.replace(dt, tolerance=dt.tolerance / _HALVED, initial=first, smallest=smallest)


def _peak(values) -> float:
    """The value of the largest size."""
    flat = np.ravel(values)
    return float(flat[np.abs(flat).argmax()])
