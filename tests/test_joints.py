"""Joints by multipliers: they hold, do no work, keep momenta, and say what is wrong with them."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxshell as js
from jaxshell.model import generators
from jaxshell.model.contribution import Place, Surface

PANEL = js.Section(thickness=2e-3, young_modulus=70e9, poisson_ratio=0.3, density=2700.0)


def panels(count: int, gap: float = 0.0, divisions=(1, 1)) -> tuple[js.Mesh, int]:
    """Plates of 0.2 × 0.1 in a row, each with nodes of its own, and how many those are."""
    one = generators.rectangle(0.2, 0.1, divisions)
    nodes = jnp.concatenate([one.nodes + jnp.array([(0.2 + gap) * k, 0.0, 0.0]) for k in range(count)])
    triangles = np.concatenate([one.triangles + one.n_nodes * k for k in range(count)])
    return js.Mesh(nodes, triangles, coincident="allow"), one.n_nodes


def jointed(**changes) -> js.Scene:
    """Four plates in flight: a hinge along an edge, a spherical joint with a bar across it, and a slider."""
    mesh, n = panels(4)
    connectors = [
        js.Hinge(2, n, (0.0, 1.0, 0.0), name="hinge"),
        js.Spherical(3, n + 1),
        js.Spherical(n + 2, 2 * n),
        js.RigidBar(n + 1, 2 * n + 1),
        js.Slider(2 * n + 2, 3 * n, (1.0, 0.0, 0.0)),
    ]
    start = js.Initial.rigid(mesh, velocity=(1.0, 0.0, 2.0), angular_velocity=(20.0, 10.0, 5.0))
    fold, nodes = jnp.array([0.0, 60.0, 0.0]), mesh.nodes[:n]
    turning = jnp.cross(fold, nodes - jnp.array([0.2, 0.0, 0.0]))  # the first plate about the hinge
    start = js.Initial(start.velocities.at[:n].add(turning), start.angular_velocities.at[:n].add(fold))
    return js.Scene(mesh, PANEL, **({"initial": start, "connectors": connectors} | changes))


def openings(solution) -> float:
    """The largest by which any joint of `jointed` is open, in any frame."""
    n = solution.scene.mesh.n_nodes // 4
    x, R = solution.displacements + solution.scene.mesh.nodes, solution.rotations
    axis, found = jnp.array([0.0, 1.0, 0.0]), []
    for a, b in ((2, n), (3, n + 1), (n + 2, 2 * n)):
        found.append(x[:, a] - x[:, b])
    found.append(R[:, 2] @ axis - R[:, n] @ axis)
    found.append(jnp.linalg.norm(x[:, n + 1] - x[:, 2 * n + 1], axis=1) - jnp.hypot(0.2, 0.0))
    a, b = 2 * n + 2, 3 * n
    found.append(jnp.einsum("fij,fi->fj", R[:, a], x[:, b] - x[:, a])[:, 1:])
    found.append(R[:, a] - R[:, b])
    return max(float(jnp.max(jnp.abs(gap))) for gap in found)


def kept(solution) -> tuple[float, float, float]:
    """The largest changes of energy, linear and angular momentum, relative."""
    total = solution.energy.kinetic + solution.energy.strain
    parts = [total[:, None], solution.momentum.linear, solution.momentum.angular]
    return tuple(float(jnp.max(jnp.abs(p - p[0])) / jnp.linalg.norm(p[0])) for p in parts)


def test_all_kinds_together_hold_do_no_work_and_keep_momenta():
    scene = jointed(watch={"opening": ("hinge", "angle")})
    solution = js.simulate(
        scene, js.EnergyMomentum(), dt=5e-5, t_end=1e-2, save_every=10, newton=js.Newton(tolerance=1e-11)
    )
    changes, opened = kept(solution), openings(solution)
    print(f"energy, momenta: {changes}; joints open by {opened:.1e}")
    assert max(changes) < 1e-12 and opened < 1e-12
    first, second = solution.rotations[-1, 2], solution.rotations[-1, 4]
    turned = Rotation.from_matrix(first.T @ second).as_rotvec()
    np.testing.assert_allclose(turned, [0.0, solution.watched["opening"][-1], 0.0], atol=1e-12)
    assert np.abs(np.degrees(turned[1])) > 10.0


@pytest.mark.slow
@pytest.mark.parametrize("factor", [pytest.param(1, marks=pytest.mark.evidence), 4])
def test_over_ten_thousand_steps(factor):
    solution = js.simulate(
        jointed(), js.EnergyMomentum(), dt=factor * 2e-5, t_end=factor * 0.2, save_every=100,
        newton=js.Newton(tolerance=1e-13),
    )  # fmt: skip
    changes, opened = kept(solution), openings(solution)
    total = np.asarray(solution.energy.kinetic + solution.energy.strain)
    steps = np.diff(total) / total[0]
    walk = np.sqrt(np.sum(steps**2))
    print(f"energy, momenta: {changes}; joints open by {opened:.1e}; a step {np.abs(steps).max():.1e}, walk {walk:.1e}")
    assert max(changes[1:]) < 1e-12 and opened < 1e-12
    # At 4Δt the plates of 70 GPa swing so that round-off of places does work of 3e-14 against their forces in a step. It
    # adds up as what is random does, to 1e-12 to 5e-12 in the end, whatever the iteration's tolerance.
    assert np.abs(steps).max() < 1e-12 and changes[0] < (1e-12 if factor == 1 else 4.0 * walk)


@pytest.mark.slow
@pytest.mark.parametrize(
    "method",
    [js.GeneralizedEnergyMomentum(), pytest.param(js.GeneralizedAlpha(0.8), marks=pytest.mark.evidence)],
    ids=["emc", "generalised alpha"],
)
def test_other_methods_hold_them_and_agree_with_second_order(method):
    fine = js.simulate(jointed(), js.EnergyMomentum(), dt=2.5e-7, t_end=4e-4, save_every=1600).displacements[-1]
    errors = []
    for steps in (50, 100):
        solution = js.simulate(jointed(), method, dt=4e-4 / steps, t_end=4e-4, save_every=steps)
        assert openings(solution) < 1e-10
        errors.append(float(jnp.max(jnp.abs(solution.displacements[-1] - fine))))
    assert errors[1] < 0.35 * errors[0]


def test_conditions_on_rotations_stay_where_all_turn_at_the_mean_of_a_step_too():
    """There matrices are no rotations, and conditions are not zero: one that turned would take angular momentum."""
    mesh, n = panels(2)
    mesh = mesh.with_points({"grip": (0.1, 0.05, 0.02), "pod": (0.0, 0.04, 0.0)})
    axis = (0.3, 1.0, -0.2)
    joints = [
        (js.Hinge(2, n, axis), (1,)), (js.Slider(0, n + 2, axis), (0, 1)), (js.RigidBar(0, n + 2), (0,)),
        (js.Tie(2, n, ("rx", "ry", "rz")), (0,)), (js.EdgeTie("pod", [[0, 1]]), (1,)),
        (js.Distributed(np.arange(n), 2 * n), (0,)),
    ]  # fmt: skip
    rng, turn = np.random.default_rng(0), Rotation.from_rotvec([0.4, -0.9, 1.3]).as_matrix()
    x = mesh.nodes + 0.05 * rng.normal(size=mesh.nodes.shape)
    R = sum(Rotation.from_rotvec(rng.normal(size=(mesh.n_nodes, 3))).as_matrix() for _ in range(2)) / 2
    none = jnp.zeros(0)
    surface = Surface(mesh.nodes, mesh.triangles, none, none, jnp.zeros((0, 3)), jnp.array(0.4))
    parts = [joint.placed(mesh, 0)[0].parts()[k] for joint, which in joints for k in which]

    @jax.jit
    def conditions(x, R):
        found = []
        for part in parts:
            nodes, data = part.groups(mesh.triangles).array[0], jax.tree.map(lambda a: a[0], part.data(surface))
            found.append(part.conditions(data, Place(x[nodes], R[nodes], jnp.zeros(()))))
        return (*found[:-1], found[-1][3:])  # the first three are of places, which stay zero at the mean

    before, after = conditions(x, R), conditions((x + 0.7) @ turn.T, turn @ R)
    for one, other in zip(before, after, strict=True):
        assert jnp.max(jnp.abs(one)) > 1e-3
        np.testing.assert_allclose(other, one, atol=1e-14)


def test_a_hinge_carries_no_moment():
    """A beam of two parts, clamped at one end, on a roller at the other, hinged between: forces by hand."""
    mesh, n = panels(2, divisions=(2, 1))
    tip = np.array([2 * n - 2, 2 * n - 1])
    hinges = [js.Hinge(n - 2, n, (0.0, 1.0, 0.0)), js.Spherical(n - 1, n + 1)]
    middle = [n + 2, n + 3]
    scene = js.Scene(
        mesh,
        PANEL,
        [js.clamped([0, 1]), js.Support(tip, ("uz",)), js.Support(tip[:1], ("uy",))],
        [js.NodalForce(middle, (0.0, 0.0, -1e-2))],
        connectors=hinges,
    )
    solution = js.solve_static(scene, [1.0])
    carried = js.reactions(solution)[-1]
    # The second part is a simple beam with its load in the middle: half of it at the roller, half at the hinge.
    np.testing.assert_allclose(jnp.sum(carried[tip, 2]), 1e-2, rtol=1e-6)
    np.testing.assert_allclose(jnp.sum(carried[:2, 2]), 1e-2, rtol=1e-6)
    np.testing.assert_allclose(jnp.sum(carried[:2, 4]), -1e-2 * 0.2, rtol=1e-6)


def two_parts(across: int, *connectors) -> js.Scene:
    """A cantilever of two parts, the second three elements wide, with a force at its tip; no parts without connectors."""
    left, right = generators.rectangle(0.1, 0.1, (2, across)), generators.rectangle(0.1, 0.1, (2, 3))
    n = left.n_nodes
    nodes = jnp.concatenate([left.nodes, right.nodes + jnp.array([0.1, 0.0, 0.0])])
    triangles = np.concatenate([left.triangles, right.triangles + n])
    mesh = js.Mesh(nodes, triangles, coincident="allow") if connectors else js.Mesh.merged(nodes, triangles, 1e-9)
    tip, root = (mesh.nodes_where(lambda x, at=at: abs(x[0] - at) < 1e-9) for at in (0.2, 0.0))
    load = js.NodalForce(tip, (0.0, 0.0, 1e-3))
    return js.Scene(mesh, PANEL, [js.clamped(root)], [load], connectors=connectors, watch={"tip": (int(tip[0]), "uz")})


@pytest.mark.slow
def test_an_edge_tie_joins_meshes():
    """As one mesh where they match; near it where they do not."""
    one = js.solve_static(two_parts(3), [1.0]).watched["tip"][-1]
    rim = np.arange(8, 12)
    same = js.EdgeTie(12 + np.arange(4), np.stack([rim[:-1], rim[1:]], axis=1))
    tied = js.solve_static(two_parts(3, same), [1.0]).watched["tip"][-1]
    np.testing.assert_allclose(tied, one, rtol=1e-6)
    other = [js.EdgeTie(6 + np.arange(1, 3), [[4, 5]]), js.Tie([4, 5], [6, 9])]
    tied = js.solve_static(two_parts(1, *other), [1.0]).watched["tip"][-1]
    np.testing.assert_allclose(tied, one, rtol=5e-2)


def test_frequencies_and_buckling_know_joints():
    one, tied = two_parts(3), two_parts(3, js.Tie(np.arange(8, 12), 12 + np.arange(4)))
    found, expected = (js.natural_frequencies(scene, 4).frequencies for scene in (tied, one))
    np.testing.assert_allclose(found, expected, rtol=1e-8)
    tip = int(one.watch[0][1])
    pressed = [
        dataclasses.replace(s, loads=[js.NodalForce([int(s.watch[0][1])], (-1.0, 0.0, 0.0))]) for s in (tied, one)
    ]
    found, expected = (js.linear_buckling(scene, 2).load_factors for scene in pressed)
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    assert tip != int(tied.watch[0][1])


def test_a_rigid_pendulum_swings_as_theory_says():
    mesh, gravity = panels(1)[0].with_points({"pin": (0.0, 0.0, 0.0)}), 9.81
    scene = js.Scene(
        mesh,
        PANEL,
        [js.clamped("pin")],
        [js.Gravity((gravity, 0.0, 0.0))],
        connectors=[js.RigidBody(np.arange(4)), js.Hinge(0, "pin", (0.0, 1.0, 0.0))],
    )
    resting = js.simulate(scene, js.EnergyMomentum(), dt=1e-6, t_end=1e-6)
    found = js.natural_frequencies(scene, 1, about=resting).frequencies[0]
    moment = 0.2**2 / 3 + 2e-3**2 / 12  # about the pin, over the mass
    np.testing.assert_allclose(found, np.sqrt(gravity * 0.1 / moment) / (2 * np.pi), rtol=1e-8)


@pytest.mark.slow
def test_a_distributed_force_is_its_resultant():
    mesh = generators.rectangle(0.2, 0.1, (2, 2))
    rim = mesh.nodes_where(lambda x: x[0] > 0.199)
    face = np.append(rim, mesh.nearest_node((0.1, 0.05, 0.0)))
    force, moment = np.array([2e-2, 1e-2, 3e-2]), np.array([1e-3, -2e-3, 0.5e-3])
    scene = js.Scene(
        mesh,
        PANEL,
        [js.clamped(mesh.nodes_where(lambda x: x[0] < 1e-9))],
        [js.NodalForce("grip", force), js.NodalMoment("grip", moment)],
        connectors=[js.Distributed(face, (0.25, 0.05, 0.02), name="grip")],
    )
    solution = js.solve_static(scene, [1.0])
    carried, x = np.asarray(js.reactions(solution)[-1]), np.asarray(scene.mesh.nodes)
    np.testing.assert_allclose(carried[:, :3].sum(axis=0), -force, atol=1e-9 * 3e-2)
    x = x + np.asarray(solution.displacements[-1])
    about = (np.cross(x - x[-1], carried[:, :3]) + carried[:, 3:]).sum(axis=0)
    np.testing.assert_allclose(about, -moment, atol=1e-8 * 2e-3)


def test_what_cannot_be_is_refused_by_name():
    mesh, n = panels(2)

    def run(*connectors, **more):
        scene = js.Scene(mesh, PANEL, connectors=list(connectors), **more)
        return js.simulate(scene, js.EnergyMomentum(), dt=1e-5, t_end=1e-5)

    with pytest.raises(
        ValueError, match=r"connector 0: A spherical joins nodes in one place, but 0 and 4 are 0\.2 apart"
    ):
        run(js.Spherical(0, n))
    with pytest.raises(ValueError, match="hinge axis must have a length"):
        js.Hinge(2, n, (0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="A rigid bar between nodes 2 and 4 has no length"):
        run(js.RigidBar(2, n))
    with pytest.raises(ValueError, match="joins nodes one by one, but a has 2 and b 1"):
        run(js.Spherical([2, 3], [n]))
    with pytest.raises(ValueError, match="has all of rx, ry, rz or none"):
        js.Tie(2, n, ("ux", "rx"))
    with pytest.raises(ValueError, match="Nodes on a line hold no rotation"):
        run(js.Distributed([0, 1], (0.0, 0.0, 1.0)))
    door = [js.RigidBody(np.arange(n)), js.RigidBody(n + np.arange(n))]
    axis = (0.0, 1.0, 0.0)
    with pytest.raises(ValueError, match=r"5 of the 10 conditions of the joints repeat .* hinge 'lower'"):
        run(*door, js.Hinge(2, n, axis), js.Hinge(3, n + 1, axis, name="lower"))
    turning = js.Initial(angular_velocities=np.repeat([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], n, axis=0))
    with pytest.raises(ValueError, match=r"The initial velocities open connector 0 \(hinge\)"):
        run(js.Hinge(2, n, axis), initial=turning)
    with pytest.raises(ValueError, match="solves no equations, which joints need"):
        scene = js.Scene(mesh, PANEL, connectors=[js.Spherical(2, n)])
        js.simulate(scene, js.CentralDifference(), dt=1e-8, t_end=1e-7)


@pytest.mark.slow
def test_gradients_by_axis_and_place():
    scene = jointed()
    hinge = scene.connectors[0]

    def measured(tilt, size):
        turned = js.Hinge(hinge.a.array, hinge.b.array, jnp.stack([0.1 * tilt, jnp.cos(tilt), jnp.sin(tilt)]))
        mesh = eqx.tree_at(lambda mesh: mesh.nodes, scene.mesh, size * scene.mesh.nodes)
        made = dataclasses.replace(
            scene, mesh=mesh, connectors=[turned, js.Spherical(6, 8)],
            initial=js.Initial.rigid(mesh, velocity=(1.0, 0.0, 2.0), angular_velocity=(20.0, 10.0, 5.0)),
        )  # fmt: skip
        load = js.NodalForce([0], (0.0, 0.0, 5.0))
        made = dataclasses.replace(made, loads=[load])
        run = js.simulate(made, js.EnergyMomentum(), dt=5e-5, t_end=1e-3, newton=js.Newton(tolerance=1e-12))
        return jnp.sum(run.displacements[-1, 0] * jnp.array([1.0, 2.0, 3.0]))

    at = (0.2, 1.1)
    backward = jax.grad(measured, argnums=(0, 1))(*at)
    for k in range(2):
        _, forward = jax.jvp(measured, at, tuple(float(k == i) for i in range(2)))
        # The axis counts a thousandth of the size, whose round-off it shares.
        np.testing.assert_allclose(backward[k], forward, rtol=1e-10, atol=1e-11 * max(map(abs, backward)))
        # Of fourth order, so that steps may be far above what Newton leaves.
        values = [measured(*[a + s * 1e-3 * (k == i) for i, a in enumerate(at)]) for s in (-2, -1, 1, 2)]
        np.testing.assert_allclose(forward, np.dot([1, -8, 8, -1], values) / 12e-3, rtol=1e-6)
