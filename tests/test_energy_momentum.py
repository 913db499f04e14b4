"""EnergyMomentum: the element's identities and tangent, exact balances, order, rigid motion, objectivity.

Runs share one free strip of eight elements, so that each variant of the method compiles once; they go in
multiples of 50 steps with a frame every 50. Long evidence is in test_energy_momentum_slow.py.
"""

import equinox as eqx
import isotropic
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import jaxshell as js
from jaxshell.elements import corotational, energy_momentum
from jaxshell.elements.director_inertia import DirectorMotion
from jaxshell.methods.energy_momentum import ElementData, Shared
from jaxshell.model.loads.pressure import mean_pressure_force

NEWTON = js.Newton(tolerance=1e-13)
CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 0.1, 0.2], [0.3, 0.9, -0.1]])


# --- one element ------------------------------------------------------------------------------------------


def turn(rng, size) -> np.ndarray:
    return Rotation.from_rotvec(size * rng.normal(size=3)).as_matrix()


def one_element(seed, step_size=0.1):
    """An element in a deformed and turned state with a step: (method data, x, R, u)."""
    rng = np.random.default_rng(seed)
    element = isotropic.element(jnp.asarray(CORNERS), *(jnp.asarray(v) for v in (0.05, 200.0, 0.3, 2.0)))
    rigid = turn(rng, 1.0)
    x = jnp.asarray((CORNERS + 0.05 * rng.normal(size=(3, 3))) @ rigid.T)
    R = jnp.asarray(np.stack([turn(rng, 0.2) @ rigid for _ in range(3)]))
    u = jnp.asarray(step_size * rng.normal(size=(3, 6)) + np.tile(rng.normal(size=6), (3, 1)))
    start = energy_momentum.StepStart(energy_momentum.edges_of(x), corotational.kinematics(x, R, element))
    normal = element.frame[2]
    motion = DirectorMotion(
        jnp.asarray(rng.normal(size=(3, 3))), R @ normal, jnp.asarray(rng.normal(size=(3, 3, 3))) @ normal
    )
    return ElementData(element, start, motion), x, R, u


def total_force(method, data, x, R, shared):
    def force(u):
        u = u.reshape(3, 6)
        found = method.element_forces(jax.vmap(method.node_motion)(u, x, R), u, data, shared)
        return found.elastic + found.inertial

    return force


@pytest.mark.parametrize(
    ("dissipation", "mixed"),
    [(0.0, False), (0.1, False), (0.1, True)],
)
def test_closed_form_tangent_is_the_derivative(dissipation, mixed):
    """Three states each; a mixed iteration's tangent is the derivative at fixed excess."""
    method, rng = js.EnergyMomentum(dissipation), np.random.default_rng(5)
    excess = 0.1 * jnp.asarray(rng.normal(size=12)) if mixed else None
    shared = Shared(0.1, method.dissipation)

    @jax.jit
    def both(data, x, R, u):
        found = method.element_tangent(jax.vmap(method.node_motion)(u, x, R), u, data, shared)
        return found, jax.jacfwd(total_force(method, data, x, R, shared))(u.reshape(18))

    for seed in range(3):
        data, x, R, u = one_element(seed)
        found, expected = both(data._replace(excess=excess), x, R, u)
        assert np.abs(found - expected).max() < 1e-11 * np.abs(expected).max()


@pytest.mark.parametrize("dissipation", [0, 0.2])
@pytest.mark.parametrize("step_size", [1e-4, 0.1, 0.5])
def test_forces_do_the_work_of_the_strain_energy_without_resultant_and_moment(step_size, dissipation):
    """Dπ(q_m)ᵀs on (Δx, θ) gives ΔS + ξ ΔeᵀK̂Δe, and no force or moment is left, at any size of the step."""
    data, x, R, u = one_element(1, step_size)
    motion = jax.vmap(js.EnergyMomentum().node_motion)(u, x, R)
    state = energy_momentum.evaluate(data.start, motion.x, motion.R, u, data.element, dissipation)
    forces = energy_momentum.elastic_forces(state)
    end = corotational.kinematics(motion.x, motion.R, data.element).deformations
    start = data.start.kin.deformations
    energy = corotational.strain_energy
    expected = energy(end, data.element) - energy(start, data.element)
    expected += 2 * dissipation * energy(end - start, data.element)
    scale = energy(end, data.element) + energy(start, data.element)
    assert abs(jnp.sum(forces * u.reshape(18)) - expected) < 1e-13 * scale
    forces = forces.reshape(3, 2, 3)
    middle = x + 0.5 * u[:, :3]
    moment = jnp.sum(jnp.cross(middle, forces[:, 0]) + forces[:, 1], axis=0)
    assert np.abs(jnp.sum(forces[:, 0], axis=0)).max() < 1e-14 * np.abs(forces).max()
    assert np.abs(moment).max() < 1e-13 * np.abs(forces).max()


def test_increments_of_the_invariants_are_bilinear():
    """π₁ - π₀ = Dπ(q_m)·(Δx, θ): the increments in the state against the difference of the invariants."""
    data, x, R, u = one_element(2)
    motion = jax.vmap(js.EnergyMomentum().node_motion)(u, x, R)
    state = energy_momentum.evaluate(data.start, motion.x, motion.R, u, data.element, 0)

    def invariants(x, R):
        edges = energy_momentum.edges_of(x)
        return edges @ edges.T, jnp.einsum("kab,ia->kib", R, edges)

    metric, seen = (end - start for end, start in zip(invariants(motion.x, motion.R), invariants(x, R), strict=True))
    y = jnp.linalg.solve(state.A, jnp.swapaxes(state.turned, 1, 2))
    turned = jnp.einsum("kba,kbi->kia", 0.5 * (R + motion.R), y)
    np.testing.assert_allclose(turned, seen, atol=1e-14)
    np.testing.assert_allclose(state.d_metric, [metric[0, 0], metric[0, 1], metric[1, 1]], atol=1e-14)


@pytest.mark.slow
def test_no_motion_gives_the_internal_force_with_its_derivatives():
    """Δπ = 0: the guarded quotient leaves value, first and second derivatives finite, forward and reverse."""
    data, x, R, _ = one_element(3)
    shared = Shared(0.1, 0)
    method = js.EnergyMomentum()

    def elastic(u):
        motion = jax.vmap(method.node_motion)(u.reshape(3, 6), x, R)
        return method.element_forces(motion, u.reshape(3, 6), data, shared).elastic

    still = jnp.zeros(18)
    expected = np.asarray(corotational.internal_force(x, R, data.element))
    np.testing.assert_allclose(elastic(still), expected, rtol=1e-13, atol=1e-13 * np.abs(expected).max())

    @jax.jit
    def derivatives(u):
        second = jax.jacfwd(jax.jacrev(lambda u: jnp.sum(elastic(u) * expected)))(u)
        return jax.jacfwd(elastic)(u), jax.jacrev(elastic)(u), second

    forward, reverse, second = derivatives(still)
    np.testing.assert_allclose(forward, reverse, atol=1e-12 * np.abs(forward).max())
    assert np.isfinite(second).all()


def test_constant_pressure_on_a_closed_surface_works_on_the_volume():
    """On an octahedron p ΔV is exact for a step of any size, since the mean normal integrates the path."""
    rng = np.random.default_rng(4)
    nodes = np.concatenate([np.eye(3), -np.eye(3)])
    faces = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])
    moved = 0.5 * rng.normal(size=nodes.shape)

    def volume(x):
        return np.linalg.det(x[faces]).sum() / 6.0

    forces = jax.vmap(mean_pressure_force, in_axes=(0, 0, None))(nodes[faces], moved[faces], 7.0)
    work = np.sum(np.asarray(forces)[:, :, :3] * moved[faces])
    assert volume(nodes) > 0
    assert work == pytest.approx(7.0 * (volume(nodes + moved) - volume(nodes)), rel=1e-13)


# --- a free strip -----------------------------------------------------------------------------------------

LENGTH, WIDTH, THICKNESS, DENSITY = 1.0, 0.4, 0.05, 1000.0


def strip(young_modulus=1e6, loads=(), initial=None, supports=(), rotation=None, thinner=1.0) -> js.Scene:
    """A strip of eight elements in the x-y plane, or that plane turned by `rotation` (3, 3).

    `thinner` divides the thickness at the same mass and the same bending stiffness.
    """
    columns = 4
    x, y = (k.ravel() for k in np.meshgrid(np.arange(columns + 1), np.arange(2), indexing="ij"))
    nodes = np.stack([LENGTH * x / columns, WIDTH * y, 0.0 * x], axis=1)
    nodes = nodes if rotation is None else nodes @ rotation.T
    mesh = js.Mesh(nodes, js.structured_triangles(columns, 1))
    section = js.Section(THICKNESS / thinner, young_modulus * thinner**3, 0.3, DENSITY * thinner)
    if initial is None:
        initial = js.Initial.rigid(mesh)
    return js.Scene(mesh, section, supports, loads, initial, watch={"corner": (0, "uz")})


def pulse(rotation=None, force=1.0, moment=1.0):
    """Forces and a moment that rise and fall within 0.1; a factor 0 leaves them out, but not of the program."""
    turned = np.eye(3) if rotation is None else rotation
    history = js.History([0.0, 0.05, 0.1], [0.0, 1.0, 0.0])
    return [
        js.NodalForce([0, 9], force * np.array([[60.0, 0.0, 80.0], [0.0, 30.0, -60.0]]) @ turned.T, history),
        js.NodalMoment([4], moment * (turned @ np.array([2.0, 3.0, -1.0])), history),
    ]


def run(scene, method=None, count=100, duration=0.2, **options):
    options = {"newton": NEWTON, "linear_solver": js.Dense(), "save_every": 50} | options
    return js.simulate(scene, method or js.EnergyMomentum(), dt=duration / count, t_end=duration, **options)


def drift(history, first=0) -> float:
    """Largest change of a history (k,) or (k, 3) from its entry `first` on, relative to that entry."""
    history = np.asarray(history)[first:].reshape(len(history) - first, -1)
    return np.abs(history - history[0]).max() / np.linalg.norm(history[0])


def after_pulse(solution) -> int:
    return int(np.flatnonzero(np.asarray(solution.times) > 0.1 + 1e-9)[0])


@pytest.fixture(scope="module")
def flight():
    return run(strip(loads=pulse()))


def test_energy_is_the_work_of_the_loads(flight):
    balance = np.asarray(flight.energy.total - flight.energy.external_work)
    assert np.abs(balance).max() < 1e-12 * np.max(np.asarray(flight.energy.total))
    assert np.max(np.asarray(flight.energy.strain)) > 0.01 * np.max(np.asarray(flight.energy.total))


def test_free_flight_conserves_energy_and_momenta(flight):
    free = after_pulse(flight)
    assert drift(flight.energy.total, free) < 1e-12
    assert drift(flight.momentum.linear, free) < 1e-13
    assert drift(flight.momentum.angular, free) < 1e-12
    assert np.all(np.asarray(flight.energy.dissipated) == 0)


def test_momenta_are_the_impulses_of_forces_and_moments(flight):
    """ΔL = ∫F dt, ΔJ = ∫(x × F + M) dt by the scheme's own mid-points; the forces' part from a run without moment."""
    impulse = 0.05 * np.array([60.0, 30.0, 20.0])
    np.testing.assert_allclose(np.asarray(flight.momentum.linear)[-1], impulse, rtol=1e-12)
    alone = run(strip(loads=pulse(force=0.0)))
    np.testing.assert_allclose(np.asarray(alone.momentum.angular)[-1], 0.05 * np.array([2.0, 3.0, -1.0]), rtol=1e-11)


def test_step_size_may_change_freely():
    steps = np.concatenate([np.full(30, 0.002), np.full(50, 0.0008), np.full(20, 0.005)])
    solution = js.simulate(
        strip(loads=pulse()), js.EnergyMomentum(), dt=steps, newton=NEWTON, linear_solver=js.Dense(), save_every=50
    )
    balance = np.asarray(solution.energy.total - solution.energy.external_work)
    balance = balance - balance[0]  # what the support's velocity brings at once
    assert np.abs(balance).max() < 1e-12 * np.max(np.asarray(solution.energy.total))
    assert drift(solution.momentum.angular, after_pulse(solution)) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("dissipation", [0.01, 0.3])
def test_dissipation_removes_exactly_what_it_records(dissipation):
    solution = run(strip(loads=pulse()), js.EnergyMomentum(dissipation))
    energy, free = solution.energy, after_pulse(solution)
    scale = np.max(np.asarray(energy.total))
    balance = np.asarray(energy.total + energy.dissipated - energy.external_work)
    assert np.abs(balance).max() < 1e-12 * scale
    assert np.all(np.diff(np.asarray(energy.dissipated))[1:] > 0)
    assert np.all(np.diff(np.asarray(energy.total))[free:] < 0)
    assert drift(solution.momentum.angular, free) < 1e-12
    assert np.asarray(energy.dissipated)[-1] > 1e-4 * scale


def test_another_dissipation_does_not_compile_again(monkeypatch):
    run(strip(loads=pulse()), js.EnergyMomentum(0.3))
    traced = []
    original = js.EnergyMomentum.begin
    monkeypatch.setattr(js.EnergyMomentum, "begin", lambda *a: traced.append(a) or original(*a))
    run(strip(loads=pulse()), js.EnergyMomentum(0.2))
    assert not traced


def test_no_dissipation_is_not_in_the_program():
    """A zero leaves no trace in a step; a traced number would."""
    data, x, R, u = one_element(0)

    def operations(dissipation):
        method = js.EnergyMomentum(dissipation)

        def force(number):
            held = eqx.tree_at(lambda m: m.dissipation, method, number) if method._dissipates else method
            return total_force(held, data, x, R, Shared(0.1, held.dissipation))(u)

        return len(jax.make_jaxpr(force)(0.5).jaxpr.eqns)

    assert js.EnergyMomentum().dissipation == 0
    assert operations(0.0) < operations(0.5)


@pytest.mark.parametrize("value", [-0.1, 0.6, np.nan])
def test_dissipation_out_of_range_is_refused(value):
    with pytest.raises(ValueError, match=str(value)):
        js.EnergyMomentum(value)


@pytest.mark.slow
def test_autodiff_tangent_gives_the_same_run(flight):
    other = run(strip(loads=pulse()), tangent="autodiff")
    np.testing.assert_allclose(other.displacements, flight.displacements, atol=1e-11)


def test_turned_scene_gives_the_turned_answer(flight):
    rotation = Rotation.from_rotvec([0.7, -1.1, 0.4]).as_matrix()
    turned = run(strip(loads=pulse(rotation), rotation=rotation))
    np.testing.assert_allclose(
        np.asarray(turned.displacements), np.asarray(flight.displacements) @ rotation.T, atol=1e-10 * LENGTH
    )
    np.testing.assert_allclose(turned.rotations, rotation @ np.asarray(flight.rotations) @ rotation.T, atol=1e-10)


@pytest.mark.slow
def test_prescribed_motion_and_pressure_balance():
    """One edge is moved sideways while a constant pressure acts: energy equals the work of both."""
    shake = js.Support([0, 1], ("uz",), 0.05, js.History([0.0, 0.05, 0.1], [0.0, 1.0, -1.0]))
    held = js.Support([0, 1], ("ux", "uy", "ry", "rz"))
    scene = strip(supports=[shake, held], loads=[js.Pressure(20.0), js.Gravity([0.0, 0.0, -2.0])])
    solution = run(scene)
    balance = np.asarray(solution.energy.total - solution.energy.external_work)
    balance = balance - balance[0]  # what the support's velocity brings at once
    assert np.abs(balance).max() < 1e-12 * np.max(np.asarray(solution.energy.total))
    assert float(solution.displacements[1, 0, 2]) == pytest.approx(-0.05, rel=1e-14)


@pytest.mark.slow
def test_second_order_with_the_limit_of_the_papers_scheme():
    """Both tend to one motion but for the rotary inertia, which they interpolate differently; it falls with h²."""

    def ends(method, thinner, counts):
        scene = strip(loads=pulse(), thinner=thinner)
        return [np.asarray(run(scene, method, count=n).displacements[-1]) for n in counts]

    coarse, middle, fine = ends(js.EnergyMomentum(), 1.0, (200, 400, 800))
    slope = np.log2(np.linalg.norm(coarse - middle) / np.linalg.norm(middle - fine))
    assert slope == pytest.approx(2.0, abs=0.1)
    apart = []
    for thinner in (2.0, 4.0):
        limits = [
            (4.0 * fine - coarse) / 3.0
            for coarse, fine in (
                ends(m, thinner, (400, 800)) for m in (js.EnergyMomentum(), js.GeneralizedEnergyMomentum())
            )
        ]
        apart.append(np.abs(limits[0] - limits[1]).max())
    assert apart[0] < 5e-5 * LENGTH
    assert apart[1] < 0.4 * apart[0]


# --- rigid motion -----------------------------------------------------------------------------------------

STIFF = 1e12
"""Young's modulus at which the strip stretches by 1e-8 at the spins below."""


def principal_inertia() -> np.ndarray:
    """Moments about x, y, z: the mid-surface's, exact because linear elements with a consistent mass carry linear
    velocities exactly, and ρh³/12 per area about x and y, since directors do not turn about themselves."""
    mass = DENSITY * THICKNESS * LENGTH * WIDTH
    a, b, h = LENGTH**2, WIDTH**2, THICKNESS**2
    return mass / 12.0 * np.array([b + h, a + h, a + b])


def rigid(spin, velocity=(0.0, 0.0, 0.0)):
    mesh = strip(STIFF).mesh
    return strip(STIFF, pulse(force=0.0, moment=0.0), js.Initial.rigid(mesh, velocity, spin))


def euler(spin, duration):
    """Orientation (3, 3) after `duration` of a free body with the principal inertia."""
    inertia = principal_inertia()

    def rates(_, y):
        omega = y[9:]
        turning = y[:9].reshape(3, 3) @ np.cross(np.eye(3), omega)  # Ṙ = R ~Ω, eq. (12)
        return np.concatenate([turning.ravel(), np.cross(inertia * omega, omega) / inertia])

    y = np.concatenate([np.eye(3).ravel(), spin])
    end = solve_ivp(rates, (0.0, duration), y, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    return end[:9].reshape(3, 3)


def test_tumbling_plate_follows_eulers_equations():
    """Second order towards scipy's solution of Euler's equations, about the unstable axis with a disturbance."""
    spin, duration = np.array([2.0, 6.0, 1.0]), 1.0
    expected = euler(spin, duration)
    errors = []
    for count in (200, 400, 800):
        solution = run(rigid(spin), count=count, duration=duration)
        errors.append(np.abs(np.asarray(solution.rotations[-1]) - expected).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2.0, abs=0.1)
    assert errors[2] < 1e-3


def test_translation_stays():
    velocity = np.array([3.0, -2.0, 5.0])
    solution = run(rigid(np.zeros(3), velocity), duration=1.0)
    np.testing.assert_allclose(solution.velocities[-1], np.tile(velocity, (10, 1)), atol=1e-9)
    np.testing.assert_allclose(solution.displacements[-1], np.tile(velocity, (10, 1)), atol=1e-9)


@pytest.mark.parametrize("axis", [0, 2])
def test_steady_spin_stays(axis):
    """Each step turns by 2 arctan(½ωΔt), the Cayley transform of ωΔt, for ever."""
    spin = np.zeros(3)
    spin[axis] = 5.0
    solution = run(rigid(spin), count=200, duration=1.0)
    angle = 200 * 2 * np.arctan(0.5 * 5.0 / 200)
    expected = Rotation.from_rotvec(spin / 5.0 * angle).as_matrix()
    np.testing.assert_allclose(solution.rotations[-1], np.tile(expected, (10, 1, 1)), atol=1e-6)
