"""Full Newton: every iteration assembles and factors its own tangent, and converges quadratically."""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxshell.solvers.iteration import (
    DIVERGED,
    ROUND_OFF,
    STAGNATED,
    SUCCESSFUL,
    Correction,
    Linear,
    Measure,
    Memory,
    Problem,
    Solved,
    Start,
    after_residual,
    energy_closes,
)

_RESIDUAL_SAFETY = 0.1
"""The correction scales with the residual only roughly: ask for ten times less."""


class _Carry(NamedTuple):
    free: Float[Array, " nf"]
    last: Float[Array, " nf"]
    """The iterate before."""
    done: Bool[Array, ""]
    result: Int[Array, ""]
    iterations: Int[Array, ""]
    correction: Float[Array, ""]
    error: Float[Array, ""]
    """The residual that the last correction started from, relative."""
    huge: Bool[Array, ""]
    factorization: Any
    """Of the last correction's matrix."""
    start: Start


def predicted_to_converge(found: Correction, tolerance) -> Bool[Array, ""]:
    """This correction, or the one that would follow by quadratic contraction, is below the tolerance."""
    next_length = found.length * found.ratio * found.ratio
    return (found.length <= tolerance) | ((found.ratio < 0.5) & (next_length <= tolerance))


def iterate(newton, problem: Problem, start: Start, measure: Measure, linear: Linear, memory: Memory):
    """Iterate from `start` with the settings `newton`: (Solved, `memory` with the last factorization)."""
    by_norm = newton.criterion == "norm"

    def advance(c: _Carry, r, error, work) -> _Carry:
        step, factorization, _ = linear.factor_and_solve(problem.matrix(c.free, c.last), -r)
        found = measure.correction(step, c.correction)
        if by_norm:
            enough = jnp.linalg.norm(step) <= newton.tolerance
        else:
            left = jnp.where(jnp.isfinite(c.correction), found.ratio**2, found.unseen)
            enough = predicted_to_converge(found, newton.tolerance)
            enough &= found.balances(r, work, c.free, left, newton.tolerance)
        bad = found.hopeless(again=c.huge)
        return _Carry(
            free=jnp.where(bad, c.free, c.free + found.damping * step),
            last=c.free,
            done=bad | (enough & found.whole),
            result=jnp.where(bad, found.failure(), SUCCESSFUL),
            iterations=c.iterations + 1,
            correction=jnp.where(bad, jnp.inf, found.measured),
            error=error,
            huge=found.huge,
            factorization=factorization,
            start=c.start,
        )

    def body(c: _Carry) -> _Carry:
        r, error, work = measure.residual(problem, c.free)
        settled = error < ROUND_OFF
        if not by_norm:
            near = c.correction * error < _RESIDUAL_SAFETY * newton.tolerance * c.error
            settled |= near & energy_closes(r @ c.free, work, newton.tolerance)
        broken = ~jnp.isfinite(error)
        stop = c._replace(done=jnp.array(True), result=jnp.where(broken, DIVERGED, c.result))
        return after_residual(c, r, error, measure, settled | broken, stop, lambda c: advance(c, r, error, work))

    zero = jnp.zeros((), jnp.int32)
    first = _Carry(
        free=start.free,
        last=jnp.zeros_like(start.free),
        done=jnp.array(False),
        result=zero,
        iterations=zero,
        correction=jnp.array(jnp.inf),
        error=jnp.array(0.0),
        huge=jnp.array(False),
        factorization=memory.factorization,
        start=start,
    )
    end = lax.while_loop(lambda c: ~c.done & (c.iterations < newton.max_iterations), body, first)
    result = jnp.where(end.done, end.result, STAGNATED)
    memory = eqx.tree_at(lambda m: m.factorization, memory, end.factorization)
    return Solved(end.free, result, end.iterations, end.iterations, end.correction), memory
