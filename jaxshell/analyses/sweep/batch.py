"""Some members as one program: `jax.vmap` of whole runs, and what is kept of each of them.

A batch is plain arrays and one scene, so that it can be sent to another process; what comes back is NumPy arrays.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxshell.analyses.driver import RESULT_NAMES, result_of
from jaxshell.analyses.simulation import failure_message, simulate
from jaxshell.analyses.sweep.member import Case, Member, Options, is_float, unnamed
from jaxshell.numerics.compiled import compiled
from jaxshell.numerics.kernels import kernels
from jaxshell.results.quaternions import matrices_to_quaternions
from jaxshell.results.solution import Solution
from jaxshell.results.sweep import ENERGIES

Quantities = Mapping[str, Callable[[Solution], Any]]


class Kept(NamedTuple):
    """What is kept of every member."""

    times: np.ndarray | None
    """Of the histories; None for those of the steps."""
    save_every: int | None
    """Steps between frames, where frames are kept."""


class Batch(NamedTuple):
    """Members of one structure. The program has a row more for each that `leaves` have beyond the numbers."""

    numbers: tuple[int, ...]
    case: Case
    """Of the first."""
    leaves: tuple[np.ndarray, ...]
    """(K, ...) floats of scene and method."""
    steps: np.ndarray | None
    """(K, N)."""


def batch_of(members: Sequence[Member], rows: int) -> Batch:
    """A batch of so many rows; the last member fills up what is left."""
    padded = [*members, *[members[-1]] * (rows - len(members))]
    leaves = tuple(np.stack(values) for values in zip(*(member.leaves for member in padded), strict=True))
    first = members[0]
    steps = None if first.steps is None else np.stack([np.asarray(member.steps) for member in padded])
    return Batch(tuple(member.number for member in members), first.case, leaves, steps)


def run_batch(batch: Batch, quantities: Quantities, kept: Kept) -> dict[str, np.ndarray]:
    """Run all members; returns {what: (n, ...)} rows, with their `number`, `code`, `steps` and `message`."""
    with kernels(batch.case.options.kernels):
        return {"number": np.asarray(batch.numbers), **_run(batch, quantities, kept)}


def _run(batch: Batch, quantities: Quantities, kept: Kept) -> dict[str, np.ndarray]:
    scene, method = unnamed(batch.case.scene), batch.case.method
    if batch.steps is None:
        found = [_controlled(batch, row, quantities, kept) for row in range(len(batch.numbers))]
        rows = {name: np.stack([one[name] for one in found]) for name in found[0]}
    else:
        count = batch.steps.shape[1]
        every = count if kept.save_every is None else kept.save_every
        options = batch.case.options
        outputs = _program((scene, method), batch.leaves, batch.steps, options, dict(quantities), every)
        outputs = jax.tree.map(lambda a: np.asarray(a)[: len(batch.numbers)], outputs)
        rows = _rows([label for label, _, _ in scene.watch], outputs, kept)
        rows["message"] = _messages(rows, batch.steps)
    return rows


@compiled
def _program(example, leaves, steps, options: Options, quantities: dict, save_every: int):
    """The runs of all rows, in the structure of `example` (scene, method)."""
    parts, tree = jax.tree.flatten(example)

    def one(own, steps):
        values = iter(own)
        scene, method = jax.tree.unflatten(tree, [next(values) if is_float(part) else part for part in parts])
        solution = simulate(scene, method, dt=steps, save_every=save_every, throw=False, **options.of_simulate())
        return _outputs(solution, quantities)

    return jax.vmap(one)([jnp.asarray(leaf) for leaf in leaves], jnp.asarray(steps))


def _outputs(solution: Solution, quantities: Quantities) -> dict[str, Any]:
    codes = jnp.stack([jnp.asarray(solution.result == result_of(code)) for code in range(len(RESULT_NAMES))])
    return {
        "code": jnp.argmax(codes),
        "time": solution.times,
        "watched": [solution.watched[label] for label, _, _ in solution.scene.watch],
        "energy": [getattr(solution.energy, name) for name in ENERGIES],
        "frames": [solution.frame_times, solution.displacements, solution.rotations, solution.velocities],
        "quantities": {name: jnp.asarray(function(solution), float) for name, function in quantities.items()},
    }


def _controlled(batch: Batch, row: int, quantities: Quantities, kept: Kept) -> dict[str, Any]:
    """One member under step control, whose number of steps no compiled program of many can know."""
    case, values = batch.case, iter([leaf[row] for leaf in batch.leaves])
    parts, tree = jax.tree.flatten((unnamed(case.scene), case.method))
    scene, method = jax.tree.unflatten(tree, [jnp.asarray(next(values)) if is_float(p) else p for p in parts])
    solution = simulate(scene, method, dt=case.dt, t_end=case.t_end, throw=False, **case.options.of_simulate())
    outputs = jax.tree.map(lambda a: np.asarray(a)[None], _outputs(solution, quantities))
    rows = {name: value[0] for name, value in _rows([label for label, _, _ in scene.watch], outputs, kept).items()}
    return {**rows, "message": np.asarray(solution.message, object)}


def _rows(labels: list[str], outputs: dict, kept: Kept) -> dict[str, np.ndarray]:
    """What is kept, of outputs whose leaves have a leading axis of members. Rows over `labels` are in their order."""
    t, n = outputs["time"], len(outputs["time"])
    watched = np.stack(outputs["watched"], 1) if labels else np.zeros((n, 0, t.shape[1]))
    finished = np.isfinite(t) & np.isfinite(np.stack(outputs["energy"], 1)).all(axis=1)
    finished &= np.isfinite(watched).all(axis=1)
    last = np.maximum(finished.sum(axis=1) - 1, 0)
    seen = np.where(finished[:, None], watched, np.nan)
    members = np.arange(n)
    rows = {
        "code": outputs["code"],
        "steps": last,
        "watched": seen if kept.times is None else _at_times(kept.times, t, seen, last),
        "end": seen[members, :, last],
        "energy": np.stack(outputs["energy"], 1)[members, :, last],
        "energy_balance": _balance(outputs["energy"], finished),
        **{f"quantity {name}": value for name, value in outputs["quantities"].items()},
    }
    for name, best, empty in (("minimum", np.argmin, np.inf), ("maximum", np.argmax, -np.inf)):
        at = best(np.where(finished[:, None], watched, empty), axis=2)
        rows[name] = np.take_along_axis(seen, at[:, :, None], 2)[:, :, 0]
        rows[f"time_of_{name}"] = t[members[:, None], at]
    if kept.save_every is not None:
        times, displacements, rotations, velocities = outputs["frames"]
        rows |= {"frame times": times, "frame displacements": displacements, "frame velocities": velocities}
        rows["frame rotations"] = _quaternions(rotations)
    return rows


def _quaternions(rotations: np.ndarray) -> np.ndarray:
    there = np.isfinite(rotations).all(axis=(-1, -2), keepdims=True)
    found = matrices_to_quaternions(np.where(there, rotations, np.eye(3)))
    return np.where(np.squeeze(there, -1), found, np.nan)


def _balance(energy: list[np.ndarray], finished: np.ndarray) -> np.ndarray:
    """(n,) the largest change of K + S + D - W, as a fraction of the largest K + S."""
    kinetic, strain, work, dissipated = energy
    total = np.where(finished, kinetic + strain, 0.0)
    change = np.where(finished, total + dissipated - work - (total + dissipated - work)[:, :1], 0.0)
    largest = np.abs(total).max(axis=1)
    return np.abs(change).max(axis=1) / np.where(largest > 0, largest, 1.0)


def _at_times(times: np.ndarray, t: np.ndarray, values: np.ndarray, last: np.ndarray) -> np.ndarray:
    """(n, labels, k) of (n, labels, steps): linear between steps, NaN after a member's last."""
    found = np.full((*values.shape[:2], len(times)), np.nan)
    for i, end in enumerate(last):
        within = times <= t[i, end] * (1 + 1e-12)
        for j in range(values.shape[1]):
            found[i, j, within] = np.interp(times[within], t[i, : end + 1], values[i, j, : end + 1])
    return found


def _messages(rows: dict[str, np.ndarray], steps: np.ndarray) -> np.ndarray:
    """(n,) as `simulate` says it; empty where a member ended as asked."""
    said = np.empty(len(rows["code"]), object)
    for i, (code, done) in enumerate(zip(rows["code"], rows["steps"], strict=True)):
        step = steps[i, min(int(done), steps.shape[1] - 1)]
        said[i] = failure_message(int(code), int(done) + 1, float(steps[i, :done].sum()), step)
    return said
