"""Meshes, sections, supports, loads and scenes: what they hold, select and sum up to."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxshell as js
from jaxshell.assembly.discretised import Model
from jaxshell.assembly.structure import structure_of
from jaxshell.assembly.tables import analyse
from jaxshell.model.generators import rectangle

RECTANGLE = rectangle(2.0, 1.0, [4, 2])
SECTION = js.Section(0.1, 1e4, 0.3, 5.0)
build = eqx.filter_jit(Model.build)


def model_of(*loads, mesh=RECTANGLE) -> Model:
    scene = js.Scene(mesh, SECTION, loads=loads)
    return build(scene, analyse(structure_of(scene))[0])


def areas(mesh) -> np.ndarray:
    a, b, c = (np.asarray(mesh.nodes)[mesh.triangles[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


# --- meshes -----------------------------------------------------------------------------------------------


def test_selections():
    mesh = RECTANGLE
    assert mesh.n_nodes == 15 and mesh.n_elements == 16
    edge = mesh.nodes_where(lambda x: np.isclose(x[0], 2.0))
    np.testing.assert_allclose(np.asarray(mesh.nodes)[edge, 0], 2.0)
    assert len(edge) == 3 and mesh.nearest_node([1.9, 0.9, 0.2]) == edge[-1]
    assert len(mesh.boundary_edges()) == 12
    assert areas(mesh).sum() == pytest.approx(2.0)


def test_quads_are_cut_along_the_first_diagonal():
    np.testing.assert_array_equal(js.structured_triangles(1, 1), [[0, 2, 3], [0, 3, 1]])
    closed = js.structured_triangles(2, 3, periodic=True)
    assert closed.shape == (12, 3) and closed.max() == 8
    np.testing.assert_array_equal(closed[4:6], [[2, 5, 3], [2, 3, 0]])


@pytest.mark.parametrize("suffix", [".vtk", ".msh", ".stl"])
def test_files_that_meshlane_writes(suffix, tmp_path):
    import meshlane

    points = np.concatenate([np.asarray(RECTANGLE.nodes), [[9.0, 9.0, 9.0]]])  # one that no triangle uses
    meshlane.write(tmp_path / f"sheet{suffix}", meshlane.Mesh(points, {"triangle": RECTANGLE.triangles}))
    mesh = js.Mesh.read(tmp_path / f"sheet{suffix}")
    assert mesh.n_nodes == RECTANGLE.n_nodes and mesh.n_elements == RECTANGLE.n_elements
    np.testing.assert_allclose(areas(mesh), areas(RECTANGLE), rtol=1e-6)


# --- sections, supports, loads ----------------------------------------------------------------------------


def test_sections_per_element():
    thickness = np.linspace(0.1, 0.2, 16)
    section = js.Section(thickness, 1e4, 0.3, 5.0).per_element(16)
    np.testing.assert_array_equal(section.thickness, thickness)
    np.testing.assert_array_equal(section.density, np.full(16, 5.0))


def test_freedoms_of_supports():
    np.testing.assert_array_equal(js.pinned([0, 2]).dof_numbers, [[0, 1, 2], [12, 13, 14]])
    np.testing.assert_array_equal(js.symmetry([1], "y").dof_numbers, [[7, 9, 11]])
    supports = [js.clamped([0]), js.Support([0, 1], "uz")]
    scene = js.Scene(RECTANGLE, SECTION, supports)
    np.testing.assert_array_equal(scene.held_dofs, [0, 1, 2, 3, 4, 5, 8])


def test_histories():
    ramp, pulse = js.History.ramp(2.0), js.History([1.0, 2.0, 4.0], [0.0, 3.0, 1.0])
    np.testing.assert_allclose([ramp(t) for t in (0.0, 1.0, 2.0, 9.0)], [0.0, 0.5, 1.0, 1.0])
    np.testing.assert_allclose([pulse(t) for t in (0.0, 1.5, 3.0, 9.0)], [0.0, 1.5, 2.0, 1.0])
    assert float(js.History.constant()(-1.0)) == 1.0


def test_resultants_of_loads():
    """Edge force: length times intensity, at its middle. Gravity: the weight, at the centre."""
    nodes = np.asarray(RECTANGLE.nodes)
    right = np.flatnonzero(np.isclose(nodes[:, 0], 2.0))
    edge = js.EdgeForce(np.stack([right[:-1], right[1:]], 1), [1.0, 2.0, 3.0])
    weight = js.Gravity([0.0, 0.0, -10.0], js.History.ramp(1.0))
    twice = js.NodalForce([3, 3], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    for load, time, force, at in (
        (edge, 0.0, [1.0, 2.0, 3.0], [2.0, 0.5, 0.0]),
        (weight, 0.5, [0.0, 0.0, -0.5 * 10.0 * 5.0 * 0.1 * 2.0], [1.0, 0.5, 0.0]),
        (twice, 0.0, [1.0, 1.0, 0.0], nodes[3]),
    ):
        found = np.asarray(model_of(load).dead_load(time))
        np.testing.assert_allclose(found[:, :3].sum(axis=0), force, atol=1e-13)
        moment = np.cross(nodes, found[:, :3]).sum(axis=0)
        np.testing.assert_allclose(moment, np.cross(at, force), atol=1e-13)
    found = np.asarray(model_of(js.NodalMoment([2], [0.0, 4.0, 0.0])).dead_load(0.0))
    assert found[2, 4] == 4.0 and np.abs(found).sum() == 4.0


def following(model, x) -> np.ndarray:
    """Loads that follow the shape x, nodes not turned."""
    x = jnp.asarray(x)
    return np.asarray(model.following_load(x, jnp.broadcast_to(jnp.eye(3), (len(x), 3, 3)), 0.0))


def test_pressure_acts_on_the_deformed_surface():
    """p times the area, along the normal, of the sheet stretched by three and turned on its side."""
    model = model_of(js.Pressure(2.0))
    x = 3.0 * np.asarray(model.x0)[:, [2, 0, 1]]  # normal +x
    force = following(model, x)
    np.testing.assert_allclose(force[:, :3].sum(axis=0), [2.0 * 9.0 * 2.0, 0.0, 0.0], atol=1e-12)


def test_pressure_on_a_closed_surface_has_no_resultant():
    corners = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    mesh = js.Mesh(corners, np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]))
    force = following(model_of(js.Pressure(7.0), mesh=mesh), corners)
    assert np.abs(force).max() > 1.0
    np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-13)


# --- scenes -----------------------------------------------------------------------------------------------


def test_a_scene_is_a_pytree_of_its_floats():
    scene = js.scenes.spherical_cap(divisions=2)
    leaves = jax.tree.leaves(scene)
    assert all(jnp.issubdtype(leaf.dtype, jnp.floating) for leaf in leaves)
    assert {leaf.shape for leaf in leaves} >= {(9, 3), (3,), ()}
    doubled = jax.tree.map(lambda leaf: 2 * leaf, scene)
    assert float(doubled.section.thickness) == 2 * float(scene.section.thickness)
    # Structure is static and hashable, so that an equal scene compiles nothing anew.
    again = jax.tree.structure(js.scenes.spherical_cap(divisions=2))
    assert jax.tree.structure(scene) == again and hash(again) == hash(jax.tree.structure(scene))


def test_scenes_and_their_parts_can_be_replaced():
    """dataclasses.replace gives back to every __init__ what the object holds."""
    history = js.History.ramp(1.0)
    support = js.Support([0, 3], ("ux", "uy"), displacement=[1.0, 2.0], history=history)
    loads = (
        js.NodalForce([1], [0.0, 0.0, 1.0]),
        js.NodalMoment([1], [1.0, 0.0, 0.0]),
        js.EdgeForce([[1, 2]], [1.0, 0, 0]),
    )
    cap = js.scenes.spherical_cap(4)
    for part in (support, *loads, js.Gravity([0.0, 0.0, -9.81]), js.Pressure(2.0, history), cap):
        same = dataclasses.replace(part)
        assert jax.tree.structure(same) == jax.tree.structure(part)
        assert all(np.array_equal(a, b) for a, b in zip(jax.tree.leaves(same), jax.tree.leaves(part), strict=True))
    other = dataclasses.replace(cap, loads=(), watch={"rim": (3, "ux")})
    assert other.loads == () and other.watch == (("rim", 3, "ux"),) and other.mesh is cap.mesh


def test_the_papers_scenes():
    """Section VI: meshes, section, loads, supports, steps."""
    cap, plate, opened = js.scenes.spherical_cap(), js.scenes.free_plate(), js.scenes.opened_cap()
    assert [scene.mesh.n_elements for scene in (cap, plate, opened)] == [200, 90, 960]
    assert [len(scene.supports) for scene in (cap, plate, opened)] == [3, 0, 1]
    nodes = np.asarray(cap.mesh.nodes)
    np.testing.assert_allclose(np.linalg.norm(nodes, axis=1), 0.1209, rtol=1e-14)
    assert np.ptp(nodes[:, 2]) == pytest.approx(0.002182, rel=1e-3)  # H
    np.testing.assert_allclose(cap.loads[0].force, [0, 0, -111.2])  # a quarter of 444.8 N
    quarter = 2 * np.pi * 0.1209**2 * (1 - np.cos(np.radians(10.9))) / 4
    assert areas(cap.mesh).sum() == pytest.approx(quarter, rel=5e-3)
    pulse = plate.loads[0].history
    np.testing.assert_allclose([pulse(t) for t in (0.001, 0.002, 0.003, 0.005)], [2e4, 4e4, 2e4, 0.0])
    ring = opened.loads[0]
    forces = np.asarray(ring.nodal(opened.mesh.nodes, opened.mesh.triangles, None))
    assert np.count_nonzero(forces) == 48 and np.allclose(forces[forces != 0], -1)
    np.testing.assert_allclose([ring.history(t) for t in (0.5, 1.0, 3.0)], [0.5, 1.0, 1.0])
    top = np.asarray(opened.mesh.nodes)[opened.watch[0][1]]
    azimuth = np.radians(18.594)
    np.testing.assert_allclose(top, 12.16 * np.array([np.sin(azimuth), 0, np.cos(azimuth)]), rtol=1e-14)
    assert [scene.defaults.dt for scene in (cap, plate, opened)] == [2e-6, 5e-5, 0.01]
    names = [[name for name, *_ in scene.defaults.methods] for scene in (cap, plate, opened)]
    assert names == [["EMC", "EDMC1", "EDMC2"]] * 3


def test_normals_point_away_from_the_centre_of_the_sphere():
    for scene in (js.scenes.spherical_cap(divisions=3), js.scenes.opened_cap((6, 2))):
        x = np.asarray(scene.mesh.nodes)[scene.mesh.triangles]
        normals = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
        assert np.all(np.sum(normals * x.mean(axis=1), axis=1) > 0)


def test_opened_cap_carries_the_same_resultant_on_any_mesh():
    for divisions in ((48, 10), (12, 3)):
        scene = js.scenes.opened_cap(divisions)
        nodal = np.asarray(scene.loads[0].nodal(scene.mesh.nodes, scene.mesh.triangles, None))
        assert nodal[:, 2].sum() == pytest.approx(-48.0, rel=1e-14)
        assert nodal[nodal[:, 2] != 0, 2] == pytest.approx(-48.0 / divisions[0], rel=1e-14)
