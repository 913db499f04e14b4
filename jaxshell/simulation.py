"""Dynamic runs: `simulate` compiles one program of many steps and drives it chunk by chunk.

Inside the program a `lax.scan` runs over frames and steps, with Newton's `lax.while_loop` inside; the host sees
a chunk's histories only, shows progress and hands them to the file. When `simulate` is itself being traced
(by `jax.grad`, `jax.vmap`, `jax.jit`) the whole run is one program.
"""

import contextlib
import dataclasses
import time
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxshell import program
from jaxshell.assembly import Tables, analyse, nodal_tables
from jaxshell.checks import check_finite, check_positive, is_concrete, require_float64
from jaxshell.gradients import Gradients, Stored
from jaxshell.linear_solver import Handle, LinearSolver, default_solver
from jaxshell.methods.base import Method
from jaxshell.methods.with_reactions import WithReactions
from jaxshell.model import structure_of
from jaxshell.newton import SUCCESSFUL, Newton
from jaxshell.program import Carry, Choices, Frame, Record
from jaxshell.progress import Progress
from jaxshell.quoted import quote
from jaxshell.restart import restored
from jaxshell.scene import Scene
from jaxshell.solution import RESULTS, Energy, Momentum, Solution, Stats
from jaxshell.step_control import StepControl

_CHUNK_STEPS = 50
"""Steps between two looks of the host: often enough for a progress bar, seldom enough to cost nothing."""


_STOPS = 128
"""Under step control, room for so many output times and kinks at a time."""


class SimulationError(RuntimeError):
    """A run that ended early. `solution` holds every step that was finished."""

    def __init__(self, message: str, solution: Solution):
        super().__init__(message)
        self.solution = solution


def simulate(
    scene: Scene,
    method: Method,
    *,
    dt,
    t_end=None,
    save_every: int = 1,
    reactions: bool = False,
    tangent: str = "closed_form",
    newton: Newton | None = None,
    linear_solver: LinearSolver | None = None,
    gradients: Gradients | None = None,
    throw: bool = True,
    progress: bool = False,
    output=None,
    restart: Solution | None = None,
) -> Solution:
    """Run a scene in time.

    Arguments:
        scene: what to run. Differentiable in its floats.
        method: the time integrator, e.g. `GeneralizedEnergyMomentum()`.
        dt: step size [time], or an array of step sizes (then t_end may be left out), or a `StepControl`. A run
            whose length is no multiple of dt ends with a shorter step.
        t_end: duration of the run [time], counted from the start (or from the end of `restart`).
        save_every: steps between frames (displacements, rotations, velocities of all nodes); histories are
            kept at every step.
        reactions: record what the supports carry in every step, for `jaxshell.reactions`; a residual more a step.
        tangent: "closed_form" or "autodiff" (`jax.jacfwd` of the element residual); the same run.
        newton: tolerances and limits of the iteration, see `Newton`.
        linear_solver: `Pardiso()`, `KLU()`, `Dense()`; None chooses for this machine.
        gradients: what reverse mode keeps of the run: `jaxshell.gradients.Stored()` (the default) the state of
            every step, `Checkpointed(...)` fewer. Without effect on a run that is not differentiated.
        throw: raise `SimulationError` when the run fails (it carries the solution so far); otherwise the
            solution's `result` and `message` say so. A run traced by JAX raises while the compiled program
            runs; with throw=False everything after the failure is NaN, gradients included.
        progress: show a progress bar.
        output: path of an HDF5 file that receives the results as they come.
        restart: a solution of the same scene and method to go on from, also one read from a file.

    Returns a `Solution`. Raises ValueError for bad input and RuntimeError when float64 is off, both before
    anything is compiled.
    """
    require_float64()
    newton = Newton() if newton is None else newton
    _check_options(scene, method, save_every, tangent, newton)
    steps = _controlled(scene, dt, t_end) if isinstance(dt, StepControl) else _step_sizes(dt, t_end)
    linear_solver = default_solver() if linear_solver is None else linear_solver
    method.check(scene, np.asarray([dt.initial]) if isinstance(dt, StepControl) else steps)
    if method.uses_matrix:
        tables, pattern = analyse(structure_of(scene))
        handle = linear_solver.prepare(pattern)
    else:
        empty = jnp.zeros(0, jnp.int32)
        tables, handle = nodal_tables(structure_of(scene)), Handle(empty, empty, empty, ())
    choices = Choices(tangent, linear_solver, save_every, scene.watch)
    as_arrays = _floats_to_arrays((WithReactions(method) if reactions else method, newton))
    run = Run(scene, as_arrays[0], as_arrays[1], tables, handle, choices)

    if not all(is_concrete(leaf) for leaf in jax.tree.leaves((scene, method, newton, steps))):
        if output is not None or progress:
            raise ValueError("output= and progress= need a run that is not traced by jax.grad, jax.vmap or jax.jit.")
        if isinstance(steps, Controlled):
            raise ValueError(
                "A run under StepControl cannot be traced by jax.grad, jax.vmap or jax.jit, since its number of "
                "steps is not known. Run it once, then trace simulate(..., dt=solution.step_sizes)."
            )
        return _traced_run(run, steps, restart, Stored() if gradients is None else gradients, throw)
    duration = steps.stops[-1] if isinstance(steps, Controlled) else np.sum(steps)
    with Progress(float(duration), enabled=progress) as bar:
        solution = _driven_run(run, steps, output, bar, restart)
    if throw and solution.message:
        raise SimulationError(solution.message, solution)
    return solution


class Run(NamedTuple):
    """Everything that is fixed during a run."""

    scene: Scene
    method: Method
    newton: Newton
    tables: Tables
    handle: Handle
    choices: Choices


class Controlled(NamedTuple):
    """A run under step control: when frames are wanted and where steps land, from the run's start."""

    control: StepControl
    outputs: np.ndarray
    stops: np.ndarray


def _driven_run(run: Run, steps, output, bar, restart) -> Solution:
    begun = time.perf_counter()
    model, carry, record, frame = program.prepare(*run)
    carry, record, frame, start = _resume(model, run, carry, record, frame, restart)
    if isinstance(steps, Controlled):
        chunks = _controlled_chunks(run, model, carry, steps, start)
    else:
        chunks = _fixed_chunks(run, model, carry, steps, start)
    records, frames = [_expand(record)], [_expand(frame)]
    first_chunk, counts, bar.start = 0.0, {}, start
    settings = _settings(run, steps, start)
    with _writer(output, run.scene, settings, settings["reactions"]) as writer:
        _append(writer, run.scene, records[0], frames[0], carry.state)
        for carry, record, frame, dt, counts in chunks:
            records.append(record)
            frames.append(frame)
            _append(writer, run.scene, record, frame, carry.state)
            first_chunk = first_chunk or time.perf_counter() - begun
            bar.advance(record)
        record, frame = (jax.tree.map(lambda *a: np.concatenate(a), *parts) for parts in (records, frames))
        code, taken = int(carry.result), record.time.size - 1
        message = _message(code, taken, record.time[-1], dt)
        stats = Stats(
            method=settings["method"],
            newton=settings["newton"],
            linear_solver=type(run.choices.linear_solver).__name__,
            tangent=run.choices.tangent,
            steps=taken,
            **counts,
            iterations=int(record.iterations.sum()),
            factorizations=int(record.factorizations.sum()),
            wall_time=time.perf_counter() - begun,
            first_chunk_time=first_chunk,
        )
        if writer is not None:
            writer.finish(_RESULT_NAMES[code], message, stats)
    return _solution(run.scene, record, frame, carry.state, _results()[code], message, stats, jax.device_put)


def _fixed_chunks(run: Run, model, carry, steps, start):
    """Run given step sizes; yields (carry, record, frame, the size of a step that failed, counts) a chunk."""
    save_every = run.choices.save_every
    frames = max(1, _CHUNK_STEPS // save_every)  # of any run, so that its length compiles nothing anew
    size, ends, taken = frames * save_every, start + np.cumsum(steps), 0
    for at in range(0, len(steps), size):
        fill = size - len(steps[at : at + size])
        pairs = [np.pad(a[at : at + size], (0, fill)).reshape(frames, save_every) for a in (steps, ends)]
        carry, *found = program.run(model, run.method, run.newton, run.handle, run.choices, carry, tuple(pairs))
        record, frame = jax.tree.map(np.asarray, tuple(found))
        done = record.done
        # Frames none of whose steps was taken repeat the last state.
        fresh = done.reshape(frames, save_every).any(axis=1)
        taken += int(done.sum())
        yield carry, _select(record, done), _select(frame, fresh), steps[min(taken, len(steps) - 1)], {}
        if int(carry.result) != SUCCESSFUL:
            return


def _controlled_chunks(run: Run, model, carry, steps: Controlled, start):
    """Run under step control; yields as `_fixed_chunks`, with a frame at every output time."""
    # Where the run lands is traced, its number of stops in blocks: other outputs compile nothing anew.
    control = dataclasses.replace(steps.control, output_interval=None)
    outputs, stops = (start + times for times in (steps.outputs, steps.stops))
    stops = np.pad(stops, (0, -len(stops) % _STOPS), mode="edge")
    attempts = program.Attempts(carry, control.start(start))
    while float(attempts.control.time) < stops[-1] and int(attempts.carry.result) == SUCCESSFUL:
        attempts, found = program.try_steps(
            model, run.method, run.newton, run.handle, run.choices, control, attempts, stops, jnp.zeros(_CHUNK_STEPS)
        )
        record, frame = jax.tree.map(np.asarray, found)
        shown = record.done & np.isin(record.time, outputs)
        counts = {name: int(getattr(attempts.control, name)) for name in ("accepted", "rejected")}
        yield attempts.carry, _select(record, record.done), _select(frame, shown), attempts.control.dt, counts


def _select(tree, which):
    return jax.tree.map(lambda a: a[which], tree)


def _settings(run: Run, steps, start) -> dict:
    """What a result file says about how the run was made, enough to make it again."""
    controlled = isinstance(steps, Controlled)
    method = run.method.method if isinstance(run.method, WithReactions) else run.method
    return {
        "method": quote(method),
        "newton": quote(run.newton),
        "tangent": run.choices.tangent,
        "save_every": run.choices.save_every,
        "reactions": method is not run.method,
        "dt": quote(steps.control) if controlled else float(steps[0]),
        "t_end": float(start + (steps.stops[-1] if controlled else np.sum(steps))),
    }


def _writer(output, scene: Scene, settings: dict, reactions: bool = False):
    if output is None:
        return contextlib.nullcontext()
    from jaxshell.storage import ResultWriter

    return ResultWriter(output, scene, settings, reactions)


def _traced_run(run: Run, steps, restart, gradients: Gradients, throw: bool) -> Solution:
    model, carry, record, frame = program.prepare(*run)
    carry, record, frame, start = _resume(model, run, carry, record, frame, restart)
    pairs = jnp.asarray(steps), start + jnp.cumsum(jnp.asarray(steps))
    carry, records, shots = program.run_whole(
        model, run.method, run.newton, run.handle, run.choices, gradients, carry, pairs
    )
    record, frame = (
        jax.tree.map(lambda first, rest: jnp.concatenate([first[None], rest]), *parts)
        for parts in ((record, records), (frame, shots))
    )
    result = _results()[0]
    for code, item in enumerate(_results()):
        result = RESULTS.where(carry.result == code, item, result)
    solution = _solution(run.scene, record, frame, carry.state, result, "", Stats(), lambda a: a)
    return _raise_on_failure(solution) if throw else solution


def _raise_on_failure(solution: Solution) -> Solution:
    """Tie an error to every float of a traced solution, so that it comes with values and with gradients alone."""
    failed = solution.result != RESULTS.successful
    sound = solution.result.error_if(jnp.array(1.0), failed)
    floats, rest = eqx.partition(solution, eqx.is_inexact_array)
    scene = floats.scene
    floats = jax.tree.map(lambda a: a * sound, floats)
    return eqx.combine(eqx.tree_at(lambda s: s.scene, floats, scene), rest)


def _resume(model, run: Run, carry: Carry, record, frame, restart: Solution | None):
    if restart is None:
        return carry, record, frame, 0.0
    carry = carry._replace(state=restored(restart.state, carry.state))
    return carry, *program.first(model, run.method, carry.state, run.choices), float(carry.state.time)


def _solution(scene, record: Record, frame: Frame, state, result, message, stats, convert) -> Solution:
    record, frame = jax.tree.map(convert, (record, frame))
    seen = record.observed
    return Solution(
        scene=scene,
        times=record.time,
        watched={label: record.watched[:, i] for i, (label, _, _) in enumerate(scene.watch)},
        energy=Energy(seen.kinetic, seen.strain, seen.external_work, seen.dissipated),
        momentum=Momentum(seen.linear, seen.angular),
        iterations=record.iterations,
        frame_times=frame.time,
        displacements=frame.displacements,
        rotations=frame.rotations,
        velocities=frame.velocities,
        state=state,
        result=result,
        message=message,
        stats=stats,
        reaction=seen.reaction,
    )


def _append(writer, scene: Scene, record: Record, frame: Frame, state=None) -> None:
    """Hand a chunk, and the state at its end, to the result file, if there is one."""
    if writer is None:
        return
    solution = _solution(scene, record, frame, state, RESULTS.successful, "", Stats(), np.asarray)
    writer.append(
        solution.times,
        solution.watched,
        solution.energy,
        solution.momentum,
        solution.iterations,
        solution.frame_times,
        solution.displacements,
        solution.rotations,
        solution.velocities,
        solution.reaction,
        solution.state,
    )


_RESULT_NAMES = ("successful", "diverged", "stagnated", "singular", "step_too_small", "unstable")


def _results() -> list[RESULTS]:
    """In the order of the codes in `jaxshell.newton`."""
    return [getattr(RESULTS, name) for name in _RESULT_NAMES]


def _message(code: int, taken: int, at, dt) -> str:
    if code == SUCCESSFUL:
        return ""
    return f"Step {taken + 1}, from t = {at:.6g} with dt = {float(dt):.3g}: {RESULTS[_results()[code]]}"


def _expand(tree):
    return jax.tree.map(lambda a: np.asarray(a)[None], tree)


def _floats_to_arrays(tree: Any) -> Any:
    """Python floats as arrays, so that another value compiles nothing anew."""
    return jax.tree.map(lambda leaf: jax.device_put(np.float64(leaf)) if isinstance(leaf, float) else leaf, tree)


def _controlled(scene: Scene, control: StepControl, t_end) -> Controlled:
    if t_end is None:
        raise ValueError("t_end, the duration of the run, is missing.")
    check_positive("t_end", t_end)
    interval = t_end / 100 if control.output_interval is None else control.output_interval
    outputs = np.append(np.arange(interval, t_end * (1 - 1e-9), interval), t_end)
    histories = [item.history for item in (*scene.loads, *scene.supports) if item.history is not None]
    kinks = np.concatenate([np.zeros(0), *(np.asarray(h.times) for h in histories if is_concrete(h.times))])
    stops = np.unique(np.concatenate([outputs, kinks[(kinks > 0) & (kinks < t_end)]]))
    # Times that differ by round-off only are one.
    return Controlled(_floats_to_arrays(control), outputs, stops[np.append(np.diff(stops) > 1e-9 * t_end, True)])


def _step_sizes(dt, t_end):
    dt = np.asarray(dt, float) if isinstance(dt, list | tuple) else dt
    check_positive("dt", dt)
    if np.ndim(dt) == 1:
        if t_end is not None:
            raise ValueError("With an array of step sizes t_end follows from it: leave t_end out.")
        return dt if not is_concrete(dt) else np.asarray(dt, float)
    if t_end is None:
        raise ValueError("t_end, the duration of the run, is missing.")
    if not (is_concrete(dt) and is_concrete(t_end)):
        raise ValueError("The number of steps must be known: pass an array of step sizes to trace dt or t_end.")
    check_positive("t_end", t_end)
    count = max(1, int(np.ceil(float(t_end) / float(dt) * (1 - 1e-10))))
    steps = np.full(count, float(dt))
    steps[-1] = float(t_end) - (count - 1) * float(dt)
    if abs(steps[-1] - float(dt)) < 1e-9 * float(dt):
        steps[-1] = float(dt)
    return steps


def _check_options(scene, method, save_every, tangent, newton) -> None:
    for name, value, kind in (("scene", scene, Scene), ("method", method, Method), ("newton", newton, Newton)):
        if not isinstance(value, kind):
            raise ValueError(f"{name} must be a jaxshell.{kind.__name__}, but it is {value!r}.")
    if not isinstance(save_every, int | np.integer) or save_every < 1:
        raise ValueError(f"save_every must be a whole number of at least 1, but it is {save_every!r}.")
    if tangent not in ("closed_form", "autodiff"):
        raise ValueError(f'tangent must be "closed_form" or "autodiff", but it is {tangent!r}.')
    check_finite("thickness", scene.section.thickness)
