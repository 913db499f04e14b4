"""Dynamic relaxation: `settle` lets a shell under its final loads move, loses its energy, and ends where it rests.

Steps are those of `jaxshell.methods.settling`: backward Euler, with the shell's own inertia. Each is one compiled
program; the host doubles a step that Newton solves easily and quarters one that it does not, or that gains energy. The
shell is at rest when the static balance holds without inertia, nothing moves any more, and no kinetic energy is left.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.analyses import program
from jaxshell.analyses.branches import NUDGE
from jaxshell.analyses.driver import Log, Setup, SimulationError, check_options, is_traced, result_of, set_up, single
from jaxshell.analyses.program import Carry, Plan, Record
from jaxshell.analyses.progress import Progress
from jaxshell.analyses.stability import critical
from jaxshell.assembly.discretised import Model
from jaxshell.methods.settling import Settling, SettlingState
from jaxshell.methods.static import Static
from jaxshell.model.history import History
from jaxshell.model.mechanisms import check_supported
from jaxshell.model.scene import Scene
from jaxshell.numerics import rotations
from jaxshell.numerics.checks import check_count, check_positive_number, check_within, require_float64
from jaxshell.numerics.compiled import compiled
from jaxshell.results.solution import RESULTS, Solution
from jaxshell.solvers.iteration import SUCCESSFUL
from jaxshell.solvers.linear_solver import LinearSolver
from jaxshell.solvers.newton import Newton

NOT_AT_REST = 6
"""The code of `RESULTS.not_at_rest`."""
_STATIC = Static()
_PERIOD = 0.1
"""The first step, of √(m L⁴/D): a sixtieth of the period of a cantilever as long as the shell is large, about."""
_GROWTH, _CUT, _EASY = 2.0, 0.25, 12
"""Steps grow where Newton takes no more iterations than that, and are cut where it fails."""
_RISES = 1e-9
"""A step after which K + S - W is larger, by more than this part of the terms, is cut too: a large step of backward
Euler is one of Newton's method, which does not mind whether it climbs to an equilibrium that is unstable."""
_SMALLEST = 1e-8
"""Of the first step: below it a step that fails ends the run."""
_FLAT = 1e-6
"""Moments below this part of the largest force times the shell's size are measured against that."""
_RAMP = 10
"""In so many first steps supports move to where they are to be."""


class _Rest(NamedTuple):
    """How far a state is from rest."""

    unbalanced: Float[Array, ""]
    """The static residual over the largest force of an element or load; of forces or moments, whichever is larger."""
    moved: Float[Array, ""]
    """In the last step, over the shell's size and in radians."""
    kinetic: Float[Array, ""]
    """Kinetic energy over the larger of strain energy and work."""


def settle(
    scene: Scene,
    *,
    dt: float | None = None,
    tolerance: float = 1e-8,
    max_steps: int = 500,
    newton: Newton | None = None,
    linear_solver: LinearSolver | None = None,
    save_every: int = 1,
    throw: bool = True,
    progress: bool = False,
    output=None,
) -> Solution:
    """Let a shell come to rest: dynamic relaxation to a static equilibrium that is stable.

    For statics where load steps find no way: past limit points, for snaps to a far equilibrium, for slack membranes
    and flat cushions, which have no stiffness at the start. Loads act at the final values of their histories from the
    start; supports with a prescribed motion move to its final value in the time of ten first steps. The shell starts
    with the scene's initial motion and moves by its own inertia, in backward Euler steps, which lose energy and grow
    until nothing moves: of several equilibria it takes one that this motion leads to. One that is not stable is left
    again, by a push of 1e-3 of the shell's size along its critical motion, as `solve_static(branch="follow")` does. The
    scene's `damping` is not looked at: where a shell rests does not depend on it.

    Arguments:
        scene: what is to settle. Its supports must leave no rigid-body motion free.
        dt: first step [time]; None is a tenth of √(m L⁴/D) with the mass per area m, the plate rigidity D and the size
            L of the shell. A smaller one follows the first motion, a snap for instance, more closely.
        tolerance: at rest where the static residual is below this part of the largest force in the balance, the
            last step moved no node by more than this part of the shell's size, or radians, and the kinetic energy is
            below this part of the strain energy.
        max_steps: so many steps at most.
        newton: how the steps' equations are solved; None is Newton's full method to a tenth of `tolerance`.
        linear_solver, save_every, progress, output: as in `solve_static`.
        throw: raise `SimulationError` where the shell does not come to rest (it carries the solution so far);
            otherwise the solution's `result` (`RESULTS.not_at_rest`, or Newton's failure) and `message` say so.

    Returns a `Solution` in time, whose last frame is the rest state and whose histories begin at the last sample of the
    loads' histories; `stats["unbalanced"]` is what the static balance lacks there, `stats["pushes"]` how often an
    unstable equilibrium was left. `reactions` of it are those of the
    static balance at the end of each step. The energy that the steps lose is not recorded as dissipated.

    Raises ValueError for bad input, for a mechanism, and when it is traced by `jax.grad` and the like, before anything
    is compiled: take derivatives through `solve_static`, started from the rest state as the scene's `initial`.
    """
    require_float64()
    check_within("tolerance", tolerance, 1e-12, 1e-2)
    newton = Newton(tolerance=0.1 * tolerance, reuse=False) if newton is None else newton
    check_options(scene, Settling(), save_every, "closed_form", newton)
    if dt is not None:
        check_positive_number("dt", dt)
    check_count("max_steps", max_steps)
    if is_traced(scene, newton, dt):
        raise ValueError(
            "settle chooses its steps as it goes and cannot be traced: trace solve_static, from the rest state as the "
            "scene's initial displacements and rotations."
        )
    if any(support.acceleration is not None for support in scene.supports):
        raise ValueError("settle: a support with a prescribed acceleration ends in no place: give its displacement.")
    check_supported(scene, may_touch=True)
    setup = set_up(scene, Settling(), newton, linear_solver=linear_solver, save_every=save_every, reactions=True)
    with Progress(steps=max_steps, enabled=progress) as bar:
        solution = _driven(setup, dt, tolerance, max_steps, output, bar)
    if throw and solution.message:
        raise SimulationError(solution.message, solution)
    return solution


def _driven(setup: Setup, dt, tolerance: float, max_steps: int, output, bar) -> Solution:
    begin = _last_sample(setup.scene)
    if dt is None:
        dt = _PERIOD * float(_time_scale(setup.prepare()[0]))
    model, carry, _, _ = setup.prepare(_moved_at_once(setup.scene, begin, _RAMP * dt))
    state, memory = eqx.tree_at(lambda s: s.time, carry.state, jnp.asarray(begin)), carry.memory
    record, frame = program.first(model, setup.plan, state)
    log = Log(setup.scene, setup.plan, output, {"dt": float(dt), "tolerance": tolerance, "max_steps": max_steps})
    ramped, smallest = begin + _RAMP * dt, _SMALLEST * dt
    step, code, rest, pushes, energy = dt, NOT_AT_REST, None, 0, np.inf
    with log:
        log.append(single(record), single(frame))
        while log.steps < max_steps:
            found = _advance(model, setup.plan, state, memory, jnp.asarray(step))
            new, memory, code, record, frame, rest = found
            still = float(new.time) > ramped or not (model.moving or model.driven)
            left, scale = _energy(record)
            if int(code) != SUCCESSFUL or (still and left > energy + _RISES * scale):
                code, step = NOT_AT_REST if int(code) == SUCCESSFUL else int(code), _CUT * step
                if step < smallest:
                    break
                continue
            state, code, energy = new, NOT_AT_REST, left
            rests = still and all(float(part) <= tolerance for part in rest)
            pushed, is_stable = _pushed(model, setup.plan, state) if rests else (state, False)
            if rests and bool(is_stable):
                code = int(SUCCESSFUL)
            last = code == SUCCESSFUL or log.steps + 1 == max_steps
            keep = last or (log.steps + 1) % setup.plan.save_every == 0
            log.append(single(record), single(frame) if keep else _none(frame))
            bar.advance(log.records[-1])
            if code == SUCCESSFUL:
                break
            if rests:  # on the top of a hill
                state, step, pushes, energy = pushed, dt, pushes + 1, np.inf
            elif int(record.iterations) <= _EASY:
                step *= _GROWTH
        left = {} if rest is None else {name: float(value) for name, value in rest._asdict().items()}
        message = "" if code == SUCCESSFUL else _message(int(code), log, left, tolerance)
        return log.finish(Carry(state, None, jnp.asarray(code)), int(code), message, pushes=pushes, **left)


def _energy(record: Record) -> tuple[float, float]:
    """What is left to lose, K + S - W, and the size of its parts."""
    seen = record.observed
    kinetic, strain, work = float(seen.kinetic), float(seen.strain), float(seen.external_work)
    return kinetic + strain - work, kinetic + strain + abs(work)


def _message(code: int, log: Log, left: dict, tolerance: float) -> str:
    figures = ", ".join(f"{name} {value:.2g}" for name, value in left.items())
    return (
        f"After {log.steps} steps, at time {log.latest_time:.6g}, the shell is not at rest to {tolerance:g} "
        f"({figures}). {RESULTS[result_of(code)]}"
    )


def _none(frame):
    """No frame, of this one's kind."""
    return jax.tree.map(lambda a: a[:0], single(frame))


@compiled
def _advance(model: Model, plan: Plan, state: SettlingState, memory, step):
    """State, memory, result, record, frame and distance from rest of a step."""
    before = state
    state, info, memory = plan.method.step(model, before, step, plan.solvers, memory)
    begun = _STATIC.begin(model, state, jnp.zeros(()))
    balance = _STATIC.balance(model, state, begun, jnp.zeros_like(state.velocities))
    carried = balance.residual.reshape(-1)[model.tables.held]
    record = program.record(
        model, plan, before, state, carried, info.iterations, info.factorizations, info.result == SUCCESSFUL
    )
    free = jnp.zeros(balance.residual.size).at[model.tables.free].set(1.0).reshape(-1, 2, 3)
    parts = jnp.max(jnp.abs(free * balance.residual.reshape(-1, 2, 3)), axis=(0, 2))
    tiny = jnp.finfo(float).tiny
    # A shell that lies flat is not bent: its moments are round-off, and no scale.
    moment = jnp.maximum(balance.moment, _FLAT * balance.force * model.size)
    unbalanced = jnp.max(parts / (jnp.stack([balance.force, moment]) + tiny))
    sizes = jnp.stack([model.size, jnp.ones(())])
    moved = jnp.max(jnp.abs(step * state.velocities).reshape(-1, 2, 3), axis=(0, 2)) / sizes
    seen = record.observed
    scale = jnp.maximum(seen.strain, jnp.abs(seen.external_work)) + tiny
    rest = _Rest(unbalanced, jnp.max(moved), seen.kinetic / scale)
    return state, memory, info.result, record, program.frame(model, state), rest


@compiled
def _pushed(model: Model, plan: Plan, state: SettlingState):
    """The state moved a little along its critical motion, and whether the equilibrium that it was is stable."""
    weakest, _ = critical(model, plan.solvers, state, state, None)
    move = NUDGE * model.size * weakest.mode
    turned = jax.vmap(rotations.exp)(move[:, 3:]) @ state.R
    return eqx.tree_at(lambda s: (s.d, s.R), state, (state.d + move[:, :3], turned)), weakest.quotient > 0


@compiled
def _time_scale(model: Model) -> Float[Array, ""]:
    """√(m L⁴/D): the inverse of the lowest bending frequency of a shell of that size without curvature, about."""
    return 1.0 / jnp.sqrt(model.frequency_scale)


def _last_sample(scene: Scene) -> float:
    """The time from which on no history changes; 0 at least."""
    return max([0.0, *(float(history.times[-1]) for history in scene.histories)])


def _moved_at_once(scene: Scene, begin: float, ramp: float) -> Scene:
    """The scene with supports and obstacles that move to their final place between the times `begin` and `begin` +
    `ramp`."""
    moving = [i for i, support in enumerate(scene.supports) if support.moves]
    carried = [i for i, obstacle in enumerate(scene.obstacles) if obstacle.is_moving]

    def histories(scene: Scene) -> list:
        return [scene.supports[i].history for i in moving] + [scene.obstacles[i].history for i in carried]

    ends = [jnp.stack([history(0.0), history.values[-1]]) for history in histories(scene)]
    return eqx.tree_at(histories, scene, [History([begin, begin + ramp], values) for values in ends]) if ends else scene
