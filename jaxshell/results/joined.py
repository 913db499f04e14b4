"""A run and its continuation as one: histories one after the other, the frames of both."""

import dataclasses
from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxshell.results.frames import JoinedFrames
from jaxshell.results.solution import Energy, Momentum, Solution, Stats

_SAME = 1e-9
"""Relative difference up to which times, and energies of the largest, are the same."""


def continues(later: Solution, earlier: Solution) -> bool:
    """Whether `later` went on where `earlier` ended: the same scene, but for how it is shown, and method; it begins at
    the other's last time, with its energies and what was watched."""
    if later.analysis != "time" or earlier.analysis != "time" or not len(earlier.times) or not len(later.times):
        return False
    if later.stats.get("method") != earlier.stats.get("method"):
        return False
    end, start = float(earlier.times[-1]), float(later.times[0])
    if start <= 0 or abs(end - start) > _SAME * start:
        return False
    largest = float(np.max(np.abs(np.asarray(earlier.energy.total))))
    for name in ("kinetic", "strain"):
        change = float(getattr(earlier.energy, name)[-1]) - float(getattr(later.energy, name)[0])
        if abs(change) > _SAME * largest:
            return False
    return _same_scene(earlier, later)


def _same_scene(first: Solution, second: Solution) -> bool:
    scenes = [dataclasses.replace(run.scene, defaults=None) for run in (first, second)]
    return bool(eqx.tree_equal(*scenes))


def joined(earlier: Solution, later: Solution) -> Solution:
    """Both as one run, which has the scene, the state and the end of `later`.

    Raises ValueError where it does not continue the other (`continues`).
    """
    if not continues(later, earlier):
        raise ValueError(
            f"The run from t = {float(later.times[0]):.6g} does not go on with the one that ends at t = "
            f"{float(earlier.times[-1]):.6g}: it needs the same scene, method and state there."
        )

    def after(first, second):
        return jnp.concatenate([jnp.asarray(first), jnp.asarray(second)[1:]])

    both = later.reaction is not None and earlier.reaction is not None
    frames, frame_times = _frames(earlier, later)
    return Solution(
        scene=later.scene,
        times=after(earlier.times, later.times),
        watched={label: after(earlier.watched[label], values) for label, values in later.watched.items()},
        energy=Energy(*(after(*pair) for pair in _fields(earlier.energy, later.energy))),
        momentum=Momentum(*(after(*pair) for pair in _fields(earlier.momentum, later.momentum))),
        iterations=after(earlier.iterations, later.iterations),
        frame_times=frame_times,
        frames=frames,
        result=later.result,
        message=later.message,
        stats=Stats(later.stats | _summed(earlier, later)),
        state=later.state,
        newton=later.newton,
        reaction=after(earlier.reaction, later.reaction) if both else None,
    )


def join_continuations(runs: Mapping[str, Solution]) -> dict[str, Solution]:
    """The runs with every continuation joined to the run that it goes on with, under that one's name.

    The order of the names does not matter: chains are followed from their beginnings.
    """
    left = dict(runs)
    for name in sorted(left, key=lambda name: float(runs[name].times[0]) if len(runs[name].times) else 0.0):
        if name not in left:
            continue
        while found := next((o for o in left if o != name and continues(left[o], left[name])), None):
            left[name] = joined(left[name], left.pop(found))
    return left


def _frames(earlier: Solution, later: Solution) -> tuple[JoinedFrames, jax.Array]:
    """Frames of both; one that both hold, where the one ends and the other begins, once."""
    times, more = np.asarray(earlier.frame_times), np.asarray(later.frame_times)
    twice = int(len(times) > 0 and len(more) > 0 and abs(more[0] - times[-1]) <= _SAME * abs(more[0]))
    numbers = (tuple(range(len(times))), tuple(range(twice, len(more))))
    return JoinedFrames((earlier.frames, later.frames), numbers), jnp.asarray(np.concatenate([times, more[twice:]]))


def _fields(first, second):
    return [(getattr(first, f.name), getattr(second, f.name)) for f in dataclasses.fields(first)]


def _summed(earlier: Solution, later: Solution) -> dict:
    """Figures of the run that add up."""
    names = ("wall_time", "steps", "iterations", "factorizations")
    values = {name: (earlier.stats.get(name), later.stats.get(name)) for name in names}
    return {name: a + b for name, (a, b) in values.items() if isinstance(a, int | float) and isinstance(b, int | float)}
