"""Equilibrium paths through limit points: arc-length continuation, with the load factor as an unknown.

E. Riks, "An incremental approach to the solution of snapping and buckling problems", Int. J. Solids Struct.
15 (1979) 529-551, and M. A. Crisfield, "A fast incremental/iterative solution procedure that handles
snap-through", Comput. Struct. 13 (1981) 55-62: the step has a given length in the nodal displacements,

    r(u, λ) = f_int(u) - λ f_ext = 0,      Σ_a |Δx_a|²/n = ℓ²,

and Newton solves both at once. Its bordered system needs K once, with two right-hand sides:

    δu = δu_r + δλ δu_q,   K δu_r = -r,   K δu_q = -∂r/∂λ,   δλ from the linearised constraint.
"""

import time
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxshell import program
from jaxshell.assembly import analyse
from jaxshell.checks import check_positive, is_concrete, require_float64
from jaxshell.compiled import compiled
from jaxshell.linear_solver import LinearSolver, default_solver
from jaxshell.mechanisms import check_supported
from jaxshell.methods.static import Static, StaticState
from jaxshell.model import Model, structure_of
from jaxshell.newton import DIVERGED, SINGULAR, STAGNATED, SUCCESSFUL, Linear, Newton
from jaxshell.program import Choices
from jaxshell.progress import Progress
from jaxshell.scene import Scene
from jaxshell.simulation import (
    SimulationError,
    _check_options,
    _floats_to_arrays,
    _results,
)
from jaxshell.solution import RESULTS, Solution
from jaxshell.statics import DEFAULT_NEWTON, Log, proportional

_CUTS = 10
_WANTED_ITERATIONS = 6
"""Steps grow where the iteration takes fewer and shrink where it takes more."""
_GIVE_UP = 1e3
_FIRST_LOAD, _TINY = 0.05, 1e-6
"""Without a given arc length, the load factor whose displacements at the start are one; and a step, as a part of the
shell's size, that shows them."""
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

    Loads and prescribed displacements are in proportion to the load factor, as in `solve_static`. At a
    bifurcation the path goes on straight: a small imperfection or load leads it onto a branch.

    Arguments:
        arc_length: the longest step, as the root mean square of the nodes' displacements [length]; None is how
            far a twentieth of the loads moves the shell by its stiffness at the start. Steps are shortened where
            the iteration gets slow, and halved where it fails or the path bends by more than 37°.
        steps: the largest number of steps.
        max_load_factor: the path ends with the first step at or beyond this load factor, in size.
        tangent, newton, linear_solver, save_every, throw, progress, output: as in `solve_static`.

    Returns a `Solution` whose times are the load factors along the path, so they may fall. Raises
    ValueError for bad input, for a mechanism, and when it is traced by `jax.grad` and the like, before
    anything is compiled.
    """
    require_float64()
    newton = DEFAULT_NEWTON if newton is None else newton
    _check_options(scene, Static(), save_every, tangent, newton)
    if arc_length is not None:
        check_positive("arc_length", arc_length)
    check_positive("max_load_factor", max_load_factor)
    if not isinstance(steps, int | np.integer) or steps < 1:
        raise ValueError(f"steps must be a whole number of at least 1, but it is {steps!r}.")
    if not scene.loads and all(support.displacement is None for support in scene.supports):
        raise ValueError(_NO_PATH)
    if not all(is_concrete(leaf) for leaf in jax.tree.leaves((scene, newton, arc_length))):
        raise ValueError("solve_arc_length chooses its steps as it goes and cannot be traced: use solve_static.")
    check_supported(scene)
    linear_solver = default_solver() if linear_solver is None else linear_solver
    tables, pattern = analyse(structure_of(scene))
    handle = linear_solver.prepare(pattern)
    (newton,) = _floats_to_arrays((newton,))
    choices = Choices(tangent, linear_solver, save_every, scene.watch)
    with Progress(steps=steps, enabled=progress) as bar:
        solution = _driven(scene, newton, tables, handle, choices, arc_length, steps, max_load_factor, output, bar)
    if throw and solution.message:
        raise SimulationError(solution.message, solution)
    return solution


class _Carry(NamedTuple):
    free: Float[Array, " nf"]
    last: Float[Array, " nf"]
    increment: Float[Array, ""]
    """Of the load factor, since the step's start."""
    done: Any
    result: Int[Array, ""]
    iterations: Int[Array, ""]
    correction: Float[Array, ""]


@compiled
def _advance(model: Model, newton: Newton, handle, choices: Choices, state: StaticState, previous, length):
    """One step of arc length `length`, going on in the direction `previous` (n, 3) of the last step."""
    linear, method = Linear(choices.linear_solver, handle), Static()
    rotates = model.tables.free % 6 >= 3
    scale = jnp.where(rotates, 1.0, 1.0 / model.size)
    n = state.d.shape[0]
    # Held freedoms that are moved go with the load factor.
    held_rate = model.held_displacement(state.time + 1.0) - model.held_displacement(state.time)

    def balance(free, increment):
        begun = method.begin(model, state, increment)
        return method.balance(model, state, begun, model.expand(free, increment * held_rate))

    def two_solutions(free, last, increment, residual):
        """δu_r and δu_q, each as free freedoms."""
        begun = method.begin(model, state, increment)
        held = increment * held_rate
        u, before = model.expand(free, held), model.expand(last, jnp.where(jnp.any(last != 0), held, 0.0))
        matrix = model.assemble_matrix(method.mixed_matrices(model, state, begun, u, before, choices.tangent))
        _, rate = jax.jvp(lambda t: model.free(balance(free, t).residual), (increment,), (jnp.ones(()),))
        by_load, factorization = linear.solver.factor_and_solve(linear.handle, matrix, -rate)
        by_residual = linear.solver.solve(linear.handle, factorization, matrix, -residual)
        return by_residual, by_load

    def moves(free, held):
        return model.expand(free, held)[:, :3]

    def body(c: _Carry):
        found = balance(c.free, c.increment)
        residual = model.free(found.residual)
        by_residual, by_load = two_solutions(c.free, c.last, c.increment, residual)
        so_far = moves(c.free, c.increment * held_rate)
        along = jnp.sum(so_far * moves(by_load, held_rate))
        gap = 0.5 * (n * length**2 - jnp.sum(so_far * so_far))
        change = (gap - jnp.sum(so_far * moves(by_residual, 0.0 * held_rate))) / along
        step = by_residual + change * by_load
        turn = jnp.max(jnp.where(rotates, jnp.abs(step), 0.0), initial=0.0)
        damping = jnp.minimum(1.0, newton.max_rotation / jnp.where(turn > 0, turn, 1.0))
        damping = jnp.where(turn > 0, damping, 1.0)
        size = jnp.max(jnp.abs(scale * step))
        q = jnp.where(jnp.isfinite(c.correction), size / c.correction, 1.0)
        enough = (size <= newton.tolerance) | ((q < 0.5) & (size * q * q <= newton.tolerance))
        bad = ~jnp.isfinite(size) | (size > _GIVE_UP)
        return _Carry(
            jnp.where(bad, c.free, c.free + damping * step),
            c.free,
            jnp.where(bad, c.increment, c.increment + damping * change),
            bad | (enough & (damping == 1.0)),
            jnp.where(bad, jnp.where(jnp.isfinite(size), DIVERGED, SINGULAR), SUCCESSFUL),
            c.iterations + 1,
            jnp.where(damping == 1.0, size, jnp.inf),
        )

    # Predictor along the tangent of the path, with the sense of the last step (loads grow at the start).
    zeros, zero = jnp.zeros(model.tables.free.shape), jnp.zeros(())
    _, tangent = two_solutions(zeros, zeros, zero, zeros)
    direction = moves(tangent, held_rate)
    increment = length * jnp.sqrt(n / jnp.sum(direction * direction))
    increment = jnp.where(jnp.sum(direction * previous) < 0, -increment, increment)
    one = jnp.ones((), jnp.int32)
    start = _Carry(increment * tangent, zeros, increment, jnp.array(False), 0 * one, one, jnp.array(jnp.inf))
    end = jax.lax.while_loop(lambda c: ~c.done & (c.iterations < newton.max_iterations), body, start)
    result = jnp.where(end.done, end.result, STAGNATED)
    begun = method.begin(model, state, end.increment)
    u = model.expand(end.free, end.increment * held_rate)
    state = method.finish(model, state, end.increment, u, method.motion(state, u), begun)
    record = program.record(model, method, state, choices, end.iterations, end.iterations, jnp.array(True))
    return state, u[:, :3], result, record, program.frame(model, state)


def _driven(scene, newton, tables, handle, choices, arc_length, steps, max_load_factor, output, bar) -> Solution:
    begun = time.perf_counter()
    model, carry, record, frame = program.prepare(proportional(scene), Static(), newton, tables, handle, choices)
    state, previous = carry.state, jnp.zeros_like(carry.state.d)
    if arc_length is None:
        tiny = _TINY * model.size
        after, *_ = _advance(model, newton, handle, choices, state, previous, tiny)
        arc_length = float(_FIRST_LOAD * tiny / (after.time - state.time))
        if not 0 < arc_length < np.inf:
            raise ValueError(_NO_PATH)
    length = float(arc_length)
    code, message = int(SUCCESSFUL), ""
    log = Log(scene, choices.save_every, record, frame, output, Static(), newton, choices)
    with log:
        for position in range(steps):
            spent = np.zeros(2, int)
            while True:
                new, moved, code, record, frame = _advance(
                    model, newton, handle, choices, state, previous, jnp.asarray(length)
                )
                code = int(code)
                spent += int(record.iterations)
                shortest = length / 2 < arc_length / 2**_CUTS
                if shortest or (code == SUCCESSFUL and (position == 0 or _cosine(moved, previous) > _STRAIGHT)):
                    break
                length /= 2
            if code != SUCCESSFUL:
                message = _message(code, position, float(state.time), length)
                break
            state, previous = new, moved
            over = abs(float(state.time)) >= max_load_factor
            log.append(record, frame, spent, last=over or position == steps - 1)
            bar.advance(log.latest)
            if over:
                break
            length *= float(np.clip(np.sqrt(_WANTED_ITERATIONS / int(record.iterations)), 0.5, 2.0))
            length = min(length, float(arc_length))
        stats = log.finish(code, message, time.perf_counter() - begun)
    return log.solution(state, code, message, stats)


def _cosine(step, previous) -> float:
    """Of the angle between two steps of the path."""
    return float(jnp.sum(step * previous) / (jnp.linalg.norm(step) * jnp.linalg.norm(previous)))


def _message(code: int, position: int, at: float, length: float) -> str:
    return (
        f"The path was followed for {position} steps to load factor {at:.6g}; the next failed with the arc "
        f"length down to {length:.3g}. The last attempt: {RESULTS[_results()[code]]}"
    )
