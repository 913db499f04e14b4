"""Dynamic runs: `simulate` compiles one program of many steps and drives it chunk by chunk.

Inside the program a `lax.scan` runs over frames and steps, with Newton's `lax.while_loop` inside; the host sees
a chunk's histories only, shows progress and hands them to the file. When `simulate` is itself being traced
(by `jax.grad`, `jax.vmap`, `jax.jit`) the whole run is one program.
"""

import contextlib
import time
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxshell.assembly import Tables, analyse, nodal_tables
from jaxshell.checks import check_finite, check_positive, is_concrete, require_float64
from jaxshell.gradients import Gradients, Stored, scan_steps
from jaxshell.linear_solver import Handle, LinearSolver, default_solver
from jaxshell.methods.base import Method, Observation, Solvers
from jaxshell.model import Model, structure_of
from jaxshell.newton import SUCCESSFUL, Linear, Memory, Newton
from jaxshell.progress import Progress
from jaxshell.scene import WATCHABLE, Scene
from jaxshell.solution import RESULTS, Energy, Momentum, Solution, Stats

_CHUNK_STEPS = 50
"""Steps between two looks of the host: often enough for a progress bar, seldom enough to cost nothing."""


class SimulationError(RuntimeError):
    """A run that ended early. `solution` holds every step that was finished."""

    def __init__(self, message: str, solution: Solution):
        super().__init__(message)
        self.solution = solution


class Record(NamedTuple):
    """What is kept of every step."""

    time: Float[Array, ""]
    watched: Float[Array, " w"]
    observed: Observation
    iterations: Int[Array, ""]
    factorizations: Int[Array, ""]
    done: Any
    """Whether the step was taken and succeeded."""


class Frame(NamedTuple):
    time: Float[Array, ""]
    displacements: Float[Array, "n 3"]
    rotations: Float[Array, "n 3 3"]
    velocities: Float[Array, "n 3"]


class Carry(NamedTuple):
    state: Any
    memory: Memory | None
    """None for explicit methods."""
    result: Int[Array, ""]


def simulate(
    scene: Scene,
    method: Method,
    *,
    dt,
    t_end=None,
    save_every: int = 1,
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
        dt: step size [time], or an array of step sizes (then t_end may be left out). A run whose length is no
            multiple of dt ends with a shorter step.
        t_end: duration of the run [time], counted from the start (or from the end of `restart`).
        save_every: steps between frames (displacements, rotations, velocities of all nodes); histories are
            kept at every step.
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
        restart: a solution of the same scene and method to go on from.

    Returns a `Solution`. Raises ValueError for bad input and RuntimeError when float64 is off, both before
    anything is compiled.
    """
    require_float64()
    newton = Newton() if newton is None else newton
    _check_options(scene, method, save_every, tangent, newton)
    steps = _step_sizes(dt, t_end)
    linear_solver = default_solver() if linear_solver is None else linear_solver
    method.check(scene, steps)
    if method.uses_matrix:
        tables, pattern = analyse(structure_of(scene))
        handle = linear_solver.prepare(pattern)
    else:
        empty = jnp.zeros(0, jnp.int32)
        tables, handle = nodal_tables(structure_of(scene)), Handle(empty, empty, empty, ())
    method, newton = _floats_to_arrays((method, newton))
    choices = Choices(tangent, linear_solver, save_every, scene.watch)

    if not all(is_concrete(leaf) for leaf in jax.tree.leaves((scene, method, newton, steps))):
        if output is not None or progress:
            raise ValueError("output= and progress= need a run that is not traced by jax.grad, jax.vmap or jax.jit.")
        gradients = Stored() if gradients is None else gradients
        return _traced_run(scene, method, newton, tables, handle, choices, steps, restart, gradients, throw)
    with Progress(len(steps), enabled=progress) as bar:
        solution = _driven_run(scene, method, newton, tables, handle, choices, steps, output, bar, restart)
    if throw and solution.message:
        raise SimulationError(solution.message, solution)
    return solution


class Choices(NamedTuple):
    """The static choices of a compiled run."""

    tangent: str
    linear_solver: LinearSolver
    save_every: int
    watch: tuple


# --- the compiled programs --------------------------------------------------------------------------------


@eqx.filter_jit
def _prepare(scene: Scene, method: Method, newton: Newton, tables: Tables, handle: Handle, choices: Choices):
    """Model, start and its record."""
    model = Model.build(scene, tables)
    state = method.start(model, scene, 0.0)
    memory = Linear(choices.linear_solver, handle).memory(newton) if method.uses_matrix else None
    zero = jnp.zeros((), jnp.int32)
    return model, Carry(state, memory, zero + SUCCESSFUL), *_first(model, method, state, choices)


@eqx.filter_jit
def _first(model: Model, method: Method, state, choices: Choices):
    """Record and frame of the state at the start."""
    zero = jnp.zeros((), jnp.int32)
    return _record(model, method, state, choices, zero, zero, jnp.array(True)), _frame(model, state)


@eqx.filter_jit
def _run(model: Model, method: Method, newton: Newton, handle: Handle, choices: Choices, carry: Carry, steps):
    """Scan over frames of `save_every` steps each; `steps` (dt, time at its end), (frames, save_every) each.

    A step with dt = 0 is none: it fills up the last chunk. After a failure no further step is taken.
    """
    solvers = Solvers(newton, Linear(choices.linear_solver, handle), choices.tangent)

    def one(carry: Carry, step):
        dt, end = step

        def take():
            state, info, memory = method.step(model, carry.state, dt, solvers, carry.memory)
            state = eqx.tree_at(lambda s: s.time, state, end)
            good = info.result == SUCCESSFUL
            state = jax.tree.map(lambda new, old: jnp.where(good, new, old), state, carry.state)
            record = _record(model, method, state, choices, info.iterations, info.factorizations, good)
            return Carry(state, memory, info.result.astype(jnp.int32)), record

        def skip():
            return carry, jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), jax.eval_shape(take)[1])

        return jax.lax.cond((dt > 0) & (carry.result == SUCCESSFUL), take, skip)

    def frame(carry, steps):
        carry, records = jax.lax.scan(one, carry, steps)
        return carry, (records, _frame(model, carry.state))

    carry, (records, frames) = jax.lax.scan(frame, carry, steps)
    return carry, jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), records), frames


def _record(model, method, state, choices: Choices, iterations, factorizations, done) -> Record:
    watched = [_watched(model, state, node, component) for _, node, component in choices.watch]
    observed = method.observe(model, state)
    values = jnp.stack(watched) if watched else jnp.zeros(0)
    return Record(state.time, values, observed, iterations, factorizations, done)


def _watched(model, state, node: int, component: str):
    axis = WATCHABLE.index(component) % 3
    return state.v[node, axis] if component[0] == "v" else state.x[node, axis] - model.x0[node, axis]


def _frame(model: Model, state) -> Frame:
    return Frame(state.time, state.x - model.x0, state.R, state.v)


# --- driving them -----------------------------------------------------------------------------------------


def _driven_run(scene, method, newton, tables, handle, choices, steps, output, bar, restart) -> Solution:
    begun = time.perf_counter()
    model, carry, record, frame = _prepare(scene, method, newton, tables, handle, choices)
    carry, record, frame, start = _resume(model, method, choices, carry, record, frame, restart)
    save_every = choices.save_every
    frames = max(1, min(_CHUNK_STEPS // save_every, -(-len(steps) // save_every)))
    ends = start + np.cumsum(steps)
    records, shots = [_expand(record)], [_expand(frame)]
    settings = {
        "method": repr_of(method), "newton": repr_of(newton), "tangent": choices.tangent, "save_every": save_every,
        "dt": float(steps[0]), "t_end": float(ends[-1]),
    }
    first_chunk = 0.0
    with _writer(output, scene, settings) as writer:
        _append(writer, scene, records[0], shots[0])
        for at in range(0, len(steps), frames * save_every):
            chunk = slice(at, at + frames * save_every)
            fill = frames * save_every - len(steps[chunk])
            pairs = [np.pad(a[chunk], (0, fill)).reshape(frames, save_every) for a in (steps, ends)]
            carry, record, frame = _run(model, method, newton, handle, choices, carry, tuple(pairs))
            record, frame = jax.tree.map(np.asarray, (record, frame))
            done = record.done
            # Frames none of whose steps was taken repeat the last state.
            fresh = done.reshape(frames, save_every).any(axis=1)
            records.append(jax.tree.map(lambda a, done=done: a[done], record))
            shots.append(jax.tree.map(lambda a, fresh=fresh: a[fresh], frame))
            _append(writer, scene, records[-1], shots[-1])
            first_chunk = first_chunk or time.perf_counter() - begun
            bar.advance(records[-1])
            if int(carry.result) != SUCCESSFUL:
                break
        record, frame = (jax.tree.map(lambda *a: np.concatenate(a), *parts) for parts in (records, shots))
        code = int(carry.result)
        taken = record.time.size - 1
        message = _message(code, taken, record.time[-1], steps[min(taken, len(steps) - 1)])
        stats = Stats(
            method=repr_of(method),
            newton=repr_of(newton),
            linear_solver=type(choices.linear_solver).__name__,
            tangent=choices.tangent,
            steps=taken,
            iterations=int(record.iterations.sum()),
            factorizations=int(record.factorizations.sum()),
            wall_time=time.perf_counter() - begun,
            first_chunk_time=first_chunk,
        )
        if writer is not None:
            writer.finish(_RESULT_NAMES[code], message, stats)
    return _solution(scene, record, frame, carry.state, _results()[code], message, stats, jnp.asarray)


def _writer(output, scene: Scene, settings: dict):
    if output is None:
        return contextlib.nullcontext()
    from jaxshell.storage import ResultWriter

    return ResultWriter(output, scene, settings)


def _traced_run(
    scene, method, newton, tables, handle, choices, steps, restart, gradients: Gradients, throw: bool
) -> Solution:
    model, carry, record, frame = _prepare(scene, method, newton, tables, handle, choices)
    carry, record, frame, start = _resume(model, method, choices, carry, record, frame, restart)
    pairs = jnp.asarray(steps), start + jnp.cumsum(jnp.asarray(steps))
    carry, records, shots = _run_whole(model, method, newton, handle, choices, gradients, carry, pairs)
    record, frame = (
        jax.tree.map(lambda first, rest: jnp.concatenate([first[None], rest]), *parts)
        for parts in ((record, records), (frame, shots))
    )
    result = _results()[0]
    for code, item in enumerate(_results()):
        result = RESULTS.where(carry.result == code, item, result)
    solution = _solution(scene, record, frame, carry.state, result, "", Stats(), lambda a: a)
    return _raise_on_failure(solution) if throw else solution


@eqx.filter_jit
def _run_whole(
    model: Model, method: Method, newton: Newton, handle: Handle, choices: Choices, gradients: Gradients, carry, steps
):
    """A whole run in one program, for transformations by JAX; `steps` (dt, time at its end), (N,) each.

    The state after a failed step is NaN. The steps that follow see that at once and cost one residual each.
    """
    solvers = Solvers(newton, Linear(choices.linear_solver, handle), choices.tangent)

    def one(carry: Carry, step):
        dt, end = step
        state, info, memory = method.step(model, carry.state, dt, solvers, carry.memory)
        state = eqx.tree_at(lambda s: s.time, state, end)
        result = jnp.where(carry.result == SUCCESSFUL, info.result.astype(jnp.int32), carry.result)
        good = result == SUCCESSFUL
        # As a factor, so that what is differentiated through a failure is NaN too.
        factor = jnp.where(good, 1.0, jnp.nan)
        state = jax.tree.map(lambda a: a * factor if jnp.issubdtype(a.dtype, jnp.inexact) else a, state)
        record = _record(model, method, state, choices, info.iterations, info.factorizations, good)
        return Carry(state, memory, result), record

    return scan_steps(
        gradients, one, lambda carry: _frame(model, carry.state), carry, steps, choices.save_every
    )


def _raise_on_failure(solution: Solution) -> Solution:
    """Tie an error to every float of a traced solution, so that it comes with values and with gradients alone."""
    failed = solution.result != RESULTS.successful
    sound = solution.result.error_if(jnp.array(1.0), failed)
    floats, rest = eqx.partition(solution, eqx.is_inexact_array)
    scene = floats.scene
    floats = jax.tree.map(lambda a: a * sound, floats)
    return eqx.combine(eqx.tree_at(lambda s: s.scene, floats, scene), rest)


def _resume(model, method, choices, carry: Carry, record, frame, restart: Solution | None):
    if restart is None:
        return carry, record, frame, 0.0
    if jax.tree.structure(restart.state) != jax.tree.structure(carry.state):
        raise ValueError("restart must be a solution of the same scene and method, with its final state.")
    carry = carry._replace(state=restart.state)
    return carry, *_first(model, method, carry.state, choices), float(restart.times[-1])


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
    )


def _append(writer, scene: Scene, record: Record, frame: Frame) -> None:
    """Hand a chunk to the result file, if there is one."""
    if writer is None:
        return
    solution = _solution(scene, record, frame, None, RESULTS.successful, "", Stats(), np.asarray)
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
    )


_RESULT_NAMES = ("successful", "diverged", "stagnated", "singular", "step_too_small", "unstable")


def _results() -> list[RESULTS]:
    """In the order of the codes in `jaxshell.newton`."""
    return [getattr(RESULTS, name) for name in _RESULT_NAMES]


def _message(code: int, taken: int, at, dt) -> str:
    if code == SUCCESSFUL:
        return ""
    return f"Step {taken + 1}, from t = {at:.6g} with dt = {dt:.3g}: {RESULTS[_results()[code]]}"


def repr_of(module) -> str:
    """Name and arguments of a method or of Newton, floats as numbers: what a file and the stats quote."""
    values = (f"{name}={value!r}" if isinstance(value, float) else f"{name}={value}" for name, value in
              ((name, float(v) if isinstance(v, jax.Array) else v) for name, v in vars(module).items()))
    return f"{type(module).__name__}({', '.join(values)})"


def _expand(tree):
    return jax.tree.map(lambda a: np.asarray(a)[None], tree)


def _floats_to_arrays(tree):
    """Python floats as arrays, so that another value compiles nothing anew."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf) if isinstance(leaf, float) else leaf, tree)


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
