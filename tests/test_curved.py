"""Elements that stand for a curved surface: their forces, tangents and normals, and what they bring."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxshell as js
from jaxshell.assembly.discretised import Model
from jaxshell.assembly.elements import build_elements
from jaxshell.assembly.structure import structure_of
from jaxshell.assembly.tables import analyse
from jaxshell.elements import corotational, energy_momentum
from jaxshell.elements.element import Element
from jaxshell.elements.shape import Tangents
from jaxshell.methods.static import Static
from jaxshell.model import generators
from jaxshell.model.corner_normals import corner_normals
from jaxshell.model.edges import Edges
from jaxshell.model.sections.isotropic import isotropic
from jaxshell.numerics.rotations import cayley, exp

RNG = np.random.default_rng(3)
X0 = jnp.array([[0.0, 0.0, 0.0], [1.0, 0.1, 0.05], [0.3, 0.9, -0.1]])
TILTED = np.array([0.0, 0.0, 1.0]) + 0.15 * RNG.normal(size=(3, 3))
NORMALS = jnp.asarray(TILTED / np.linalg.norm(TILTED, axis=1)[:, None])
COUPLING = jnp.array([[0.3, 0.1, 0.05], [0.1, -0.2, 0.02], [0.05, 0.02, 0.1]])


def element(coupled: bool, relaxed: bool = False) -> Element:
    section = isotropic(0.05, 1e3, 0.3, 2.0)
    if coupled:
        section = eqx.tree_at(lambda r: r.B, section, COUPLING, is_leaf=lambda leaf: leaf is None)
    one = jnp.ones(())
    return Element.build(X0, section, Tangents(NORMALS, None if relaxed else one, one if relaxed else None))


@pytest.fixture(scope="module")
def placed():
    x = X0 + 0.1 * RNG.normal(size=(3, 3))
    return x, jax.vmap(exp)(0.3 * jnp.asarray(RNG.normal(size=(3, 3))))


KINDS = pytest.mark.parametrize(("coupled", "relaxed"), [(False, False), (True, False), (False, True), (True, True)])


@KINDS
def test_forces_are_the_gradient_of_the_energy_and_the_tangent_theirs(placed, coupled, relaxed):
    curved = element(coupled, relaxed)

    def moved(q):
        q = q.reshape(3, 2, 3)
        return placed[0] + q[:, 0], jax.vmap(exp)(q[:, 1]) @ placed[1]

    def energy(q):
        return corotational.strain_energy(corotational.kinematics(*moved(q), curved).deformations, curved)

    force = corotational.internal_force(*placed, curved)
    slope, curvature = (
        jax.grad(energy)(jnp.zeros(18)),
        jax.jacfwd(lambda q: corotational.internal_force(*moved(q), curved))(jnp.zeros(18)),
    )
    assert force == pytest.approx(np.asarray(slope), abs=1e-11 * float(jnp.max(jnp.abs(slope))))
    found = corotational.tangent_stiffness(*placed, curved)
    assert found == pytest.approx(np.asarray(curvature), abs=1e-11 * float(jnp.max(jnp.abs(curvature))))


@KINDS
def test_the_step_does_the_exact_work_and_has_no_resultant(placed, coupled, relaxed):
    curved, dissipation = element(coupled, relaxed), 0.1
    start = energy_momentum.StepStart(energy_momentum.edges_of(placed[0]), corotational.kinematics(*placed, curved))

    def evaluated(u):
        x, R = placed[0] + u[:, :3], jax.vmap(cayley)(u[:, 3:]) @ placed[1]
        return energy_momentum.evaluate(start, x, R, u, curved, dissipation)

    u = jnp.asarray(0.2 * RNG.normal(size=(3, 6)))
    state = evaluated(u)
    force = energy_momentum.elastic_forces(state)
    ends = [corotational.strain_energy(kin.deformations, curved) for kin in (start.kin, state.kin)]
    lost = 2 * dissipation * corotational.strain_energy(state.change, curved)
    assert float(jnp.sum(force * u.reshape(-1))) == pytest.approx(float(ends[1] - ends[0] + lost), rel=1e-12)
    nodal = force.reshape(3, 6)
    middle = placed[0] + 0.5 * u[:, :3]
    moment = jnp.sum(jnp.cross(middle, nodal[:, :3]) + nodal[:, 3:], axis=0)
    assert jnp.sum(nodal[:, :3], axis=0) == pytest.approx(np.zeros(3), abs=1e-12 * float(jnp.max(jnp.abs(nodal))))
    assert moment == pytest.approx(np.zeros(3), abs=1e-12 * float(jnp.max(jnp.abs(nodal))))
    tangent = jax.jacfwd(lambda u: energy_momentum.elastic_forces(evaluated(u.reshape(3, 6))))(u.reshape(-1))
    found = energy_momentum.elastic_tangent(state, start, curved, dissipation)
    assert found == pytest.approx(np.asarray(tangent), abs=1e-11 * float(jnp.max(jnp.abs(tangent))))


def normals_of(mesh: js.Mesh) -> np.ndarray:
    edges = Edges(mesh.triangles)
    return np.asarray(jax.jit(lambda nodes: corner_normals(nodes, edges).normals)(mesh.nodes))


def test_normals_of_the_nodes_are_the_spheres_at_its_boundary_too():
    mesh = js.scenes.opened_cap((24, 5)).mesh
    exact = np.asarray(mesh.nodes) / np.linalg.norm(np.asarray(mesh.nodes), axis=1)[:, None]
    assert np.max(np.linalg.norm(np.cross(normals_of(mesh), exact[mesh.triangles]), axis=2)) < 1e-12


def test_a_fold_keeps_the_normals_of_its_sides_apart():
    scene = js.scenes.l_shaped_plate()
    x = np.asarray(scene.mesh.nodes)[scene.mesh.triangles]
    flat = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    flat /= np.linalg.norm(flat, axis=1)[:, None]
    assert normals_of(scene.mesh) == pytest.approx(np.repeat(flat[:, None], 3, axis=1), abs=1e-12)


def curved_cap(**changes) -> js.Scene:
    scene = js.scenes.opened_cap((12, 3))
    return dataclasses.replace(scene, section=js.Section(0.4, 1000.0, 0.3, 0.1, shape="curved"), **changes)


def test_a_run_with_both_keeps_its_energy_and_momenta():
    scene = curved_cap(supports=(), loads=(), initial=js.Initial(velocities=_swing(js.scenes.opened_cap((12, 3)))))
    run = js.simulate(scene, js.EnergyMomentum(inertia="cubic"), dt=0.02, t_end=1.0)
    energy = np.asarray(run.energy.kinetic + run.energy.strain)
    assert np.max(np.abs(energy / energy[0] - 1)) < 1e-10
    assert np.max(np.asarray(run.energy.strain)) > 0.02 * energy[0]
    for momentum in (run.momentum.linear, run.momentum.angular):
        momentum = np.asarray(momentum)
        assert np.max(np.abs(momentum - momentum[0])) < 1e-10 * np.max(np.abs(momentum[0]))


def _swing(scene: js.Scene) -> np.ndarray:
    x = np.asarray(scene.mesh.nodes)
    return np.stack([1.0 + 0.3 * x[:, 2], 0.2 * x[:, 0], 0.5 * np.cos(0.3 * x[:, 0]) + 0.1 * x[:, 1]], axis=1)


def test_a_free_shell_falls_without_bending():
    g = np.array([1.0, -2.0, 9.0])
    scene = curved_cap(supports=(), loads=(js.Gravity(g),))
    run = js.simulate(scene, js.EnergyMomentum(inertia="cubic"), dt=0.1, t_end=0.5)
    fallen = np.asarray(run.displacements[-1])
    assert fallen == pytest.approx(np.broadcast_to(0.5 * 0.5**2 * g, fallen.shape), rel=1e-10)
    assert np.max(np.asarray(run.energy.strain)) < 1e-18


@pytest.mark.slow
def test_gradients_pass_through_shape_and_inertia():
    scene = curved_cap()
    direction = jnp.asarray(np.random.default_rng(0).normal(size=scene.mesh.nodes.shape))

    def height(s):
        moved = eqx.tree_at(
            lambda scene: (scene.mesh.nodes, scene.section.thickness),
            scene,
            (scene.mesh.nodes + s * direction, scene.section.thickness * (1 + 0.3 * s)),
        )
        run = js.simulate(moved, js.EnergyMomentum(inertia="cubic"), dt=0.02, t_end=0.1)
        return run.watched["A"][-1]

    forward = float(jax.jvp(height, (0.0,), (1.0,))[1])
    assert float(jax.grad(height)(0.0)) == pytest.approx(forward, rel=1e-10)
    step = 1e-4
    values = [float(height(k * step)) for k in (-2, -1, 1, 2)]
    difference = (8 * (values[2] - values[1]) - (values[3] - values[0])) / (12 * step)
    assert difference == pytest.approx(forward, rel=1e-6)


def test_shape_and_inertia_are_one_of_their_words():
    with pytest.raises(ValueError, match="shape must be one of flat, curved, relaxed, but it is 'round'"):
        js.Section(0.4, 1e3, 0.3, 0.1, shape="round")
    with pytest.raises(ValueError, match="inertia must be one of linear, cubic, but it is 'quadratic'"):
        js.EnergyMomentum(inertia="quadratic")


def test_flat_elements_among_curved_ones_stay_flat():
    scene = js.scenes.opened_cap((12, 3))
    some = np.arange(scene.mesh.n_elements) % 12 < 6
    material = 0.4, 1000.0, 0.3, 0.1
    mixed = dataclasses.replace(
        scene,
        section=[
            (np.flatnonzero(some), js.Section(*material, shape="curved")),
            (np.flatnonzero(~some), js.Section(*material)),
        ],
    )
    of_flat, of_mixed, of_curved = (energies(s) for s in (scene, mixed, curved_cap()))
    assert of_mixed[~some] == pytest.approx(of_flat[~some], rel=1e-12)
    # The patches end where the regions do, and so do the tangent planes: elements away from there know no difference.
    inner = np.isin(scene.mesh.triangles, np.unique(scene.mesh.triangles[~some])).sum(axis=1) == 0
    assert inner.sum() > 4
    assert np.median(np.abs(of_mixed[inner] / of_curved[inner] - 1)) < 0.05
    assert np.median(np.abs(of_mixed[inner] / of_flat[inner] - 1)) > 0.01


def energies(scene: js.Scene) -> np.ndarray:
    """Of all elements, of small displacements and rotations that have nothing to do with each other."""
    rng = np.random.default_rng(1)
    x = scene.mesh.nodes + 0.05 * rng.normal(size=scene.mesh.nodes.shape)
    R = jax.vmap(exp)(jnp.asarray(0.05 * rng.normal(size=scene.mesh.nodes.shape)))

    def one(x, R, element):
        return corotational.strain_energy(corotational.kinematics(x, R, element).deformations, element)

    @jax.jit
    def every(x, R, scene):
        return jax.vmap(one)(x[scene.mesh.triangles], R[scene.mesh.triangles], build_elements(scene))

    return np.asarray(every(x, R, scene))


@pytest.mark.slow
def test_frequencies_of_a_free_plate_on_a_coarse_mesh():
    thickness, young, ratio, density = 0.005, 1e7, 0.3, 2.0
    unit = np.sqrt(young * thickness**2 / (12 * (1 - ratio**2) * density)) / (2 * np.pi)
    scene = js.Scene(generators.rectangle(1.0, 1.0, (8, 8)), js.Section(thickness, young, ratio, density))
    exact = np.array([13.468, 19.596, 24.270, 34.801])  # as in tests/test_modal.py
    linear, cubic = (
        np.asarray(js.natural_frequencies(scene, 4, rigid_modes=False, inertia=kind).frequencies) / unit / exact - 1
        for kind in ("linear", "cubic")
    )
    assert np.max(np.abs(cubic)) < 3e-3
    assert np.max(np.abs(linear)) > 1.5e-2


@pytest.mark.slow
def test_the_opened_cap_is_nearer_its_limit_on_the_same_mesh():
    limits = {0.5: -0.512, 1.0: -2.540}  # docs/accuracy.md
    scene = js.scenes.opened_cap((48, 10))
    curved = dataclasses.replace(scene, section=js.Section(0.4, 1000.0, 0.3, 0.1, shape="curved"))
    for each, inertia, bound in ((scene, "linear", 0.035), (curved, "cubic", 0.01)):
        run = js.simulate(each, js.EnergyMomentum(inertia=inertia), dt=0.01, t_end=1.0)
        errors = [abs(float(run.watched["A"][round(t / 0.01)]) / a - 1) for t, a in limits.items()]
        assert max(errors) < bound
        assert min(errors) > (0.01 if inertia == "linear" else 0.0)


@pytest.mark.slow
def test_a_relaxed_hemisphere_bends_on_a_coarse_mesh():
    # Linear deflection under the pinching forces; the limit of 64×64 cells is 9.355.
    scene = js.scenes.hemisphere((8, 8), force=1e-4)
    old: Any = scene.section
    found = {}
    for shape in ("flat", "relaxed"):
        section = js.Section(old.thickness, old.young_modulus, old.poisson_ratio, old.density, shape=shape)
        run = js.solve_static(dataclasses.replace(scene, section=section), [1.0])
        found[shape] = -float(run.watched["inward"][-1]) * 1e6 / 9.355
    assert found["flat"] < 0.55
    assert found["relaxed"] == pytest.approx(1, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["curved", "relaxed"])
def test_tangents_of_all_methods_are_the_derivatives(shape):
    section = js.Section(0.4, 1000.0, 0.3, 0.1, shape=shape)
    scene = dataclasses.replace(js.scenes.opened_cap((4, 1)), section=section, damping=js.RayleighDamping(0.1, 0.01))
    tables, _ = analyse(structure_of(scene))
    rng, dt = np.random.default_rng(0), jnp.asarray(0.05)
    first, second = (jnp.asarray(0.05 * rng.normal(size=(scene.mesh.n_nodes, 6))) for _ in range(2))
    methods = js.EnergyMomentum(0.1, inertia="cubic"), js.GeneralizedEnergyMomentum(0.8, 0.1), js.GeneralizedAlpha(0.6)
    for method in (*(methods if shape == "curved" else methods[:1]), Static()):
        model = Model.build(scene, tables, method.bends_mass)
        state = method.start(model, scene, 0.0)
        state = method.finish(model, state, dt, first, method.motion(state, first), method.begin(model, state, dt))
        begun = method.begin(model, state, dt)
        found, exact = (
            np.asarray(method.matrices(model, state, begun, second, t)) for t in ("closed_form", "autodiff")
        )
        assert np.max(np.abs(found - exact)) < 1e-11 * np.max(np.abs(exact))
