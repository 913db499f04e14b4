"""Equilibrium paths through limit points: arc-length continuation, with the load factor as an unknown.

E. Riks, "An incremental approach to the solution of snapping and buckling problems", Int. J. Solids Struct.
15 (1979) 529-551, and M. A. Crisfield, "A fast incremental/iterative solution procedure that handles
snap-through", Comput. Struct. 13 (1981) 55-62: the step has a given length in the nodal displacements,

    r(u, λ) = f_int(u) - λ f_ext = 0,      Σ_a |Δx_a|²/n = ℓ²,

and Newton solves both at once. Its bordered system needs K once, with two right-hand sides:

    δu = δu_r + δλ δu_q,   K δu_r = -r,   K δu_q = -∂r/∂λ,   δλ from the linearised constraint.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxshell.analyses import program
from jaxshell.analyses.driver import Setup, SimulationError, check_options, is_traced, result_of, set_up
from jaxshell.analyses.program import Plan
from jaxshell.analyses.progress import Progress
from jaxshell.analyses.stability import critical
from jaxshell.analyses.statics import DEFAULT_NEWTON, StaticLog, proportional
from jaxshell.assembly.discretised import Model
from jaxshell.methods.static import Static, StaticState
from jaxshell.model.mechanisms import check_supported
from jaxshell.model.scene import Scene
from jaxshell.numerics.checks import check_positive, require_float64
from jaxshell.numerics.compiled import compiled
from jaxshell.results.solution import RESULTS, Solution
from jaxshell.solvers.full_newton import predicted_to_converge
from jaxshell.solvers.iteration import STAGNATED, SUCCESSFUL, Measure
from jaxshell.solvers.linear_solver import LinearSolver
from jaxshell.solvers.newton import Newton

_STATIC = Static()
_CUTS = 10
_WANTED_ITERATIONS = 6
"""Steps grow where the iteration takes fewer and shrink where it takes more."""
_FIRST_LOAD, _TINY = 0.05, 1e-6
"""Without a given arc length, the load factor whose displacements at the start are one; and a step, as a fraction of
the shell's size, that shows them."""
_NO_PATH = "Nothing loads or moves the shell: there is no path to follow. Look at the scene's loads and supports."
_STRAIGHT = 0.8
"""Cosine of the angle between two steps below which the second is halved: where the path turns back sharply, a long
step may land on the part that it came from, and go back along it."""


def solve_arc_length(
    scene: Scene,
    arc_length: float | None = None,
    *,
    steps: int = 200,
    max_load_factor: float = 1.0,
    tangent: str = "closed_form",
    newton: Newton | None = None,
    linear_solver: LinearSolver | None = None,
    save_every: int = 1,
    throw: bool = True,
    progress: bool = False,
    output=None,
) -> Solution:
    """Follow the static equilibrium path of a scene through limit points, snap-through and snap-back.

    Loads, prescribed displacements and rotations are in proportion to the load factor, as in `solve_static`. At a
    bifurcation the path goes on straight: a small imperfection or load leads it onto a branch.

    Arguments:
        arc_length: the longest step, as the root mean square of the nodes' displacements [length]; None is how
            far a twentieth of the loads moves the shell by its stiffness at the start. Steps are shortened where
            the iteration gets slow, and halved where it fails or the path bends by more than 37°.
        steps: the largest number of steps.
        max_load_factor: the path ends with the first step at or beyond this load factor, in size.
        tangent, newton, linear_solver, save_every, throw, progress, output: as in `solve_static`.

    Returns a `Solution` whose times are the load factors along the path, so they may fall; `stable` says which of
    its equilibria are stable under a given load, and the stats where stability was lost (`stability_lost`). Raises
    ValueError for bad input, for a mechanism, and when it is traced by `jax.grad` and the like, before
    anything is compiled.
    """
    require_float64()
    newton = DEFAULT_NEWTON if newton is None else newton
    check_options(scene, _STATIC, save_every, tangent, newton)
    if arc_length is not None:
        check_positive("arc_length", arc_length)
    check_positive("max_load_factor", max_load_factor)
    if not isinstance(steps, int | np.integer) or steps < 1:
        raise ValueError(f"steps must be a whole number of at least 1, but it is {steps!r}.")
    moved = any(getattr(item, "history", None) is not None for item in scene.items)
    if not scene.loads and not moved and not any(support.moves_with_load for support in scene.supports):
        raise ValueError(_NO_PATH)
    if is_traced(scene, newton, arc_length):
        raise ValueError("solve_arc_length chooses its steps as it goes and cannot be traced: use solve_static.")
    check_supported(scene)
    setup = set_up(scene, _STATIC, newton, linear_solver=linear_solver, tangent=tangent, save_every=save_every)
    with Progress(steps=steps, enabled=progress) as bar:
        solution = _driven(setup, arc_length, steps, max_load_factor, output, bar, linear_solver)
    if throw and solution.message:
        raise SimulationError(solution.message, solution)
    return solution


class _Step(NamedTuple):
    """One step of the path: its equations in the free increments and the increment of the load factor."""

    model: Model
    plan: Plan
    state: StaticState
    held_rate: Float[Array, " nh"]
    """Held degrees of freedom that are moved go with the load factor; of turning ones, at the start of the step."""

    def held(self, increment) -> Float[Array, " nh"]:
        """Increments of the held degrees of freedom: in proportion, but for nodes that turn about a point."""
        if not self.model.turns:
            return increment * self.held_rate
        return self.model.held_increment(self.state.time, increment)

    def rate(self, increment) -> Float[Array, " nh"]:
        """Their derivative by the load factor."""
        return self.held_rate if not self.model.turns else _derivative(self.held, increment)

    def increments(self, free, increment) -> Float[Array, "n 6"]:
        return _STATIC.increments(self.model, self.state, free, self.held(increment))

    def moves(self, free, held) -> Float[Array, "n 3"]:
        return self.model.without_multipliers(self.model.spread(free, held, self.state.R))[:, :3]

    def balance(self, free, increment):
        begun = _STATIC.begin(self.model, self.state, increment)
        return _STATIC.balance(self.model, self.state, begun, self.increments(free, increment))

    def two_solutions(self, free, last, increment, residual):
        """δu_r and δu_q at the iterate `free`, reached from `last`; each as free degrees of freedom."""
        model = self.model
        linear = self.plan.solvers.linear.posed(model)
        begun = _STATIC.begin(model, self.state, increment)
        held = self.held(increment)
        u = _STATIC.increments(model, self.state, free, held)
        before = _STATIC.increments(model, self.state, last, jnp.where(jnp.any(last != 0), held, 0.0))
        matrix = _STATIC.tangent(model, self.state, begun, u, before, self.plan.solvers.tangent)
        rate = _derivative(lambda t: model.free(self.balance(free, t).residual), increment)
        by_load, factorization, factored = linear.factor_and_solve(matrix, -rate)
        by_residual = linear.solve(factorization, factored, -residual)
        return by_residual, by_load


def _derivative(function, at):
    """Of a function of a number."""
    _, rate = jax.jvp(function, (at,), (jnp.ones(()),))
    return rate


class _Carry(NamedTuple):
    free: Float[Array, " nf"]
    last: Float[Array, " nf"]
    increment: Float[Array, ""]
    """Of the load factor, since the step's start."""
    done: Any
    result: Int[Array, ""]
    iterations: Int[Array, ""]
    correction: Float[Array, ""]
    huge: Any


def _corrected(step: _Step, measure: Measure, length, c: _Carry) -> _Carry:
    """One correction of the bordered system."""
    n, newton = step.model.tables.nodes, step.plan.solvers.newton
    residual = step.model.free(step.balance(c.free, c.increment).residual)
    by_residual, by_load = step.two_solutions(c.free, c.last, c.increment, residual)
    so_far = step.moves(c.free, step.held(c.increment))
    along = jnp.sum(so_far * step.moves(by_load, step.rate(c.increment)))
    gap = 0.5 * (n * length**2 - jnp.sum(so_far * so_far))
    change = (gap - jnp.sum(so_far * step.moves(by_residual, 0.0 * step.held_rate))) / along
    found = measure.correction(by_residual + change * by_load, c.correction)
    bad = found.hopeless(again=c.huge)
    return _Carry(
        free=jnp.where(bad, c.free, c.free + found.damping * found.step),
        last=c.free,
        increment=jnp.where(bad, c.increment, c.increment + found.damping * change),
        done=bad | (predicted_to_converge(found, newton.tolerance) & found.whole),
        result=jnp.where(bad, found.failure(), SUCCESSFUL),
        iterations=c.iterations + 1,
        correction=found.measured,
        huge=found.huge,
    )


@compiled
def _advance(model: Model, plan: Plan, state: StaticState, previous, length):
    """One step of arc length `length`, going on in the direction `previous` (n, 3) of the last step."""
    newton, n = plan.solvers.newton, model.tables.nodes
    measure = Measure(model.size, model.tables.free % 6 >= 3, newton.max_rotation)
    held_rate = model.held_increment(state.time, 1.0)
    if model.turns:
        held_rate = _derivative(lambda t: model.held_increment(state.time, t), jnp.zeros(()))
    step = _Step(model, plan, state, held_rate)
    # Predictor along the tangent of the path, with the sense of the last step (loads grow at the start).
    zeros, zero = jnp.zeros(model.tables.free.shape), jnp.zeros(())
    _, tangent = step.two_solutions(zeros, zeros, zero, zeros)
    direction = step.moves(tangent, step.held_rate)
    increment = length * jnp.sqrt(n / jnp.sum(direction * direction))
    increment = jnp.where(jnp.sum(direction * previous) < 0, -increment, increment)
    one = jnp.ones((), jnp.int32)
    start = _Carry(
        free=increment * tangent,
        last=zeros,
        increment=increment,
        done=jnp.array(False),
        result=0 * one,
        iterations=one,
        correction=jnp.array(jnp.inf),
        huge=jnp.array(False),
    )
    end = jax.lax.while_loop(
        lambda c: ~c.done & (c.iterations < newton.max_iterations),
        lambda c: _corrected(step, measure, length, c),
        start,
    )
    result = jnp.where(end.done, end.result, STAGNATED)
    begun, u = _STATIC.begin(model, state, end.increment), step.increments(end.free, end.increment)
    before = state
    state = _STATIC.finish(model, state, end.increment, u, _STATIC.motion(state, u), begun)
    record = program.record(model, plan, before, state, None, end.iterations, end.iterations, jnp.array(True))
    weakest, _ = critical(model, plan.solvers, before, state, None)
    return state, model.without_multipliers(u)[:, :3], result, record, program.frame(model, state), weakest


def _driven(setup: Setup, arc_length, steps, max_load_factor, output, bar, linear_solver) -> Solution:
    asked: dict[str, Any] = {"arc_length": None if arc_length is None else float(arc_length), "max_steps": int(steps)}
    asked["max_load_factor"] = float(max_load_factor)
    log = StaticLog(setup, output, linear_solver, analysis="arc-length", **asked)
    model, carry, record, frame = setup.prepare(proportional(setup.scene))
    state, previous = carry.state, jnp.zeros_like(carry.state.d)
    longest = _first_length(model, setup.plan, state, previous) if arc_length is None else float(arc_length)
    length, code, message = longest, int(SUCCESSFUL), ""
    with log:
        log.start(record, frame)
        for position in range(steps):
            found, spent, length = _shortened(model, setup.plan, state, previous, length, longest, position == 0)
            new, moved, code, record, frame, weakest = found
            code = int(code)
            if code != SUCCESSFUL:
                message = _message(code, position, float(state.time), length)
                break
            state, previous = new, moved
            log.path.sees(float(state.time), weakest)
            over = abs(float(state.time)) >= max_load_factor
            log.step(record, frame, spent, last=over or position == steps - 1)
            bar.advance(log.records[-1])
            if over:
                break
            length *= float(np.clip(np.sqrt(_WANTED_ITERATIONS / int(record.iterations)), 0.5, 2.0))
            length = min(length, longest)
        return log.finish(state, code, message)


def _first_length(model: Model, plan: Plan, state: StaticState, previous) -> float:
    """The arc length that `_FIRST_LOAD` of the loads makes by the stiffness at the start."""
    tiny = _TINY * model.size
    after, *_ = _advance(model, plan, state, previous, tiny)
    length = float(_FIRST_LOAD * tiny / (after.time - state.time))
    if not 0 < length < np.inf:
        raise ValueError(_NO_PATH)
    return length


def _shortened(model: Model, plan: Plan, state: StaticState, previous, length, longest, first: bool):
    """A step of at most `length`, halved while it fails or turns back: (what `_advance` gives, cost, its length)."""
    spent = np.zeros(2, int)
    while True:
        found = _advance(model, plan, state, previous, jnp.asarray(length))
        _, moved, code, record, *_ = found
        spent += int(record.iterations)
        if length / 2 < longest / 2**_CUTS:
            return found, spent, length
        if int(code) == SUCCESSFUL and (first or _cosine(moved, previous) > _STRAIGHT):
            return found, spent, length
        length /= 2


def _cosine(step, previous) -> float:
    """Of the angle between two steps of the path."""
    return float(jnp.sum(step * previous) / (jnp.linalg.norm(step) * jnp.linalg.norm(previous)))


def _message(code: int, position: int, at: float, length: float) -> str:
    return (
        f"The path was followed for {position} steps to load factor {at:.6g}; the next failed with the arc "
        f"length down to {length:.3g}. The last attempt: {RESULTS[result_of(code)]}"
    )
