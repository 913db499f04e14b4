"""Shells that were not made as they were drawn: imperfections from modes and random fields, motions of sets of nodes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxshell as js
from jaxshell.files.scene_file import read_scene_file
from jaxshell.model import generators
from jaxshell.model.normals import unit_normals

SETS = {"node_sets": {"end": [0, 1]}, "element_sets": {"part": [2]}, "side_sets": {"edge": [[0, 1]]}}


def mesh() -> js.Mesh:
    return generators.rectangle(1.0, 0.1, (8, 1)).with_sets(**SETS)


def column(mesh: js.Mesh, force=1.0) -> js.Scene:
    """Hinged at both ends, pushed along x at one; about y the moments are free."""
    left, right = [0, 1], [16, 17]
    held = [js.Support(left, ("ux", "uy", "uz", "rx", "rz")), js.Support(right, ("uy", "uz", "rx", "rz"))]
    load = js.EdgeForce([right], [-force, 0.0, 0.0])
    return js.Scene(mesh, js.Section(0.005, 1e9, 0.0, 1000.0), held, [load], watch={"middle": (8, "uz")})


FILE = """
[mesh]
generator = "rectangle"
length = 1.0
width = 0.1
divisions = [8, 1]
{imperfection}
[section]
thickness = 0.005
young_modulus = 1e9
poisson_ratio = 0.0
density = 1000.0
[[supports]]
plane = {{ x = 0.0 }}
hold = ["ux", "uy", "uz", "rx", "rz"]
[[supports]]
plane = {{ x = 1.0 }}
hold = ["uy", "uz", "rx", "rz"]
[[loads]]
kind = "edge force"
plane = {{ x = 1.0, z = 0.0 }}
force = [-1.0, 0, 0]
"""


def scene_of(tmp_path, imperfection: str) -> js.Scene:
    (tmp_path / "column.toml").write_text(FILE.format(imperfection=imperfection))
    return read_scene_file(tmp_path / "column.toml")[0]


@pytest.fixture(scope="module")
def buckled(tmp_path_factory) -> js.BucklingModes:
    """Of the file's column, as it was drawn."""
    return js.linear_buckling(scene_of(tmp_path_factory.mktemp("drawn"), ""), 2)


@pytest.mark.slow
def test_an_imperfect_column_bends_as_theory_says(buckled):
    """w = w0/(1 - P/Pcr) at the middle, to 1e-3 for w0 = L/1000 up to 0.8 of the buckling load."""
    critical, factors = float(buckled.load_factors[0]), np.array([0.2, 0.4, 0.6, 0.8])
    bent = mesh().with_imperfection(buckled.shapes[0], 1e-3)
    w0 = float(bent.nodes[8, 2])
    assert abs(w0) == pytest.approx(1e-3, rel=1e-12)
    found = js.solve_static(column(bent, critical), factors).watched["middle"]
    np.testing.assert_allclose((w0 + np.asarray(found)[1:]) / w0, 1.0 / (1.0 - factors), rtol=1e-3)


def test_modes_add_up_each_scaled_to_its_amplitude_and_sets_stay(buckled):
    perfect = mesh()
    first, second = (perfect.with_imperfection(shape, 1.0).nodes - perfect.nodes for shape in buckled.shapes)
    assert float(jnp.linalg.norm(first, axis=1).max()) == pytest.approx(1.0, rel=1e-14)
    for given in (list(buckled.shapes), buckled.shapes):
        found = perfect.with_imperfection(given, [2e-3, -1e-3])
        np.testing.assert_allclose(found.nodes, perfect.nodes + 2e-3 * first - 1e-3 * second, atol=1e-16)
    np.testing.assert_array_equal(perfect.with_imperfection(7.0 * buckled.shapes[0, :, :3], 0.1).nodes,
                                  perfect.with_imperfection(7.0 * buckled.shapes[0], 0.1).nodes)  # fmt: skip
    for kind, sets in SETS.items():
        assert {name: np.asarray(of).tolist() for name, of in getattr(found, kind).items()} == sets
    assert found.connectivity == perfect.connectivity


def test_a_random_field_has_its_covariance_over_the_seeds():
    """Four points, 1500 seeds: mean, covariance and kurtosis within four standard errors of a Gaussian sample."""
    points, length, seeds = jnp.array([[0, 0, 0], [0.3, 0, 0], [0, 0.4, 0.3], [2.0, 1, 0]]), 0.5, 1500
    values = np.stack([js.RandomField(length, seed).at(points) for seed in range(seeds)])
    apart = np.linalg.norm(np.asarray(points)[:, None] - np.asarray(points)[None], axis=2)
    expected = np.exp(-0.5 * (apart / length) ** 2)
    error = np.sqrt((1.0 + expected**2) / seeds)
    assert np.all(np.abs(values.T @ values / seeds - expected) < 4 * error)
    assert expected[0, 1] > 0.8 and expected[0, 3] < 1e-4
    assert np.all(np.abs(values.mean(axis=0)) < 4 / np.sqrt(seeds))
    assert np.all(np.abs((values**4).mean(axis=0) - 3.0) < 4 * np.sqrt(96.0 / seeds))


def test_a_random_field_moves_along_the_normals_and_repeats():
    shell = generators.cylinder(1.0, 2.0, (3, 8), 360.0)
    field = js.RandomField(0.4, 5)
    moved = np.asarray(shell.with_imperfection(field, 0.01).nodes - shell.nodes)
    normals = np.asarray(unit_normals(shell.nodes, shell.triangles))
    np.testing.assert_allclose(moved, 0.01 * np.asarray(field.at(shell.nodes))[:, None] * normals, atol=1e-16)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, rtol=1e-14)
    radial = np.asarray(shell.nodes) * [0, 1, 1]
    assert np.all(np.sum(normals * radial, axis=1) > 0.95)  # outwards, as those of the elements
    again = shell.with_imperfection(js.RandomField(0.4, 5), 0.01)
    other = shell.with_imperfection(js.RandomField(0.4, 6), 0.01)
    np.testing.assert_array_equal(again.nodes - shell.nodes, moved)
    assert np.abs(np.asarray(other.nodes - shell.nodes) - moved).max() > 1e-3


@pytest.mark.slow
def test_gradients_by_amplitude_mode_correlation_length_and_nodes():
    """Forward and reverse mode, and differences of the moved nodes."""
    perfect = generators.cylinder(1.0, 2.0, (2, 6), 180.0)
    weights = jnp.asarray(np.random.default_rng(1).normal(size=perfect.nodes.shape))
    mode = jnp.asarray(np.random.default_rng(2).normal(size=perfect.nodes.shape))

    def measured(p):
        shape = js.Mesh(perfect.nodes + p["nodes"], perfect.connectivity)
        field = js.RandomField(0.7 * (1.0 + p["length"]), 1)
        moved = shape.with_imperfection([mode + p["mode"], field], [0.05 + p["amplitude"], 0.02 - p["amplitude"]])
        return jnp.sum(weights * moved.nodes)

    p = {"nodes": jnp.zeros_like(mode), "length": 0.0, "mode": jnp.zeros_like(mode), "amplitude": 0.0}
    gradient = jax.grad(measured)(p)
    along = jax.tree.map(lambda x: jnp.asarray(np.random.default_rng(3).normal(size=np.shape(x))), p)
    back = sum(float(jnp.sum(gradient[k] * along[k])) for k in p)
    assert back == pytest.approx(float(jax.jvp(measured, (p,), (along,))[1]), rel=1e-12)
    ahead = measured(jax.tree.map(lambda x, d: x + 1e-5 * d, p, along))
    behind = measured(jax.tree.map(lambda x, d: x - 1e-5 * d, p, along))
    assert back == pytest.approx(float(ahead - behind) / 2e-5, rel=1e-6)
    assert all(float(jnp.abs(gradient[k]).max()) > 1e-3 for k in p)


@pytest.mark.parametrize("kind", ["buckling", pytest.param("vibration", marks=pytest.mark.slow)])
def test_scene_files_state_imperfections(kind, tmp_path, request):
    """The load is chosen on the mesh as it was drawn, in the plane z = 0, where its nodes lie no longer."""
    text = f"""[[mesh.imperfection]]
kind = "random"
amplitude = 1e-4
correlation_length = 0.2
seed = 3
[[mesh.imperfection]]
kind = "{kind}"
mode = [1, 2]
amplitude = [1e-3, -2e-3]
"""
    found, perfect = scene_of(tmp_path, text), mesh()
    if kind == "buckling":
        modes = request.getfixturevalue("buckled").shapes
    else:
        modes = js.natural_frequencies(column(perfect), 2).shapes
    expected = perfect.with_imperfection([js.RandomField(0.2, 3), *modes], [1e-4, 1e-3, -2e-3])
    np.testing.assert_allclose(found.mesh.nodes, expected.nodes, atol=1e-12)
    assert [support.nodes.array.tolist() for support in found.supports] == [[0, 1], [16, 17]]
    assert found.loads[0].edges.array.tolist() == [[16, 17]] and np.all(np.asarray(found.mesh.nodes)[16:, 2] != 0.0)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ('kind = "buckled"\namplitude = 1.0', "kind must be one of 'buckling', 'vibration', 'random'"),
        ('kind = "random"\namplitude = 1.0', "lacks 'correlation_length'"),
        ('kind = "random"\namplitude = 1.0\ncorrelation_length = 0.0', "correlation_length must be positive"),
        ('kind = "random"\namplitude = 1.0\ncorrelation_length = 0.1\nmode = 1', "unknown key 'mode'"),
        ('kind = "buckling"\namplitude = [1.0, 2.0]', "amplitude must be 1, one for each mode, but is 2"),
        ('kind = "buckling"\namplitude = 1.0\nmode = 0', "mode must be a whole number"),
    ],
)
def test_scene_files_refuse(table, message, tmp_path):
    with pytest.raises(ValueError, match=rf"\[mesh\] imperfection .*{message}"):
        scene_of(tmp_path, "[mesh.imperfection]\n" + table + "\n")


@pytest.mark.parametrize(
    ("mode", "amplitude", "message"),
    [
        (np.zeros((18, 3)), 1.0, "mode moves no node"),
        (np.ones((17, 3)), 1.0, r"mode must be displacements \(18, 3\) of the nodes, .* but it has shape \(17, 3\)"),
        (np.full((18, 3), np.nan), 1.0, "mode must be finite"),
        (np.ones((18, 3)), [1.0, 2.0], r"amplitude must be a number, but it has shape \(2,\)"),
        ([np.ones((18, 3))] * 2, 1.0, r"amplitude must be one number for each of 2 modes"),
        (np.ones((18, 3)), float("inf"), "amplitude must be finite"),
        (np.outer(np.isin(np.arange(18), [2, 3]), [1.0, 0, 0]), -0.125, "Triangle 0 .* is degenerate"),
    ],
)
def test_bad_modes(mode, amplitude, message):
    with pytest.raises(ValueError, match=message):
        mesh().with_imperfection(mode, amplitude)


# --- motions of sets of nodes -----------------------------------------------------------------------------


def test_motions_of_sets_are_rigid_each_about_its_own_middle():
    """The end about its middle (0, 0.05, 0), two nodes about the point given, the others at rest."""
    shell = mesh()
    found = js.Initial.of(
        shell, ("end", [1, 0, 0], [0, 0, 3]), ([16, 17], None, [0, 2, 0], [0, 0, 0]), ([5], [0, 0, 7])
    )
    v, w = np.asarray(found.velocities), np.asarray(found.angular_velocities)
    np.testing.assert_allclose(v[[0, 1]], [[1.15, 0, 0], [0.85, 0, 0]], atol=1e-15)
    np.testing.assert_allclose(v[[16, 17]], [[0, 0, -2.0]] * 2, atol=1e-15)
    assert w[[0, 16, 5]].tolist() == [[0, 0, 3], [0, 2, 0], [0, 0, 0]] and v[5].tolist() == [0, 0, 7]
    assert np.flatnonzero(np.abs(v).sum(axis=1) + np.abs(w).sum(axis=1)).tolist() == [0, 1, 5, 16, 17]
    whole = js.Initial.of(shell, (np.arange(18), [1, 2, 3], [0.1, 0.2, 0.3]))
    rigid = js.Initial.rigid(shell, [1, 2, 3], [0.1, 0.2, 0.3])
    np.testing.assert_allclose(whole.velocities, rigid.velocities, atol=1e-14)
    slope = jax.grad(lambda spin: js.Initial.of(shell, ("end", None, [0, 0, spin])).velocities[0, 0])(1.0)
    assert float(slope) == pytest.approx(0.05, rel=1e-12)


@pytest.mark.parametrize(
    ("motions", "message"),
    [
        ([("end", [1, 0, 0]), ([1, 2], [0, 0, 1])], r"motion number 2: moves node 1 \(and 0 others\), which number 1"),
        ([("ends", [1, 0, 0])], "motion number 1: There is no set of nodes 'ends'"),
        ([("end",)], r"must be \(nodes, velocity, angular_velocity, about\)"),
        ([("end", None, None, [0, 0, 0])], "says no motion: give velocity or angular_velocity"),
        ([([99], [1, 0, 0])], "its list names node 99"),
        ([("end", [1, 0])], r"velocity must have shape \(3,\)"),
    ],
)
def test_motions_that_are_refused(motions, message):
    with pytest.raises(ValueError, match=message):
        js.Initial.of(mesh(), *motions)
