"""Bisection: angles and sets stay good however often it is done, and the whole scene goes along as in `test_refine`."""

import equinox as eqx
import h5py
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sensitivity import check_slope
from test_refine import SECTION, check_patch, irregular, moments_of_mass, resultants, rich_scene

import jaxshell as js
from jaxshell.model import generators
from jaxshell.model.edges import Edges
from jaxshell.model.mesh_checks import triangle_areas
from jaxshell.model.refinement.split import PATTERNS
from jaxshell.results.tree import read_scene_of, write_scene

CHOSEN = [8, 16]
CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.5, 0.0], [0.5, 0.5], [0.0, 0.5]])


def smallest_angle(mesh: js.Mesh) -> float:
    x, angles = np.asarray(mesh.nodes)[mesh.triangles], []
    for corner in range(3):
        a, b = (x[:, (corner + k) % 3] - x[:, corner] for k in (1, 2))
        cosine = np.sum(a * b, axis=1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
        angles.append(np.degrees(np.arccos(cosine)).min())
    return min(angles)


def bisected_at_random(mesh: js.Mesh, times: int) -> js.Mesh:
    rng = np.random.default_rng(0)
    for _ in range(times):
        mesh = js.refine(mesh, elements=rng.choice(mesh.n_elements, 1 + mesh.n_elements // 4, replace=False))
    return mesh


@pytest.mark.parametrize("pattern", PATTERNS)
def test_children_tile_their_parent_and_the_first_lies_along_it(pattern):
    children = CORNERS[np.array(PATTERNS[pattern])]
    a, b = children[:, 1] - children[:, 0], children[:, 2] - children[:, 0]
    areas = 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    assert (areas > 0.1).all() and areas.sum() == 0.5
    assert a[0, 1] == 0.0
    used = set(np.array(PATTERNS[pattern]).ravel().tolist())
    assert used == {0, 1, 2, *(3 + edge for edge in pattern)}


def test_no_angle_falls_below_half_of_the_smallest_and_all_edges_meet():
    mesh = irregular()
    fine = bisected_at_random(mesh, 6)
    assert fine.n_elements > 200
    assert smallest_angle(fine) >= 0.5 * smallest_angle(mesh)
    assert triangle_areas(np.asarray(fine.nodes), fine.triangles).sum() == pytest.approx(1.0, rel=1e-13)
    # A node in the middle of another triangle's edge would leave edges of one triangle inside of the square.
    middles = np.asarray(fine.nodes)[fine.boundary_edges()].mean(axis=1)[:, :2]
    assert np.allclose(np.abs(middles - 0.5).max(axis=1), 0.5)


def test_the_chosen_elements_are_cut_so_often_and_others_only_as_they_must():
    mesh = generators.rectangle(1.0, 1.0, (8, 8))
    fine = js.refine(mesh, 4, elements=[0])
    x, area = (
        np.asarray(fine.nodes)[fine.triangles].mean(axis=1),
        triangle_areas(np.asarray(fine.nodes), fine.triangles),
    )
    a, b, c = np.asarray(mesh.nodes)[mesh.triangles[0], :2]
    inside = np.linalg.solve(np.stack([b - a, c - a], 1), (x[:, :2] - a).T)
    inside = (inside > 0).all(axis=0) & (inside.sum(axis=0) < 1)
    assert area[inside].max() == pytest.approx(area.max() / 16) and inside.sum() == 16
    assert fine.n_elements < 180


def test_equal_lengths_are_cut_alike_however_the_mesh_is_turned():
    mesh = generators.rectangle(3.0, np.sqrt(3.0), (6, 4))
    nodes = np.array(mesh.nodes)
    nodes[:, 0] += 0.25 * np.round(nodes[:, 1] / (np.sqrt(3.0) / 4))  # equilateral
    turned = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    found = [js.refine(js.Mesh(x, mesh.triangles), 3, elements=[7]).triangles for x in (nodes, nodes @ turned.T)]
    assert np.array_equal(*found)


def test_all_triangles_at_a_junction_are_cut():
    nodes = [[0, 0, 0], [1, 0, 0], [0.4, 0.5, 0], [0.5, -0.5, 0], [0.6, 0, 0.6]]
    mesh = js.Mesh(nodes, [[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    fine = js.refine(mesh, elements=[2])
    assert fine.n_elements == 6 and fine.n_nodes == 6
    finer = js.refine(fine, 3, elements=[0])
    edges, x = Edges(finer.triangles), np.asarray(finer.nodes)
    of_three = edges.ends[edges.count == 3]
    assert np.linalg.norm(x[of_three[:, 1]] - x[of_three[:, 0]], axis=1).sum() == pytest.approx(1.0)
    assert set(edges.count) == {1, 2, 3}


@pytest.fixture(scope="module")
def rich() -> js.Scene:
    return rich_scene()


@pytest.fixture(scope="module")
def rich_fine(rich) -> js.Scene:
    return js.refine(rich, 2, elements=CHOSEN)


def test_mass_resultants_sets_and_what_stands_on_them_stay(rich, rich_fine):
    mesh = rich_fine.mesh
    assert 30 < mesh.n_elements < 3 * 18
    np.testing.assert_allclose(*[moments_of_mass(scene) for scene in (rich, rich_fine)], rtol=1e-13)
    np.testing.assert_allclose(resultants(rich), resultants(rich_fine), rtol=1e-12, atol=1e-12)
    x, sets, plain = np.asarray(mesh.nodes), mesh.node_sets, np.arange(mesh.n_nodes - 2)
    assert np.array_equal(sets["left"], np.flatnonzero(x[plain, 0] < 1e-12))
    assert np.array_equal(sets["rim"], np.flatnonzero((np.abs(x[plain, :2] - 0.5) > 0.5 - 1e-12).any(axis=1)))
    assert np.array_equal(sets["all"], plain) and sets["one"].tolist() == [5]
    sides = x[mesh.side_sets["right"]]
    assert (sides[:, :, 0] == 1.0).all() and len(sides) > 3
    assert np.abs(np.diff(sides[:, :, 1], axis=1)).sum() == pytest.approx(1.0)
    first = triangle_areas(x, mesh.triangles)[mesh.element_sets["first"]].sum()
    was = triangle_areas(np.asarray(rich.mesh.nodes), rich.mesh.triangles)[:9].sum()
    assert first == pytest.approx(was, rel=1e-13)
    assert rich_fine.masses[0].nodes.array.tolist() == [9, len(x) - 2]
    assert {label: number for label, number, _ in rich_fine.watch if label != "stress"} == {
        "middle": 5, "spring": "cable",
    }  # fmt: skip
    # Values for each element are those of the triangle around its middle.
    alpha = [np.asarray(scene.damping.alpha) for scene in (rich, rich_fine)]
    areas = [triangle_areas(np.asarray(s.mesh.nodes), s.mesh.triangles) for s in (rich, rich_fine)]
    for value, area in zip(alpha[0], areas[0], strict=True):
        assert areas[1][np.isclose(alpha[1], value)].sum() == pytest.approx(area, rel=1e-12)
    gauge = next(number for label, number, _ in rich_fine.watch if label == "stress")
    along = [
        np.diff(np.asarray(s.mesh.nodes)[s.mesh.triangles[k, :2]], axis=0)[0]
        for s, k in ((rich, 4), (rich_fine, gauge))
    ]
    assert np.allclose(np.cross(*along), 0.0, atol=1e-15) and np.isclose(alpha[1][gauge], alpha[0][4])


def test_a_rigid_motion_and_moved_supports_go_on(rich, rich_fine):
    wanted = js.Initial.rigid(rich_fine.mesh, [1.0, 2.0, 3.0], [0.3, -0.2, 0.5], about=irregular().nodes.mean(axis=0))
    n = rich_fine.mesh.n_nodes - 2
    np.testing.assert_allclose(rich_fine.initial.velocities[:n], wanted.velocities[:n], atol=1e-13)
    moved = rich_fine.supports[1]
    y = np.asarray(rich_fine.mesh.nodes)[moved.nodes.array, 1]
    assert len(y) == 3
    np.testing.assert_allclose(moved.values(jnp.array(1.0))[:, 0], 3.0 * y - 2.0, atol=1e-12)


def test_constant_strain_and_curvature_leave_inner_nodes_of_a_bisected_mesh_without_force():
    check_patch(js.refine(irregular(), 2, elements=CHOSEN))


@pytest.mark.slow
def test_a_bisected_curved_shell_has_six_rigid_modes():
    mesh = js.refine(generators.cylinder(1.0, 1.0, (1, 2), angle=90.0), 2, elements=[0])
    frequencies = np.asarray(js.natural_frequencies(js.Scene(mesh, SECTION), count=7).frequencies)
    assert np.abs(frequencies[:6]).max() < 1e-4 * frequencies[6]


def test_new_nodes_are_on_the_true_surface_and_between_smooth_ones():
    ring = generators.spherical_zone(1.0, 20.0, 60.0, (12, 2))
    np.testing.assert_allclose(jnp.linalg.norm(js.refine(ring, 2, elements=[3]).nodes, axis=1), 1.0, rtol=1e-14)
    smooth = js.refine(ring.on_surface(None), elements=[3])
    assert smooth.n_nodes > ring.n_nodes
    np.testing.assert_allclose(jnp.linalg.norm(smooth.nodes, axis=1), 1.0, atol=1e-9)


def test_a_corner_between_two_supported_edges_stays_free_however_it_is_cut():
    """The corner triangle is cut at an edge on a support: both halves have all of their nodes on supports then."""
    mesh = js.Mesh([[0, 0, 0], [1, 0, 0], [0.8, 0.4, 0], [1.2, 0.6, 0]], [[0, 1, 2], [1, 3, 2]])
    scene = js.Scene(mesh, SECTION, [js.pinned([0, 1, 2])])
    rim = js.Scene(js.Mesh(mesh.nodes, mesh.triangles, node_sets={"rim": [0, 1, 2]}), SECTION)
    for shell, held in ((scene, lambda s: s.supports[0].nodes.array), (rim, lambda s: s.mesh.node_sets["rim"])):
        fine = js.refine(shell, 5, elements=[0])
        x, y, _ = np.asarray(fine.mesh.nodes).T
        on_lines = (np.abs(y) < 1e-12) | (np.abs(y - 0.5 * x) < 1e-12) & (x < 0.8 + 1e-12)
        assert on_lines.sum() > 6
        assert np.array_equal(np.sort(held(fine)), np.flatnonzero(on_lines))


def test_what_cannot_be_told_is_refused_where_it_is_cut_and_only_there():
    mesh = generators.rectangle(1.0, 1.0, (3, 3))
    scene = js.Scene(mesh, SECTION, [js.pinned([0, 4, 8, 12, 5, 6, 7])])
    assert js.refine(scene, elements=[17]).mesh.n_elements == 20
    with pytest.raises(ValueError, match=r"support 0: nodes .* of element 0, .* cannot be told"):
        js.refine(scene, elements=[1])


def test_edges_that_a_hinge_joins_are_cut_together():
    one = generators.rectangle(1.0, 1.0, (1, 1))
    shifted = np.asarray(one.nodes) * [2.0, 1.0, 1.0] + [1.0, 0.0, 0.0]
    mesh = js.Mesh(
        np.concatenate([one.nodes, shifted]), np.concatenate([one.triangles, one.triangles + 4]), coincident="allow"
    )
    scene = js.Scene(mesh, SECTION, connectors=[js.Hinge([2, 3], [4, 5], [0.0, 1.0, 0.0], stiffness=2.0)])
    fine = js.refine(scene, 3, elements=[0])
    x = np.asarray(fine.mesh.nodes)
    pairs = np.concatenate([item.pairs.array for item in fine.connectors])
    np.testing.assert_allclose(x[pairs[:, 0]], x[pairs[:, 1]], atol=1e-15)
    at_seam = np.flatnonzero(np.abs(x[:, 0] - 1.0) < 1e-12)
    assert len(pairs) > 2 and np.array_equal(np.sort(pairs.ravel()), at_seam)


@pytest.mark.parametrize("surface", [None, "smooth"])
def test_places_differentiate_with_the_edges_that_are_cut(surface):
    mesh = generators.spherical_zone(1.0, 20.0, 60.0, (5, 2))
    rng = np.random.default_rng(3)
    start = mesh.nodes + 0.01 * jnp.asarray(rng.standard_normal(mesh.nodes.shape))
    change = jnp.asarray(rng.standard_normal(mesh.nodes.shape))
    weights = jnp.asarray(rng.standard_normal((60, 3)))

    def measure(nodes):
        moved = eqx.tree_at(lambda m: m.nodes, mesh, nodes)
        fine = js.refine(moved, 1, surface, 80.0, elements=[0, 5]).nodes
        return jnp.sum(weights[: len(fine)] * fine)

    check_slope(measure, start, change)
    if surface is None:
        with pytest.raises(ValueError, match=r"traced by jax\.jit"):
            jax.jit(measure)(start)


def test_a_bisected_scene_in_a_file_is_bisected_again(tmp_path):
    scene = js.refine(js.scenes.spherical_cap(2), elements=[0])
    with h5py.File(tmp_path / "scene.h5", "w") as file:
        write_scene(file.create_group("scene"), scene)
        read = read_scene_of(file, "scene.h5")
    again, wanted = (js.refine(s, elements=[1, 2]) for s in (read, scene))
    np.testing.assert_array_equal(again.mesh.nodes, wanted.mesh.nodes)
    assert np.array_equal(again.mesh.triangles, wanted.mesh.triangles)
    assert np.array_equal(again.held_dofs, wanted.held_dofs)


@pytest.mark.parametrize(
    ("elements", "message"),
    [
        ([18], "names element 18"),
        ("skin", "There is no set of elements 'skin'"),
        ([1, 1], "names an element twice"),
        ([], "at least one"),
    ],
)
def test_elements_that_there_are_not_are_refused(elements, message):
    with pytest.raises(ValueError, match=message):
        js.refine(irregular(), elements=elements)


def test_no_levels_and_the_name_of_a_set():
    mesh = irregular(element_sets={"skin": CHOSEN})
    assert js.refine(mesh, 0, elements="skin") is mesh
    assert np.array_equal(js.refine(mesh, elements="skin").triangles, js.refine(mesh, elements=CHOSEN).triangles)
