"""Newton's iteration on two equations with a known root: when it stops, what it says when it fails."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxshell as js
from jaxshell.assembly.sparsity import SparsityPattern
from jaxshell.methods.balance import Balance
from jaxshell.numerics.rotations import exp
from jaxshell.solvers.iteration import DIVERGED, SINGULAR, STAGNATED, SUCCESSFUL, Linear, Problem, Turning
from jaxshell.solvers.linear_solver import Dense
from jaxshell.solvers.newton import Newton, attach_derivative

PATTERN = SparsityPattern(2, np.array([0, 2, 4]), np.array([0, 1, 0, 1]))
SOLVER = Dense()
ROTATES = jnp.array([False, True])
SIZE = 10.0


def residual(u, load):
    """x³ + x + θ = load, θ + sin(x)/2 = 1: a displacement x and a rotation θ."""
    x, theta = u
    return jnp.stack([x**3 + x + theta - load, theta + 0.5 * jnp.sin(x) - 1.0])


def problem(function) -> Problem:
    return Problem(
        lambda u: Balance(function(u), jnp.array(10.0), jnp.array(1.0), jnp.array(10.0)),
        lambda u, last: jax.jacfwd(function)(u).reshape(-1),
        lambda nodal: nodal,
    )


def linear() -> Linear:
    return Linear(SOLVER, SOLVER.prepare(PATTERN))


@eqx.filter_jit
def solve(newton: Newton, load, guess, calm=None):
    equations, solver = problem(lambda u: residual(u, load)), linear()
    return newton.solve(equations, guess, SIZE, ROTATES, solver, solver.memory(newton), calm)[0]


def root(load) -> np.ndarray:
    u = np.zeros(2)
    for _ in range(60):
        u -= np.linalg.solve(np.asarray(jax.jacfwd(residual)(jnp.asarray(u), load)), residual(u, load))
    return u


GUESS = jnp.array([0.5, 0.8])


def test_it_stops_without_a_solve_too_many():
    """The contraction tells that the next correction is small; the paper's ‖ΔQ‖ solves once more for it."""
    exact = root(4.0)
    for reuse in (False, True):
        found = solve(Newton(reuse=reuse), 4.0, GUESS)
        assert int(found.result) == SUCCESSFUL
        np.testing.assert_allclose(found.free, exact, atol=1e-8)
    by_norm = solve(Newton(tolerance=1e-6, criterion="norm", reuse=False), 4.0, GUESS)
    assert int(by_norm.result) == SUCCESSFUL
    np.testing.assert_allclose(by_norm.free, exact, atol=1e-10)
    predicted, norm = (solve(Newton(1e-6, criterion=name, reuse=False), 4.0, GUESS) for name in ("predicted", "norm"))
    np.testing.assert_allclose(predicted.free, exact, atol=1e-6 * SIZE)
    assert int(predicted.iterations) == int(norm.iterations) - 1


@pytest.mark.parametrize("reuse", [False, True])
def test_it_starts_where_less_is_unbalanced(reuse):
    """The calm start is taken where the guess is far off, or no number, and only if it is nearer to balance."""
    newton = Newton(reuse=reuse)
    near, far, farther = jnp.asarray(root(4.0)) + 1e-3, jnp.array([4.0, 0.5]), jnp.array([9.0, 0.5])
    alone = {name: solve(newton, 4.0, at) for name, at in (("near", near), ("far", far))}
    for guess, calm, taken in (
        (far, near, "near"), (jnp.array([jnp.nan, 0.0]), near, "near"), (far, farther, "far"), (near, far, "near"),
    ):  # fmt: skip
        found = solve(newton, 4.0, guess, calm)
        assert int(found.result) == SUCCESSFUL and int(found.iterations) == int(alone[taken].iterations)
        np.testing.assert_array_equal(found.free, alone[taken].free)
    # A guess that is about in balance is not compared, though the other one were nearer.
    assert not np.array_equal(solve(newton, 4.0, near + 0.02, near).free, alone["near"].free)


def test_at_the_root_nothing_is_solved():
    assert int(solve(Newton(), 4.0, jnp.asarray(root(4.0))).iterations) <= 1


def test_a_kept_factorization_gives_the_same_root():
    fresh, kept = (solve(Newton(reuse=reuse), 4.0, jnp.asarray(root(3.8))) for reuse in (False, True))
    assert int(kept.result) == SUCCESSFUL
    np.testing.assert_allclose(kept.free, fresh.free, atol=1e-8)
    assert int(kept.factorizations) < int(kept.iterations)
    assert int(fresh.factorizations) == int(fresh.iterations)


def test_round_off_ends_the_iteration_with_kept_factorizations():
    """Asked for less than round-off allows, corrections that shrink no more are taken for what they are."""

    def noisy(u):
        return residual(u, 4.0) + 1e-12 * jnp.sin(1e14 * u)

    solver = linear()
    equations = problem(noisy)._replace(matrix=lambda u, _: jax.jacfwd(residual)(u, 4.0).reshape(-1))
    found, _ = Newton(tolerance=1e-16).solve(equations, GUESS, SIZE, ROTATES, solver, solver.memory(Newton()))
    assert int(found.result) == SUCCESSFUL and int(found.iterations) < 20
    np.testing.assert_allclose(found.free, root(4.0), atol=1e-10)


def test_a_step_whose_kept_factorization_is_poor_ends_with_its_own():
    """The matrix kept is that of a state far away: one look at it, then fresh ones, and as good a root."""
    solver = linear()

    def after(memory, load, guess):
        equations = problem(lambda u: residual(u, load))
        return Newton().solve(equations, guess, SIZE, ROTATES, solver, memory)

    _, memory = after(solver.memory(Newton()), 1e3, jnp.asarray(root(1e3)) + 0.01)
    found, _ = after(memory, 4.0, GUESS)
    assert int(found.result) == SUCCESSFUL and 0 < int(found.factorizations) <= 4
    np.testing.assert_allclose(found.free, root(4.0), atol=1e-10)


@pytest.mark.parametrize("turns", [True, False])
def test_a_kept_factorization_turns_with_the_nodes(turns):
    """A stiff node that has turned has the matrix R K Rᵀ: the factorization of K solves with it at once."""
    pattern = SparsityPattern(6, np.arange(0, 37, 6), np.tile(np.arange(6), 6))
    solver = Linear(SOLVER, SOLVER.prepare(pattern))
    K = np.diag([1e4, 1e4, 1.0, 3.0, 3.0, 30.0]) + 0.1
    load, rotates = jnp.array([3.0, -2.0, 0.5, 0.1, 0.0, 0.2]), jnp.arange(6) >= 3

    def turned(R, free):
        return jnp.einsum("nij,nkj->nki", R, free.reshape(-1, 2, 3)).reshape(-1)

    def step(R, memory):
        R = jnp.asarray(R)[None]
        both = jnp.kron(jnp.eye(2), R[0])
        matrix = both @ K @ both.T
        balance = Balance(jnp.zeros(6), jnp.array(10.0), jnp.array(1.0), jnp.array(10.0))
        turning = Turning(R, turned, jnp.zeros((0, 6))) if turns else None
        equations = Problem(
            lambda u: balance._replace(residual=matrix @ u - load),
            lambda u, _: matrix.reshape(-1),
            lambda r: r,
            turning,
        )
        memory = solver.memory(Newton(), turning) if memory is None else memory
        found, memory = Newton().solve(equations, jnp.zeros(6), SIZE, rotates, solver, memory)
        np.testing.assert_allclose(found.free, np.linalg.solve(matrix, load), atol=1e-9)
        return found, memory

    _, memory = step(np.eye(3), None)
    found, memory = step(exp(jnp.array([0.3, -0.2, 0.1])), memory)
    if turns:
        assert int(found.factorizations) == 0 and int(found.iterations) <= 2
    else:
        assert int(found.factorizations) > 0


def test_rotations_of_an_iterate_are_bounded():
    far = jnp.array([0.5, 30.0])
    found = solve(Newton(max_rotation=0.5, max_iterations=2, reuse=False), 4.0, far)
    assert abs(float(found.free[1]) - 30.0) <= 2 * 0.5 + 1e-12
    assert int(found.result) == STAGNATED and int(found.iterations) == 2
    assert int(solve(Newton(max_rotation=0.5, max_iterations=100), 4.0, far).result) == SUCCESSFUL


@pytest.mark.parametrize("reuse", [False, True])
def test_one_iterate_with_a_nearly_singular_matrix_is_no_failure(reuse):
    """θ³/3 = θ has the slope 1e-9 next to θ = 1: that correction is cut to the largest rotation, the next are good."""
    newton, handle = Newton(reuse=reuse), linear()

    @jax.jit
    def run(guess):
        equations = problem(lambda u: jnp.stack([u[0] - 1.0, u[1] ** 3 / 3.0 - u[1]]))
        return newton.solve(equations, guess, SIZE, ROTATES, handle, handle.memory(newton))[0]

    found = run(jnp.array([0.5, 1.0 + 5e-10]))
    assert int(found.result) == SUCCESSFUL
    np.testing.assert_allclose(found.free, [1.0, np.sqrt(3.0)], atol=1e-8)


@pytest.mark.parametrize(
    ("function", "result"),
    [
        (lambda u: jnp.stack([u[0] + u[1] - 1.0, u[0] + u[1] - 2.0]), SINGULAR),
        (lambda u: jnp.stack([u[0] * jnp.nan, u[1]]), DIVERGED),
        (lambda u: jnp.stack([1e-9 * u[0] - 1e7, u[1]]), DIVERGED),
        (lambda u: jnp.stack([u[0], 1e-9 * u[1] - 1e7]), DIVERGED),
        (lambda u: jnp.stack([u[0] ** 2 + 1.0, u[1]]), STAGNATED),
    ],
    ids=["singular", "not a number", "far away", "far turned", "without a root"],
)
def test_failures_are_results_with_finite_numbers(function, result):
    newton, handle = Newton(max_iterations=12), linear()

    @jax.jit
    def run(guess):
        return newton.solve(problem(function), guess, SIZE, ROTATES, handle, handle.memory(newton))[0]

    found = run(GUESS)
    assert int(found.result) == result
    assert np.all(np.isfinite(found.free))


def test_the_derivative_is_the_implicit_functions():
    """du/dload = K⁻¹ (1, 0), forward and reverse, whatever the iteration did."""

    def solution(load):
        u = jax.lax.stop_gradient(solve(Newton(tolerance=1e-12), load, GUESS).free)
        return attach_derivative(linear(), residual, lambda u, load: jax.jacfwd(residual)(u, load).reshape(-1), u, load)

    K = np.asarray(jax.jacfwd(residual)(jnp.asarray(root(4.0)), 4.0))
    expected = np.linalg.solve(K, [1.0, 0.0])
    np.testing.assert_allclose(jax.jacfwd(solution)(4.0), expected, rtol=1e-10)
    np.testing.assert_allclose(jax.jacrev(solution)(4.0), expected, rtol=1e-10)


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"tolerance": 0.0}, "tolerance .* 0"),
        ({"tolerance": float("nan")}, "tolerance .* nan"),
        ({"max_iterations": 0}, "max_iterations .* 0"),
        ({"max_rotation": -1.0}, "max_rotation .* -1"),
        ({"criterion": "energy"}, "criterion .* 'energy'"),
    ],
)
def test_settings_out_of_range_are_refused(values, named):
    with pytest.raises(ValueError, match=named):
        Newton(**values)


def i_beam(cells=4):
    """Nodes and triangles of an I-beam of plates, 2 m long."""
    places, triangles = {}, []
    strips = [[(-0.05, z), (0.0, z), (0.05, z)] for z in (-0.1, 0.1)] + [[(0.0, -0.1), (0.0, 0.0), (0.0, 0.1)]]
    for strip in strips:
        for (y0, z0), (y1, z1) in itertools.pairwise(strip):
            for k in range(cells):
                ends = 2.0 * k / cells, 2.0 * (k + 1) / cells
                corners = [(ends[0], y0, z0), (ends[1], y0, z0), (ends[1], y1, z1), (ends[0], y1, z1)]
                a, b, c, d = (places.setdefault(corner, len(places)) for corner in corners)
                triangles += [[a, b, c], [a, c, d]]
    return list(places), triangles


def test_stiff_shells_that_hardly_move_close_their_energy():
    """Corrections of 1e-8 of the size are no small part of a motion of 1e-4 of it: energy asks for more."""
    mesh = js.Mesh(*i_beam())
    tip, root = (mesh.nodes_where(lambda x, at=at: x[0] == at) for at in (2.0, 0.0))
    loads = [js.NodalForce(tip, [0, 0, 100.0 / len(tip)])]
    beam = js.Scene(mesh, js.Section(0.005, 210e9, 0.3, 7850.0), [js.clamped(root)], loads)
    run = js.simulate(beam, js.EnergyMomentum(), dt=1e-3, t_end=0.03)
    balance = np.abs(run.energy.total - run.energy.external_work).max() / run.energy.total.max()
    print(f"I-beam: moves {np.abs(run.displacements).max():.1e}, balance {balance:.1e}")
    assert np.abs(run.displacements).max() < 3e-4 and balance < 1e-9
