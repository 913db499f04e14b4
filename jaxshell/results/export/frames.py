"""Frames with the entries of the histories that belong to them."""

import dataclasses
from collections.abc import Iterator

import jax
import numpy as np

from jaxshell.results.solution import Solution


def steps_of_frames(times, frame_times) -> np.ndarray | None:
    """(f,) for every frame the position of its time in `times`; None where it cannot be told.

    Times of runs ascend. Load factors may come back to a value: then it is told where every step has a frame, or where
    one distance between frames alone fits.
    """
    times, wanted = np.asarray(times), np.asarray(frame_times)
    if len(wanted) == len(times) and np.array_equal(times, wanted):
        return np.arange(len(times))
    if np.all(np.diff(times) > 0):
        found = np.searchsorted(times, wanted)
        inside = found < len(times)
        return found if inside.all() and np.array_equal(times[found], wanted) else None
    fitting = {}
    for distance in range(1, len(times)):
        rows = np.unique(np.append(np.arange(0, len(times), distance), len(times) - 1))
        if len(rows) == len(wanted) and np.array_equal(times[rows], wanted):
            fitting[rows.tobytes()] = rows
    return next(iter(fitting.values())) if len(fitting) == 1 else None


def at_frames(solution: Solution) -> Solution:
    """The solution with the histories at its frames only: NaN where it cannot be told which these are."""
    steps = steps_of_frames(solution.times, solution.frame_times)
    count = len(solution.frame_times)

    def chosen(values):
        values = np.asarray(values)
        return np.full((count, *values.shape[1:]), np.nan) if steps is None else values[steps]

    return _with_histories(solution, chosen, np.asarray(solution.frame_times))


def in_parts(solution: Solution, size: int) -> Iterator[Solution]:
    """Parts of `size` frames, read when their turn comes, each with the histories at its frames."""
    whole = at_frames(solution)
    for start in range(0, len(whole.frame_times), size):
        numbers = np.arange(start, min(start + size, len(whole.frame_times)))
        part = _with_histories(whole, lambda values, numbers=numbers: values[numbers], whole.times[numbers])
        yield dataclasses.replace(part, frames=solution.frame(numbers.tolist()))


def _with_histories(solution: Solution, chosen, times) -> Solution:
    watched, energy, momentum = jax.tree.map(chosen, (solution.watched, solution.energy, solution.momentum))
    return dataclasses.replace(
        solution,
        times=times,
        frame_times=times,
        watched=watched,
        energy=energy,
        momentum=momentum,
        iterations=np.zeros(len(times), np.int64),
        state=None,
        newton=None,
        reaction=None,
        stable=None,
    )
