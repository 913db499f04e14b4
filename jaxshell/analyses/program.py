"""The compiled programs of a run: preparing it, scanning over fixed steps, trying steps under step control.

Each is a jitted function of the model, a `Plan` and a `Carry`; `jaxshell.analyses.simulation` drives them.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxshell.analyses.step_control import Control, StepControl
from jaxshell.assembly.discretised import Model
from jaxshell.assembly.gauges import Watching
from jaxshell.assembly.tables import Tables
from jaxshell.gradients import Gradients, merge, scan_steps
from jaxshell.methods.method import Method, Observation, Solvers
from jaxshell.methods.state import State
from jaxshell.methods.static import Static, held_reactions
from jaxshell.methods.turning import turning
from jaxshell.model.scene import WATCHABLE, Scene
from jaxshell.numerics.branches import when
from jaxshell.numerics.compiled import compiled, compiled_once
from jaxshell.solvers.iteration import STEP_TOO_SMALL, SUCCESSFUL, Memory


class Record(NamedTuple):
    """What is kept of every step."""

    time: Float[Array, ""]
    watched: Float[Array, " w"]
    observed: Observation
    iterations: Int[Array, ""]
    factorizations: Int[Array, ""]
    done: Any
    """Whether the step was taken and succeeded."""
    reaction: Float[Array, " nh"] | None = None
    """What the supports carried in the step, where it was asked for."""
    stable: Any = None
    """In statics, whether the equilibrium is stable."""


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


class Plan(NamedTuple):
    """How steps are taken and what is recorded of them: made once on the host, and handed whole to every program."""

    method: Method
    solvers: Solvers
    watch: tuple[tuple[str, int | str, str], ...]
    save_every: int
    reactions: bool = False


@compiled_once
def prepare(scene: Scene, tables: Tables, plan: Plan):
    """Model, start and its record."""
    model = Model.build(scene, tables, plan.method.bends_mass)
    state = plan.method.start(model, scene, 0.0, plan.solvers)
    solvers = plan.solvers
    memory = solvers.linear.memory(solvers.newton, turning(model, state.R)) if plan.method.uses_matrix else None
    zero = jnp.zeros((), jnp.int32)
    return model, Carry(state, memory, zero + SUCCESSFUL), *first(model, plan, state)


@compiled_once
def first(model: Model, plan: Plan, state):
    """Record and frame of the state at the start; no balance has been solved, and no reaction is known."""
    zero = jnp.zeros((), jnp.int32)
    reaction = jnp.full(model.tables.supported, jnp.nan) if plan.reactions else None
    return record(model, plan, state, state, reaction, zero, zero, jnp.array(True)), frame(model, state)


first_again = compiled(first.__wrapped__)
"""`first` as a run records its steps, to the last digit: for a run that goes on."""


def empty(shapes):
    """Zeros for a record or a frame of a step that was not taken."""
    return jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), shapes)


@compiled
def run(model: Model, plan: Plan, carry: Carry, steps):
    """Scan over frames of `save_every` steps each; `steps` (dt, time at its end), (frames, save_every) each.

    A step with dt = 0 is none: it fills up the last chunk. After a failure no further step is taken.
    """

    def one(carry: Carry, step):
        dt, end = step

        def take(found):
            carry, _ = found
            state, info, memory = plan.method.step(model, carry.state, dt, plan.solvers, carry.memory)
            reaction = carried(model, plan, carry.state, state, dt)
            state = eqx.tree_at(lambda s: s.time, state, end)
            good = info.result == SUCCESSFUL
            state = jax.tree.map(lambda new, old: jnp.where(good, new, old), state, carry.state)
            recorded = record(model, plan, carry.state, state, reaction, info.iterations, info.factorizations, good)
            return Carry(state, memory, info.result.astype(jnp.int32)), recorded

        skipped = carry, empty(jax.eval_shape(lambda: first(model, plan, carry.state))[0])
        return when((dt > 0) & (carry.result == SUCCESSFUL), take, skipped)

    def one_frame(carry, steps):
        carry, records = jax.lax.scan(one, carry, steps)
        return carry, (records, frame(model, carry.state))

    carry, (records, frames) = jax.lax.scan(one_frame, carry, steps)
    return carry, jax.tree.map(merge, records), frames


def carried(model: Model, plan: Plan, before, after, dt) -> Float[Array, " nh"] | None:
    """Reactions of the balance that the method solved in the step, where they are recorded.

    Accelerations and spins live in the states of a step, not in the frames of a solution: so they are taken here.
    """
    if not plan.reactions:
        return None
    held = model.tables.held[: model.tables.supported]
    return plan.method.unbalanced(model, before, after, dt).reshape(-1)[held]


def record(model: Model, plan: Plan, before, state, reaction, iterations, factorizations, done) -> Record:
    """What is kept of the step that led from `before` to `state`."""
    gauges, readings = iter(model.gauges), iter(model.readings)

    def value(number, component):
        if isinstance(number, str):
            ends = _place(model, before), _place(model, state)
            return next(readings).read(model.contributions, *ends, plan.method)
        if component in WATCHABLE:
            return watched(model, state, number, component)
        return read(model, state, next(gauges))

    values = [value(number, component) for _, number, component in plan.watch]
    values = jnp.stack(values) if values else jnp.zeros(0)
    observed = plan.method.observe(model, state)
    if reaction is None and model.tables.multipliers and isinstance(plan.method, Static):
        reaction = held_reactions(model, state)  # frames do not hold the multipliers
    return Record(state.time, values, observed, iterations, factorizations, done, reaction)


def _place(model: Model, state: State) -> tuple[Any, Any, Any]:
    """Positions, rotations and time of a state."""
    return model.x0 + state.displacements(model.x0), state.R, state.time


def watched(model: Model, state: State, node: int, component: str):
    """A component out of WATCHABLE at a node."""
    axis = WATCHABLE.index(component) % 3
    return (state.v if component[0] == "v" else state.displacements(model.x0))[node, axis]


def read(model: Model, state: State, gauge: Watching):
    """A stress or a section force at an element."""
    d = state.displacements(model.x0)
    return gauge.read(model.x0, model.tables.triangles, model.elements, d, state.R, state.time)


def frame(model: Model, state: State) -> Frame:
    """The shape and the motion of all nodes."""
    shape = state.displacements(model.x0), state.R, state.v
    if model.tables.multipliers:
        shape = tuple(nodal[: model.tables.nodes] for nodal in shape)
    return Frame(state.time, *shape)


@compiled
def run_whole(model: Model, plan: Plan, gradients: Gradients, carry, steps):
    """A whole run in one program, for transformations by JAX; `steps` (dt, time at its end), (N,) each.

    The state after a failed step is NaN. The steps that follow see that at once and cost one residual each.
    """

    def one(carry: Carry, step):
        dt, end = step
        memory = carry.memory
        if gradients.repeats_newton and memory is not None:
            # A step done again must come out as it did at first, whatever has been factored since.
            memory = eqx.tree_at(lambda m: m.stale, memory, jnp.array(True))
        state, info, memory = plan.method.step(model, carry.state, dt, plan.solvers, memory)
        reaction = carried(model, plan, carry.state, state, dt)
        state = eqx.tree_at(lambda s: s.time, state, end)
        result = jnp.where(carry.result == SUCCESSFUL, info.result.astype(jnp.int32), carry.result)
        good = result == SUCCESSFUL
        # As a factor, so that what is differentiated through a failure is NaN too.
        factor = jnp.where(good, 1.0, jnp.nan)
        state = jax.tree.map(lambda a: a * factor if jnp.issubdtype(a.dtype, jnp.inexact) else a, state)
        recorded = record(model, plan, carry.state, state, reaction, info.iterations, info.factorizations, good)
        return Carry(state, memory, result), recorded

    return scan_steps(gradients, one, lambda carry: frame(model, carry.state), carry, steps, plan.save_every)


@compiled
def with_memory(plan: Plan, carry: Carry, kept: Memory) -> Carry:
    """`carry` with what an earlier run's iteration kept; its factorization is made anew, and comes out the same."""
    linear = plan.solvers.linear
    factored = jax.lax.cond(
        kept.stale,
        lambda: linear.solver.initial_factorization(linear.handle),
        lambda: linear.solver.factor(linear.handle, kept.values),
    )
    return carry._replace(memory=eqx.tree_at(lambda m: m.factorization, kept, factored))


class Attempts(NamedTuple):
    """The carry of a run under step control."""

    carry: Carry
    control: Control


@compiled
def try_steps(
    model: Model,
    plan: Plan,
    control: StepControl,
    attempts: Attempts,
    stops: Float[Array, " s"],
    allowed: Bool[Array, " c"],
):
    """As many attempts at a step as are allowed; `stops` are the times to land on, the last ends the run.

    Returns the carry, a record and a frame per attempt; `done` marks the accepted steps.
    """

    def attempt(attempts: Attempts, allowed):
        carry, now = attempts
        stop = stops[jnp.searchsorted(stops, now.time, side="right")]
        dt, lands = control.next_step(now, stop)

        def take(found):
            (carry, now), _ = found
            state, info, memory = plan.method.step(model, carry.state, dt, plan.solvers, carry.memory)
            reaction = carried(model, plan, carry.state, state, dt)
            state = eqx.tree_at(lambda s: s.time, state, jnp.where(lands, stop, state.time))
            solved = info.result == SUCCESSFUL
            after, accepted = control.judge(now, dt, solved, state, model.size, stops[-1])
            state = jax.tree.map(lambda new, old: jnp.where(accepted, new, old), state, carry.state)
            small = ~accepted & (after.dt < control.smallest)
            failure = jnp.where(solved, STEP_TOO_SMALL, info.result).astype(jnp.int32)
            result = jnp.where(small, failure, SUCCESSFUL)
            recorded = record(model, plan, carry.state, state, reaction, info.iterations, info.factorizations, accepted)
            return Attempts(Carry(state, memory, result), after), (recorded, frame(model, state))

        skipped = attempts, empty(jax.eval_shape(lambda: first(model, plan, carry.state)))
        active = allowed & (carry.result == SUCCESSFUL) & (now.time < stops[-1])
        return when(active, take, skipped)

    return jax.lax.scan(attempt, attempts, allowed)
