"""The paper's time integration: a step's tangent, order, conservation, dissipation, exact motions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.sparse import csr_matrix
from test_methods import ends, order, strip

import jaxshell as js
from jaxshell.assembly.discretised import Model
from jaxshell.assembly.structure import structure_of
from jaxshell.assembly.tables import analyse
from jaxshell.elements.inertia import Spins
from jaxshell.methods.base import _problem
from jaxshell.methods.generalized_energy_momentum import GEMState
from jaxshell.methods.method import Solvers
from jaxshell.model.generators import rectangle
from jaxshell.model.loads.pressure import pressure_force, pressure_stiffness
from jaxshell.numerics.rotations import exp
from jaxshell.solvers.iteration import Linear
from jaxshell.solvers.newton import Newton

SECTION = js.Section(0.02, 1e6, 0.3, 1000.0)
METHODS = {
    "EMC": js.GeneralizedEnergyMomentum(),
    "EDMC1": js.GeneralizedEnergyMomentum(spectral_radius=0.8),
    "EDMC2": js.GeneralizedEnergyMomentum(dissipation=0.05),
    "both": js.GeneralizedEnergyMomentum(spectral_radius=0.3, dissipation=0.2),
}


def relative_error(found, exact) -> float:
    return float(np.abs(np.asarray(found) - np.asarray(exact)).max() / np.abs(np.asarray(exact)).max())


# --- the step's equations ---------------------------------------------------------------------------------


def loaded_strip() -> js.Scene:
    """Four triangles with a clamped node, a support that moves, a follower pressure, a force and a moment."""
    mesh = rectangle(1.0, 0.4, [2, 1])
    return js.Scene(
        mesh,
        SECTION,
        [
            js.clamped([0]),
            js.Support([1], ("ux", "uz"), displacement=[0.01, 0.03], history=js.History.ramp(1.0)),
            js.symmetry([2], "y"),
        ],
        [
            js.Pressure(500.0, js.History.ramp(0.5)),
            js.NodalForce([5], [1.0, 2.0, 3.0]),
            js.NodalMoment([4], [0.1, 0.2, 0.3]),
        ],
    )


@pytest.fixture(scope="module")
def equations():
    """inertia → compiled function (ρ∞, ξ, key) → residual's `jax.jacfwd`, both tangents."""
    scene = loaded_strip()
    tables, pattern = analyse(structure_of(scene))
    solver = js.Dense()
    handle = solver.prepare(pattern)

    def matrices(inertia):
        @jax.jit
        def compute(rho, xi, seed):
            model = Model.build(scene, tables)
            method = js.GeneralizedEnergyMomentum(rho, xi, inertia=inertia)
            keys = iter(jax.random.split(jax.random.PRNGKey(seed), 9))
            n, m = model.x0.shape[0], tables.triangles.shape[0]

            def random(scale, *shape):
                return scale * jax.random.normal(next(keys), shape)

            R = jax.vmap(exp)(random(0.3, n, 3))
            points = {"seven_point": (m, 7), "traditional": (n,), "none": None}[inertia]
            spins = None
            if points is not None:
                at_points = jax.vmap(exp)(random(1.0, m * 7, 3)).reshape(m, 7, 3, 3) if points != (n,) else R
                spins = Spins(at_points, random(5.0, *points, 3), random(50.0, *points, 3))
            x, v, a = model.x0 + random(0.05, n, 3), random(1.0, n, 3), random(10.0, n, 3)
            state = GEMState(jnp.array(0.2), x, R, v, a, spins, jnp.array(0.0), jnp.zeros((4, n, 6)))
            free = jax.random.normal(next(keys), tables.free.shape)
            free = free * jnp.where(tables.free % 6 >= 3, 0.3, 0.05)
            found = []
            for tangent in ("closed_form", "autodiff"):
                solvers = Solvers(Newton(), Linear(solver, handle), tangent)
                held = model.held_increment(state.time, 0.05, method.size_of_turn)
                problem = _problem(method, model, state, method.begin(model, state, 0.05), held, solvers)
                found.append(problem.matrix(free, free))
            return jax.jacfwd(lambda free: problem.free(problem.balance(free).residual))(free), *found

        return compute

    def to_dense(values):
        n = pattern.size
        return csr_matrix((np.asarray(values), pattern.indices.array, pattern.indptr.array), (n, n)).toarray()

    return {name: matrices(name) for name in ("seven_point", "traditional", "none")}, to_dense, tables


@pytest.mark.parametrize(
    "inertia", ["seven_point", *(pytest.param(name, marks=pytest.mark.slow) for name in ("traditional", "none"))]
)
@pytest.mark.parametrize(("rho", "xi"), [(1.0, 0.0), (0.8, 0.0), (1.0, 0.05), (0.0, 0.3)])
def test_tangent_of_a_step(inertia, rho, xi, equations):
    """Elements, assembly, supports (held, moving, symmetric), follower pressure; eqs. (87)-(100)."""
    compute, to_dense, tables = equations
    turns = np.asarray(tables.free) % 6 >= 3
    jacobian, *matrices = compute[inertia](rho, xi, 1)
    jacobian = np.asarray(jacobian)
    for values in matrices:
        error = np.abs(to_dense(values) - jacobian)
        # Forces and moments by displacements and by rotations have different units: each on its own scale.
        for rows in (turns, ~turns):
            for columns in (turns, ~turns):
                block = np.ix_(rows, columns)
                assert error[block].max() < 1e-11 * np.abs(jacobian[block]).max()


def test_pressure_stiffness_is_the_derivative():
    x = jnp.asarray(np.random.default_rng(0).normal(size=(3, 3)))

    def force(dq):
        return pressure_force(x + dq.reshape(3, 2, 3)[:, 0], 2.5).reshape(18)

    assert relative_error(pressure_stiffness(x, 2.5), jax.jacfwd(force)(jnp.zeros(18))) < 1e-13


# --- motions with known answers ---------------------------------------------------------------------------


def plate(velocity=(0.0, 0.0, 0.0), spin=(0.0, 0.0, 0.0), pulse=0.0, gravity=0.0) -> js.Scene:
    """A free plate; `pulse` scales a force on a corner, until t = 0.2, that throws it off, bends and twists it."""
    mesh = rectangle(0.6, 0.4, [3, 2])
    history = js.History([0.0, 0.1, 0.2], [0.0, pulse, 0.0])
    loads = [js.NodalForce([11], [0.0, 6.0, 20.0], history), js.Gravity([0.0, 0.0, -gravity])]
    initial = js.Initial.rigid(mesh, velocity, spin)
    return js.Scene(mesh, SECTION, (), loads, initial=initial, watch={"corner": (0, "uz")})


def run(scene, method, dt, t_end, **options) -> js.Solution:
    """Steps in multiples of 50 with 50 between frames: one compiled program per method."""
    return js.simulate(scene, method, dt=dt, t_end=t_end, save_every=50, **options)


@pytest.mark.slow
def test_free_fall():
    """Under gravity every node falls g t²/2: exactly, if the accelerations start with g."""
    scene, fallen = plate(gravity=9.81), -0.5 * 9.81 * np.linspace(0.0, 0.5, 51) ** 2
    consistent = run(scene, METHODS["EDMC1"], 0.01, 0.5)
    np.testing.assert_allclose(consistent.watched["corner"], fallen, atol=1e-11)
    assert consistent.energy.external_work[-1] == pytest.approx(float(consistent.energy.total[-1]), rel=1e-9)
    from_zero = js.GeneralizedEnergyMomentum(spectral_radius=0.8, initial_acceleration="zero")
    lag = np.abs(np.asarray(run(scene, from_zero, 0.01, 0.5).watched["corner"]) - fallen)
    assert 1e-5 < lag.max() < 1e-2


def test_momenta_and_energy_of_a_rigid_body():
    """The plate's own: M v, I ω about the centre of mass plus x × M v, with the director's rotary inertia."""
    velocity, spin = np.array([1.0, 2.0, 3.0]), np.array([0.5, -0.7, 0.9])
    a, b, h, rho = 0.6, 0.4, 0.02, 1000.0
    mass = rho * h * a * b
    director = mass * h**2 / 12
    # A thin plate's directors have no inertia about the normal, so that I_z is that of the mid-surface.
    inertia = np.diag([mass * b**2 / 12 + director, mass * a**2 / 12 + director, mass * (a**2 + b**2) / 12])
    centre = np.array([a / 2, b / 2, 0.0])
    solution = run(plate(velocity, spin), METHODS["EMC"], 0.001, 0.05)
    np.testing.assert_allclose(solution.momentum.linear[0], mass * velocity, rtol=1e-13)
    angular = inertia @ spin + mass * np.cross(centre, velocity)
    np.testing.assert_allclose(solution.momentum.angular[0], angular, rtol=1e-12)
    kinetic = 0.5 * (mass * velocity @ velocity + spin @ inertia @ spin)
    assert float(solution.energy.kinetic[0]) == pytest.approx(kinetic, rel=1e-12)
    assert float(solution.energy.strain[0]) == 0.0
    np.testing.assert_allclose(solution.momentum.linear[-1], mass * velocity, rtol=1e-12)


@pytest.fixture(scope="module")
def flights():
    """One second of flight by each method, the forcing over after 0.2 s."""
    return {name: run(plate(pulse=1.0), method, 0.002, 1.0) for name, method in METHODS.items()}


@pytest.mark.parametrize("name", METHODS)
def test_linear_momentum_is_the_impulse(name, flights):
    """The impulse is 0.1 s times the largest force: the mid-point force integrates the ramps exactly."""
    momentum = np.asarray(flights[name].momentum.linear)[100:]
    impulse = np.broadcast_to([0.0, 0.6, 2.0], momentum.shape)
    if name == "EMC" or name == "EDMC2":
        np.testing.assert_allclose(momentum, impulse, atol=1e-13 * 2.0)
    else:
        # With αf ≠ ½ the weights of a step's two ends differ, and what is left dies out like ρ∞ⁿ.
        np.testing.assert_allclose(momentum[100:], impulse[100:], atol=1e-10 * 2.0)


def test_emc_keeps_energy_and_angular_momentum_to_second_order(flights):
    coarse = flights["EMC"]
    fine = run(plate(pulse=1.0), METHODS["EMC"], 0.001, 1.0)
    drift = {}
    for solution, after in ((coarse, 100), (fine, 200)):
        energy = np.asarray(solution.energy.total)[after:]
        angular = np.asarray(solution.momentum.angular)[after:]
        drift[after] = np.ptp(energy) / energy[0], np.abs(angular - angular[0]).max() / np.abs(angular).max()
    assert np.asarray(coarse.energy.strain).max() > 0.05 * np.asarray(coarse.energy.total).max()
    assert drift[100][0] < 1e-3 and drift[100][1] < 1e-4
    assert drift[200][0] < 0.5 * drift[100][0] and drift[200][1] < 0.5 * drift[100][1]


@pytest.mark.parametrize("name", ["EDMC1", "EDMC2", "both"])
def test_edmc_loses_energy_and_keeps_momentum(name, flights):
    energy = np.asarray(flights[name].energy.total)[100:]
    means = energy[:400].reshape(8, 50).mean(axis=1)
    assert np.all(np.diff(means) < 0) and means[-1] < 0.999 * means[0]
    angular = np.asarray(flights[name].momentum.angular)[150:]
    assert np.abs(angular - angular[0]).max() < 2e-3 * np.abs(angular).max()


@pytest.mark.parametrize("name", ["EMC", "EDMC1"])
def test_second_order(name):
    found = ends(strip(force=(0.1, 0.1, 2.0)), METHODS[name], 1.0, 100)
    assert order(*found) == pytest.approx(2.0, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("inertia", ["traditional", "none"])
def test_rotary_inertia_of_a_thin_shell_is_a_correction(inertia, flights):
    """(h/L)² of the translational inertia: the motions agree to a per cent, and not to round-off."""
    method = js.GeneralizedEnergyMomentum(inertia=inertia)
    solution = run(plate(pulse=1.0), method, 0.002, 1.0)
    exact = np.asarray(flights["EMC"].watched["corner"])
    error = np.abs(np.asarray(solution.watched["corner"]) - exact).max() / np.abs(exact).max()
    assert 1e-8 < error < 2e-2


@pytest.mark.slow
def test_autodiff_and_closed_form_give_the_same_run():
    """With ρ∞ < 1 and ξ > 0, fifty steps to a tenth of a second."""
    closed, autodiff = (
        run(plate(pulse=1.0), METHODS["both"], 0.002, 0.1, tangent=tangent) for tangent in ("closed_form", "autodiff")
    )
    scale = np.abs(np.asarray(closed.displacements)).max()
    np.testing.assert_allclose(autodiff.displacements, closed.displacements, atol=1e-10 * scale)


def test_work_of_a_moving_support_is_the_energy():
    """A strip lifted at one end by a moving support, at once with its velocity: K + S gains the work of the reactions."""
    mesh = rectangle(1.0, 0.4, [2, 1])
    lift = js.Support([0, 1], ("uz",), displacement=0.2, history=js.History([0.0, 0.2, 0.4], [0.0, 0.6, 1.0]))
    scene = js.Scene(mesh, SECTION, [lift], watch={"end": (0, "uz")})
    solution = run(scene, METHODS["EMC"], 0.001, 0.5)
    times, lifted = np.asarray(solution.times), np.asarray(solution.watched["end"])
    np.testing.assert_allclose(lifted, 0.2 * np.interp(times, [0, 0.2, 0.4], [0, 0.6, 1.0]), atol=1e-13)
    energy, work = np.asarray(solution.energy.total), np.asarray(solution.energy.external_work)
    assert np.abs(energy - energy[0] - work).max() < 2e-3 * work.max()


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"spectral_radius": 1.2}, "spectral_radius .* 1.2"),
        ({"spectral_radius": -0.1}, "spectral_radius .* -0.1"),
        ({"spectral_radius": float("nan")}, "spectral_radius .* nan"),
        ({"dissipation": -0.01}, "dissipation .* -0.01"),
        ({"initial_acceleration": "none"}, "initial_acceleration .* 'none'"),
        ({"inertia": "lumped"}, "inertia .* 'lumped'"),
    ],
)
def test_parameters_out_of_range_are_refused(values, named):
    with pytest.raises(ValueError, match=named):
        js.GeneralizedEnergyMomentum(**values)
