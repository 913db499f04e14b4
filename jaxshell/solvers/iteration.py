"""What the iterations for one step's equations have in common: the problem, how corrections are measured, results.

Corrections are measured in the shell's own scale: displacements over the diagonal of its bounding box, and
rotations in radians; the largest entry counts.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxshell.numerics.branches import when
from jaxshell.numerics.checks import Real
from jaxshell.solvers.linear_solver import Handle, LinearSolver, linear_solve, multiply, scaled

C = TypeVar("C")

SUCCESSFUL, DIVERGED, STAGNATED, SINGULAR, STEP_TOO_SMALL, UNSTABLE = (np.int32(k) for k in range(6))
"""Result codes inside compiled programs, in the order of `jaxshell.RESULTS`."""

ROUND_OFF = 1e-14
"""A residual below this fraction of the forces in balance is noise."""
_GIVE_UP = 1e3
"""No correction is this many times the shell's size, or so many radians."""
_SMALLEST = 1e-12
"""Corrections below this are not asked for the sake of energy: near it positions have no more digits."""
_CURVED = 1e4
"""What a full correction leaves is about so many times its square, of thin shells, before another one tells."""
_SOFT, _REFINEMENTS, _IN_NEWTON, _KEPT = 1e-6, 3, 2, 1
"""What stands in place of zeros on the diagonal, as a part of what they become; and how often a solution with a
softened matrix is refined: where no iteration follows, in Newton's, and there with a factorization kept."""
_FIRST_GUESS = 0.1
"""Contraction of a factorization that has not been used yet."""
_OFF = 0.1
"""Residual of an extrapolated start, over the largest force in balance, above which a calm one is looked at too."""
_NEW, _AT_CALM, _CHOSEN = range(3)


class Problem(NamedTuple):
    """The equations of a step as functions of the free increments (nf,)."""

    balance: Callable
    """→ `jaxshell.methods.base.Balance`."""
    matrix: Callable
    """(free, the iterate before it: zeros, the step's start, at first) → values of the sparse tangent."""
    free: Callable
    """(n, 6) → its free entries."""
    turning: "Turning | None" = None
    """None: a kept factorization does not turn with the nodes."""


class Turning(NamedTuple):
    """What a kept factorization needs to turn with the nodes."""

    frames: Float[Array, "n 3 3"]
    """Nodal rotations at the step's start."""
    turned: Callable
    """(rotations (n, 3, 3), free vector) → the vector with every node's part turned."""
    translations: Float[Array, "k nf"]
    """The shell's translations, those that no support holds."""


class Linear(NamedTuple):
    """A linear solver, its prepared pattern, and the units in which it sees the unknowns.

    Matrices, right-hand sides and solutions are the user's; the solver gets S K S and S b, in which forces and moments,
    displacements and rotations are of like size, so that no pivot depends on the user's units.
    """

    solver: LinearSolver
    handle: Handle
    units: Float[Array, " nf"] | None = None
    """The diagonal of S, `Model.units`; None where matrices are to be taken as they are."""
    soft: tuple[Int[Array, " q"], Float[Array, " q"]] | None = None
    """Places of the zeros on the diagonal that multipliers have, and the squares of the entries of their rows, as the
    solver gets them. None where there is none.

    A factorization without pivoting would divide by the zeros. In their place it has -s²ε/K, K the largest entry: what
    remains after elimination of the others is s²/K or more, so a solution errs by ε, and is refined.
    """

    def posed(self, model) -> "Linear":
        """For the matrices of a `Model`: in its units, and with the zeros of its multipliers."""
        return self._replace(units=model.units, soft=model.soft)

    def factor_and_solve(self, values, rhs):
        """(K⁻¹ rhs, factorization, the matrix that was factored: `values` in these units).

        Where zeros are softened the solution is refined with the matrix itself: a factorization without pivoting loses
        digits of saddles besides, and Newton would take for converged what it has not solved for (2e-11 of the angular
        momentum after 10 000 steps of jointed plates, 1e-13 with two refinements).
        """
        rhs, given = self._times_units(rhs), self._in_units(values)
        softening = self._softening(given)
        values = given if softening is None else given.at[self._zeros].add(-softening)
        x, factorization = self.solver.factor_and_solve(self.handle, values, rhs)
        if softening is not None:
            again = functools.partial(self.solver.solve, self.handle, factorization, values)
            x = self._refined(x, given, rhs, again, _IN_NEWTON)
        return self._times_units(x), factorization, values

    def keeping(self, memory: "Memory", factorization, factored, turning: "Turning | None") -> "Memory":
        """`memory` with what `factor_and_solve` made in a step that turns like `turning`."""
        memory = eqx.tree_at(lambda m: (m.factorization, m.values), memory, (factorization, factored))
        if turning is None:
            return memory
        memory, moves = eqx.tree_at(lambda m: m.frames, memory, turning.frames), turning.translations
        if not moves.size:
            return memory
        units = 1.0 if self.units is None else self.units
        products = factored[:, None] * (moves / units).T[self.handle.rows]
        sums = jnp.zeros(moves.shape[::-1]).at[self.handle.indices].add(products).T / units
        return eqx.tree_at(lambda m: (m.sums, m.whole), memory, (sums, jnp.linalg.inv(sums @ moves.T)))

    def solve(self, factorization, factored, rhs) -> Float[Array, " nf"]:
        """K⁻¹ rhs, from the factorization and the matrix factored of `factor_and_solve`; refined once where zeros are
        softened (1e-12 of the unfolding panel's angular momentum lost in 800 steps, so 2e-13)."""
        rhs = self._times_units(rhs)
        substituted = functools.partial(self.solver.solve, self.handle, factorization, factored)
        x = substituted(rhs)
        if self.soft is not None:
            x = self._refined(x, factored.at[self._zeros].set(0.0), rhs, substituted, _KEPT)
        return self._times_units(x)

    def solve_once(self, values, rhs) -> Float[Array, " nf"]:
        """K⁻¹ rhs to the last digit, differentiable to every order; see `linear_solve`."""
        rhs, given = self._times_units(rhs), self._in_units(values)
        softening = self._softening(given)
        if softening is None:
            return self._times_units(linear_solve(self.solver, self.handle, given, rhs))
        matrix = given.at[self._zeros].add(-softening)
        solved = functools.partial(linear_solve, self.solver, self.handle, matrix)
        return self._times_units(self._refined(solved(rhs), given, rhs, solved, _REFINEMENTS))

    def _refined(self, x, given, rhs, solve, times: int):
        """x, the solution with a softened matrix, towards that with the matrix `given` itself; all in these units."""
        for _ in range(times):
            x = x + solve(rhs - multiply(self.handle, given, x))
        return x

    @property
    def _zeros(self):
        assert self.soft is not None
        return self.soft[0]

    def _softening(self, values) -> Float[Array, " q"] | None:
        """D: what is taken from the zeros of a matrix in these units; None where there are none."""
        if self.soft is None:
            return None
        return _SOFT * self.soft[1] / jax.lax.stop_gradient(jnp.max(jnp.abs(values)))

    def _in_units(self, values):
        return values if self.units is None else scaled(values, self.handle.rows, self.handle.indices, self.units)

    def _times_units(self, vector):
        return vector if self.units is None else self.units * vector

    def memory(self, newton, turning: "Turning | None" = None) -> "Memory":
        """Memory before the first step of a run with the settings `newton`, whose steps turn like `turning`."""
        kept = self.handle.indices.shape if newton.reuse else (0,)
        turns = turning if newton.reuse else None
        nodes, moves = (0, 0) if turns is None else (turns.frames.shape[0], turns.translations.shape[0])
        return Memory(
            factorization=self.solver.initial_factorization(self.handle),
            values=jnp.zeros(kept),
            stale=jnp.array(True),
            contraction=jnp.array(_FIRST_GUESS, float),  # not weakly typed: a restart's is not either
            hard=jnp.zeros((), jnp.int32),
            frames=jnp.zeros((nodes, 3, 3)),
            sums=jnp.zeros((moves, self.handle.size)),
            whole=jnp.zeros((moves, moves)),
            spent=jnp.array(0.0, float),
            steps=jnp.zeros((), jnp.int32),
        )


class Memory(eqx.Module):
    """What one step's iteration leaves to the next: a factorization, and whether it still contracts well."""

    factorization: Any
    values: Float[Array, " m"]
    """The matrix that was factored, where factorizations are reused."""
    stale: Bool[Array, ""]
    """The factorization must not be used again."""
    contraction: Float[Array, ""]
    """By which corrections shrank that a factorization of an earlier step gave."""
    hard: Int[Array, ""]
    """Of the last step. 1: its own factorizations contracted slowly; 2: it took many full iterations."""
    frames: Float[Array, "n 3 3"]
    """Nodal rotations at the start of the step in which it was factored."""
    sums: Float[Array, "k nf"]
    """tᵀ K for the shell's translations t that no support holds."""
    whole: Float[Array, "k k"]
    """(tᵀ K t)⁻¹."""
    spent: Float[Array, ""]
    """Corrections since then, with what the factorization cost."""
    steps: Int[Array, ""]
    """In so many steps."""


class Start(NamedTuple):
    """The increments from which an iteration starts: extrapolated ones, or calm ones where those are far off.

    Both are looked at in the iteration's own loop, so that a program evaluates residuals in one place only.
    """

    free: Float[Array, " nf"]
    calm: Float[Array, " nf"] | None = None
    """None: `free` is the start."""
    unbalanced: Float[Array, ""] | None = None
    """Square of the unbalanced forces at `free`, once it is known and `calm` is looked at."""
    stage: Int[Array, ""] | None = None

    @classmethod
    def of(cls, free, calm=None) -> "Start":
        if calm is None:
            return cls(free)
        return cls(free, calm, jnp.zeros(()), jnp.asarray(_NEW, jnp.int32))

    def chosen(self, at, r, error, rotates) -> tuple["Start", Float[Array, " nf"], Bool[Array, ""]]:
        """From the residual r, of the size `error`, at the iterate `at`: (what is known now, the next iterate, whether
        that one is to be looked at before any correction)."""
        assert self.calm is not None and self.unbalanced is not None
        force = jnp.sum(jnp.where(rotates, 0.0, r) ** 2)
        # Comparisons with what is no number are false: then the calm start is taken.
        off = (self.stage == _NEW) & ~(error <= _OFF)
        at_calm = self.stage == _AT_CALM
        back = at_calm & (self.unbalanced < force)
        free = jnp.where(at_calm & ~back, self.calm, self.free)
        stage = jnp.where(off, _AT_CALM, _CHOSEN).astype(jnp.int32)
        start = Start(free, self.calm, jnp.where(off, force, self.unbalanced), stage)
        return start, jnp.where(off, self.calm, jnp.where(back, self.free, at)), off | back


class Solved(NamedTuple):
    """What an iteration found."""

    free: Float[Array, " nf"]
    result: Int[Array, ""]
    iterations: Int[Array, ""]
    factorizations: Int[Array, ""]
    correction: Float[Array, ""]


class Correction(NamedTuple):
    """A solution of the linearised equations, scaled down where it turns a node too far."""

    step: Float[Array, " nf"]
    """What is added to the iterate, whole or in part."""
    damping: Float[Array, ""]
    """The fraction of `step` that is added."""
    length: Float[Array, ""]
    """Largest entry of `step`, scaled."""
    ratio: Float[Array, ""]
    """`length` over that of the correction before it, 1 at first."""
    finite: Bool[Array, ""]
    huge: Bool[Array, ""]
    """One to give up at, but for its being scaled down."""

    @property
    def whole(self) -> Bool[Array, ""]:
        return self.damping == 1.0

    @property
    def measured(self) -> Float[Array, ""]:
        """`length`, infinite where the correction was scaled down and says nothing of convergence."""
        return jnp.where(self.whole, self.length, jnp.inf)

    def hopeless(self, again: Bool[Array, ""]) -> Bool[Array, ""]:
        """Diverged: not finite, or huge even when scaled down, or huge `again`.

        Once it may come from an iterate whose matrix happens to be all but singular.
        """
        return ~self.finite | (self.huge & (again | (self.damping * self.length > _GIVE_UP)))

    @property
    def unseen(self) -> Float[Array, ""]:
        """The fraction of it that a full correction is expected to leave where none has been before it."""
        return jnp.minimum(1.0, _CURVED * self.length)

    def balances(self, r, work, free, left, tolerance) -> Bool[Array, ""]:
        """Whether the energy unbalanced after this correction is within the tolerance of what the step exchanges.

        `r` is the residual that asked for it, at the iterate `free`, `work` what the step exchanges there, and `left`
        the fraction of it that is expected to be left. Corrections are measured by the shell's size; where a stiff
        shell moves by a small part of it, this asks for more.
        """
        unbalanced = jnp.maximum(jnp.abs(r @ (free + self.step)), jnp.abs(r @ self.step))
        return energy_closes(left * unbalanced, work, tolerance) | (left * self.length <= _SMALLEST)

    def failure(self) -> Int[Array, ""]:
        """The result code of a hopeless correction."""
        return jnp.where(self.finite, DIVERGED, SINGULAR)


def energy_closes(unbalanced, work, tolerance) -> Bool[Array, ""]:
    """Whether the energy that a step leaves unbalanced is within the tolerance of the work that it exchanges."""
    return jnp.abs(unbalanced) <= tolerance * work


class Measure(NamedTuple):
    """What corrections and residuals are measured with."""

    size: Float[Array, ""]
    """The shell's size [length]."""
    rotates: Bool[Array, " nf"]
    """Which free degrees of freedom are rotations."""
    max_rotation: Real
    """A correction is scaled down so that no nodal rotation in it exceeds this [rad]."""

    def correction(self, step, before) -> Correction:
        """`step` (nf,) and how it compares; `before` is what the last one `measured`, infinite if there is none."""
        turn = jnp.max(jnp.where(self.rotates, jnp.abs(step), 0.0), initial=0.0)
        damping = jnp.minimum(1.0, self.max_rotation / jnp.where(turn > 0, turn, 1.0))
        damping = jnp.where(turn > 0, damping, 1.0)
        scale = jnp.where(self.rotates, 1.0, 1.0 / self.size)
        length = jnp.max(jnp.abs(scale * step))
        ratio = jnp.where(jnp.isfinite(before), length / before, 1.0)
        return Correction(step, damping, length, ratio, jnp.isfinite(length), length > _GIVE_UP)

    def residual(self, problem: Problem, free):
        """(free residual, its largest entry over the largest force in balance, for forces and moments apart, and the
        work that the step exchanges)."""
        balance = problem.balance(free)
        r = problem.free(balance.residual)
        force = jnp.where(balance.force > 0, balance.force, 1.0)
        moment = jnp.where(balance.moment > 0, balance.moment, 1.0)
        return r, jnp.max(jnp.abs(r) / jnp.where(self.rotates, moment, force)), balance.work


def after_residual(c, r, error, measure: Measure, ends, stop, advance: Callable):
    """An iteration's carry `c`, with its iterate `free` and its `start`, after the residual r of the size `error`.

    It looks at the other start, ends as `stop`, or is what `advance` makes of it.
    """
    if c.start.calm is None:
        return when(~ends, advance, where(ends, stop, c))
    start, free, looks = c.start.chosen(c.free, r, error, measure.rotates)
    looking, c = c._replace(free=free, start=start), c._replace(start=start)
    return when(~looks & ~ends, advance, where(looks, looking, where(ends, stop, c)))


def where(condition, there: C, here: C) -> C:
    """`there` where the condition holds, else `here`; what both share is left alone."""
    return jax.tree.map(lambda a, b: a if a is b else jnp.where(condition, a, b), there, here)
