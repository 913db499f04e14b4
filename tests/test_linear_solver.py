"""The three linear solvers against dense LAPACK, their derivatives and batches, and bad input."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from systems import (
    PATTERN,
    RHS,
    ROUND_OFF,
    SOLVERS,
    N,
    available,
    random_values,
    relative_error,
    relative_residual,
    shell_pattern,
    to_dense,
)

from jaxshell.assembly.structure import structure_of
from jaxshell.assembly.tables import analyse
from jaxshell.scenes import spherical_cap
from jaxshell.solvers.linear_solver import (
    KLU,
    Pardiso,
    SparsityPattern,
    linear_solve,
)


@pytest.fixture(params=SOLVERS, ids=lambda kind: kind.__name__)
def solver(request):
    return available(request.param)


@pytest.mark.parametrize("mesh", [(1, 1), (4, 3), (9, 5)])
def test_solves_as_lapack_does(solver, mesh):
    pattern = shell_pattern(*mesh)
    values, rhs = random_values(pattern), jnp.arange(1.0, pattern.size + 1)
    dense = to_dense(pattern, values)

    @jax.jit
    def solve_all(handle, values, rhs):
        x, factorization = solver.factor_and_solve(handle, values, rhs)
        kept = solver.solve(handle, factorization, values, 2 * rhs)
        kept_transposed = solver.solve(handle, factorization, values, rhs, transpose=True)
        transposed, factorization = solver.factor_and_solve(handle, values, rhs, transpose=True)
        after_transposed = solver.solve(handle, factorization, values, rhs)
        return x, kept / 2, after_transposed, kept_transposed, transposed

    *straight, kept_transposed, transposed = solve_all(solver.prepare(pattern), values, rhs)
    reference = np.linalg.solve(dense, rhs)
    for x in straight:
        assert relative_error(x, reference) < ROUND_OFF
    reference = np.linalg.solve(dense.T, rhs)
    for x in (kept_transposed, transposed):
        assert relative_error(x, reference) < ROUND_OFF


def test_prepare_while_tracing_is_concrete_and_happens_once(solver):
    pattern = shell_pattern(2, 2)
    handles = []

    @jax.jit
    def solve(values, rhs):
        handles.append(solver.prepare(pattern))
        return linear_solve(solver, handles[0], values, rhs)

    values, rhs = random_values(pattern), jnp.ones(pattern.size)
    x = solve(values, rhs)
    assert relative_error(x, np.linalg.solve(to_dense(pattern, values), rhs)) < ROUND_OFF
    for leaf in jax.tree.leaves(handles):
        np.asarray(leaf)  # raises for a tracer
    same = SparsityPattern(pattern.size, pattern.indptr.array.copy(), pattern.indices.array.copy())
    assert hash(same) == hash(pattern) and same == pattern
    assert type(solver)().prepare(same) is handles[0]


def test_jvp_and_vjp_agree_and_match_finite_differences(solver):
    handle, values = solver.prepare(PATTERN), random_values(PATTERN)
    rng = np.random.default_rng(3)
    tangents = jnp.asarray(rng.standard_normal(values.shape)), jnp.asarray(rng.standard_normal(N))
    cotangent = jnp.asarray(rng.standard_normal(N))

    @jax.jit
    def solve(values, rhs):
        return linear_solve(solver, handle, values, rhs)

    x_dot = jax.jvp(solve, (values, RHS), tangents)[1]
    pulled = jax.vjp(solve, values, RHS)[1](cotangent)
    forward, reverse = cotangent @ x_dot, sum(p @ t for p, t in zip(pulled, tangents, strict=True))
    size = jnp.linalg.norm(cotangent) * jnp.linalg.norm(x_dot)
    assert abs(forward - reverse) < 1e-12 * size

    # Central differences of fourth order: error about 1e-16 / h + h^4.
    def moved(h):
        return solve(values + h * tangents[0], RHS + h * tangents[1])

    h = 1e-3
    difference = (8 * (moved(h) - moved(-h)) - (moved(2 * h) - moved(-2 * h))) / (12 * h)
    assert relative_error(x_dot, difference) < 1e-10


def test_second_derivative(solver):
    handle, values = solver.prepare(PATTERN), random_values(PATTERN)
    direction = jnp.asarray(np.random.default_rng(4).standard_normal(values.shape))

    def work(s):
        return RHS @ linear_solve(solver, handle, values + s * direction, RHS)

    inverse, slope = np.linalg.inv(to_dense(PATTERN, values)), to_dense(PATTERN, direction)
    exact = 2 * RHS @ inverse @ slope @ inverse @ slope @ inverse @ RHS
    for second in (jax.hessian(work), jax.jacrev(jax.jacrev(work))):
        assert jax.jit(second)(0.0) == pytest.approx(float(exact), rel=1e-11)


@pytest.mark.parametrize("axes", [(0, None), (None, 0), (0, 0)])
def test_vmap(solver, axes):
    handle = solver.prepare(PATTERN)
    values = jnp.stack([random_values(PATTERN, seed) for seed in range(3)]) if axes[0] == 0 else random_values(PATTERN)
    rhs = jnp.stack([RHS, 2 * RHS + 1, RHS**2]) if axes[1] == 0 else RHS

    def once(values, rhs):
        return linear_solve(solver, handle, values, rhs)

    def fused(values, rhs):
        return solver.factor_and_solve(handle, values, rhs)[0]

    def slope(values, rhs):
        return jax.grad(lambda v: jnp.sum(once(v, rhs) ** 2))(values)

    for function in (once, fused, slope):
        mapped = jax.jit(jax.vmap(function, axes))(values, rhs)
        for k in range(3):
            alone = function(values[k] if axes[0] == 0 else values, rhs[k] if axes[1] == 0 else rhs)
            assert relative_error(mapped[k], alone) < ROUND_OFF


def test_nested_vmap(solver):
    handle = solver.prepare(PATTERN)
    values, rhs = jnp.stack([random_values(PATTERN, s) for s in range(2)]), jnp.stack([RHS, RHS**2, 1 + RHS])

    def solve(values, rhs):
        return linear_solve(solver, handle, values, rhs)

    mapped = jax.jit(jax.vmap(jax.vmap(solve, (None, 0)), (0, None)))(values, rhs)
    for i in range(2):
        for j in range(3):
            assert relative_error(mapped[i, j], solve(values[i], rhs[j])) < ROUND_OFF


def singular_values():
    """Column 3 a copy of column 4: the two belong to one node, so their rows are the same."""
    values, columns = np.array(random_values(PATTERN)), PATTERN.indices.array
    values[columns == 3] = values[columns == 4]
    return jnp.asarray(values)


@pytest.mark.parametrize("kind", ["singular", "zero"])
def test_singular_matrix_is_seen(solver, kind):
    handle, regular = solver.prepare(PATTERN), random_values(PATTERN)
    values = singular_values() if kind == "singular" else jnp.zeros_like(regular)
    solve = jax.jit(lambda values: solver.factor_and_solve(handle, values, RHS)[0])
    if isinstance(solver, KLU):
        with pytest.raises(jax.errors.JaxRuntimeError, match="singular"):
            solve(values).block_until_ready()
    else:
        residual = relative_residual(handle, values, solve(values), RHS)
        assert not residual < 1e-6  # NaN counts as seen
    x = solve(regular)
    assert relative_residual(handle, regular, x, RHS) < ROUND_OFF


def test_values_that_are_not_finite_give_nan(solver):
    handle, values = solver.prepare(PATTERN), random_values(PATTERN)
    x, factorization = solver.factor_and_solve(handle, values.at[7].set(jnp.nan), RHS)
    kept = solver.solve(handle, factorization, values, RHS)
    assert not np.any(np.isfinite(x)) and not np.any(np.isfinite(kept))
    assert np.all(np.isfinite(solver.factor_and_solve(handle, values, RHS)[0]))


@pytest.mark.slow
def test_pardiso_on_several_threads_is_the_same_to_the_last_bit():
    # Its classical factorization is not: 1 to 3 of 60 solutions of this size differ in their last digits.
    solver, pattern = available(Pardiso), analyse(structure_of(spherical_cap(divisions=52)))[1]
    values, rhs = random_values(pattern), jnp.ones(pattern.size)
    solve = jax.jit(lambda handle, values, rhs: solver.factor_and_solve(handle, values, rhs)[0])
    handle = solver.prepare(pattern)
    first = np.asarray(solve(handle, values, rhs))
    assert relative_residual(handle, values, jnp.asarray(first), rhs) < ROUND_OFF
    for _ in range(60):
        assert np.array_equal(solve(handle, values, rhs), first)


@pytest.mark.parametrize(
    "indptr, indices, message",
    [
        ([0, 2, 3], [0, 1, 1], r"structurally symmetric; \(0, 1\) has no \(1, 0\)"),
        ([0, 1, 2], [1, 0], "row 0 lacks"),
        ([0, 2, 4], [1, 0, 0, 1], "ascending"),
        ([0, 2, 4], [0, 0, 0, 1], "ascending"),
        ([0, 1, 2], [0, 2], r"0\.\.1, not 0\.\.2"),
        ([0, 1], [0], "shape"),
        ([0, 1, 3], [0, 1], "rise from 0"),
    ],
)
def test_bad_pattern(indptr, indices, message):
    with pytest.raises(ValueError, match=message):
        SparsityPattern(2, indptr, indices)


def test_bad_values(solver):
    handle = solver.prepare(PATTERN)
    with pytest.raises(ValueError, match=r"not float64 of shape \(3,\)"):
        solver.factor_and_solve(handle, jnp.ones(3), RHS)
    with pytest.raises(ValueError, match="not float32"):
        linear_solve(solver, handle, random_values(PATTERN).astype(jnp.float32), RHS)
