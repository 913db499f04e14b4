"""Rayleigh damping: balances, decay of momenta and of a mode, tangents, derivatives, files, errors.

Runs share one free strip of eight elements with coefficients per element, so that each method compiles once; they go
in multiples of 50 steps with a frame every 50. test_settle.py has `settle`.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sensitivity import check_derivatives

import jaxshell as js
from jaxshell.assembly.discretised import Model
from jaxshell.assembly.structure import structure_of
from jaxshell.assembly.tables import analyse
from jaxshell.elements import corotational, energy_momentum, inertia
from jaxshell.elements.director_inertia import DirectorMotion
from jaxshell.elements.element import Element
from jaxshell.files.scene_file import read_scene_file
from jaxshell.methods import damping
from jaxshell.methods import energy_momentum as exact
from jaxshell.methods import generalized_energy_momentum as averaged
from jaxshell.methods import newmark as force_level
from jaxshell.methods.lumped import lumped_mass
from jaxshell.numerics.rotations import exp

NEWTON = js.Newton(tolerance=1e-13)
LENGTH, WIDTH, THICKNESS, DENSITY = 1.0, 0.4, 0.05, 1000.0
NODES, ELEMENTS = 10, 8
METHODS = {
    "energy_momentum": js.EnergyMomentum(),
    "averaged": js.GeneralizedEnergyMomentum(),
    "generalized_alpha": js.GeneralizedAlpha(0.9),
    "bathe": js.Bathe(),  # the trapezoidal rule among its halves
    "central_difference": js.CentralDifference(),
}
ALL = [pytest.param(name, marks=pytest.mark.slow if name in ("averaged", "bathe") else ()) for name in METHODS]


def strip(alpha=0.0, beta=0.0, velocities=None, angular_velocities=None, force=0.0) -> js.Scene:
    """A free strip in the x-y plane; `force` pulls and twists it until 0.1. Damping is given to each element."""
    x, y = (k.ravel() for k in np.meshgrid(np.arange(5), np.arange(2), indexing="ij"))
    mesh = js.Mesh(np.stack([LENGTH * x / 4, WIDTH * y, 0.0 * x], axis=1), js.structured_triangles(4, 1))
    still = np.zeros((NODES, 3))
    each = [jnp.broadcast_to(jnp.asarray(value, float), (ELEMENTS,)) for value in (alpha, beta)]
    return js.Scene(
        mesh,
        js.Section(THICKNESS, 1e6, 0.3, DENSITY),
        loads=[
            js.NodalForce(
                [0, 9],
                force * jnp.array([[60.0, 0.0, 80.0], [0.0, 30.0, -60.0]]),
                js.History([0.0, 0.05, 0.1], [0.0, 1.0, 0.0]),
            )
        ],
        initial=js.Initial(
            jnp.asarray(still if velocities is None else velocities),
            jnp.asarray(still if angular_velocities is None else angular_velocities),
        ),
        watch={"corner": (0, "uz")},
        damping=js.RayleighDamping(*each),
    )


def run(scene, method, dt, count, **options):
    options = {"newton": NEWTON, "linear_solver": js.Dense(), "save_every": 50} | options
    return js.simulate(scene, method, dt=dt, t_end=count * dt, **options)


def flight(method=METHODS["energy_momentum"], count=100, **options):
    """Damped unevenly, α of both ends differing by a factor of 3; forces until 0.1, free until 0.2."""
    scene = strip(np.linspace(1.0, 3.0, ELEMENTS), np.linspace(2e-4, 1e-3, ELEMENTS), force=1.0)
    return run(scene, method, 0.2 / count, count, **options)


def gap(solution) -> float:
    """Largest change of K + S + D - W, as a fraction of the largest K + S."""
    energy = solution.energy
    balance = np.asarray(energy.total + energy.dissipated - energy.external_work)
    return np.abs(balance - balance[0]).max() / np.asarray(energy.total).max()


# --- balances ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dissipation", [0.0, pytest.param(0.1, marks=pytest.mark.slow)])
def test_energy_momentum_records_exactly_what_it_removes(dissipation):
    solution = flight(js.EnergyMomentum(dissipation))
    removed = np.asarray(solution.energy.dissipated)
    assert gap(solution) < 1e-12
    assert np.all(np.diff(removed)[1:] > 0) and removed[-1] > 0.1 * np.asarray(solution.energy.total).max()


@pytest.mark.parametrize(
    "name",
    [*(pytest.param(n, marks=pytest.mark.slow) for n in ("averaged", "generalized_alpha")), "central_difference"],
)
def test_other_methods_record_what_they_remove_to_their_order(name):
    """The smooth forces leave few oscillations that a step does not resolve, which these methods damp by themselves."""
    method, count = METHODS[name], 200
    if name == "central_difference":
        count = 50 * int(np.ceil(0.2 / method.critical_step(strip(3.0, 1e-3)) / 50))
    coarse, fine = flight(method, count), flight(method, 2 * count)
    assert gap(coarse) < 2e-2 and gap(fine) < 0.6 * gap(coarse)
    if name != "central_difference":  # whose lumped masses make it another shell
        reference = np.asarray(flight(count=400).watched["corner"])[-1]
        assert np.asarray(fine.watched["corner"])[-1] == pytest.approx(reference, rel=1e-3)


@pytest.mark.parametrize("name", ALL)
def test_momenta_of_a_free_shell_fall_as_e_to_minus_alpha_t(name):
    """A rigid flight with spin at α = 2 for t = 0.4; β takes no part. Exact: (1 - αΔt/2)/(1 + αΔt/2) a step."""
    method, alpha, dt, count = METHODS[name], 2.0, 2e-3, 200
    scene = strip(alpha, 1e-4 if name == "central_difference" else 1e-3)
    if name == "central_difference":
        dt, count = 2e-4, 2000
    start = js.Initial.rigid(scene.mesh, (1.0, -2.0, 3.0), (0.3, 0.2, 0.5))
    solution = run(strip(alpha, scene.damping.beta, start.velocities, start.angular_velocities), method, dt, count)
    fall = np.exp(-alpha * np.asarray(solution.times))
    for momentum in (solution.momentum.linear, solution.momentum.angular):
        momentum = np.asarray(momentum)
        error = np.abs(momentum - fall[:, None] * momentum[0]).max() / np.linalg.norm(momentum[0])
        assert error < (alpha * dt) ** 2
    if name == "energy_momentum":
        factor = ((1 - 0.5 * alpha * dt) / (1 + 0.5 * alpha * dt)) ** np.arange(count + 1)
        linear = np.asarray(solution.momentum.linear)
        np.testing.assert_allclose(linear, factor[:, None] * linear[0], rtol=1e-11, atol=1e-12 * np.abs(linear).max())


@pytest.mark.parametrize("name", ALL)
def test_a_mode_decays_by_its_ratio(name):
    """The first bending mode of the free strip, half damped by α and half by β, over two periods of 120 steps (16 000
    of central differences, by their critical step).

    (ωΔt)² is 2.7e-3: the logarithmic decrement of a scheme of second order errs by less.
    """
    method, ratio, steps = METHODS[name], 0.04, 120
    if name == "central_difference":
        (omega, mode), steps = lumped_mode(), 16000
    else:
        modes = js.natural_frequencies(strip(), count=1, rigid_modes=False)
        omega, mode = 2 * np.pi * float(modes.frequencies[0]), np.asarray(modes.shapes[0])
    mode = 1e-5 * omega * mode / np.abs(mode[:, 2]).max()
    scene = strip(ratio * omega, ratio / omega, mode[:, :3], mode[:, 3:])
    dt = 2 * np.pi / omega / steps
    if name == "central_difference":
        assert dt < method.critical_step(scene)
    solution = run(scene, method, dt, 2 * steps + 50 if name == "central_difference" else 300)
    q = np.asarray(solution.watched["corner"])
    inner = q[1:-1]
    peaks = 1 + np.flatnonzero((np.abs(inner) >= np.abs(q[:-2])) & (np.abs(inner) > np.abs(q[2:])))
    sizes = np.abs(q[peaks])
    decrement = np.log(sizes[0] / sizes[2])
    found = decrement / np.hypot(2 * np.pi, decrement)
    assert found == pytest.approx(ratio, rel=5e-3)


def lumped_mode():
    """ω and shape (n, 6) of the first bending mode with the lumped masses of central differences."""
    scene = strip()
    model = eqx.filter_jit(Model.build)(scene, analyse(structure_of(scene))[0])
    still = jnp.stack([jnp.eye(3)] * 3)
    tangent = jax.jit(jax.vmap(corotational.tangent_stiffness, in_axes=(0, None, 0)))
    dofs = (6 * np.asarray(model.tables.triangles)[:, :, None] + np.arange(6)).reshape(-1, 18)
    K = np.zeros((6 * NODES, 6 * NODES))
    for numbers, matrix in zip(dofs, np.asarray(tangent(model.gather(model.x0), still, model.elements)), strict=True):
        K[np.ix_(numbers, numbers)] += matrix
    scale = 1 / np.sqrt(np.asarray(lumped_mass(model)).reshape(-1))
    squares, vectors = np.linalg.eigh(scale[:, None] * K * scale)
    return np.sqrt(squares[6]), (scale * vectors[:, 6]).reshape(-1, 6)


# --- tangents ---------------------------------------------------------------------------------------------


def element_step(seed=5):
    """(element, x, R, u, DampingStart-like values) of one element far from rest."""
    rng = np.random.default_rng(seed)
    scene = strip()
    section = jax.tree.map(lambda leaf: leaf[0], scene.section.resultants(scene.mesh))
    corners = np.asarray(scene.mesh.nodes)[np.asarray(scene.mesh.triangles)[0]]
    element = Element.build(jnp.asarray(corners), section)
    x = jnp.asarray(corners + 0.02 * rng.normal(size=(3, 3)))
    R = jax.vmap(exp)(0.3 * jnp.asarray(rng.normal(size=(3, 3))))
    u = jnp.asarray(np.array([0.01] * 3 + [0.2] * 3) * rng.normal(size=(3, 6)))
    start = corotational.kinematics(x, R, element)
    rates = damping.Rates(*(jnp.asarray(s * rng.normal(size=12)) for s in (1.0, 10.0)))
    return element, x, R, u, start, damping.Damped(2.0, 3e-3, start.deformations, rates), rng


def random_points(element, rng):
    R, Omega, Omega_dot = (jnp.asarray(s * rng.normal(size=(7, 3))) for s in (1.0, 3.0, 20.0))
    return inertia.PointStart.of(inertia.Spins(jax.vmap(exp)(R), Omega, Omega_dot), element.frame[2])


def assert_derivative(method, x, R, u, data, step):
    def forces(u):
        u = u.reshape(3, 6)
        found = method.element_forces(jax.vmap(method.node_motion)(u, x, R), u, data, step)
        return found.elastic + found.inertial

    @jax.jit
    def both(u):
        motion = jax.vmap(method.node_motion)(u.reshape(3, 6), x, R)
        return method.element_tangent(motion, u.reshape(3, 6), data, step), jax.jacfwd(forces)(u)

    found, expected = (np.asarray(K).reshape(3, 2, 3, 3, 2, 3) for K in both(u.reshape(18)))
    error, scale = (np.abs(K).max(axis=(0, 2, 3, 5)) for K in (found - expected, expected))
    assert np.all(error <= 1e-11 * scale)


def test_tangent_of_energy_momentum():
    element, x, R, u, start, damped, rng = element_step()
    motion = DirectorMotion(
        jnp.asarray(rng.normal(size=(3, 3))), R @ element.frame[2], jnp.asarray(rng.normal(size=(3, 3)))
    )
    begun = energy_momentum.StepStart(energy_momentum.edges_of(x), start)
    given = js.RayleighDamping(damped.alpha, damped.beta).per_element(1)
    each = jax.tree.map(lambda leaf: leaf[0], given)
    data = exact.ElementData(element, begun, motion, damping=each)
    assert_derivative(js.EnergyMomentum(), x, R, u, data, exact.Shared(0.01, 0))


@pytest.mark.parametrize("kind", ["seven_point", "traditional"])
def test_tangent_of_the_papers_method(kind):
    element, x, R, u, start, damped, rng = element_step()
    method = js.GeneralizedEnergyMomentum(0.7, 0.1, inertia=kind)
    v, a = (jnp.asarray(s * rng.normal(size=(3, 3))) for s in (1.0, 10.0))
    spins = random_points(element, rng)
    if kind == "traditional":
        spins = inertia.Spins(R, jnp.asarray(rng.normal(size=(3, 3))), jnp.asarray(rng.normal(size=(3, 3))))
    data = averaged.ElementData(element, start, v, a, R, spins, damped)
    step = averaged.Shared(method.factors(0.01), jnp.asarray(method.dissipation))
    assert_derivative(method, x, R, u, data, step)


def test_tangent_of_newmarks_family():
    element, x, R, u, _, damped, rng = element_step()
    method = js.GeneralizedAlpha(0.5)
    v, a = (jnp.asarray(s * rng.normal(size=(3, 3))) for s in (1.0, 10.0))
    data = force_level.ElementData(element, v, a, random_points(element, rng), damped)
    assert_derivative(method, x, R, u, data, method.factors(0.01))


# --- what costs nothing, the explicit step, derivatives ----------------------------------------------------


def test_a_zero_is_not_in_the_program():
    given = js.RayleighDamping(alpha=0.0, beta=1e-3)
    assert given.alpha is None and given.per_element(3).alpha is None and given.per_element(3).beta.shape == (3,)


def test_viscous_material_shortens_the_explicit_step():
    """(√(1 + ζ²) - ζ) 2/ω with ζ = βω/2 for the stiffest element."""
    method = js.CentralDifference(safety=1.0)
    free, beta = method.critical_step(strip()), 5e-4
    zeta = beta / free  # βω/2 with ω = 2/Δt
    assert method.critical_step(strip(2.0, beta)) == pytest.approx(free * (np.hypot(1.0, zeta) - zeta), rel=1e-12)
    with pytest.raises(ValueError, match="critical step"):
        run(strip(2.0, beta), method, 0.9 * free, 50)


GRADIENTS = [
    pytest.param(method, marks=pytest.mark.slow if k < 1 else pytest.mark.evidence)
    for k, method in enumerate(METHODS.values())
]


@pytest.mark.parametrize("method", GRADIENTS)
def test_derivatives_by_both_coefficients(method):
    """Adjoint against forward mode to 1e-10 and differences to 1e-6, element by element along random directions."""
    rng = np.random.default_rng(4)
    velocities, weights = (jnp.asarray(rng.normal(size=(NODES, 3))) for _ in range(2))
    dt = 1e-4 if isinstance(method, js.CentralDifference) else 2e-3

    def value(p):
        scene = strip(2.0 * (1 + p["alpha"]), 4e-4 * (1 + p["beta"]), velocities, force=1.0)
        solution = js.simulate(scene, method, dt=np.full(6, dt), newton=NEWTON, linear_solver=js.Dense(), save_every=6)
        moved = jnp.sum(weights * (solution.displacements[-1] + 1e-3 * solution.velocities[-1]))
        return 10 * moved + solution.energy.dissipated[-1] + solution.energy.strain[-1]

    p = {"alpha": jnp.zeros(ELEMENTS), "beta": jnp.zeros(ELEMENTS)}
    push = jax.jit(lambda p, d: jax.jvp(value, (p,), (d,))[1])
    check_derivatives(jax.jit(jax.value_and_grad(value)), push, p)


# --- ratios, files, restarts, errors ----------------------------------------------------------------------


def test_ratios_of_two_modes():
    scene = strip()
    frequencies = js.natural_frequencies(scene, count=8).frequencies
    found = js.RayleighDamping.from_ratios(scene, [0.02, 0.03], [7, 8])
    omega = 2 * np.pi * np.asarray(frequencies)[[6, 7]]
    np.testing.assert_allclose(found.alpha / (2 * omega) + found.beta * omega / 2, [0.02, 0.03], rtol=1e-9)
    same = js.RayleighDamping.from_ratios(None, [0.02, 0.03], frequencies=frequencies[6:8])
    assert float(same.beta) == pytest.approx(float(found.beta), rel=1e-12)


def test_files_and_restart(tmp_path):
    """A run that goes on from a file does so to the last bit: the rates of the deformations are in it."""
    method = METHODS["generalized_alpha"]
    whole = flight(method, 200)
    scene = whole.scene
    run(scene, method, 1e-3, 100, output=tmp_path / "half.h5")
    half = js.Solution.load(tmp_path / "half.h5")
    for name in ("alpha", "beta"):
        assert np.array_equal(getattr(half.scene.damping, name), getattr(scene.damping, name))
    rest = run(half.scene, method, 1e-3, 100, restart=half)
    assert np.array_equal(rest.watched["corner"], whole.watched["corner"][100:])
    assert np.array_equal(rest.energy.dissipated, whole.energy.dissipated[100:])


TOML = """
[mesh]
generator = "rectangle"
length = 1.0
width = 0.5
divisions = [2, 1]
[section]
thickness = 0.1
young_modulus = 1.0e6
poisson_ratio = 0.3
density = 1.0
[[supports]]
plane = { x = 0.0 }
hold = "clamped"
[damping]
"""


def test_scene_files(tmp_path):
    def read(text):
        (tmp_path / "scene.toml").write_text(TOML + text)
        return read_scene_file(tmp_path / "scene.toml")[0]

    plain = read("alpha = 0.5\nbeta = [1e-3, 2e-3, 3e-3, 4e-3]").damping
    assert float(plain.alpha) == 0.5 and plain.beta.tolist() == [1e-3, 2e-3, 3e-3, 4e-3]
    scene = read("ratios = [0.02, 0.02]\nmodes = [1, 2]")
    expected = js.RayleighDamping.from_ratios(scene, [0.02, 0.02], [1, 2])
    assert float(scene.damping.alpha) == pytest.approx(float(expected.alpha), rel=1e-10)
    for text, message in [
        ("gamma = 1.0", r"\[damping\] has the unknown key 'gamma'. Known keys: alpha, beta"),
        ("alpha = -1.0", r"\[damping\] alpha must be zero or positive, but it is -1.0"),
        ("beta = [1.0, 2.0]", r"\[damping\] damping beta must be one value or one per element \(4\)"),
        ("ratios = [0.02, 0.02]", r"\[damping\] from_ratios needs either modes"),
        ("ratios = [0.02, 9.0]\nmodes = [1, 2]", r"\[damping\] The ratios .* need alpha = -.*must lie in \["),
    ]:
        with pytest.raises(ValueError, match=message):
            read(text)


@pytest.mark.wrong_types
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: js.RayleighDamping(alpha=-0.1), "alpha must be zero or positive, but it is -0.1"),
        (lambda: js.RayleighDamping(beta=float("nan")), "beta must be finite, but it is nan"),
        (lambda: js.RayleighDamping(alpha="much"), "alpha must be a number"),
        (lambda: js.RayleighDamping(beta=[[1.0]]), "beta must be one value or a list"),
        (lambda: js.RayleighDamping(alpha=True), "alpha must be a number"),
        (lambda: strip_with(js.RayleighDamping([1.0, 2.0])), r"alpha must be one value or one per element \(8\)"),
        (lambda: strip_with(0.1), "damping must be a jaxshell.RayleighDamping or None, but it is 0.1"),
        (lambda: ratios([0.02], [1.0, 2.0]), r"ratios must have shape \(2,\)"),
        (lambda: ratios([0.02, 0.02], [1.0, 1.0]), "must be positive and different"),
        (lambda: ratios([0.02, 0.02], [0.0, 1.0]), "must be positive and different"),
        (lambda: ratios([0.02, 0.2], [1.0, 2.0]), r"need alpha = -.* must lie in \[0.5, 2\]"),
        (lambda: ratios([0.2, 0.02], [1.0, 2.0]), r"need beta = -"),
        (lambda: js.RayleighDamping.from_ratios(strip(), [0.02, 0.02], [0, 1]), "A mode's number must be a whole"),
        (lambda: js.RayleighDamping.from_ratios(strip(), [0.02, 0.02], [1, 7]), "of modes 1 and 7 must be positive"),
    ],
)
def test_bad_input(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def strip_with(given):
    scene = strip()
    return js.Scene(scene.mesh, scene.section, damping=given)


def ratios(values, frequencies):
    return js.RayleighDamping.from_ratios(None, values, frequencies=frequencies)
