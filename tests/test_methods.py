"""The opponents: tangents, order, period error, spectral radius, rigid rotation, the explicit critical step.

All runs share one free strip (10 nodes) with an initial motion and one force, so that each method compiles once.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from scipy.spatial.transform import Rotation

import jaxshell as js
from jaxshell.assembly.discretised import Model
from jaxshell.assembly.structure import structure_of
from jaxshell.assembly.tables import analyse
from jaxshell.elements import corotational
from jaxshell.elements.inertia import PointStart, Spins
from jaxshell.methods import seven_point
from jaxshell.methods.bathe import ThreePointBackward
from jaxshell.methods.lumped import lumped_mass
from jaxshell.methods.newmark import ElementData, step_factors
from jaxshell.numerics.rotations import exp

METHODS = {
    "newmark": js.Newmark(),
    "hht": js.HHT(alpha=-0.1),
    "generalized_alpha": js.GeneralizedAlpha(spectral_radius=0.6),
    "bathe": js.Bathe(),
    "central_difference": js.CentralDifference(safety=1.0),
}
IMPLICIT = [name for name in METHODS if name != "central_difference"]
LENGTH, WIDTH, THICKNESS = 1.0, 0.2, 0.02


def strip(velocities=None, angular_velocities=None, force=(0.0, 0.0, 0.0), duration=1.0) -> js.Scene:
    """A free strip in the x-y plane; `force` on its last node grows linearly until `duration`."""
    columns, rows = 4, 1
    x, y = (k.ravel() for k in np.meshgrid(np.arange(columns + 1), np.arange(rows + 1), indexing="ij"))
    nodes = np.stack([LENGTH * x / columns, WIDTH * y / rows, 0.0 * x], axis=1)
    mesh = js.Mesh(nodes, js.structured_triangles(columns, rows))
    still = np.zeros_like(nodes)
    return js.Scene(
        mesh,
        js.Section(THICKNESS, 1e6, 0.3, 1000.0),
        loads=[js.NodalForce([nodes.shape[0] - 1], list(force), js.History([0.0, duration], [0.0, 1.0]))],
        initial=js.Initial(
            jnp.asarray(still if velocities is None else velocities),
            jnp.asarray(still if angular_velocities is None else angular_velocities),
        ),
        watch={"corner": (0, "uz"), "corner velocity": (0, "vz")},
    )


def run(scene, method, duration, count):
    """`count` steps, a multiple of 50, with 50 between frames: one compiled program per method."""
    newton = js.Newton(tolerance=1e-13)
    return js.simulate(scene, method, dt=duration / count, t_end=duration, save_every=50, newton=newton)


@pytest.fixture(scope="module")
def model():
    scene = strip()
    return eqx.filter_jit(Model.build)(scene, analyse(structure_of(scene))[0])


@pytest.fixture(scope="module")
def stiffness(model):
    """Dense (60, 60) linear stiffness of the strip."""
    tangent = jax.jit(jax.vmap(corotational.tangent_stiffness, in_axes=(0, None, 0)))
    return dense(model, tangent(model.gather(model.x0), jnp.stack([jnp.eye(3)] * 3), model.elements))


@pytest.fixture(scope="module")
def consistent_mass(model):
    unit = step_factors(1.0, 0.5, 0.0, 0.0, 1.0)  # 1/(βΔt²) = 1 leaves M, eq. (53)

    def mass(element):
        up, still = jnp.broadcast_to(element.frame[2], (7, 3)), jnp.zeros((7, 3))
        return seven_point.inertial_tangent(jnp.zeros((3, 3)), PointStart(up, still, still), element, unit)

    matrices = jax.jit(jax.vmap(mass))
    return dense(model, matrices(model.elements))


def dense(model, matrices) -> np.ndarray:
    dofs = (6 * np.asarray(model.tables.triangles)[:, :, None] + np.arange(6)).reshape(-1, 18)
    total = np.zeros((6 * model.x0.shape[0],) * 2)
    for numbers, matrix in zip(dofs, np.asarray(matrices), strict=True):
        total[np.ix_(numbers, numbers)] += matrix
    return total


def modes(K, M):
    """Angular frequencies, ascending, and modes of K φ = ω² M φ, where both may be singular (not together)."""
    shift = 1e-3 * np.trace(K) / np.trace(M)
    inverse, vectors = scipy.linalg.eigh(M, K + shift * M)
    inverse, vectors = inverse[::-1], vectors[:, ::-1]
    kept = inverse > 1e-12 * inverse[0]
    return np.sqrt(np.maximum(1.0 / inverse[kept] - shift, 0.0)), vectors[:, kept]


# --- tangents ---------------------------------------------------------------------------------------------


def random_step(model):
    """(x, R, increments (18,), data) of one element far from rest."""
    rng = np.random.default_rng(3)

    def random(*shape):
        return jnp.asarray(rng.normal(size=shape))

    rotations = jax.jit(jax.vmap(exp))
    element = jax.tree.map(lambda leaf: leaf[0], model.elements)
    x, R = model.gather(model.x0)[0] + 0.02 * random(3, 3), rotations(0.4 * random(3, 3))
    spins = Spins(rotations(random(7, 3)), 3.0 * random(7, 3), 20.0 * random(7, 3))
    points = PointStart.of(spins, element.frame[2])
    data = ElementData(element, random(3, 3), 10.0 * random(3, 3), points)
    return x, R, (jnp.asarray([0.01] * 3 + [0.2] * 3) * random(3, 6)).reshape(18), data


def assert_same_tangent(closed, derivative):
    """Forces and moments, displacements and rotations have different units: each pair on its own scale."""
    blocks = [np.asarray(K).reshape(3, 2, 3, 3, 2, 3) for K in (closed - derivative, derivative)]
    error, scale = (np.abs(K).max(axis=(0, 2, 3, 5)) for K in blocks)
    assert np.all(error <= 1e-11 * scale)


def test_closed_form_tangent_is_the_derivative(model):
    """Newmark and HHT are parameter choices of the same functions."""
    method = js.GeneralizedAlpha(0.5)
    x, R, u, data = random_step(model)
    step = method.factors(0.01)

    @jax.jit
    def both(u):
        def motion(u):
            return jax.vmap(method.node_motion)(u.reshape(3, 6), x, R)

        def forces(u):
            found = method.element_forces(motion(u), u.reshape(3, 6), data, step)
            return found.elastic + found.inertial

        return method.element_tangent(motion(u), u.reshape(3, 6), data, step), jax.jacfwd(forces)(u)

    assert_same_tangent(*both(u))


def test_closed_form_tangent_of_the_three_point_formula(model):
    """Bathe's second half differs from the others in its inertia only."""
    _, _, u, data = random_step(model)
    step = ThreePointBackward().factors(0.01)

    @jax.jit
    def both(u):
        def forces(u):
            u = u.reshape(3, 6)
            return seven_point.inertial_forces(u[:, :3], u[:, 3:], data.v, data.a, data.points, data.element, step)

        theta = u.reshape(3, 6)[:, 3:]
        return seven_point.inertial_tangent(theta, data.points, data.element, step), jax.jacfwd(forces)(u)

    assert_same_tangent(*both(u))


@pytest.mark.parametrize(
    ("kind", "values", "named"),
    [
        (js.Newmark, {"beta": 0.2}, "0.25"),
        (js.Newmark, {"gamma": 0.4}, "0.4"),
        (js.HHT, {"alpha": 0.1}, "0.1"),
        (js.HHT, {"alpha": -0.4}, "-0.4"),
        (js.GeneralizedAlpha, {"spectral_radius": 1.1}, "1.1"),
        (js.CentralDifference, {"safety": 0.0}, "0"),
    ],
)
def test_parameters_out_of_range_are_refused(kind, values, named):
    with pytest.raises(ValueError, match=named):
        kind(**values)


# --- linear oscillations ----------------------------------------------------------------------------------


def recursion(method, omega, dt, count):
    """Amplitude of q'' = -ω² q from q = 0, q' = 1: the method's scalar equations, solved one after the other."""
    q, v, a, found = 0.0, 1.0, 0.0, [0.0]

    def newmark(q, v, a, beta, gamma, alpha_m, alpha_f, dt):
        free = q + dt * v + dt**2 * (0.5 - beta) * a
        new = -(alpha_m * a + omega**2 * ((1 - alpha_f) * free + alpha_f * q))
        new /= (1 - alpha_m) + (1 - alpha_f) * omega**2 * beta * dt**2
        return free + beta * dt**2 * new, v + dt * ((1 - gamma) * a + gamma * new), new

    for _ in range(count):
        if isinstance(method, js.Bathe):
            q2, v2, _ = newmark(q, v, a, 0.25, 0.5, 0.0, 0.0, 0.5 * dt)
            # -ω² q1 = (3 v1 - 4 v2 + v)/Δt with v1 = (3 q1 - 4 q2 + q)/Δt
            new = (3.0 * (4.0 * q2 - q) + dt * (4.0 * v2 - v)) / (9.0 + (omega * dt) ** 2)
            q, v, a = new, (3.0 * new - 4.0 * q2 + q) / dt, -(omega**2) * new
        elif isinstance(method, js.CentralDifference):
            middle = v + 0.5 * dt * a
            q = q + dt * middle
            a = -(omega**2) * q
            v = middle + 0.5 * dt * a
        else:
            beta, gamma, alpha_m, alpha_f, _ = (float(k) for k in method.factors(dt))
            q, v, a = newmark(q, v, a, beta, gamma, alpha_m, alpha_f, dt)
        found.append(q)
    return np.array(found)


def small_oscillation(method, stiffness, mass, phase, count=100):
    """(corner's deflection over that of q' = 1, ω, Δt) of the first bending mode of the free strip, ωΔt = phase."""
    omegas, vectors = modes(stiffness, mass)
    mode = vectors[:, 6].reshape(-1, 6)
    assert np.abs(mode[:, 2]).max() > 10 * np.abs(mode[:, :2]).max()
    mode = 1e-5 * omegas[6] * mode / np.abs(mode[:, 2]).max()  # a deflection of 1e-5: linear
    dt = phase / omegas[6]
    solution = run(strip(mode[:, :3], mode[:, 3:]), method, count * dt, count)
    return np.asarray(solution.watched["corner"]) / mode[0, 2], omegas[6], dt


@pytest.mark.parametrize("name", IMPLICIT)
@pytest.mark.parametrize("phase", [0.5, 30.0])
def test_a_mode_oscillates_as_the_scalar_equations_say(name, phase, stiffness, consistent_mass):
    found, omega, dt = small_oscillation(METHODS[name], stiffness, consistent_mass, phase)
    expected = recursion(METHODS[name], omega, dt, 100)
    np.testing.assert_allclose(found, expected, atol=2e-4 * np.abs(expected).max())


def test_explicit_mode_has_the_known_frequency(model, stiffness):
    mass = np.diag(np.asarray(lumped_mass(model)).reshape(-1))
    method = METHODS["central_difference"]
    omegas, _ = modes(stiffness, mass)
    dt = 0.9 * method.critical_step(strip())
    found, omega, dt = small_oscillation(method, stiffness, mass, dt * omegas[6], count=2000)
    np.testing.assert_allclose(found, recursion(method, omega, dt, 2000), atol=2e-4 / omega)


def period(method, omega, dt, count=4000):
    """Mean period of the scalar equations, from the sign changes interpolated between steps."""
    q = recursion(method, omega, dt, count)[1:]
    crossings = np.flatnonzero(q[:-1] * q[1:] < 0)
    times = dt * (crossings + q[crossings] / (q[crossings] - q[crossings + 1]))
    return 2.0 * (times[-1] - times[0]) / (len(times) - 1)


def test_period_errors_are_the_textbooks():
    omega, dt = 1.0, 0.3
    exact = 2.0 * np.pi
    assert period(js.Newmark(), omega, dt) == pytest.approx(exact * 0.15 / np.arctan(0.15), rel=1e-4)
    assert period(js.CentralDifference(), omega, dt) == pytest.approx(exact * 0.15 / np.arcsin(0.15), rel=1e-4)


@pytest.mark.parametrize("radius", [0.0, 0.5, 0.9])
def test_generalized_alpha_shrinks_the_highest_modes_by_its_spectral_radius(radius):
    """The triple root -ρ∞ of Chung & Hulbert's amplification matrix, for ω → ∞, from the factors alone."""
    beta, gamma, _, alpha_f, _ = (float(k) for k in js.GeneralizedAlpha(radius).factors(1.0))
    # (q, v, a)_{n+1} with (1-αf) q_{n+1} + αf q_n = 0, all that is left of the balance.
    left = np.array([[1.0, 0.0, -beta], [0.0, 1.0, -gamma], [1.0 - alpha_f, 0.0, 0.0]])
    right = np.array([[1.0, 1.0, 0.5 - beta], [0.0, 1.0, 1.0 - gamma], [-alpha_f, 0.0, 0.0]])
    polynomial = np.poly(np.linalg.solve(left, right))
    np.testing.assert_allclose(polynomial, np.poly([-radius] * 3), atol=1e-12)


@pytest.mark.parametrize("radius", [0.0, 0.5, 0.9])
def test_generalized_alpha_dissipates_as_the_scalar_equations_say(radius, stiffness, consistent_mass):
    method = js.GeneralizedAlpha(radius)
    found, omega, dt = small_oscillation(method, stiffness, consistent_mass, phase=10.0)
    expected = recursion(method, omega, dt, 100)
    np.testing.assert_allclose(found, expected, atol=2e-4 * np.abs(expected).max())
    assert np.abs(found[50:]).max() < np.abs(found).max() * {0.0: 1e-3, 0.5: 1e-2, 0.9: 0.5}[radius]


# --- large rotations --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", METHODS)
def test_rigid_rotation_is_followed(name, model):
    """One and a quarter half turns in the strip's plane, past π, while it flies off."""
    method, duration, angle = METHODS[name], 20.0, 1.25 * np.pi
    velocity, spin = np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.0, angle / duration])
    start = js.Initial.rigid(strip().mesh, velocity, spin)
    count = 200 if name in IMPLICIT else 50 * int(np.ceil(duration / method.critical_step(strip()) / 50))
    solution = run(strip(start.velocities, start.angular_velocities), method, duration, count)
    x0 = np.asarray(model.x0)
    turned, centre = Rotation.from_rotvec(angle * np.array([0.0, 0.0, 1.0])), x0.mean(axis=0)
    expected = centre + duration * velocity + turned.apply(x0 - centre)
    # Newmark's chords fall behind by (ωΔt)²/12 of the angle, Bathe's by less, HHT's by more; the spin stretches
    # the strip by ρω²L²/8E, and slows down by twice that.
    step_angle = angle / count
    error = angle * (step_angle**2 / 5.0 + 1000.0 * spin[2] ** 2 / 4e6)
    assert np.abs(x0 + solution.displacements[-1] - expected).max() < error
    assert np.abs(np.asarray(solution.rotations[-1]) - turned.as_matrix()).max() < 2.0 * error
    momentum = np.asarray(solution.momentum.linear)
    np.testing.assert_allclose(momentum, np.broadcast_to(momentum[0], momentum.shape), rtol=1e-9, atol=1e-9)


# --- order ------------------------------------------------------------------------------------------------


def ends(scene, method, duration, count) -> list[np.ndarray]:
    """Displacements at the end with `count`, twice and four times as many steps."""
    return [np.asarray(run(scene, method, duration, count * k).displacements[-1]) for k in (1, 2, 4)]


def order(coarse, middle, fine) -> float:
    return np.log2(np.linalg.norm(coarse - middle) / np.linalg.norm(middle - fine))


def test_second_order_and_one_limit():
    """A growing force bends, twists and carries the strip off: 0.4 lengths and 1.4 rad at the end."""
    scene, limits = strip(force=(0.1, 0.1, 2.0)), {}
    for name in IMPLICIT:
        found = ends(scene, METHODS[name], 1.0, 100)
        assert order(*found) == pytest.approx(2.0, abs=0.1), name
        limits[name] = (4.0 * found[2] - found[1]) / 3.0
        spread = np.linalg.norm(limits[name] - limits["newmark"])
        assert spread < 0.05 * np.linalg.norm(found[1] - found[2]), name


def test_central_difference_is_second_order():
    scene, method = strip(force=(0.1, 0.1, 2.0)), METHODS["central_difference"]
    count = 50 * int(np.ceil(1.0 / method.critical_step(scene) / 50))
    assert order(*ends(scene, method, 1.0, count)) == pytest.approx(2.0, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("method", [js.GeneralizedEnergyMomentum(1.0, 0.3), js.EnergyMomentum(0.3)])
def test_dissipation_of_the_local_forces_is_of_first_order(method):
    """Armero & Petocz's ξ acts like a viscosity ξΔt K̂; without it both methods are of second order, elsewhere."""
    found = ends(strip(force=(0.1, 0.1, 2.0)), method, 1.0, 200)
    assert order(*found) == pytest.approx(1.0, abs=0.1)


# --- the critical step ------------------------------------------------------------------------------------


def test_element_bound_lies_below_the_critical_step_of_the_strip(model, stiffness):
    omegas, _ = modes(stiffness, np.diag(np.asarray(lumped_mass(model)).reshape(-1)))
    exact, bound = 2.0 / omegas[-1], js.CentralDifference(safety=1.0).critical_step(strip())
    assert 0.7 * exact < bound <= exact


@pytest.mark.parametrize("rotary", ["physical", "scaled"])
def test_scaled_rotary_inertia_is_where_the_bound_and_the_mass_say(model, stiffness, rotary):
    """Of an element of area A at least ρhA/8; the bound holds with it too."""
    method, scene = js.CentralDifference(safety=1.0, rotary=rotary), strip()
    mass = np.asarray(lumped_mass(model, rotary))
    area, surface, h = (np.asarray(a) for a in (model.elements.area, model.elements.mass_per_area, 0.02))
    inertia = np.full(area.shape, h**2 / 12)
    inertia = np.maximum(inertia, area / 8) if rotary == "scaled" else inertia
    assert mass[:, 3:].sum() / 3 == pytest.approx((surface * area * inertia).sum(), rel=1e-12)
    assert mass[:, :3].sum() / 3 == pytest.approx((surface * area).sum(), rel=1e-12)
    omegas, _ = modes(stiffness, np.diag(mass.reshape(-1)))
    assert method.critical_step(scene) <= 2.0 / omegas[-1]


def test_scaled_rotary_inertia_takes_larger_steps_and_keeps_the_balance():
    scaled, scene = js.CentralDifference(safety=1.0, rotary="scaled"), strip(force=(0.1, 0.1, 2.0))
    critical = scaled.critical_step(scene)
    assert critical > 1.5 * js.CentralDifference(safety=1.0).critical_step(scene)
    solution = run(scene, scaled, 2000 * 0.99 * critical, 2000)
    energy, work = np.asarray(solution.energy.total), np.asarray(solution.energy.external_work)
    assert np.abs(energy - work).max() < 1e-2 * work.max()


def test_central_difference_refuses_a_step_above_the_critical_and_runs_just_below():
    method, scene = js.CentralDifference(safety=1.0), strip(force=(0.1, 0.1, 2.0))
    critical = method.critical_step(scene)
    with pytest.raises(ValueError, match=f"critical step .* is {critical:g}"):
        js.simulate(scene, method, dt=1.001 * critical, t_end=1.0)
    solution = run(scene, method, 2000 * 0.999 * critical, 2000)
    energy, work = np.asarray(solution.energy.total), np.asarray(solution.energy.external_work)
    assert np.abs(energy - work).max() < 1e-3 * work.max()


class Unchecked(js.CentralDifference):
    """Runs with any step, as a shell would that has stiffened since the start."""

    def check(self, scene, steps):
        pass


def test_an_explicit_run_that_blows_up_ends_as_unstable():
    scene, method = strip(force=(0.1, 0.1, 2.0)), Unchecked()
    dt = 2.0 * method.critical_step(scene)
    solution = js.simulate(scene, method, dt=dt, t_end=1000 * dt, save_every=50, throw=False)
    assert solution.result == js.RESULTS.unstable
    assert "explicit method became unstable" in solution.message
    assert 1 < len(solution.times) < 1000
    energy = np.asarray(solution.energy.total)
    assert np.all(np.isfinite(energy)) and energy.max() <= 10.0 * np.asarray(solution.energy.external_work).max()
