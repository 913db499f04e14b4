"""The three linear solvers against dense LAPACK, their kept factorizations in loops, and their gradients."""

import os
import platform
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse

from jaxshell.linear_solver import (
    KLU,
    Dense,
    Pardiso,
    SparsityPattern,
    default_solver,
    linear_solve,
    multiply,
    relative_residual,
)

ROUND_OFF = 1e-12  # of matrices whose condition numbers are below 100


@pytest.fixture(params=[Pardiso, KLU, Dense], ids=lambda solver: solver.__name__)
def solver(request):
    try:
        return request.param()
    except ImportError as error:
        pytest.skip(str(error))


@pytest.fixture
def pardiso():
    try:
        return Pardiso()
    except ImportError as error:
        pytest.skip(str(error))


def shell_pattern(columns, rows):
    """Six unknowns a node on a structured mesh of triangles."""
    node = np.arange((columns + 1) * (rows + 1)).reshape(columns + 1, rows + 1)
    a, b, c, d = (part.ravel() for part in (node[:-1, :-1], node[1:, :-1], node[1:, 1:], node[:-1, 1:]))
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    i, j = np.repeat(triangles, 3, axis=1).ravel(), np.tile(triangles, (1, 3)).ravel()
    nodes = np.zeros((node.size, node.size))
    nodes[i, j] = 1.0
    rows, columns = np.nonzero(np.kron(nodes, np.ones((6, 6))))
    size = 6 * node.size
    return SparsityPattern(size, np.searchsorted(rows, np.arange(size + 1)), columns)


def random_values(pattern, seed=0):
    """Unsymmetric, with a diagonal that keeps the condition number low."""
    values = np.random.default_rng(seed).standard_normal(len(pattern.indices.array))
    return jnp.asarray(values + 40.0 * (pattern.rows == pattern.indices.array))


def to_dense(pattern, values):
    shape = (pattern.size, pattern.size)
    csr = (np.asarray(values), pattern.indices.array, pattern.indptr.array)
    return scipy.sparse.csr_matrix(csr, shape=shape).toarray()


def relative_error(x, reference):
    return np.linalg.norm(x - reference) / np.linalg.norm(reference)


PATTERN = shell_pattern(3, 2)
N = PATTERN.size
RHS = jnp.asarray(np.random.default_rng(1).standard_normal(N))


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


def test_pardiso_never_analyses_again(pardiso):
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
        jax.grad(lambda v: linear_solve(pardiso, handle, v, rhs).sum())(
            scale * matrices[0]
        ).block_until_ready()
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
    values = (
        jnp.stack([random_values(PATTERN, seed) for seed in range(3)])
        if axes[0] == 0
        else random_values(PATTERN)
    )
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


def test_relative_residual_of_a_zero_right_hand_side():
    handle, values = Dense().prepare(PATTERN), random_values(PATTERN)
    assert relative_residual(handle, values, jnp.zeros(N), jnp.zeros(N)) == 0.0
    assert relative_residual(handle, values, jnp.ones(N), jnp.zeros(N)) > 0.0


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


@pytest.mark.parametrize(
    "solver, module, package", [(Pardiso, "pardiso_mkl_jax", "pardiso-mkl-jax"), (KLU, "klujax", "klujax")]
)
def test_missing_package(monkeypatch, solver, module, package):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError, match=f"pip install {package}"):
        solver()


def test_default_solver(monkeypatch):
    monkeypatch.setattr(platform, "machine", lambda: "arm64")
    assert not isinstance(default_solver(), Pardiso)
    monkeypatch.setattr(platform, "machine", lambda: "x86_64")
    for module, missing_from_here in (("pardiso_mkl_jax", Pardiso), ("klujax", KLU)):
        monkeypatch.setitem(sys.modules, module, None)
        assert not isinstance(default_solver(), missing_from_here)
    assert isinstance(default_solver(), Dense)


def in_fresh_process(code):
    root = str(Path(__file__).parents[1])
    environment = {k: v for k, v in os.environ.items() if k not in ("JAX_ENABLE_X64", "MKL_NUM_THREADS")}
    environment["PYTHONPATH"] = root + os.pathsep + environment.get("PYTHONPATH", "")
    run = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr


def test_import_changes_nothing():
    in_fresh_process(
        "import os, sys, jax\n"
        "before, environment = jax.config.values, dict(os.environ)\n"
        "import jaxshell.linear_solver\n"
        "assert jax.config.values == before and dict(os.environ) == environment\n"
        "assert 'pardiso_mkl_jax' not in sys.modules and 'klujax' not in sys.modules\n"
    )


def test_preparing_changes_no_setting_of_jax(solver):
    in_fresh_process(
        "import jax\n"
        f"from jaxshell.linear_solver import {type(solver).__name__}, SparsityPattern\n"
        "before = jax.config.values\n"
        "with jax.enable_x64(True):\n"
        f"    {type(solver).__name__}().prepare(SparsityPattern(1, [0, 1], [0]))\n"
        "assert jax.config.values == before\n"
    )


def test_float64_off(solver):
    in_fresh_process(
        f"from jaxshell.linear_solver import {type(solver).__name__}, SparsityPattern\n"
        "try:\n"
        f"    {type(solver).__name__}().prepare(SparsityPattern(1, [0, 1], [0]))\n"
        "except RuntimeError as error:\n"
        "    assert 'jax_enable_x64' in str(error)\n"
        "else:\n"
        "    raise SystemExit('no error')\n"
    )
