"""The recovered error of the mesh: by its formula in NumPy, on states without error, at folds and between regions."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from synthetic import synthetic_solution

import jaxshell as js
from jaxshell.model import generators

CARBON = js.Orthotropic(140.0, 10.0, 0.3, 5.0, 1.6e-9, 1e-6, 3e-5)
LAMINATE = js.Laminate([js.Ply(CARBON, 0.05, angle) for angle in (0.0, 45.0, 90.0)], offset=0.02)
STEEL = js.Section(0.05, 200.0, 0.3, 8e-9)
FOLDED = js.Mesh(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [1.2, 0, -1], [1.2, 1, -1], [2.2, 0, -1], [2.2, 1, -1]],
    [[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2], [4, 6, 7], [4, 7, 5]],
)
"""Three planes: at every fold normals turn by about 79 degrees."""


def shaken(mesh, seed=2, size=1e-3):
    """Displacements and rotations of all nodes, of no meaning."""
    random = np.random.default_rng(seed)
    vectors = size * random.standard_normal((2, mesh.n_nodes, 3))
    return vectors[0], Rotation.from_rotvec(vectors[1]).as_matrix()


def bent(x, curvature):
    """A plate's small deflections and rotations with the curvatures (κxx, κyy, 2κxy) = `curvature`."""
    x, y = np.asarray(x)[:, :2].T
    kxx, kyy, twist = curvature
    w = -0.5 * (kxx * x * x + kyy * y * y + twist * x * y)
    slopes = -np.stack([kxx * x + 0.5 * twist * y, kyy * y + 0.5 * twist * x], axis=1)
    rotations = np.stack([slopes[:, 1], -slopes[:, 0], 0 * x], axis=1)
    return np.stack([0 * w, 0 * w, w], axis=1), Rotation.from_rotvec(rotations).as_matrix()


def by_hand(scene, d, R, labels):
    """Energies of error and solution: tensors in space, averaged around nodes by a loop. For flat patches."""
    forces = js.section_forces_of(scene, d, R)
    sigma = np.concatenate([forces.N, forces.M], axis=2)
    C = np.asarray(scene.section.resultants(scene.mesh).matrix)
    x = np.asarray(scene.mesh.nodes)[scene.mesh.triangles]
    area = 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
    e1 = (x[:, 1] - x[:, 0]) / np.linalg.norm(x[:, 1] - x[:, 0], axis=1)[:, None]
    e3 = np.cross(e1, x[:, 2] - x[:, 0])
    e2 = np.cross(e3 / np.linalg.norm(e3, axis=1)[:, None], e1)
    frame = np.stack([e1, e2], axis=1)

    def tensor(k, six):
        parts = [np.array([[s[0], s[2]], [s[2], s[1]]]) for s in (six[:3], six[3:])]
        return np.array([frame[k].T @ part @ frame[k] for part in parts])

    def six(k, tensors):
        plane = [frame[k] @ part @ frame[k].T for part in tensors]
        return np.concatenate([[p[0, 0], p[1, 1], p[0, 1]] for p in plane])

    corners = sigma[:, [0, 0, 1]] + sigma[:, [2, 1, 2]] - sigma[:, [1, 2, 0]]
    total, weight = {}, {}
    for k, row in enumerate(labels):
        for c, label in enumerate(row):
            total[label] = total.get(label, 0) + area[k] * tensor(k, corners[k, c])
            weight[label] = weight.get(label, 0) + area[k]
    found = np.zeros((2, len(area)))
    for k, row in enumerate(labels):
        smooth = np.array([six(k, total[label] / weight[label]) for label in row])
        for p, pair in enumerate(((0, 1), (1, 2), (2, 0))):
            difference = smooth[list(pair)].mean(axis=0) - sigma[k, p]
            for row_of, value in enumerate((difference, sigma[k, p])):
                found[row_of, k] += area[k] / 3 * 0.5 * value @ np.linalg.inv(C[k]) @ value
    return found


def test_energies_are_those_of_the_formula_on_a_folded_shell():
    scene = js.Scene(FOLDED, LAMINATE)
    d, R = shaken(FOLDED)
    labels = np.asarray(js.smooth_patches(scene).labels.array)
    assert len(np.unique(labels)) == 12  # every fold has values on both its sides
    found = js.mesh_errors_of(scene, d, R)
    error, strain = by_hand(scene, d, R, labels)
    np.testing.assert_allclose(found.energy, error, rtol=1e-10)
    np.testing.assert_allclose(found.strain_energy, strain, rtol=1e-10)
    assert float(found.relative) == pytest.approx(np.sqrt(error.sum() / (error.sum() + strain.sum())))
    mean_square = float(found.area @ found.local**2 / found.area.sum())
    assert mean_square == pytest.approx(float(found.relative) ** 2)


def test_constant_moments_have_no_error_and_regions_keep_their_jump():
    mesh = generators.rectangle(2.0, 1.0, (4, 2))
    left = np.asarray(mesh.nodes)[mesh.triangles][:, :, 0].mean(axis=1) < 1.0
    sets = {"thin": np.flatnonzero(left), "thick": np.flatnonzero(~left)}
    mesh = js.Mesh(mesh.nodes, mesh.triangles, element_sets=sets)
    thick = js.Section(0.1, 200.0, 0.3, 8e-9)
    d, R = bent(mesh.nodes, (1e-6, -2e-6, 1e-6))
    split = js.mesh_errors_of(js.Scene(mesh, {"thin": STEEL, "thick": thick}), d, R)
    assert float(split.relative) < 1e-4  # of the small rotations' second order
    # Smoothed across the regions' border it would be an error, and a large one.
    whole = js.smooth_patches(mesh)
    mixed = js.mesh_errors_of(js.Scene(mesh, {"thin": STEEL, "thick": thick}), d, R, patches=whole)
    assert float(mixed.relative) > 0.2


@pytest.fixture(scope="module")
def heated():
    """A coupled laminate that bends while it is heated, in five frames."""
    mesh = generators.rectangle(2.0, 1.0, (2, 1))
    warm = js.Thermal(40.0, history=js.History([0.0, 1.0], [0.0, 1.0]))
    return synthetic_solution(js.Scene(mesh, LAMINATE, loads=[warm]))


def test_strain_energy_is_that_of_the_elements_and_frames_come_singly_or_all(heated):
    every = js.mesh_errors(heated, frame=[0, 1, 2, 3, 4])
    wanted = js.strain_energies(heated, frame=[0, 1, 2, 3, 4])
    np.testing.assert_allclose(every.strain_energy, wanted, rtol=1e-8, atol=1e-12 * np.max(wanted))
    last = js.mesh_errors(heated)
    np.testing.assert_allclose(every.energy[-1], last.energy, rtol=1e-12)
    np.testing.assert_allclose(every.relative[-1], last.relative, rtol=1e-12)
    np.testing.assert_allclose(every.local[-1], last.local, rtol=1e-12)
    assert float(every.relative[0]) == 0.0 and np.all(np.asarray(every.local[0]) == 0.0)  # unloaded, not nan


@pytest.mark.slow
def test_it_differentiates_also_at_rest(heated):
    scene = heated.scene
    d, R = shaken(scene.mesh, size=1e-2)
    patches = js.smooth_patches(scene)

    @jax.jit
    @jax.value_and_grad
    def error(given):
        nodes, scale, turned = given
        moved = eqx.tree_at(lambda scene: scene.mesh.nodes, scene, nodes)
        return js.mesh_errors_of(moved, scale * d, turned, patches=patches).relative

    x = scene.mesh.nodes
    way = jnp.asarray(np.random.default_rng(1).standard_normal(x.shape))
    _, (by_nodes, by_scale, _) = error((x, 1.0, R))
    step = 1e-5
    ends = [error((x + sign * step * way, 1 + sign * 0.5 * step, R))[0] for sign in (1, -1)]
    slope = float(jnp.sum(by_nodes * way) + 0.5 * by_scale)
    assert (float(ends[0]) - float(ends[1])) / (2 * step) == pytest.approx(slope, rel=1e-6)
    value, at_rest = error((x, 0.0, jnp.broadcast_to(jnp.eye(3), R.shape)))
    assert value == 0.0 and all(np.all(np.isfinite(leaf)) for leaf in at_rest)


def test_what_has_no_error_is_refused():
    with pytest.raises(ValueError, match="no elements"):
        lonely = js.Scene(js.Mesh.of_points({"bob": [0.0, 0.0, 0.0]}), None, masses=[js.PointMass("bob", 1.0)])
        js.mesh_errors_of(lonely, np.zeros((1, 3)), np.eye(3)[None])
