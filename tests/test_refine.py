"""Refinement: what must not change is exact, what is curved converges, and what cannot be told is refused."""

import equinox as eqx
import h5py
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from linear import _element as stiffness
from scipy.spatial import KDTree
from sensitivity import check_slope

import jaxshell as js
from jaxshell.command.cli import main
from jaxshell.files.scene_file import read_scene_file
from jaxshell.model import generators
from jaxshell.model.grids import chain
from jaxshell.model.mesh_checks import triangle_areas
from jaxshell.results.tree import read_scene_of, write_scene

SECTION = js.Section(0.01, 1e6, 0.3, 1000.0)


def resultants(scene: js.Scene) -> np.ndarray:
    """Forces and moments about the origin of all loads with fixed directions."""
    x, mass = scene.mesh.nodes, scene.section.area_masses(scene.mesh)
    dead = (load for load in scene.loads if hasattr(load, "nodal"))
    loads = sum((load.nodal(x, scene.mesh.triangles, mass) for load in dead), jnp.zeros((len(x), 6)))
    return np.concatenate([loads[:, :3].sum(axis=0), (jnp.cross(x, loads[:, :3]) + loads[:, 3:]).sum(axis=0)])


def moments_of_mass(scene: js.Scene) -> np.ndarray:
    """The shell's mass, and that times the place of its middle."""
    x, triangles = np.asarray(scene.mesh.nodes), scene.mesh.triangles
    mass = np.asarray(scene.section.area_masses(scene.mesh)) * triangle_areas(x, triangles)
    return np.concatenate([[mass.sum()], mass @ x[triangles].mean(axis=1)[:, :2]])


def irregular(**sets) -> js.Mesh:
    """A unit square of 3 × 3 cells whose inner nodes are moved."""
    flat = generators.rectangle(1.0, 1.0, (3, 3))
    nodes = np.array(flat.nodes)
    inner = (nodes[:, :2] > 0.1).all(axis=1) & (nodes[:, :2] < 0.9).all(axis=1)
    nodes[inner, :2] += 0.08 * np.array([[1.0, -0.5], [-0.7, 0.4], [0.3, 0.8], [-0.5, -0.9]])
    return js.Mesh(nodes, flat.triangles, **sets)


def matched(fine: js.Mesh, other: js.Mesh) -> tuple[float, np.ndarray]:
    """The largest distance of the nodes of `other` to those of `fine`, and which these are."""
    apart, number = KDTree(np.asarray(fine.nodes)).query(np.asarray(other.nodes))
    return float(np.max(apart)), number


SCENES = {
    "spherical_cap": (3, 6), "free_plate": ((4, 2), (8, 4)), "opened_cap": ((8, 2), (16, 4)),
    "snapping_panel": ((2, 2), (4, 4)), "slit_annular_plate": ((1, 6), (2, 12)), "hemisphere": ((2, 2), (4, 4)),
    "suddenly_loaded_cap": (3, 6),
    "twisted_beam": ((4, 2), (8, 4)), "l_shaped_plate": (1, 2), "pinched_cylinder": ((2, 2), (4, 4)),
}  # fmt: skip


RING = np.cos(np.pi / 16)
"""Length of a regular polygon of 8 edges over that of 16 in the same circle."""
LONG = ("snapping_panel", "pinched_cylinder")


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow if n in LONG else ()) for n in SCENES])
def test_a_refined_scene_of_the_library_is_that_with_doubled_divisions(name):
    coarse, doubled = (getattr(js.scenes, name)(divisions) for divisions in SCENES[name])
    fine = js.refine(coarse)
    apart, number = matched(fine.mesh, doubled.mesh)
    size = float(jnp.max(jnp.abs(fine.mesh.nodes)))
    assert fine.mesh.n_nodes == doubled.mesh.n_nodes and apart < 1e-13 * size
    if name == "slit_annular_plate":  # whose lips coincide: which of them is nearest is chance
        return
    as_sets = [
        {frozenset(t) for t in triangles.tolist()}
        for triangles in (fine.mesh.triangles, number[doubled.mesh.triangles])
    ]
    assert as_sets[0] == as_sets[1]
    held = 6 * number[doubled.held_dofs // 6] + doubled.held_dofs % 6
    assert np.array_equal(np.sort(held), fine.held_dofs)
    scale = np.abs(resultants(doubled)).max()
    longer = 1 / RING if name == "opened_cap" else 1.0  # loads on edges are per length
    np.testing.assert_allclose(resultants(fine), longer * resultants(coarse), atol=1e-12 * scale)
    np.testing.assert_allclose(resultants(fine), longer * resultants(doubled), atol=1e-12 * scale)
    assert [label for label, _, _ in fine.watch] == [label for label, _, _ in doubled.watch]


def rich_scene() -> js.Scene:
    """A plate in two regions with everything on it that is carried over."""
    rim = generators.rectangle(1.0, 1.0, (3, 3)).boundary_edges()
    mesh = irregular(
        node_sets={"left": [0, 1, 2, 3], "all": np.arange(16), "one": [5], "rim": np.unique(rim), "line": [4, 5, 6, 7]},
        element_sets={"first": np.arange(9), "rest": np.arange(9, 18)},
        side_sets={"right": chain(np.array([12, 13, 14, 15]))},
    ).with_points({"anchor": [0.5, 0.5, 0.3]})
    other = js.Section(0.02, 2e6, 0.3, np.linspace(900.0, 1100.0, 9))
    return js.Scene(
        mesh,
        {"first": SECTION, "rest": other},
        [js.pinned("left"), js.Support([14, 15], "uz", displacement=[[0.0], [1.0]], history=js.History.ramp(1.0))],
        [
            js.NodalForce([5, 6], [[1.0, 2.0, 3.0], [0.0, 0.0, 1.0]]),
            js.EdgeForce("right", [[1.0, 0.0, 2.0], [2.0, 0.0, 2.0], [3.0, 1.0, 2.0]]),
            js.Gravity([0.0, 0.0, -9.81]),
            js.Traction(np.arange(27.0).reshape(9, 3), elements="rest"),
            js.DeadPressure(3.0, elements="first"),
        ],
        initial=js.Initial.rigid(irregular(), [1.0, 2.0, 3.0], [0.3, -0.2, 0.5]),
        watch={"middle": (5, "uz"), "stress": (4, "Mxx"), "spring": ("cable", "force")},
        damping=js.RayleighDamping(np.linspace(0.0, 1.0, 18), 1e-4),
        masses=[js.PointMass([9, 16], [1.0, 2.0])],
        connectors=[js.Spring(5, 16, 10.0, name="cable"), js.RigidBody([10, 11], name="body")],
        obstacles=[js.Plane([0.0, 0.0, 1.0], [0.0, 0.0, -5.0], nodes="all")],
    )


@pytest.fixture(scope="module")
def rich() -> js.Scene:
    return rich_scene()


@pytest.fixture(scope="module")
def rich_fine(rich) -> js.Scene:
    return js.refine(rich)


def test_mass_resultants_and_sets_stay(rich, rich_fine):
    masses = [moments_of_mass(scene) for scene in (rich, rich_fine)]
    np.testing.assert_allclose(masses[0], masses[1], rtol=1e-13)
    np.testing.assert_allclose(resultants(rich), resultants(rich_fine), rtol=1e-12, atol=1e-12)
    x, sets = np.asarray(rich_fine.mesh.nodes), rich_fine.mesh.node_sets
    plain = np.arange(rich_fine.mesh.n_nodes - 2)
    on_rim = (np.abs(x[plain, :2] - 0.5) > 0.5 - 1e-12).any(axis=1)
    assert np.array_equal(sets["left"], np.flatnonzero(x[plain, 0] < 1e-12))
    assert np.array_equal(sets["all"], plain)
    assert np.array_equal(sets["rim"], np.flatnonzero(on_rim))
    assert sets["one"].tolist() == [5] and len(sets["line"]) == 7
    assert len(rich_fine.mesh.side_sets["right"]) == 6
    assert sets["anchor"].tolist() == [len(plain)] and np.allclose(x[-2], [0.5, 0.5, 0.3])


def test_what_stands_on_nodes_and_elements_follows(rich, rich_fine):
    x = np.asarray(rich_fine.mesh.nodes)
    n = len(x)
    assert rich_fine.masses[0].nodes.array.tolist() == [9, n - 2]
    assert rich_fine.connectors[0].nodes.array.tolist() == [[5, n - 2]]
    body = rich_fine.connectors[1]
    assert (
        body.master == n - 1 and len(body.nodes.array) == 3 and np.allclose(x[body.nodes.array[2]], x[[10, 11]].mean(0))
    )
    assert len(rich_fine.obstacles[0].nodes.array) == n - 2
    assert {label: number for label, number, _ in rich_fine.watch} == {
        "middle": 5,
        "stress": 19,
        "spring": "cable",
    }
    moved = rich_fine.supports[1]
    np.testing.assert_allclose(moved.values(jnp.array(1.0))[:, 0], [0.0, 1.0, 0.5])
    np.testing.assert_allclose(rich_fine.damping.alpha, np.repeat(np.linspace(0.0, 1.0, 18), 4))
    # A child's first edge is along its parent's, so that components in its axes mean the same.
    e = [np.diff(np.asarray(s.mesh.nodes)[s.mesh.triangles[:, :2]], axis=1)[:, 0] for s in (rich, rich_fine)]
    assert np.allclose(np.cross(np.repeat(e[0], 4, axis=0), e[1]), 0.0, atol=1e-15)


def test_a_rigid_motion_goes_on_as_one(rich, rich_fine):
    wanted = js.Initial.rigid(rich_fine.mesh, [1.0, 2.0, 3.0], [0.3, -0.2, 0.5], about=irregular().nodes.mean(axis=0))
    n = rich_fine.mesh.n_nodes - 2
    np.testing.assert_allclose(rich_fine.initial.velocities[:n], wanted.velocities[:n], atol=1e-13)
    np.testing.assert_allclose(rich_fine.initial.angular_velocities[:n], wanted.angular_velocities[:n], atol=1e-13)


def test_a_turned_start_on_a_curved_shell_is_turned_as_a_whole():
    mesh = generators.cylinder(1.0, 1.0, (1, 4), angle=90.0)
    R = jax.scipy.linalg.expm(jnp.array([[0.0, -0.7, 0.4], [0.7, 0.0, -1.1], [-0.4, 1.1, 0.0]]))
    rows = jnp.broadcast_to(R, (mesh.n_nodes, 3, 3))
    spin = jnp.array([0.2, 0.5, -0.1])
    start = js.Initial(
        jnp.cross(spin, mesh.nodes @ R.T), jnp.broadcast_to(spin, mesh.nodes.shape), mesh.nodes @ R.T - mesh.nodes, rows
    )
    fine = js.refine(js.Scene(mesh, SECTION, initial=start))
    x = fine.mesh.nodes
    np.testing.assert_allclose(x + fine.initial.displacements, x @ R.T, atol=1e-14)
    np.testing.assert_allclose(fine.initial.rotations, jnp.broadcast_to(R, (len(x), 3, 3)), atol=1e-14)
    np.testing.assert_allclose(fine.initial.velocities, jnp.cross(spin, x @ R.T), atol=1e-14)


def check_patch(mesh: js.Mesh) -> None:
    """Constant strain and curvature leave the inner nodes of a plane mesh without force."""
    nodes, zero = np.asarray(mesh.nodes), np.zeros(mesh.n_nodes)
    x, y, _ = nodes.T
    u = np.stack([x + 0.3 * y, 0.3 * x - 0.5 * y, x**2 + 0.5 * x * y - 0.7 * y**2], 1)
    turned = np.stack([0.5 * x - 1.4 * y, -2.0 * x - 0.5 * y, zero], 1)
    field = np.concatenate([u, turned], axis=1)[mesh.triangles].reshape(-1, 18)
    of_elements = np.einsum("mij,mj->mi", stiffness(nodes[mesh.triangles], 0.01, 1e6, 0.3, 0.32), field)
    forces = np.zeros((mesh.n_nodes, 6))
    np.add.at(forces, mesh.triangles, of_elements.reshape(-1, 3, 6))
    inner = np.setdiff1d(np.arange(mesh.n_nodes), mesh.boundary_edges())
    for part in ([0, 1, 5], [2, 3, 4]):
        assert np.abs(forces[inner][:, part]).max() < 1e-12 * np.abs(of_elements.reshape(-1, 6)[:, part]).max()


def test_constant_strain_and_curvature_leave_inner_nodes_of_a_refined_irregular_mesh_without_force():
    check_patch(js.refine(irregular()))


@pytest.mark.slow
def test_a_refined_curved_shell_has_six_rigid_modes():
    scene = js.refine(js.Scene(generators.cylinder(1.0, 1.0, (1, 2), angle=90.0), SECTION))
    frequencies = np.asarray(js.natural_frequencies(scene, count=7).frequencies)
    assert np.abs(frequencies[:6]).max() < 1e-4 * frequencies[6]


def test_places_on_a_smooth_surface_are_of_fourth_order():
    """A quarter of a cylinder that does not know that it is one; its curved edges, and the inside."""
    errors = []
    for k in (1, 2):
        mesh = generators.cylinder(1.0, 1.0, (3 * k, 3 * k), angle=90.0).on_surface(None)
        y, z = np.asarray(js.refine(mesh).nodes)[mesh.n_nodes :, 1:].T
        errors.append(np.abs(np.hypot(y, z) - 1.0).max())
    assert errors[0] < 1e-2 and 3.5 < np.log2(errors[0] / errors[1]) < 5.0


def test_a_hole_stays_round_and_folds_stay_sharp():
    ring = generators.spherical_zone(1.0, 20.0, 60.0, (12, 2)).on_surface(None)
    fine = js.refine(ring)
    np.testing.assert_allclose(jnp.linalg.norm(fine.nodes, axis=1), 1.0, atol=1e-9)
    for edge in (20.0, 60.0):
        z = np.cos(np.radians(edge))
        of_edge = np.abs(np.asarray(fine.nodes)[:, 2] - z) < 1e-9
        assert of_edge.sum() == 24
    plate = js.refine(js.scenes.l_shaped_plate(1).mesh, levels=2)
    x, _, z = np.asarray(plate.nodes).T
    assert np.all((np.abs(x) < 1e-14) | (np.abs(z) < 1e-14))


def test_flat_refinement_keeps_the_polyhedron():
    mesh = generators.cylinder(1.0, 1.0, (1, 4), angle=90.0)
    area = [triangle_areas(np.asarray(m.nodes), m.triangles).sum() for m in (mesh, js.refine(mesh, 2, "flat"))]
    assert area[0] == pytest.approx(area[1], rel=1e-13)
    assert js.refine(mesh, 1, "flat").surface is None


@pytest.mark.parametrize("surface", [None, "smooth"])
def test_places_differentiate(surface):
    """Adjoint against forward mode, and against differences; nodes need not be on the surface."""
    mesh = generators.spherical_zone(1.0, 20.0, 60.0, (5, 2))
    rng = np.random.default_rng(3)
    weights = jnp.asarray(rng.standard_normal((4 * 15, 3)))
    change = jnp.asarray(rng.standard_normal(mesh.nodes.shape))
    start = mesh.nodes + 0.01 * jnp.asarray(rng.standard_normal(mesh.nodes.shape))

    def measure(nodes):
        moved = eqx.tree_at(lambda m: m.nodes, mesh, nodes)
        fine = js.refine(moved, surface=surface, crease=80.0).nodes
        return jnp.sum(weights[: len(fine)] * fine)

    check_slope(measure, start, change)


def test_a_refined_scene_in_a_file_is_refined_again(tmp_path):
    scene = js.refine(js.scenes.spherical_cap(2))
    with h5py.File(tmp_path / "scene.h5", "w") as file:
        write_scene(file.create_group("scene"), scene)
        read = read_scene_of(file, "scene.h5")
    again, wanted = js.refine(read), js.refine(scene)
    np.testing.assert_array_equal(again.mesh.nodes, wanted.mesh.nodes)
    assert np.array_equal(again.held_dofs, wanted.held_dofs)
    np.testing.assert_allclose(jnp.linalg.norm(again.mesh.nodes, axis=1), 0.1209, rtol=1e-14)


FILE = """
[mesh]
generator = "cylinder"
radius = 1.0
length = 1.0
angle = 90.0
divisions = [1, 2]
{refine}
[section]
thickness = 0.01
young_modulus = 1e6
poisson_ratio = 0.3
density = 1000.0
[[supports]]
plane = {{ x = 0.0 }}
hold = "clamped"
"""


def test_a_scene_file_says_refine(tmp_path):
    path = tmp_path / "shell.toml"
    path.write_text(FILE.format(refine=""))
    plain, _ = read_scene_file(path)
    path.write_text(FILE.format(refine="refine = 2"))
    fine, _ = read_scene_file(path)
    np.testing.assert_array_equal(fine.mesh.nodes, js.refine(plain, 2).mesh.nodes)
    assert len(fine.held_dofs) == 6 * 9
    path.write_text(FILE.format(refine="refine = -1"))
    with pytest.raises(ValueError, match=r"\[mesh\].*levels"):
        read_scene_file(path)


@pytest.mark.slow
def test_the_command_line_refines(tmp_path):
    arguments = ["run", "cap", "--divisions", "1", "--refine", "1", "--t-end", "4e-6", "--no-plots", "--quiet"]
    assert main([*arguments, "--method", "EMC", "--output", str(tmp_path)]) == 0
    (file,) = tmp_path.glob("*.h5")
    assert js.Solution.load(file).scene.mesh.n_elements == 8
    assert "refined_1" in file.name


def test_nodes_between_two_supports_on_an_edge_are_held_by_what_both_hold():
    mesh = generators.rectangle(1.0, 1.0, (2, 2))
    alone = js.refine(js.Scene(mesh, SECTION, [js.Support([0], "uz"), js.Support([1], "uz"), js.Support([8], "ux")]))
    assert sorted(divmod(int(dof), 6)[1] for dof in alone.held_dofs) == [0, 2, 2, 2]
    one, other = (
        js.Support([node], "ux", normal=normal) for node, normal in ((0, [1.0, 0.0, 0.0]), (1, [1.0, 1.0, 0.0]))
    )
    slanted = js.refine(js.Scene(mesh, SECTION, [one, other]))
    middle = slanted.supports[2]
    np.testing.assert_allclose(middle.axes[0], [np.cos(np.pi / 8), np.sin(np.pi / 8), 0.0], atol=1e-12)


def test_a_line_that_ends_in_a_clamped_corner_is_held_up_to_it_however_fine():
    mesh = generators.rectangle(2.0, 1.0, (2, 1))
    scene = js.Scene(mesh, SECTION, [js.pinned([0]), js.Support([2, 4], "uz")])
    for fine in (js.refine(scene, 2), js.refine(js.refine(scene))):
        held = fine.held_dofs[fine.held_dofs % 6 == 2] // 6
        assert np.array_equal(held, np.flatnonzero(np.asarray(fine.mesh.nodes)[:, 1] == 0.0))


def test_joints_of_two_edges_join_what_is_between():
    one = generators.rectangle(1.0, 1.0, (1, 1))
    nodes = np.concatenate([one.nodes, np.asarray(one.nodes) + [1.0, 0.0, 0.0]])
    mesh = js.Mesh(nodes, np.concatenate([one.triangles, one.triangles + 4]), coincident="allow")
    scene = js.Scene(mesh, SECTION, connectors=[js.Hinge([2, 3], [4, 5], [0.0, 1.0, 0.0], stiffness=2.0)])
    fine = js.refine(scene)
    assert [len(item.a.array) for item in fine.connectors] == [2, 1]
    assert fine.connectors[1].stiffness is None
    x = np.asarray(fine.mesh.nodes)
    pair = fine.connectors[1].pairs.array[0]
    np.testing.assert_allclose(x[pair], [[1.0, 0.5, 0.0]] * 2, atol=1e-15)


@pytest.mark.parametrize("name", ["spherical_cap", "opened_cap", "hemisphere", "twisted_beam"])
def test_a_coarsened_scene_of_the_library_is_that_with_half_the_divisions(name):
    half, scene = (getattr(js.scenes, name)(divisions) for divisions in COARSENED[name])
    coarse = js.coarsen(scene)
    np.testing.assert_allclose(coarse.mesh.nodes, half.mesh.nodes, atol=1e-13 * float(jnp.abs(half.mesh.nodes).max()))
    assert {tuple(t) for t in coarse.mesh.triangles.tolist()} == {tuple(t) for t in half.mesh.triangles.tolist()}
    assert np.array_equal(coarse.held_dofs, half.held_dofs) and coarse.watch == half.watch
    loads = [sum(load.nodal(s.mesh.nodes, s.mesh.triangles, None) for load in s.loads) for s in (coarse, half)]
    shorter = RING if name == "opened_cap" else 1.0
    np.testing.assert_allclose(loads[0], shorter * loads[1], atol=1e-12 * float(jnp.abs(loads[1]).max()))


def test_coarsening_undoes_refinement(rich, rich_fine):
    back = js.coarsen(rich_fine)
    np.testing.assert_allclose(back.mesh.nodes, rich.mesh.nodes, atol=1e-15)
    assert np.array_equal(back.mesh.triangles, rich.mesh.triangles)
    for sets in ("node_sets", "element_sets", "side_sets"):
        assert getattr(back.mesh, sets) == getattr(rich.mesh, sets)
    assert np.array_equal(back.held_dofs, rich.held_dofs) and back.watch == rich.watch
    np.testing.assert_allclose(resultants(back), resultants(rich), rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(back.section.resultants(back.mesh).D, rich.section.resultants(rich.mesh).D, rtol=1e-14)
    np.testing.assert_allclose(back.damping.alpha, rich.damping.alpha, rtol=1e-14)
    np.testing.assert_allclose(back.initial.velocities, rich.initial.velocities, atol=1e-14)
    assert back.connectors[1].nodes.array.tolist() == [10, 11]


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        (lambda: js.scenes.spherical_cap(3), "The mesh can not be coarsened"),
        (lambda: js.Scene(FOUR, SECTION, [js.pinned([1])]), "support 0: no nodes of the coarser mesh"),
        (lambda: js.Scene(FOUR, SECTION, loads=[js.Pressure(1.0, elements=[0])]), "load 0: some of the elements"),
        (lambda: js.Scene(FOUR, SECTION, masses=[js.PointMass([1], 1.0)]), "mass 0: node 1 is in the middle"),
    ],
)
def test_what_a_coarser_mesh_cannot_say_is_refused_by_name(scene, message):
    with pytest.raises(ValueError, match=message):
        js.coarsen(scene())


COARSENED = {"spherical_cap": (2, 4), "opened_cap": ((8, 2), (16, 4)), "hemisphere": ((2, 2), (4, 4))}
COARSENED["twisted_beam"] = ((4, 2), (8, 4))
FOUR = generators.rectangle(1.0, 1.0, (4, 4))
MESH = generators.rectangle(1.0, 1.0, (3, 3))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"loads": [js.EdgeForce([[0, 6]], [1.0, 0.0, 0.0])]}, r"load 0: \[0, 6\] is no edge"),
        ({"supports": [js.pinned([0, 4, 8, 12, 5, 6, 7])]}, "support 0: nodes .* cannot be told"),
        (
            {"supports": [js.pinned([0]), js.Support([1, 2, 3], "uz", displacement=1.0, history=js.History.ramp(1.0))]},
            "supports 0 and 1 .* move",
        ),
        ({"supports": [js.pinned([0]), js.Support([1], ("ux", "uy", "uz"), normal=[1.0, 1.0, 0.0])]}, "different axes"),
    ],
)
def test_what_cannot_be_told_is_refused_by_name(changed, message):
    with pytest.raises(ValueError, match=message):
        js.refine(js.Scene(MESH, SECTION, **changed))


def test_a_strip_of_supported_nodes_is_a_face_and_said_to_be():
    strip = generators.rectangle(4.0, 1.0, (4, 1))
    with pytest.warns(UserWarning, match="support 0 .* edges alone"):
        fine = js.refine(js.Scene(strip, SECTION, [js.symmetry(np.arange(10), "y")]))
    assert len(fine.supports[0].nodes.array) == fine.mesh.n_nodes
