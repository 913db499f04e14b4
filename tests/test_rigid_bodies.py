"""Rigid bodies by elimination, point masses with inertia, and slanted supports."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import jaxshell as js
from jaxshell.assembly.discretised import Model
from jaxshell.assembly.structure import structure_of
from jaxshell.assembly.tables import analyse
from jaxshell.methods.static import Static
from jaxshell.model import generators

STEEL = js.Section(thickness=2e-3, young_modulus=70e9, poisson_ratio=0.3, density=2700.0)
NEWTON = js.Newton(tolerance=1e-11)


def plate(divisions=(2, 1)):
    return generators.rectangle(0.2, 0.1, divisions)


def flying(**changes) -> js.Scene:
    """A plate in flight whose right edge is rigid and carries a hub, with a gyroscope on the left; a blow on the hub."""
    mesh = plate()
    given = {
        "initial": js.Initial.rigid(mesh, velocity=(1.0, 0.0, 2.0), angular_velocity=(40.0, 10.0, 5.0)),
        "masses": [js.PointMass([0], 0.01, np.diag([2e-6, 3e-6, 4e-6]))],
        "connectors": [js.RigidBody([4, 5], mass=0.05, inertia=np.diag([1e-5, 2e-5, 2.5e-5]), name="hub")],
        "loads": [js.NodalForce("hub", (5.0, 3.0, 20.0), js.History([0.0, 1e-3, 2e-3], [0.0, 1.0, 0.0]))],
    }
    return js.Scene(mesh, STEEL, **(given | changes))


def test_energy_and_momenta_are_kept_to_round_off():
    scene = flying()
    solution = js.simulate(scene, js.EnergyMomentum(), dt=2e-5, t_end=4e-3, save_every=20, newton=NEWTON)
    total = solution.energy.kinetic + solution.energy.strain
    left = total - total[0] - solution.energy.external_work
    assert jnp.max(jnp.abs(left)) < 1e-12 * jnp.max(total)
    for momentum in (solution.momentum.linear, solution.momentum.angular):
        free = momentum[101:]  # after the blow
        assert jnp.max(jnp.abs(free - free[0])) < 1e-12 * jnp.linalg.norm(free[0])
    edge = (solution.displacements + scene.mesh.nodes)[:, jnp.array([4, 5, scene.connectors[0].master])]
    for a, b, length in ((0, 1, 0.1), (0, 2, 0.05)):
        np.testing.assert_allclose(jnp.linalg.norm(edge[:, a] - edge[:, b], axis=1), length, atol=1e-14)


def matrices(scene: js.Scene, method, dt):
    """(tangent, derivative of the residual by `jax.jacfwd`) of a step from a deformed state, both full."""
    tables, pattern = analyse(structure_of(scene))
    model = Model.build(scene, tables)
    linear = js.Dense().prepare(pattern)
    solvers = _solvers(linear)
    state = method.start(model, scene, 0.0, solvers)
    held = model.held_increment(state.time, dt)
    begun = method.begin(model, state, dt)
    free = 0.02 * jax.random.normal(jax.random.key(1), model.tables.free.shape)

    def residual(free):
        return model.free(method.balance(model, state, begun, method.increments(model, state, free, held)).residual)

    values = method.tangent(model, state, begun, method.increments(model, state, free, held), None, "closed_form")
    full = np.zeros((pattern.size, pattern.size))
    full[pattern.rows, pattern.indices.array] = values
    return full, np.asarray(jax.jit(jax.jacfwd(residual))(free))


def _solvers(handle):
    from jaxshell.methods.base import Solvers
    from jaxshell.solvers.iteration import Linear

    return Solvers(js.Newton(), Linear(js.Dense(), handle), "closed_form")


@pytest.mark.parametrize(
    "method",
    [
        js.EnergyMomentum(),
        pytest.param(js.GeneralizedEnergyMomentum(0.8), marks=pytest.mark.slow),
        pytest.param(js.GeneralizedAlpha(0.6), marks=pytest.mark.slow),
        pytest.param(Static(), marks=pytest.mark.slow),
    ],
    ids=lambda method: type(method).__name__,
)
def test_tangent_is_the_derivative_of_the_balance(method):
    slanted = js.Support([0, 1], ("ux", "ry"), normal=(1.0, 2.0, 0.5))
    hub = js.Support("hub", ("uy",), axes=Rotation.from_rotvec([0.2, 0.3, 0.5]).as_matrix())
    scene = flying(supports=[slanted, hub])
    tangent, exact = matrices(scene, method, 1e-3)
    assert np.abs(tangent - exact).max() < 1e-11 * np.abs(exact).max()


def top(spin=40.0, tilt=0.3) -> tuple[js.Scene, np.ndarray]:
    """A heavy top on a fixed tip, tilted, and where its centre is after one second, by its own equations."""
    m, arm, J, g = 1.0, 0.5, np.diag([0.05, 0.05, 0.02]), 9.81
    R0 = Rotation.from_rotvec([0.0, tilt, 0.0]).as_matrix()
    omega, centre = R0 @ [0.0, 0.0, spin], R0 @ [0.0, 0.0, arm]
    about_tip = J + m * arm**2 * np.diag([1.0, 1.0, 0.0])

    def rates(_, y):
        R, Omega = y[:9].reshape(3, 3), y[9:]
        moment = np.cross([0.0, 0.0, arm], R.T @ [0.0, 0.0, -m * g])
        turning = np.linalg.solve(about_tip, moment - np.cross(Omega, about_tip @ Omega))
        return np.concatenate([(R @ -np.cross(np.eye(3), Omega).T).ravel(), turning])

    start = np.concatenate([R0.ravel(), R0.T @ omega])
    end = solve_ivp(rates, (0.0, 1.0), start, rtol=1e-12, atol=1e-13, method="DOP853").y[:9, -1].reshape(3, 3)
    still = np.zeros(3)
    initial = js.Initial(
        velocities=np.stack([still, np.cross(omega, centre)]),
        angular_velocities=np.stack([omega, omega]),
        displacements=np.stack([still, centre - [0.0, 0.0, arm]]),
        rotations=np.stack([R0, R0]),
    )
    scene = js.Scene(
        js.Mesh.of_points({"tip": (0.0, 0.0, 0.0), "centre": (0.0, 0.0, arm)}),
        None,
        [js.Support("tip", ("ux", "uy", "uz"))],
        [js.Gravity((0.0, 0.0, -g))],
        initial=initial,
        masses=[js.PointMass("centre", m, J)],
        connectors=[js.RigidBody("centre", "tip")],
        watch={axis: ("centre", f"u{axis}") for axis in "xyz"},
    )
    return scene, end @ [0.0, 0.0, arm]


@pytest.mark.parametrize(
    "method",
    [
        js.EnergyMomentum(),
        pytest.param(js.GeneralizedEnergyMomentum(), marks=pytest.mark.slow),
        pytest.param(js.GeneralizedAlpha(0.8), marks=pytest.mark.slow),
    ],
    ids=lambda method: type(method).__name__,
)
def test_a_top_without_a_shell_follows_its_equations_with_second_order(method):
    scene, expected = top()
    errors = []
    for steps in (250, 500):
        newton = js.Newton(1e-13)  # the energy is as near as the iteration
        solution = js.simulate(scene, method, dt=1.0 / steps, t_end=1.0, save_every=steps, newton=newton)
        found = np.array([solution.watched[axis][-1] for axis in "xyz"]) + [0.0, 0.0, 0.5]
        errors.append(np.linalg.norm(found - expected))
    assert errors[1] < 2e-3 and 3.5 < errors[0] / errors[1] < 4.5
    if isinstance(method, js.EnergyMomentum):
        total = solution.energy.kinetic - solution.energy.external_work
        assert jnp.max(jnp.abs(total - total[0])) < 1e-10 * total[0]


def test_a_tip_mass_gives_the_frequency_of_theory():
    """A clamped beam of mass μL with a mass M at its tip: 1 + cos β cosh β = β M/μL (sin β cosh β - cos β sinh β)."""
    length, width, h, young, density = 1.0, 0.02, 5e-3, 200e9, 7800.0
    mesh = generators.rectangle(length, width, (16, 1))
    section = js.Section(thickness=h, young_modulus=young, poisson_ratio=0.0, density=density)
    own, tip = density * length * width * h, 0.5
    ends = mesh.nodes_where(lambda x: x[0] > length - 1e-9)
    scene = js.Scene(
        mesh,
        section,
        [js.clamped(mesh.nodes_where(lambda x: x[0] < 1e-9))],
        masses=[js.PointMass(ends, tip / 2)],
    )

    def characteristic(b):
        return 1 + np.cos(b) * np.cosh(b) - b * tip / own * (np.sin(b) * np.cosh(b) - np.cos(b) * np.sinh(b))

    beta = brentq(characteristic, 0.3, 1.9)
    expected = beta**2 / (2 * np.pi) * np.sqrt(young * width * h**3 / 12 * length / own) / length**2
    found = js.natural_frequencies(scene, 1).frequencies[0]
    np.testing.assert_allclose(found, expected, rtol=1e-3)


@pytest.mark.slow
def test_rigid_by_elimination_is_the_limit_of_stiff_elements():
    mesh = generators.rectangle(0.2, 0.05, (4, 1))
    clamp = js.clamped(mesh.nodes_where(lambda x: x[0] < 1e-9))
    outer = mesh.nodes_where(lambda x: x[0] > 0.099)
    tips = mesh.nodes_where(lambda x: x[0] > 0.199)
    load = js.NodalForce(tips, (0.0, 0.0, 2.0))
    thickness = np.where(np.asarray(mesh.nodes)[mesh.triangles][:, :, 0].mean(axis=1) > 0.1, 0.2, 2e-3)
    stiff = js.Section(thickness=thickness, young_modulus=70e9, poisson_ratio=0.3, density=2700.0)
    expected = js.solve_static(js.Scene(mesh, stiff, [clamp], [load]), [1.0]).displacements[-1, tips]
    load = js.NodalForce(tips, (0.0, 0.0, 2.0))
    scene = js.Scene(mesh, STEEL, [clamp], [load], connectors=[js.RigidBody(outer)])
    found = js.solve_static(scene, [1.0]).displacements[-1, tips]
    np.testing.assert_allclose(found, expected, atol=2e-5 * np.abs(expected).max())


def test_a_slanted_support_is_the_turned_scene():
    mesh, turn = plate(), Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix()
    left, right = [0, 1], [4, 5]
    supports = [js.Support(left, ("ux", "uy", "uz", "rx")), js.Support(right, ("uz", "rz"))]
    load = (3.0, 2.0, 20.0)
    plain = js.Scene(mesh, STEEL, supports, [js.NodalForce([5], load)])
    turned = js.Mesh(mesh.nodes @ turn.T, mesh.triangles)
    slanted = [js.Support(s.nodes.array, s.dofs, axes=turn.T) for s in supports]
    scene = js.Scene(turned, STEEL, slanted, [js.NodalForce([5], turn @ load)])
    first, second = js.solve_static(plain, [1.0]), js.solve_static(scene, [1.0])
    size = jnp.abs(first.displacements).max()
    np.testing.assert_allclose(second.displacements[-1], first.displacements[-1] @ turn.T, atol=1e-10 * size)
    np.testing.assert_allclose(js.reactions(second)[-1, :, :3], js.reactions(first)[-1, :, :3] @ turn.T, atol=1e-8)
    mirror = js.symmetry([0], (0.0, 1.0, 0.0))
    assert mirror.dofs == ("ux", "ry", "rz") and np.allclose(mirror.axes[0], [0.0, 1.0, 0.0])


def test_what_cannot_be_is_refused_by_name():
    mesh = plate()

    def scene(*connectors, supports=(), masses=()):
        return js.Scene(mesh, STEEL, list(supports), masses=list(masses), connectors=list(connectors))

    with pytest.raises(ValueError, match="Node 5 is in two rigid bodies, 0 and 1"):
        scene(js.RigidBody([4, 5]), js.RigidBody([5, 3]))
    with pytest.raises(ValueError, match="support 0 holds node 4 of rigid body 0, which its reference moves"):
        scene(js.RigidBody([4, 5]), supports=[js.clamped([4])])
    with pytest.raises(ValueError, match="connector 0: There is no set of nodes 'rim'"):
        scene(js.RigidBody("rim"))
    with pytest.raises(ValueError, match="without nodes needs a reference"):
        js.RigidBody([])
    with pytest.raises(ValueError, match="mass must not be negative"):
        js.PointMass([0], -1.0)
    with pytest.raises(ValueError, match="are no body's"):
        js.PointMass([0], 1.0, np.diag([1.0, 1.0, 3.0]))
    with pytest.raises(ValueError, match="at right angles and right-handed"):
        js.Support([0], ("ux",), axes=-np.eye(3))
    with pytest.raises(ValueError, match="supports 0 and 1 hold node 0 along different axes"):
        scene(supports=[js.Support([0], ("ux",), normal=(1.0, 1.0, 0.0)), js.Support([0], ("uz",))])
    with pytest.raises(ValueError, match="no rigid bodies"):
        js.simulate(scene(js.RigidBody([4, 5])), js.CentralDifference(), dt=1e-8, t_end=1e-7)


def test_a_scene_with_bodies_comes_back_from_its_file(tmp_path):
    scene = flying()
    solution = js.simulate(scene, js.EnergyMomentum(), dt=2e-5, t_end=4e-5)
    solution.save(tmp_path / "a.h5")
    again = js.Solution.load(tmp_path / "a.h5").scene
    assert again.mesh.points == 1 and again.mesh.node_sets == scene.mesh.node_sets
    assert again.connectors[0].name == "hub" and again.masters == scene.masters
    for before, after in zip(jax.tree.leaves(scene), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(before, after)
    assert dataclasses.replace(scene, name="other").mesh.n_nodes == scene.mesh.n_nodes


@pytest.mark.slow
def test_gradients_by_mass_inertia_and_the_place_of_the_reference():
    scene, _ = top()

    def height(mass, inertia, arm):
        masses = [js.PointMass(scene.masses[0].nodes.array, mass, inertia * jnp.eye(3))]
        nodes = scene.mesh.nodes.at[1, 2].set(arm)
        mesh = eqx.tree_at(lambda mesh: mesh.nodes, scene.mesh, nodes)
        made = dataclasses.replace(scene, mesh=mesh, masses=masses, initial=js.Initial(
            angular_velocities=scene.initial.angular_velocities,
            velocities=scene.initial.velocities * arm / 0.5,
            displacements=scene.initial.displacements * arm / 0.5,
            rotations=scene.initial.rotations,
        ))  # fmt: skip
        return js.simulate(made, js.EnergyMomentum(), dt=5e-3, t_end=0.1, newton=NEWTON).watched["x"][-1]

    at = (1.1, 0.05, 0.5)
    backward = jax.grad(height, argnums=(0, 1, 2))(*at)
    for k in range(3):
        along = tuple(float(k == i) for i in range(3))
        _, forward = jax.jvp(height, at, along)
        np.testing.assert_allclose(backward[k], forward, rtol=1e-10)
        step = 1e-5 * at[k]
        up, down = (height(*[a + s * step * (k == i) for i, a in enumerate(at)]) for s in (1, -1))
        np.testing.assert_allclose(forward, (up - down) / (2 * step), rtol=1e-6)
