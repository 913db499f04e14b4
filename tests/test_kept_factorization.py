"""Factorizations that are kept over iterations and steps: in loops, beside other solves, under vmap."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from systems import (
    PATTERN,
    RHS,
    ROUND_OFF,
    SOLVERS,
    available,
    random_values,
    relative_error,
    relative_residual,
    shell_pattern,
    to_dense,
)

from jaxshell.solvers.linear_solver import Dense, Pardiso, linear_solve, multiply


@pytest.fixture(params=SOLVERS, ids=lambda kind: kind.__name__)
def solver(request):
    return available(request.param)


def chord_scan(solver, handle, start, rhs, matrices, refactor):
    """x of K_k x = rhs for a list of matrices, by chord iterations with the LU of the last refactored K.

    The factorization is a carry of the scan and of the loop in it; `refactor` says when to factor anew.
    """

    def step(factorization, inputs):
        values, anew = inputs

        def iterate(carry):
            x, factorization, count = carry
            factorization = jax.lax.cond(
                anew & (count == 0), lambda: solver.factor(handle, values), lambda: factorization
            )
            residual = rhs - multiply(handle, values, x)
            return x + solver.solve(handle, factorization, values, residual), factorization, count + 1

        def unfinished(carry):
            return (relative_residual(handle, values, carry[0], rhs) > 1e-13) & (carry[2] < 100)

        x, factorization, count = jax.lax.while_loop(
            unfinished, iterate, (jnp.zeros(rhs.shape), factorization, jnp.zeros((), jnp.int32))
        )
        return factorization, (x, count)

    return jax.lax.scan(step, start, (matrices, refactor))


def chord_problem(pattern, steps):
    noise = np.random.default_rng(2).standard_normal((steps, len(pattern.indices.array)))
    refactor = jnp.arange(steps) % 10 == 0
    return random_values(pattern) + 0.1 * jnp.asarray(noise), refactor


def test_factorization_is_kept_over_iterations_and_steps(solver):
    matrices, refactor = chord_problem(PATTERN, 20)
    handle = solver.prepare(PATTERN)
    run = jax.jit(chord_scan, static_argnums=0)
    start = solver.initial_factorization(handle)
    last, (x, counts) = run(solver, handle, start, RHS, matrices, refactor)
    for values, solution in zip(matrices, x, strict=True):
        assert relative_error(solution, np.linalg.solve(to_dense(PATTERN, values), RHS)) < ROUND_OFF
    # One iteration is the sign of a fresh LU, more are the sign of one kept from an earlier step.
    assert np.all(counts[refactor] <= 2) and np.all(counts[~refactor] > 2)
    # What the compiled program hands back may be used by the next one.
    onward = run(solver, handle, last, RHS, matrices[11:13], refactor[11:13])[1]
    assert np.array_equal(onward[0], x[11:13])


def test_pardiso_never_analyses_again():
    pardiso = available(Pardiso)
    primitive = pytest.importorskip("pardiso_mkl_jax.primitive")
    pattern = shell_pattern(5, 2)  # of this test alone: no other can have had it evicted
    rhs = jnp.ones(pattern.size)
    matrices, refactor = chord_problem(pattern, 200)
    handle = pardiso.prepare(pattern)
    run = jax.jit(chord_scan, static_argnums=0)
    primitive.reset_rebuild_count()
    counts = [primitive._ffi.analysis_count(name) for name in handle.native]
    assert counts == [1, 1]
    for scale in (1.0, 2.0, 3.0):
        start = pardiso.initial_factorization(handle)
        run(pardiso, handle, start, rhs, scale * matrices, refactor)[1][0].block_until_ready()
        jax.grad(lambda v: linear_solve(pardiso, handle, v, rhs).sum())(scale * matrices[0]).block_until_ready()
    assert primitive.rebuild_count() == 0
    assert [primitive._ffi.analysis_count(name) for name in handle.native] == counts


def test_linear_solve_leaves_a_kept_factorization_alone(solver):
    handle = solver.prepare(PATTERN)
    kept, other = random_values(PATTERN), random_values(PATTERN, seed=5)

    @jax.jit
    def run(kept, other):
        factorization = solver.factor(handle, kept)
        between = linear_solve(solver, handle, other, RHS)
        # The rhs depends on `between`, so the kept factorization is used after the other matrix was solved.
        return solver.solve(handle, factorization, kept, RHS + 0.0 * between)

    assert relative_error(run(kept, other), np.linalg.solve(to_dense(PATTERN, kept), RHS)) < ROUND_OFF


def test_kept_factorization_under_vmap(solver):
    handle, values = solver.prepare(PATTERN), random_values(PATTERN)
    both = jnp.stack([values, 2 * values])
    rhs = jnp.stack([RHS, RHS**2])
    factorization = solver.factor(handle, values)
    mapped = jax.vmap(lambda b: solver.solve(handle, factorization, values, b))(rhs)
    assert relative_error(mapped[1], np.linalg.solve(to_dense(PATTERN, values), rhs[1])) < ROUND_OFF

    def factor_then_solve(values):
        return solver.solve(handle, solver.factor(handle, values), values, RHS)

    if isinstance(solver, Dense):
        assert relative_error(jax.vmap(factor_then_solve)(both)[1], factor_then_solve(both[1])) < ROUND_OFF
    else:
        with pytest.raises(NotImplementedError, match="cannot be mapped over matrices"):
            jax.vmap(factor_then_solve)(both)
