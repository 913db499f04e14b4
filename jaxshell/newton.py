"""Newton's iteration for one step: a `lax.while_loop` that stops as soon as it has said enough.

Corrections are measured in the shell's own scale: displacements over the diagonal of its bounding box, and
rotations in radians; the largest entry counts. The iteration ends when the correction that WOULD follow is
predicted below the tolerance, from the contraction seen so far or from the residual, so that no solve is
spent only to see that it was small. A failed iteration is a result with its numbers, never a NaN.

A factorization costs as much as five to twenty corrections with one at hand. So each serves over iterations and
steps (chord Newton) while the contraction that it gives promises convergence in a few of them.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxshell.checks import check_positive
from jaxshell.linear_solver import Handle, LinearSolver, linear_solve

SUCCESSFUL, DIVERGED, STAGNATED, SINGULAR, STEP_TOO_SMALL, UNSTABLE = (np.int32(k) for k in range(6))
"""Result codes inside compiled programs, in the order of `jaxshell.RESULTS`."""

_ROUND_OFF = 1e-14
"""A residual below this part of the forces in balance is noise."""
_RESIDUAL_SAFETY = 0.1
"""The correction scales with the residual only roughly: ask for ten times less."""
_GIVE_UP = 1e3
"""Diverged: a correction this many times the shell's size (or radians), even scaled down, or twice in a row: once it
may come from an iterate whose matrix happens to be all but singular."""
_CONTRACTS = 0.25
"""A kept factorization is used again while corrections shrink at least by this factor ..."""
_AFFORDABLE = 6
"""... and no more than so many are expected to follow: about what a factorization costs on small meshes."""
_USELESS, _FORGETS = 0.5, 0.8
"""A step starts with its own factorization if the last step's left more than this of the error; to be tried again
later, what is remembered of it fades by this factor a step."""
_FEW = 4
"""Full iterations of a step after which the next one tries kept factorizations again."""
_PATIENCE = 8
"""Corrections of a step after which every further one factors."""
_MARGIN = 1e-2
"""With kept factorizations corrections shrink linearly, and what remains is about as large as what was predicted:
a hundredth of the tolerance makes results as near to the converged ones as full iterations' at that tolerance."""
_NOISE = 1e-10
"""Corrections below this that shrink no more, their factorization being their own, are round-off."""
_FIRST_GUESS = 0.1
"""Contraction of a factorization that has not been used yet."""


class Problem(NamedTuple):
    """The equations of a step as functions of the free increments (nf,)."""

    balance: Callable
    """→ `jaxshell.methods.base.Balance`."""
    matrix: Callable
    """(free, the iterate before it: zeros, the step's start, at first) → values of the sparse tangent."""
    free: Callable
    """(n, 6) → its free entries."""


class Linear(NamedTuple):
    """A linear solver and its prepared pattern."""

    solver: LinearSolver
    handle: Handle

    def memory(self, newton: "Newton") -> "Memory":
        """Memory before the first step."""
        kept = self.handle.indices.shape if newton.reuse else (0,)
        first = self.solver.initial_factorization(self.handle)
        zero = jnp.zeros((), jnp.int32)
        return Memory(first, jnp.zeros(kept), jnp.array(True), jnp.array(_FIRST_GUESS), zero)


class Memory(eqx.Module):
    """What one step's Newton leaves to the next: a factorization, and whether it still contracts well."""

    factorization: Any
    values: Float[Array, " m"]
    """The matrix that was factored, where factorizations are reused."""
    stale: Bool[Array, ""]
    """The factorization must not be used again."""
    contraction: Float[Array, ""]
    """By which corrections shrank that a factorization of an earlier step gave."""
    hard: Int[Array, ""]
    """Of the last step. 1: its own factorizations contracted slowly; 2: it took many full iterations."""


class Solved(NamedTuple):
    free: Float[Array, " nf"]
    result: Int[Array, ""]
    iterations: Int[Array, ""]
    factorizations: Int[Array, ""]
    correction: Float[Array, ""]


class _Carry(NamedTuple):
    free: Float[Array, " nf"]
    last: Float[Array, " nf"]
    done: Bool[Array, ""]
    result: Int[Array, ""]
    iterations: Int[Array, ""]
    factorizations: Int[Array, ""]
    correction: Float[Array, ""]
    error: Float[Array, ""]
    memory: Memory
    hard: Bool[Array, ""]
    """A factorization of this step contracted slowly."""
    own: Bool[Array, ""]
    """The last correction's matrix was its own iterate's."""
    full: Bool[Array, ""]
    """Kept factorizations have failed in this step: begun anew with one in every iteration."""
    huge: Bool[Array, ""]
    """The last correction was one to give up at, but for its being scaled down."""


def _where(condition, there: _Carry, here: _Carry) -> _Carry:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), there, here)


class Newton(eqx.Module):
    """How a step's nonlinear equations are solved.

    Arguments:
        tolerance: of the scaled correction (part of the shell's size, radians); with criterion="norm" of the
            Euclidean norm of the raw correction ‖ΔQ‖, in the user's units.
        max_iterations: corrections allowed in a step; and as many again where kept factorizations failed and the
            step is done anew without them.
        max_rotation: a correction is scaled down so that no nodal rotation in it exceeds this [rad].
        reuse: keep a factorization over iterations and steps while it contracts well (chord Newton): more
            corrections, each far cheaper, and a predicted one a hundred times below the tolerance at the end.
            False factors in every iteration, which statics does by default.
        criterion: "predicted" (the correction that would follow) or "norm" (‖ΔQ‖ of the last one, as the paper
            does with 1e-6).

    Raises ValueError for values that are not positive and unknown criteria.
    """

    tolerance: float = 1e-8
    max_iterations: int = eqx.field(static=True, default=25)
    max_rotation: float = 0.3
    reuse: bool = eqx.field(static=True, default=True)
    criterion: str = eqx.field(static=True, default="predicted")

    def __check_init__(self):
        check_positive("Newton tolerance", self.tolerance)
        check_positive("Newton max_rotation", self.max_rotation)
        check_positive("Newton max_iterations", self.max_iterations)
        if self.criterion not in ("predicted", "norm"):
            raise ValueError(f'Newton criterion must be "predicted" or "norm", but it is {self.criterion!r}.')

    def solve(self, problem: Problem, guess, size, rotates, linear: Linear, memory: Memory):
        """Iterate from `guess` (nf,): (Solved, Memory for the next step).

        `size` [length] and the mask `rotates` (nf,) scale the corrections. Not to be differentiated: see
        `attach_derivative`.
        """
        scale = jnp.where(rotates, 1.0, 1.0 / size)

        def relative(balance):
            """Largest residual over the largest force in balance, for forces and moments apart."""
            r = problem.free(balance.residual)
            force = jnp.where(balance.force > 0, balance.force, 1.0)
            moment = jnp.where(balance.moment > 0, balance.moment, 1.0)
            return r, jnp.max(jnp.abs(r) / jnp.where(rotates, moment, force))

        def advance(c: _Carry, r, error):
            def anew():
                values = problem.matrix(c.free, c.last)
                step, factorization = linear.solver.factor_and_solve(linear.handle, values, -r)
                return step, factorization, values

            def again():
                kept = c.memory
                step = linear.solver.solve(linear.handle, kept.factorization, kept.values, -r)
                return step, kept.factorization, kept.values

            if self.reuse:
                step, factorization, values = lax.cond(c.memory.stale, anew, again)
                fresh = c.memory.stale
            else:
                (step, factorization, _), values, fresh = anew(), c.memory.values, jnp.array(True)
            turn = jnp.max(jnp.where(rotates, jnp.abs(step), 0.0), initial=0.0)
            damping = jnp.minimum(1.0, self.max_rotation / jnp.where(turn > 0, turn, 1.0))
            damping = jnp.where(turn > 0, damping, 1.0)
            length = jnp.max(jnp.abs(scale * step))
            whole = damping == 1.0
            q = jnp.where(jnp.isfinite(c.correction), length / c.correction, 1.0)
            target, predicted, contraction, stale, hard = self._outlook(c, length, q, fresh)
            if self.criterion == "norm":
                enough = jnp.linalg.norm(step) <= self.tolerance
            else:
                enough = (length <= target) | ((q < 0.5) & (predicted <= target))
                if self.reuse:
                    enough |= fresh & (q > 0.5) & (c.correction < _NOISE)
            huge = length > _GIVE_UP
            # A correction that an old factorization spoiled is not taken; the next factors anew.
            bad = ~jnp.isfinite(length) | (huge & (~fresh | c.huge | (damping * length > _GIVE_UP)))
            final = bad & fresh
            done = final | (enough & whole & ~bad)
            result = jnp.where(final, jnp.where(jnp.isfinite(length), DIVERGED, SINGULAR), SUCCESSFUL)
            after = _Carry(
                jnp.where(bad, c.free, c.free + damping * step),
                c.free,
                done,
                result,
                c.iterations + 1,
                c.factorizations + fresh,
                jnp.where(whole & ~bad, length, jnp.inf),
                error,
                Memory(factorization, values, stale | bad, contraction, c.memory.hard),
                hard,
                fresh,
                c.full,
                huge & fresh,
            )
            if not self.reuse:
                return after
            failed = jnp.where(done, result != SUCCESSFUL, after.iterations >= self.max_iterations)
            return _where(failed & ~c.full, begun_anew(after), after)

        def begun_anew(c: _Carry):
            """What kept factorizations spoilt is done again without them."""
            memory = eqx.tree_at(lambda m: m.stale, c.memory, jnp.array(True))
            yes = jnp.array(True)
            return start._replace(
                iterations=c.iterations, factorizations=c.factorizations, memory=memory, hard=yes, full=yes
            )

        def body(c: _Carry):
            r, error = relative(problem.balance(c.free))
            # Kept factorizations leave errors in soft directions (rigid motions, for one), which residuals hardly show:
            # there corrections alone decide.
            settled = (error < _ROUND_OFF) & c.full
            if self.criterion == "predicted" and not self.reuse:
                settled |= c.correction * error < _RESIDUAL_SAFETY * self.tolerance * c.error
            broken = ~jnp.isfinite(error)
            stop = c._replace(done=jnp.array(True), result=jnp.where(broken, DIVERGED, c.result))
            if self.reuse:
                stop = _where(broken & ~c.full, begun_anew(c), stop)
            return lax.cond(settled | broken, lambda: stop, lambda: advance(c, r, error))

        zero = jnp.zeros((), jnp.int32)
        full = memory.hard == 2 if self.reuse else jnp.array(True)
        if self.reuse:
            memory = eqx.tree_at(lambda m: m.stale, memory, memory.stale | full)
        start = _Carry(
            guess,
            jnp.zeros_like(guess),
            jnp.array(False),
            zero,
            zero,
            zero,
            jnp.array(jnp.inf),
            jnp.array(0.0),
            memory,
            jnp.array(False),
            jnp.array(False),
            full,
            jnp.array(False),
        )
        limit = self.max_iterations * (2 if self.reuse else 1)
        end = lax.while_loop(lambda c: ~c.done & (c.iterations < limit), body, start)
        result = jnp.where(end.done, end.result, STAGNATED)
        kept = end.memory
        if self.reuse:
            useless = (kept.contraction > _USELESS) | (result != SUCCESSFUL)
            many = end.full & (end.iterations > _FEW)
            hard = jnp.where(many, 2, end.full | end.hard).astype(jnp.int32)
            kept = eqx.tree_at(lambda m: (m.stale, m.hard), kept, (kept.stale | useless, hard))
        return Solved(end.free, result, end.iterations, end.factorizations, end.correction), kept

    def _outlook(self, c: _Carry, length, q, fresh):
        """After a correction of scaled `length`, `q` times the last one, whose matrix was its iterate's if `fresh`:

        (what the next must be below, the next as predicted, the contraction to remember, whether to factor, whether
        the step is a hard one).
        """
        if not self.reuse:  # Quadratic: the tangents are those of this iterate and of the last.
            return self.tolerance, length * q * q, c.memory.contraction, jnp.array(True), c.hard
        first = ~jnp.isfinite(c.correction)
        target = jnp.where(c.full, 1.0, _MARGIN) * self.tolerance
        # Only corrections of one kept factorization say how it contracts: after its own iterate's, which took most
        # of the error, what it leaves is in soft directions and may be far larger than their ratio tells.
        linear = jnp.where(c.own, 1.0, q / jnp.maximum(1.0 - q, 0.1))
        # After a kept factorization's correction a fresh one's q is still the kept one's, hence no square.
        quadratic = jnp.where(c.full | (c.factorizations == c.iterations), q * q, q)
        predicted = length * jnp.where(first, 1.0, jnp.where(fresh, quadratic, linear))
        earlier = ~fresh & (c.factorizations == 0)
        contraction = jnp.where(earlier & (c.iterations == 1), q, c.memory.contraction)
        contraction = jnp.where(first & fresh, _FORGETS * contraction, contraction)
        # Of further corrections with this factorization.
        expected = jnp.where(first, c.memory.contraction, q)
        to_go = jnp.log(length * expected / target) / -jnp.log(jnp.clip(expected, 1e-10, 0.99))
        slow = expected > _CONTRACTS
        # Steps on which even their own factorizations serve once only start a long way off: full iterations, in the
        # next step too.
        hard = c.hard | (slow & (c.factorizations > 0))
        full = (c.memory.hard > 0) | hard
        near = expected < _CONTRACTS**2
        stale = jnp.where(fresh, full & ~near, slow | (to_go > _AFFORDABLE)) | (c.iterations >= _PATIENCE)
        return target, predicted, contraction, stale | c.full, hard


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def attach_derivative(solver, handle, free, residual, values):
    """`free`, with the derivative of the solution of residual(free; parameters) = 0.

    `residual` (nf,) and `values` (the matrix ∂residual/∂free) are evaluated at `free` with it held fixed. By
    the implicit function theorem d free = -K⁻¹ d residual; where nothing is differentiated neither is used,
    and XLA leaves them out.
    """
    return free


@attach_derivative.defjvp
def _implicit(solver, primals, tangents):
    handle, free, _, values = primals
    return free, -linear_solve(solver, handle, values, tangents[2])
