"""Laminates and initial strains in motion and at rest: tangents, balances, closed forms, measured frequencies, gradients."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import sensitivity
from layups import CARBON

import jaxshell as js
from jaxshell.assembly.discretised import Model
from jaxshell.assembly.structure import structure_of
from jaxshell.assembly.tables import analyse
from jaxshell.elements import corotational, energy_momentum
from jaxshell.elements.director_inertia import DirectorMotion
from jaxshell.elements.element import Element
from jaxshell.elements.inertia import PointStart, Spins
from jaxshell.methods import energy_momentum as exact
from jaxshell.methods import generalized_energy_momentum as paper
from jaxshell.methods import newmark, static
from jaxshell.model.generators import rectangle
from jaxshell.numerics.rotations import exp

HEAVY = js.Orthotropic(40e9, 8e9, 0.25, 4e9, 2900.0, 7e-6, 21e-6)
TIGHT = js.Newton(tolerance=1e-13)

# --- tangents ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def far():
    """An element of a shifted laminate with a stress-free state of its own, two states far from rest, and rates."""
    rng = np.random.default_rng(7)

    def random(scale, *shape):
        return jnp.asarray(scale * rng.normal(size=shape))

    x0 = np.array([[0.0, 0.0, 0.0], [1.0, 0.1, 0.2], [0.3, 0.8, -0.1]])
    soft = [js.Ply(js.Orthotropic(14.0, 1.0, 0.3, 0.5, 1.6), 0.06, 30.0), js.Ply(js.Isotropic(3.0, 0.3, 2.5), 0.05)]
    given = js.Laminate(soft, offset=0.03).resultants(js.Mesh(x0, [[0, 1, 2]]))
    element = Element.build(jnp.asarray(x0), jax.tree.map(lambda a: a[0], given))
    element = Element(**{**element.__dict__, "rest": random(0.05, 12)})
    turned = jax.jit(jax.vmap(exp))
    x, R = jnp.asarray(x0) + random(0.05, 3, 3), turned(random(0.4, 3, 3))
    spins = Spins(turned(random(0.5, 7, 3)), random(1.0, 7, 3), random(3.0, 7, 3))
    start = jax.jit(corotational.kinematics)(x, R, element)
    u = jnp.concatenate([random(0.05, 3, 3), random(0.2, 3, 3)], axis=1)
    v, a = random(1.0, 3, 3), random(1.0, 3, 3)
    return SimpleNamespace(
        element=element, x=x, R=R, u=u, v=v, a=a, start=start, points=PointStart.of(spins, element.frame[2])
    )


def method_and_data(name, far):
    element = far.element
    if name == "Static":
        return static.Static(), static.ElementData(element, far.x - far.x[:1]), None, 0.1 * far.v
    if name == "Newmark":
        method = js.GeneralizedAlpha(0.6)
        return method, newmark.ElementData(element, far.v, far.a, far.points), method.factors(0.1), far.x
    if name == "EnergyMomentum":
        normal = element.frame[2]
        motion = DirectorMotion(far.v, far.R @ normal, far.a)
        data = exact.ElementData(element, energy_momentum.StepStart(energy_momentum.edges_of(far.x), far.start), motion)
        return js.EnergyMomentum(0.1), data, exact.Shared(jnp.array(0.1), jnp.array(0.1)), far.x
    method = js.GeneralizedEnergyMomentum(0.8, 0.1)
    data = paper.ElementData(element, far.start, far.v, far.a, far.R, far.points)
    return method, data, paper.Shared(method.factors(0.1), jnp.array(0.1)), far.x


@pytest.mark.parametrize("name", ["EnergyMomentum", "GeneralizedEnergyMomentum", "Newmark", "Static"])
def test_closed_form_tangents(name, far):
    """With the full 12 × 12 K̂, a stress-free state of its own, and (EnergyMomentum) a first moment."""
    method, data, shared, x = method_and_data(name, far)

    @jax.jit
    def both(u):
        def motion(u):
            return jax.vmap(method.node_motion)(u.reshape(3, 6), x, far.R)

        def force(u):
            found = method.element_forces(motion(u), u.reshape(3, 6), data, shared)
            return found.elastic + found.inertial

        return method.element_tangent(motion(u), u.reshape(3, 6), data, shared), jax.jacfwd(force)(u)

    found, expected = (np.asarray(K).reshape(3, 2, 3, 3, 2, 3) for K in both(far.u.reshape(18)))
    error, scale = (np.abs(K).max(axis=(0, 2, 3, 5)) for K in (found - expected, expected))
    assert np.all(error <= 1e-11 * scale)


# --- balances ---------------------------------------------------------------------------------------------


def strip(offset=0.5e-3, plies=None, heat=40.0, spin=300.0) -> js.Scene:
    """A free strip of two cells, thrown and spun, which is heated while it flies."""
    mesh = rectangle(0.1, 0.05, [2, 1])
    plies = [js.Ply(CARBON, 0.4e-3, 30.0), js.Ply(HEAVY, 0.6e-3, -40.0)] if plies is None else plies
    heated = js.Thermal(heat, 2e4, js.History([0.0, 1e-3, 4e-3], [0.0, 1.0, -0.5]))
    initial = js.Initial.rigid(mesh, [1.0, 2.0, 3.0], [spin, -0.3 * spin, 0.2 * spin])
    watch = {"corner": (0, "uz")}
    return js.Scene(mesh, js.Laminate(plies, offset=offset), loads=[heated], initial=initial, watch=watch)


def fly(scene, **options):
    return js.simulate(scene, js.EnergyMomentum(), dt=1e-4, newton=TIGHT, **options)


@pytest.mark.slow
def test_a_heated_laminate_flies_with_its_momenta(tmp_path):
    """Coupled, mass beside the nodes, heated: E - W and both momenta to round-off; the file goes on as the run would."""
    whole = fly(strip(), t_end=4e-3)
    gained = np.asarray(whole.energy.total - whole.energy.external_work)
    size = np.max(np.abs(np.asarray(whole.energy.strain)))
    moved = {
        name: np.abs(values - values[0]).max() / np.abs(values).max()
        for name, values in ((n, np.asarray(getattr(whole.momentum, n))) for n in ("linear", "angular"))
    }
    print(f"E - W changes by {np.abs(gained - gained[0]).max() / whole.energy.total[0]:.1e} of E, momenta by {moved}")
    assert np.abs(gained - gained[0]).max() < 1e-11 * float(whole.energy.total[0])
    assert size > 1e-3 * float(whole.energy.total[0])
    assert abs(float(whole.energy.external_work[-1])) > 1e-4 * float(whole.energy.total[0])
    assert max(moved.values()) < 1e-11
    half = fly(strip(), t_end=2e-3, output=tmp_path / "half.h5")
    again = fly(strip(), t_end=2e-3, restart=js.Solution.load(tmp_path / "half.h5"))
    np.testing.assert_array_equal(again.displacements[-1], whole.displacements[-1])
    assert half.momentum.linear[0, 0] > 0


@pytest.mark.parametrize("method", [js.EnergyMomentum(), js.GeneralizedEnergyMomentum(), js.Newmark()])
def test_kinetic_energy_and_momenta_do_not_depend_on_the_reference_surface(method):
    """A rigid motion of the same plate, its middle in the plane of the nodes or beside it (moved there)."""
    ply, z = [js.Ply(js.Isotropic(70e9, 0.3, 2700.0, 1e-5), 1e-3)], 2e-3
    beside = strip(z, ply, heat=1e-9)
    tables = analyse(structure_of(beside))[0]

    @jax.jit
    def observed(scene):
        model = Model.build(scene, tables)
        return method.observe(model, method.start(model, scene, 0.0))

    found = observed(beside)
    spin = np.array([300.0, -90.0, 60.0])
    mass, x = 2.7 * 0.1 * 0.05, np.asarray(beside.mesh.nodes)
    centre = x.mean(0) + [0, 0, z]
    v = np.array([1.0, 2.0, 3.0]) + np.cross(spin, centre - x.mean(0))
    a, b = 0.1, 0.05
    inertia = mass / 12 * np.diag([b**2 + 1e-6, a**2 + 1e-6, a**2 + b**2])
    np.testing.assert_allclose(found.linear, mass * v, rtol=1e-12)
    np.testing.assert_allclose(found.angular, mass * np.cross(centre, v) + inertia @ spin, rtol=1e-10)
    assert float(found.kinetic) == pytest.approx(0.5 * mass * v @ v + 0.5 * spin @ inertia @ spin, rel=1e-10)


@pytest.mark.parametrize("method", [js.CentralDifference(), js.GeneralizedEnergyMomentum(inertia="traditional")])
def test_mass_beside_the_nodes_is_refused_where_it_would_be_left_out(method):
    with pytest.raises(ValueError, match="first moment of mass"):
        js.simulate(strip(), method, dt=1e-9, t_end=1e-8)


# --- initial strains --------------------------------------------------------------------------------------


def largest_stress(solution, frame=-1) -> float:
    """Largest stress of an element in units of a force: moments over the thickness."""
    scene = solution.scene
    tables = analyse(structure_of(scene))[0]

    def one(x, R, element):
        return corotational.stresses(corotational.kinematics(x, R, element).deformations, element)

    @jax.jit
    def largest(scene, displacements, rotations):
        model = Model.build(scene, tables)
        x, R = model.gather((model.x0 + displacements, rotations))
        return jnp.max(jnp.abs(jax.vmap(one)(x, R, model.elements_at((1.0, 1.0)))[:, :3]))

    return float(largest(scene, jnp.asarray(solution.displacements[frame]), jnp.asarray(solution.rotations[frame])))


@pytest.mark.slow
def test_free_expansion_is_without_stress():
    """A cap, held as a rigid body only, heated at rest and then slowly in motion: it grows by αT and feels nothing."""
    cap = js.scenes.spherical_cap(2).mesh
    x = np.asarray(cap.nodes)
    mesh = js.Mesh(x, cap.triangles)
    E, h, alpha, T = 70e9, 1e-3, 2e-5, 100.0
    held = js.clamped([0])
    section = js.Section(h, E, 0.3, 2700.0, alpha)
    scene = js.Scene(mesh, section, [held], [js.Thermal(T)])
    scale = E * h * alpha * T * np.ptp(x[:, 0]) / 4
    still = js.solve_static(scene, [0.5, 1.0])
    np.testing.assert_allclose(still.displacements[-1], alpha * T * (x - x[0]), atol=1e-12 * np.abs(x).max())
    # Slowly: in 40 steps over a second, at periods of milliseconds.
    moved = js.simulate(
        js.Scene(mesh, section, [held], [js.Thermal(T, history=js.History.ramp(1.0))]),
        js.EnergyMomentum(0.5),
        dt=0.05,
        t_end=1.5,
        newton=TIGHT,
    )
    print(
        f"largest force over EhαT·edge: {largest_stress(still) / scale:.1e} at rest, {largest_stress(moved) / scale:.1e}"
    )
    assert max(largest_stress(still), largest_stress(moved)) < 1e-12 * scale


def test_bimetal():
    """Free, two layers of one ν: Timoshenko's curvature (1925, J. Opt. Soc. Am. 11, eq. (4)), the plate's and the beam's."""
    brass, steel = js.Isotropic(100e9, 0.3, 8500.0, 19e-6), js.Isotropic(200e9, 0.3, 7800.0, 12e-6)
    t1, t2, T = 0.4e-3, 0.7e-3, 80.0
    section = js.Laminate([js.Ply(brass, t1), js.Ply(steel, t2)])
    mesh = rectangle(0.1, 0.02, [2, 1])
    _, curvature = js.Thermal(T).strains(section, mesh)
    m, n, h = t1 / t2, 100 / 200, t1 + t2
    exact = 6 * (12e-6 - 19e-6) * T * (1 + m) ** 2 / (h * (3 * (1 + m) ** 2 + (1 + m * n) * (m**2 + 1 / (m * n))))
    np.testing.assert_allclose(curvature[:, :2], exact, rtol=1e-12)  # brass below: it bends upwards


def formed_strip(curvature=0.0, strain=0.0, heat=0.0):
    """A clamped strip 1 × 0.1 in ten cells, which was formed to a radius: ν = 0, so that the edges do nothing."""
    mesh = rectangle(1.0, 0.1, [10, 1])
    clamp = js.clamped(np.flatnonzero(np.asarray(mesh.nodes)[:, 0] == 0))
    section = js.Laminate([js.Ply(js.Isotropic(1e9, 0.0, 1000.0, 1e-5), 1e-3)], symmetric=False)
    made = js.InitialStrain([strain, 0.0, 0.0], jnp.array([curvature, 0.0, 0.0]))
    return js.Scene(mesh, section, [clamp], [made], watch={"tip": (20, "uz")})


@pytest.mark.slow
def test_a_strip_that_was_formed_rolls_up():
    """A half circle of chords: every element alone has its curvature, so that the strip is free of stress."""
    scene = formed_strip(np.pi)
    found = js.solve_static(scene, np.linspace(0.1, 1.0, 10))
    turn = np.pi / 10
    ends = np.concatenate([[0], np.cumsum(0.1 * np.exp(1j * turn * (0.5 + np.arange(10))))])
    x = np.asarray(scene.mesh.nodes + found.displacements[-1])[::2]
    np.testing.assert_allclose(x[:, 0], ends.real, atol=1e-9)
    np.testing.assert_allclose(x[:, 2], -ends.imag, atol=1e-9)  # the side of the normals is stretched
    assert abs(float(found.energy.strain[-1])) < 1e-12 * 0.5 * 1e9 * 1e-9 / 12 * np.pi**2 * 0.1


def clamped_plate(loads, cells=6, section=None) -> js.Scene:
    """A quarter of a clamped square plate of side 1, its middle at the origin."""
    mesh = rectangle(0.5, 0.5, [cells, cells])
    x, y, _ = np.asarray(mesh.nodes).T
    rim = np.flatnonzero((x == 0.5) | (y == 0.5))
    held = [
        js.clamped(rim),
        js.symmetry(np.setdiff1d(np.flatnonzero(x == 0), rim), "x"),
        js.symmetry(np.setdiff1d(np.flatnonzero(y == 0), rim), "y"),
    ]
    section = js.Section(0.01, 70e9, 0.3, 2700.0, 2e-5) if section is None else section
    return js.Scene(mesh, section, held, loads)


@pytest.mark.slow
def test_thermal_buckling_of_a_clamped_plate():
    """N = EhαT/(1-ν) = 52.3447 D/a² (Bjørstad & Tjøstheim 1999, Computing 63, table 3), approached from the mesh."""
    T = float(js.linear_buckling(clamped_plate([js.Thermal(1.0)], 8), count=1).load_factors[0])
    exact = 52.344691168 * 0.01**2 / 12 / (1 + 0.3) / 2e-5
    print(f"T of buckling: {T:.4g}, closed form {exact:.4g} ({T / exact - 1:+.2%})")
    assert 0 < T / exact - 1 < 0.015


def test_a_gradient_bends_a_clamped_plate_without_moving_it():
    """M = D (1 + ν) α g everywhere, and at a node of the rim that times the length between its neighbours."""
    scene = clamped_plate([js.Thermal(0.0, 50.0)])
    tables, _ = analyse(structure_of(scene))
    node, n = scene.mesh.nearest_node([0.5, 0.25, 0.0]), scene.mesh.n_nodes

    @jax.jit
    def unbalanced(scene):
        model = Model.build(scene, tables)
        force = model.internal_force(model.x0, jnp.broadcast_to(jnp.eye(3), (n, 3, 3)), 1.0)
        return model.free(force), force[node]

    free, carried = unbalanced(scene)
    moment = 70e9 * 0.01**3 / 12 / (1 - 0.3**2) * (1 + 0.3) * 2e-5 * 50.0 * 0.5 / 6
    assert np.abs(free).max() < 1e-12 * moment
    np.testing.assert_allclose(np.abs(carried), [0, 0, 0, 0, moment, 0], atol=1e-12 * moment)


# --- measured ---------------------------------------------------------------------------------------------


def test_kosmatkas_plate():
    """Cantilever 9 × 3 × 0.1 in of graphite/epoxy, [±22.5/0₂/-22.5/0₂/22.5/0₂]s: measured 69, 270, 427, 890, 1155, 1426 Hz."""
    material = js.Orthotropic(22.43e6, 1.45e6, 0.25, 0.917e6, 0.05781 / 386.09)
    section = js.Laminate.from_layup("[±22.5/0₂/-22.5/0₂/22.5/0₂]s", material, 0.1 / 20)
    mesh = rectangle(9.0, 3.0, [36, 12])
    clamp = js.clamped(np.flatnonzero(np.asarray(mesh.nodes)[:, 0] == 0))
    found = np.asarray(js.natural_frequencies(js.Scene(mesh, section, [clamp]), 6).frequencies)
    error = found / np.array([69, 270, 427, 890, 1155, 1426]) - 1
    print("Hz:", np.round(found, 1), "against the measured:", [f"{e:+.1%}" for e in error])
    # Shear would lower these modes by less than 1 %; docs/sections.md says what is left.
    assert np.all(np.abs(error[[0, 1, 2, 3, 5]]) < 0.03) and 0 < error[4] < 0.05


# --- gradients --------------------------------------------------------------------------------------------


def parameters() -> dict:
    names = ("angle", "thickness", "modulus", "offset", "temperature", "gradient", "curvature", "expansion")
    return {name: jnp.zeros(()) for name in names}


def warm_strip(p: dict, dynamic: bool) -> js.Scene:
    """A clamped strip of two plies, heated, formed and loaded; parameters are relative changes, angles in radians."""
    mesh = rectangle(0.1, 0.05, [2, 1])
    one = js.Orthotropic(140e9 * (1 + p["modulus"]), 10e9, 0.3, 5e9, 1600.0, -0.3e-6, 28e-6 * (1 + p["expansion"]))
    plies = [js.Ply(one, 1e-3 * (1 + p["thickness"]), 30.0 + 20.0 * p["angle"]), js.Ply(HEAVY, 1e-3, -40.0)]
    history = js.History.constant() if dynamic else None
    loads = [
        js.NodalForce([4], [0.0, 3.0, 20.0], history),
        js.Thermal(40.0 * (1 + p["temperature"]), 1e4 * (1 + p["gradient"]), history),
        js.InitialStrain([1e-4, 0, 0], jnp.array([0.5, 0.0, 0.3]) * (1 + p["curvature"]), history),
    ]
    section = js.Laminate(plies, offset=0.3e-3 * (1 + p["offset"]))
    return js.Scene(mesh, section, [js.clamped([0, 1])], loads, watch={"tip": (5, "uz")})


@pytest.mark.slow
@pytest.mark.parametrize("dynamic", [pytest.param(False, marks=pytest.mark.evidence), True], ids=["static", "dynamic"])
def test_gradients(dynamic):
    """Adjoint against forward mode to 1e-10 and differences to 1e-6."""

    def tip(p):
        scene = warm_strip(p, dynamic)
        if dynamic:
            run = js.simulate(scene, js.EnergyMomentum(), dt=jnp.full(4, 1e-4), newton=TIGHT)
        else:
            run = js.solve_static(scene, [1.0])
        return 1e3 * run.watched["tip"][-1]

    value_and_gradient = jax.jit(jax.value_and_grad(tip))
    push = jax.jit(lambda p, direction: jax.jvp(tip, (p,), (direction,))[1])
    sensitivity.check_derivatives(value_and_gradient, push, parameters())
