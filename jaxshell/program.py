"""The compiled programs of a run: preparing it, scanning over fixed steps, trying steps under step control.

Each is a jitted function of the model, the method and a `Carry`; `jaxshell.simulation` drives them from the host.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxshell.assembly import Tables
from jaxshell.compiled import compiled
from jaxshell.gradients import Gradients, merge, scan_steps
from jaxshell.linear_solver import Handle, LinearSolver
from jaxshell.methods.base import Method, Observation, Solvers
from jaxshell.methods.static import StaticState
from jaxshell.model import Model
from jaxshell.newton import STEP_TOO_SMALL, SUCCESSFUL, Linear, Memory, Newton
from jaxshell.scene import WATCHABLE, Scene
from jaxshell.step_control import Control, StepControl


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


class Choices(NamedTuple):
    """The static choices of a compiled run."""

    tangent: str
    linear_solver: LinearSolver
    save_every: int
    watch: tuple


@compiled
def prepare(scene: Scene, method: Method, newton: Newton, tables: Tables, handle: Handle, choices: Choices):
    """Model, start and its record."""
    model = Model.build(scene, tables)
    state = method.start(model, scene, 0.0)
    memory = Linear(choices.linear_solver, handle).memory(newton) if method.uses_matrix else None
    zero = jnp.zeros((), jnp.int32)
    return model, Carry(state, memory, zero + SUCCESSFUL), *first(model, method, state, choices)


@compiled
def first(model: Model, method: Method, state, choices: Choices):
    """Record and frame of the state at the start."""
    zero = jnp.zeros((), jnp.int32)
    return record(model, method, state, choices, zero, zero, jnp.array(True)), frame(model, state)


def empty(shapes):
    """Zeros for a record or a frame of a step that was not taken."""
    return jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), shapes)


@compiled
def run(model: Model, method: Method, newton: Newton, handle: Handle, choices: Choices, carry: Carry, steps):
    """Scan over frames of `save_every` steps each; `steps` (dt, time at its end), (frames, save_every) each.

    A step with dt = 0 is none: it fills up the last chunk. After a failure no further step is taken.
    """
    solvers = Solvers(newton, Linear(choices.linear_solver, handle), choices.tangent, differentiated=False)

    def one(carry: Carry, step):
        dt, end = step

        def take():
            state, info, memory = method.step(model, carry.state, dt, solvers, carry.memory)
            state = eqx.tree_at(lambda s: s.time, state, end)
            good = info.result == SUCCESSFUL
            state = jax.tree.map(lambda new, old: jnp.where(good, new, old), state, carry.state)
            recorded = record(model, method, state, choices, info.iterations, info.factorizations, good)
            return Carry(state, memory, info.result.astype(jnp.int32)), recorded

        def skip():
            return carry, empty(jax.eval_shape(lambda: first(model, method, carry.state, choices))[0])

        return jax.lax.cond((dt > 0) & (carry.result == SUCCESSFUL), take, skip)

    def one_frame(carry, steps):
        carry, records = jax.lax.scan(one, carry, steps)
        return carry, (records, frame(model, carry.state))

    carry, (records, frames) = jax.lax.scan(one_frame, carry, steps)
    return carry, jax.tree.map(merge, records), frames


def record(model, method, state, choices: Choices, iterations, factorizations, done) -> Record:
    values = [watched(model, state, node, component) for _, node, component in choices.watch]
    values = jnp.stack(values) if values else jnp.zeros(0)
    return Record(state.time, values, method.observe(model, state), iterations, factorizations, done)


def watched(model, state, node: int, component: str):
    axis = WATCHABLE.index(component) % 3
    return (state.v if component[0] == "v" else displacements(model, state))[node, axis]


def frame(model: Model, state) -> Frame:
    return Frame(state.time, displacements(model, state), state.R, state.v)


def displacements(model, state) -> Float[Array, "n 3"]:
    """A state of statics keeps them, the others keep positions."""
    return state.d if isinstance(state, StaticState) else state.x - model.x0


@compiled
def run_whole(
    model: Model, method: Method, newton: Newton, handle: Handle, choices: Choices, gradients: Gradients, carry, steps
):
    """A whole run in one program, for transformations by JAX; `steps` (dt, time at its end), (N,) each.

    The state after a failed step is NaN. The steps that follow see that at once and cost one residual each.
    """
    solvers = Solvers(newton, Linear(choices.linear_solver, handle), choices.tangent)

    def one(carry: Carry, step):
        dt, end = step
        memory = carry.memory
        if gradients.repeats_newton and memory is not None:
            # A step done again must come out as it did at first, whatever has been factored since.
            memory = eqx.tree_at(lambda m: m.stale, memory, jnp.array(True))
        state, info, memory = method.step(model, carry.state, dt, solvers, memory)
        state = eqx.tree_at(lambda s: s.time, state, end)
        result = jnp.where(carry.result == SUCCESSFUL, info.result.astype(jnp.int32), carry.result)
        good = result == SUCCESSFUL
        # As a factor, so that what is differentiated through a failure is NaN too.
        factor = jnp.where(good, 1.0, jnp.nan)
        state = jax.tree.map(lambda a: a * factor if jnp.issubdtype(a.dtype, jnp.inexact) else a, state)
        recorded = record(model, method, state, choices, info.iterations, info.factorizations, good)
        return Carry(state, memory, result), recorded

    return scan_steps(gradients, one, lambda carry: frame(model, carry.state), carry, steps, choices.save_every)


class Attempts(NamedTuple):
    """The carry of a run under step control."""

    carry: Carry
    control: Control


@compiled
def try_steps(
    model: Model,
    method: Method,
    newton: Newton,
    handle: Handle,
    choices: Choices,
    control: StepControl,
    attempts: Attempts,
    stops: Float[Array, " s"],
    chunk: Int[Array, " c"],
):
    """As many attempts at a step as `chunk` is long; `stops` are the times to land on, the last ends the run.

    Returns the carry, a record and a frame per attempt; `done` marks the accepted steps.
    """
    solvers = Solvers(newton, Linear(choices.linear_solver, handle), choices.tangent, differentiated=False)

    def attempt(attempts: Attempts, _):
        carry, now = attempts
        stop = stops[jnp.searchsorted(stops, now.time, side="right")]
        dt, lands = control.next_step(now, stop)

        def take():
            state, info, memory = method.step(model, carry.state, dt, solvers, carry.memory)
            state = eqx.tree_at(lambda s: s.time, state, jnp.where(lands, stop, state.time))
            solved = info.result == SUCCESSFUL
            after, accepted = control.judge(now, dt, solved, state, model.size, stops[-1])
            state = jax.tree.map(lambda new, old: jnp.where(accepted, new, old), state, carry.state)
            small = ~accepted & (after.dt < control.smallest)
            failure = jnp.where(solved, STEP_TOO_SMALL, info.result).astype(jnp.int32)
            result = jnp.where(small, failure, SUCCESSFUL)
            recorded = record(model, method, state, choices, info.iterations, info.factorizations, accepted)
            return Attempts(Carry(state, memory, result), after), (recorded, frame(model, state))

        def skip():
            return attempts, empty(jax.eval_shape(lambda: first(model, method, carry.state, choices)))

        active = (carry.result == SUCCESSFUL) & (now.time < stops[-1])
        return jax.lax.cond(active, take, skip)

    return jax.lax.scan(attempt, attempts, chunk)
