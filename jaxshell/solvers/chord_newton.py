"""Chord Newton: a factorization serves over iterations and steps while the contraction that it gives is good.

A factorization costs as much as several corrections with one at hand. It turns with the nodes: what changes the
tangent of a thin shell most is that its elements turn, and a tangent turned with them, R K Rᵀ with the nodes' rotations
since it was factored, is that of the turned shell, exactly where it turned as a rigid body. A new one is made when a
step is expected to cost more than steps have on average since the last, that one's cost included: with a tangent that
drifts away, this makes the average least. What does not turn (`Problem.turning`) serves under stricter rules. Where
kept factorizations fail, the step is done anew with one in every iteration.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxshell.numerics.branches import when
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
    where,
)


class _Rules(NamedTuple):
    """How long kept factorizations serve, and when their iteration ends."""

    contracts: float
    """One is not used again where corrections shrink by less than this factor ..."""
    useless: float
    """... and no step starts with one by which those of the last step shrank by less than this."""
    patience: int
    """Corrections of a step after which every further one factors."""
    margin: float
    """With kept factorizations corrections shrink linearly, and what remains is about as large as what was predicted:
    this part of the tolerance makes results as near to the converged ones as full iterations' at that tolerance."""
    by_cost: bool
    """A step may cost what steps have cost on average since the factorization. Else it is used again where no more than
    `_AFFORDABLE` corrections are expected to follow, and only two corrections of its own say how it contracts."""


_TURNING = _Rules(0.6, 0.6, 14, 1e-3, by_cost=True)
"""The smaller margin keeps what a method conserves as well as shorter service of factorizations does at 1e-2."""
_STILL = _Rules(0.25, 0.5, 8, 1e-2, by_cost=False)
_COSTS, _LARGE, _COSTS_LARGE = 8.0, 1000, 12.0
"""A factorization, its tangent included, in corrections, and from how many unknowns on it is more: 3 to 5 with 500, 8.5
to 11 with 3000, 13 with 16 000, 15 with 60 000. With few it hardly matters, and shorter service conserves better."""
_FEWEST = 4.0
"""No step is expected to do with fewer corrections."""
_AFFORDABLE = 6
_FORGETS = 0.8
"""What is remembered of a useless factorization fades by this factor a step, so that one is tried again later."""
_NEAR = 0.06
"""A step that started far off is near its end where its own factorization contracts like this."""
_FEW = 4
"""Full iterations of a step after which the next one tries kept factorizations again."""
_DIGITS, _AT_LEAST = 1e-14, 1e-2
"""Below this fraction of the shell corrections are noise: near it a hundredth of the tolerance does."""
_NOISE = 1e-10
"""Corrections below this that shrink no more, their factorization being their own, are round-off."""


class _Carry(NamedTuple):
    free: Float[Array, " nf"]
    last: Float[Array, " nf"]
    """The iterate before."""
    done: Bool[Array, ""]
    result: Int[Array, ""]
    iterations: Int[Array, ""]
    factorizations: Int[Array, ""]
    since: Int[Array, ""]
    """Corrections since the last of them."""
    correction: Float[Array, ""]
    memory: Memory
    hard: Bool[Array, ""]
    """A factorization of this step contracted slowly."""
    own: Bool[Array, ""]
    """The last correction's matrix was its own iterate's."""
    full: Bool[Array, ""]
    """Kept factorizations have failed in this step: begun anew with one in every iteration."""
    huge: Bool[Array, ""]
    """The last correction was huge, with its own factorization."""
    start: Start


class _Outlook(NamedTuple):
    """What a correction says of those to come."""

    target: Float[Array, ""]
    """What the next must be below."""
    predicted: Float[Array, ""]
    """The next one."""
    left: Float[Array, ""]
    """The fraction of the unbalanced energy that this correction is expected to leave."""
    contraction: Float[Array, ""]
    """To be remembered."""
    stale: Bool[Array, ""]
    """The next one is to factor."""
    hard: Bool[Array, ""]


def iterate(newton, problem: Problem, start: Start, measure: Measure, linear: Linear, memory: Memory):
    """Iterate from `start` with the settings `newton`: (Solved, Memory for the next step)."""
    rules = _STILL if problem.turning is None else _TURNING
    full = memory.hard == 2
    memory = eqx.tree_at(lambda m: m.stale, memory, memory.stale | full)
    first = _first(start, memory, full)

    def advance(c: _Carry, r, work) -> _Carry:
        fresh = c.memory.stale
        found, memory = _correction(problem, measure, linear, c, r)
        outlook = _outlook(newton, rules, c, found, fresh)
        if newton.criterion == "norm":
            enough = jnp.linalg.norm(found.step) <= newton.tolerance
        else:
            enough = (found.length <= outlook.target) | ((found.ratio < 0.5) & (outlook.predicted <= outlook.target))
            enough &= found.balances(r, work, c.free, outlook.left, newton.tolerance)
            enough |= fresh & (found.ratio > 0.5) & (c.correction < _NOISE)
        # A correction that an old factorization spoiled is not taken; the next factors anew.
        bad = found.hopeless(again=~fresh | c.huge)
        final = bad & fresh
        done = final | (enough & found.whole & ~bad)
        result = jnp.where(final, found.failure(), SUCCESSFUL)
        after = _Carry(
            free=jnp.where(bad, c.free, c.free + found.damping * found.step),
            last=c.free,
            done=done,
            result=result,
            iterations=c.iterations + 1,
            factorizations=c.factorizations + fresh,
            since=jnp.where(fresh, 0, c.since + 1),
            correction=jnp.where(bad, jnp.inf, found.measured),
            memory=eqx.tree_at(lambda m: (m.stale, m.contraction), memory, (outlook.stale | bad, outlook.contraction)),
            hard=outlook.hard,
            own=fresh,
            full=c.full,
            huge=found.huge & fresh,
            start=c.start,
        )
        failed = jnp.where(done, result != SUCCESSFUL, after.iterations >= newton.max_iterations)
        return where(failed & ~c.full, _begun_anew(first, after), after)

    def body(c: _Carry) -> _Carry:
        r, error, work = measure.residual(problem, c.free)
        # Kept factorizations leave errors in soft directions (rigid motions, for one), which residuals hardly show:
        # there corrections alone decide.
        settled = (error < ROUND_OFF) & c.full
        broken = ~jnp.isfinite(error)
        stop = c._replace(done=jnp.array(True), result=jnp.where(broken, DIVERGED, c.result))
        stop = where(broken & ~c.full, _begun_anew(first, c), stop)
        return after_residual(c, r, error, measure, settled | broken, stop, lambda c: advance(c, r, work))

    limit = 2 * newton.max_iterations
    end = lax.while_loop(lambda c: ~c.done & (c.iterations < limit), body, first)
    result = jnp.where(end.done, end.result, STAGNATED)
    solved = Solved(end.free, result, end.iterations, end.factorizations, end.correction)
    return solved, _remembered(rules, end, result)


def _correction(problem: Problem, measure: Measure, linear: Linear, c: _Carry, r) -> tuple[Correction, Memory]:
    """The correction for the residual r, and the memory with what was factored for it."""

    def anew(found):
        _, memory = found
        step, factorization, values = linear.factor_and_solve(problem.matrix(c.free, c.last), -r)
        return step, linear.keeping(memory, factorization, values, problem.turning)

    step, memory = when(c.memory.stale, anew, (jnp.zeros_like(r), c.memory))
    step = lax.cond(c.memory.stale, lambda: step, lambda: _turned_along(problem, linear, memory, -r))
    return measure.correction(step, c.correction), memory


def _turned_along(problem: Problem, linear: Linear, kept: Memory, rhs) -> Float[Array, " nf"]:
    """The kept factorization's solution, as if it had turned with the nodes: R K⁻¹ Rᵀ rhs.

    A shell that nothing holds is then moved as a whole, so that the forces on all of it are in balance: K turned node
    by node no longer has sums of rows that are its mass over Δt², so the linear momentum would converge no faster than
    all else (2e-10 of it lost in 500 steps of a free plate, so 3e-15).
    """
    if problem.turning is None:
        return linear.solve(kept.factorization, kept.values, rhs)
    turned, translations = problem.turning.turned, problem.turning.translations
    R = problem.turning.frames @ jnp.swapaxes(kept.frames, 1, 2)
    step = turned(R, linear.solve(kept.factorization, kept.values, turned(jnp.swapaxes(R, 1, 2), rhs)))
    if not translations.size:
        return step
    return step + (kept.whole @ (translations @ rhs - kept.sums @ step)) @ translations


def _first(start: Start, memory: Memory, full) -> _Carry:
    zero = jnp.zeros((), jnp.int32)
    return _Carry(
        free=start.free,
        last=jnp.zeros_like(start.free),
        done=jnp.array(False),
        result=zero,
        iterations=zero,
        factorizations=zero,
        since=zero,
        correction=jnp.array(jnp.inf),
        memory=memory,
        hard=jnp.array(False),
        own=jnp.array(False),
        full=full,
        huge=jnp.array(False),
        start=start,
    )


def _begun_anew(first: _Carry, c: _Carry) -> _Carry:
    """What kept factorizations spoilt is done again without them, from the same start."""
    yes = jnp.array(True)
    memory = eqx.tree_at(lambda m: m.stale, c.memory, yes)
    again = first._replace(iterations=c.iterations, factorizations=c.factorizations, since=c.since)
    return again._replace(memory=memory, hard=yes, full=yes, free=c.start.free, start=c.start)


def _outlook(newton, rules: _Rules, c: _Carry, found: Correction, fresh) -> _Outlook:
    """After the correction `found`, whose matrix was its iterate's if `fresh`."""
    length, q = found.length, found.ratio
    first = ~jnp.isfinite(c.correction)
    tolerance = newton.tolerance
    beyond = jnp.maximum(rules.margin * tolerance, jnp.minimum(_DIGITS, _AT_LEAST * tolerance))
    target = jnp.where(c.full, tolerance, beyond)
    # Only corrections of one kept factorization say how it contracts: after its own iterate's, which took most
    # of the error, what it leaves is in soft directions and may be far larger than their ratio tells.
    linear = jnp.where(c.own, 1.0, q / jnp.maximum(1.0 - q, 0.1))
    # After a kept factorization's correction a fresh one's q is still the kept one's, hence no square.
    quadratic = jnp.where(c.full | (c.factorizations == c.iterations), q * q, q)
    predicted = length * jnp.where(first, 1.0, jnp.where(fresh, quadratic, linear))
    # Energy goes with the stiff directions, which the first correction all but settles: what the second leaves of it
    # shows in the third.
    left = jnp.where(fresh, found.unseen, jnp.where(c.own | (c.iterations < 2), 1.0, linear))
    # How much the first correction left shows in the second, also in one with a fresh factorization.
    earlier = (c.factorizations == 0) & (c.iterations == 1) & (rules.by_cost | ~fresh)
    contraction = jnp.where(earlier, q, c.memory.contraction)
    contraction = jnp.where(first & fresh, _FORGETS * contraction, contraction)
    # Of further corrections with this factorization.
    expected = jnp.where(first, c.memory.contraction, q)
    to_go = jnp.log(length * expected / target) / -jnp.log(jnp.clip(expected, 1e-10, 0.99))
    slow = expected > rules.contracts
    # Steps on which even their own factorizations serve once only start a long way off: full iterations, in the
    # next step too.
    hard = c.hard | (slow & (c.factorizations > 0))
    full = (c.memory.hard > 0) | hard
    average = jnp.maximum(c.memory.spent / jnp.maximum(c.memory.steps, 1), _FEWEST)
    costly = slow | (c.iterations + to_go > average if rules.by_cost else to_go > _AFFORDABLE)
    stale = jnp.where(fresh, full & (expected > _NEAR), costly) | (c.iterations >= rules.patience)
    return _Outlook(target, predicted, left, contraction, stale | c.full, hard)


def _remembered(rules: _Rules, end: _Carry, result) -> Memory:
    """What the step leaves to the next."""
    kept, own = end.memory, end.factorizations > 0
    costs = _COSTS if end.free.size < _LARGE else _COSTS_LARGE
    spent = jnp.where(own, costs + 1 + end.since, kept.spent + end.iterations)
    kept = eqx.tree_at(lambda m: (m.spent, m.steps), kept, (spent, jnp.where(own, 1, kept.steps + 1)))
    useless = (kept.contraction > rules.useless) | (result != SUCCESSFUL)
    many = end.full & (end.iterations > _FEW)
    hard = jnp.where(many, 2, end.full | end.hard).astype(jnp.int32)
    return eqx.tree_at(lambda m: (m.stale, m.hard), kept, (kept.stale | useless, hard))
