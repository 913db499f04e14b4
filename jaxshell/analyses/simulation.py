"""Dynamic runs: `simulate` compiles one program of many steps and drives it chunk by chunk.

Inside the program a `lax.scan` runs over frames and steps, with Newton's `lax.while_loop` inside; the host sees
a chunk's histories only, shows progress and hands them to the file. When `simulate` is itself being traced
(by `jax.grad`, `jax.vmap`, `jax.jit`) the whole run is one program.
"""

import dataclasses
import time
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxshell.analyses import program
from jaxshell.analyses.driver import (
    Log,
    Setup,
    SimulationError,
    check_options,
    check_untraced,
    floats_to_arrays,
    is_traced,
    result_of,
    resumed,
    run_traced,
    set_up,
    single,
)
from jaxshell.analyses.program import Carry, Frame, Plan, Record
from jaxshell.analyses.progress import Progress
from jaxshell.analyses.step_control import StepControl
from jaxshell.files.quoted import quote
from jaxshell.gradients import Gradients, Stored
from jaxshell.methods.method import Method
from jaxshell.model.scene import Scene
from jaxshell.numerics.checks import check_positive, check_positive_number, check_steps, is_concrete, require_float64
from jaxshell.results.restart import time_of
from jaxshell.results.solution import RESULTS, Solution
from jaxshell.solvers.iteration import SUCCESSFUL
from jaxshell.solvers.linear_solver import LinearSolver
from jaxshell.solvers.newton import Newton

_CHUNK_STEPS = 50
"""The most steps between two looks of the host: seldom enough to cost nothing."""
_CHUNK_TIME = 0.7
"""Seconds between two looks, about: after so long a run shows its progress, hears Ctrl-C and has its steps on disk."""
_CHUNK_BYTES = 2**24
"""Frames of a chunk, which are in memory together."""

_STOPS = 128
"""Under step control, room for so many output times and kinks at a time."""


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
        output: path of an HDF5 file that receives the results as they come, or of a VTKHDF file (*.vtkhdf) for
            ParaView; or an `Output`, or several of them.
        restart: a solution of the same scene and method to go on from, also one read from a file.

    Returns a `Solution`. Raises ValueError for bad input and RuntimeError when float64 is off, both before
    anything is compiled.
    """
    require_float64()
    newton = Newton() if newton is None else newton
    check_options(scene, method, save_every, tangent, newton)
    for position, load in enumerate(scene.loads):
        if not load.in_time:
            raise ValueError(
                f"load {position} ({load.kind}) has no place in a run in time, which would need the gyroscopic forces "
                "of axes that spin: drive the hub by Support(rotation=...)."
            )
    steps = _controlled(scene, method, dt, t_end) if isinstance(dt, StepControl) else step_sizes(dt, t_end)
    method.check(scene, np.asarray([dt.initial]) if isinstance(dt, StepControl) else steps)
    if not isinstance(steps, Controlled):
        check_turns(scene, steps, 0.0 if restart is None else time_of(restart.state))
    traced = is_traced(scene, method, newton, steps)
    setup = set_up(
        scene,
        method,
        newton,
        linear_solver=linear_solver,
        tangent=tangent,
        save_every=save_every,
        reactions=reactions,
        differentiated=traced,
    )
    if traced:
        check_untraced(output, progress)
        if isinstance(steps, Controlled):
            raise ValueError(
                "A run under StepControl cannot be traced by jax.grad, jax.vmap or jax.jit, since its number of "
                "steps is not known. Run it once, then trace simulate(..., dt=solution.step_sizes)."
            )
        return run_traced(setup, steps, Stored() if gradients is None else gradients, throw, restart=restart)
    asked = {} if linear_solver is None else {"linear_solver": type(linear_solver).__name__.lower()}
    with Progress(enabled=progress) as bar:
        solution = _driven_run(
            setup, steps if isinstance(steps, Controlled) else dt, t_end, output, bar, restart, asked
        )
    if throw and solution.message:
        raise SimulationError(solution.message, solution)
    return solution


def check_turns(scene: Scene, steps, start=0.0) -> None:
    """Raise ValueError where a support turns its nodes by half a turn or more in one of the steps (N,) from `start` on.

    A step would take such a turn the other way round. What JAX traces cannot be looked at: the run fails there.
    """
    for position, support in enumerate(scene.supports):
        if support.rotation is None or not all(map(is_concrete, (*jax.tree.leaves(support), steps, start))):
            continue
        times = start + np.concatenate([[0.0], np.cumsum(steps)])
        # NumPy's: in a trace JAX's would be traced, though all that it takes is known.
        factors = np.interp(times, support.history.times, support.history.values)  # pyright: ignore[reportOptionalMemberAccess]
        turns = np.abs(np.diff(np.asarray(support.angle) * factors))
        if np.any(turns >= np.pi):
            i = int(np.argmax(turns >= np.pi))
            raise ValueError(
                f"support {position} turns its nodes by {turns[i]:.4g} rad in the step from time {times[i]:g} to "
                f"{times[i + 1]:g}, and a step must turn them by less than half a turn (3.14 rad): use a dt below "
                f"{3.14 / np.max(turns / np.diff(times)):.3g}."
            )


class Controlled(NamedTuple):
    """A run under step control: when frames are wanted and where steps land, from the run's start."""

    control: StepControl
    outputs: np.ndarray
    stops: np.ndarray


class Chunk(NamedTuple):
    """Some steps of a run."""

    carry: Carry
    record: Record
    frame: Frame
    dt: Any
    """The size of the step that failed, or that comes next."""
    counts: dict[str, int]
    """Steps accepted and rejected until then, under step control."""


def _driven_run(setup: Setup, dt, t_end, output, bar, restart, asked: dict) -> Solution:
    begun, first_chunk = time.perf_counter(), 0.0
    model, carry, record, frame = setup.prepare()
    carry, record, frame, start = resumed(model, setup.plan, carry, record, frame, restart)
    if isinstance(dt, Controlled):
        duration, shown = dt.stops[-1], quote(dt.control)
        chunks = _controlled_chunks(setup.plan, model, carry, dt, start)
    else:
        steps, ends = _fixed_steps(dt, t_end, start)
        duration, shown = np.sum(steps), float(steps[0])
        chunks = _fixed_chunks(setup.plan, model, carry, steps, ends)
    end = start + (duration if t_end is None or isinstance(dt, Controlled) else t_end)
    bar.start, bar.duration = start, float(duration)
    log = Log(setup.scene, setup.plan, output, {**asked, "dt": shown, "t_end": float(end)})
    log.begun = begun
    with log:
        log.append(single(record), single(frame), carry)
        chunk = Chunk(carry, record, frame, 0.0, {})
        for chunk in chunks:
            log.append(chunk.record, chunk.frame, chunk.carry)
            first_chunk = first_chunk or time.perf_counter() - begun
            bar.advance(chunk.record)
        code = int(chunk.carry.result)
        message = failure_message(code, log.steps + 1, log.latest_time, chunk.dt)
        return log.finish(chunk.carry, code, message, **chunk.counts, first_chunk_time=first_chunk)


class _Pace:
    """How many steps the next chunk has, so that it takes about `_CHUNK_TIME`."""

    def __init__(self, most: int):
        self.most, self.steps, self.begun = most, min(2, most), time.perf_counter()

    def after(self, taken: int) -> None:
        """Learn from a chunk of `taken` steps. The first compiles, and says little."""
        now = time.perf_counter()
        fits = int(taken * _CHUNK_TIME / max(now - self.begun, 1e-9))
        self.steps, self.begun = max(1, min(self.most, 4 * self.steps, fits)), now


def _fixed_chunks(plan: Plan, model, carry, steps, ends):
    """Run given step sizes to the given times, chunk by chunk.

    A chunk has rows of steps with a frame after each; what is not to be taken yet has the size 0. So chunks of every
    length and the frames' distance, beyond a chunk's, compile nothing anew.
    """
    columns = min(plan.save_every, _CHUNK_STEPS)
    rows = max(1, min(_CHUNK_STEPS // columns, _CHUNK_BYTES // model.x0.nbytes // 5))
    pace, at = _Pace(rows * columns), 0
    while at < len(steps):
        sizes, times = np.zeros((rows, columns)), np.zeros((rows, columns))
        shown, first, budget = np.zeros(rows, bool), at, pace.steps
        for row in range(rows):
            count = min(columns, plan.save_every - at % plan.save_every, len(steps) - at, budget)
            sizes[row, :count], times[row, :count] = steps[at : at + count], ends[at : at + count]
            at, budget = at + count, budget - count
            shown[row] = count > 0 and (at % plan.save_every == 0 or at == len(steps))
        carry, *found = program.run(model, plan, carry, (sizes, times))
        record, frame = jax.tree.map(np.asarray, tuple(found))
        done = record.done
        failed = int(carry.result) != SUCCESSFUL
        # Of a run that fails, the state that it reached is the last frame.
        taken = done.reshape(rows, columns).any(axis=1)
        fresh = taken & shown
        if failed and taken.any():
            fresh[np.flatnonzero(taken)[-1]] = True
        pace.after(at - first)
        reached = first + int(done.sum())
        yield Chunk(carry, _select(record, done), _select(frame, fresh), steps[min(reached, len(steps) - 1)], {})
        if failed:
            return


def _controlled_chunks(plan: Plan, model, carry, steps: Controlled, start):
    """Run under step control, chunk by chunk, with a frame at every output time."""
    # Where the run lands is traced, its number of stops in blocks: other outputs compile nothing anew.
    control = dataclasses.replace(steps.control, output_interval=None)
    outputs, stops = (start + times for times in (steps.outputs, steps.stops))
    stops = np.pad(stops, (0, -len(stops) % _STOPS), mode="edge")
    attempts = program.Attempts(carry, control.start(start))
    most = max(1, min(_CHUNK_STEPS, _CHUNK_BYTES // model.x0.nbytes // 5))
    pace = _Pace(most)
    while float(attempts.control.time) < stops[-1] and int(attempts.carry.result) == SUCCESSFUL:
        allowed = np.arange(most) < pace.steps
        attempts, found = program.try_steps(model, plan, control, attempts, stops, allowed)
        record, frame = jax.tree.map(np.asarray, found)
        pace.after(int(allowed.sum()))
        shown = record.done & np.isin(record.time, outputs)
        counts = {name: int(getattr(attempts.control, name)) for name in ("accepted", "rejected")}
        yield Chunk(attempts.carry, _select(record, record.done), _select(frame, shown), attempts.control.dt, counts)


def _select(tree, which):
    return jax.tree.map(lambda a: a[which], tree)


def failure_message(code: int, step: int, at, dt) -> str:
    """What a run says that ended with a result code in the step with this number, from the time `at`."""
    if code == SUCCESSFUL:
        return ""
    return f"Step {step}, from t = {at:.6g} with dt = {float(dt):.3g}: {RESULTS[result_of(code)]}"


def _controlled(scene: Scene, method: Method, control: StepControl, t_end) -> Controlled:
    if not method.controls_step:
        raise ValueError(
            f"{type(method).__name__} takes equal steps, which its stability limits and not its error: StepControl has "
            "nothing to choose. Pass a number, e.g. dt=method.critical_step(scene)."
        )
    if t_end is None:
        raise ValueError("t_end, the duration of the run, is missing.")
    check_positive_number("t_end", t_end)
    interval = t_end / 100 if control.output_interval is None else control.output_interval
    if is_concrete(t_end) and is_concrete(control.initial):
        for name, step in (("output_interval", interval), ("StepControl initial", control.initial)):
            check_steps(step, max(step, t_end), name)
    outputs = np.append(np.arange(interval, t_end * (1 - 1e-9), interval), t_end)
    kinks = np.concatenate([np.zeros(0), *(np.asarray(h.times) for h in scene.histories if is_concrete(h.times))])
    stops = np.unique(np.concatenate([outputs, kinks[(kinks > 0) & (kinks < t_end)]]))
    # Times that differ by round-off only are one.
    return Controlled(floats_to_arrays(control), outputs, stops[np.append(np.diff(stops) > 1e-9 * t_end, True)])


def step_sizes(dt, t_end):
    """(N,) the steps of a run. Raises ValueError for a dt and a t_end that make none."""
    check_positive("dt", dt)
    if isinstance(dt, list | tuple):
        dt = jnp.asarray(dt, float) if is_traced(dt) else np.asarray(dt, float)
    if np.ndim(dt) > 1 or np.size(dt) == 0:
        raise ValueError(f"dt must be one step size or a list of them, but it has shape {np.shape(dt)}.")
    if np.ndim(dt) == 1:
        if t_end is not None:
            raise ValueError("With an array of step sizes t_end follows from it: leave t_end out.")
        return dt if not is_concrete(dt) else np.asarray(dt, float)
    if t_end is None:
        raise ValueError("t_end, the duration of the run, is missing.")
    if not (is_concrete(dt) and is_concrete(t_end)):
        raise ValueError("The number of steps must be known: pass an array of step sizes to trace dt or t_end.")
    check_steps(dt, t_end)
    return _fixed_steps(dt, t_end, 0.0)[0]


def _fixed_steps(dt, t_end, start: float) -> tuple[np.ndarray, np.ndarray]:
    """Sizes of the steps (N,) from the time `start` on, and the times at their ends.

    Equal steps end at the multiples of dt, whether or not the run was begun before them: so one that goes on takes the
    steps that it would have taken.
    """
    if np.ndim(dt) == 1:
        steps = np.asarray(dt, float)
        return steps, start + np.cumsum(steps)
    dt, end = float(dt), start + float(t_end)
    before = round(start / dt)
    origin = 0.0 if before * dt == start else start
    before = before if origin == 0.0 else 0
    count = max(before + 1, int(np.ceil((end - origin) / dt * (1 - 1e-10))))
    ends = origin + dt * np.arange(before + 1, count + 1)
    steps = np.full(len(ends), dt)
    last = end - (origin + (count - 1) * dt)
    if abs(last - dt) >= 1e-9 * dt:
        steps[-1], ends[-1] = last, end
    return steps, ends
