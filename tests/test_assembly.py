"""From elements to the structure: sums by gathers, the sparsity pattern, held degrees of freedom."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.sparse import csr_matrix

import jaxshell as js
from jaxshell.assembly.structure import structure_of
from jaxshell.assembly.tables import GatherSum, analyse
from jaxshell.model.generators import rectangle

SECTION = js.Section(0.1, 1e4, 0.3, 5.0)


def fan(blades: int) -> js.Mesh:
    """Triangles around one hub, which belongs to all of them."""
    angles = 2 * np.pi * np.arange(blades) / blades
    nodes = np.concatenate([[[0.0, 0, 0]], np.stack([np.cos(angles), np.sin(angles), 0 * angles], 1)])
    rim = 1 + np.arange(blades)
    return js.Mesh(nodes, np.stack([0 * rim, rim, np.roll(rim, -1)], 1))


@pytest.mark.parametrize("most", [1, 3, 20])
def test_sums(most):
    """Against numpy's scatter, also beyond the contributions that are gathered."""
    rng = np.random.default_rng(most)
    targets = np.concatenate([np.arange(7), rng.integers(0, 7, 6 * most), np.full(most, 3)])
    sources = rng.permutation(targets.size)
    values = rng.normal(size=(targets.size, 2))
    expected = np.zeros((7, 2))
    np.add.at(expected, targets, values[sources])
    found = GatherSum.build(targets, sources, 7)(jnp.asarray(values))
    np.testing.assert_allclose(found, expected, rtol=1e-14, atol=1e-14)


def test_a_target_without_contribution_is_zero():
    found = GatherSum.build(np.array([0, 2]), np.array([0, 1]), 4)(jnp.array([3.0, 5.0]))
    np.testing.assert_array_equal(found, [3.0, 0.0, 5.0, 0.0])
    assert GatherSum.build(np.zeros(0, int), np.zeros(0, int), 2)(jnp.zeros((0, 3))).shape == (2, 3)


SUPPORTS = (js.clamped([1]), js.Support([0, 2], ("uz", "rx")))


@pytest.mark.parametrize("mesh", [rectangle(2.0, 1.0, [3, 2]), fan(12)], ids=["rectangle", "hub"])
@pytest.mark.parametrize("held", [(), SUPPORTS], ids=["free", "held"])
def test_matrix_and_vector(mesh, held):
    """Random element matrices and vectors, assembled densely by numpy."""
    scene = js.Scene(mesh, SECTION, held)
    tables, pattern = analyse(structure_of(scene))
    rng = np.random.default_rng(0)
    matrices, vectors = rng.normal(size=(mesh.n_elements, 18, 18)), rng.normal(size=(mesh.n_elements, 18))
    dense, total = np.zeros((6 * mesh.n_nodes,) * 2), np.zeros(6 * mesh.n_nodes)
    for triangle, matrix, vector in zip(mesh.triangles, matrices, vectors, strict=True):
        dofs = (6 * triangle[:, None] + np.arange(6)).ravel()
        dense[np.ix_(dofs, dofs)] += matrix
        total[dofs] += vector
    free = np.setdiff1d(np.arange(6 * mesh.n_nodes), scene.held_dofs)
    np.testing.assert_array_equal(tables.free, free)
    values = np.asarray(tables.matrix(jnp.asarray(matrices.reshape(-1))))
    found = csr_matrix((values, pattern.indices.array, pattern.indptr.array), (pattern.size,) * 2).toarray()
    np.testing.assert_allclose(found, dense[np.ix_(free, free)], atol=1e-12)
    nodal = np.asarray(tables.nodal(jnp.asarray(vectors.reshape(-1, 6))))
    np.testing.assert_allclose(nodal.ravel(), total, atol=1e-12)
    joined = np.concatenate([total[free], total[scene.held_dofs]])
    np.testing.assert_allclose(joined[np.asarray(tables.place)], total, atol=0)


def test_a_structure_is_analysed_once():
    scene = js.scenes.spherical_cap(divisions=2)
    thicker = js.scenes.spherical_cap(divisions=2, thickness=1e-3)
    assert analyse(structure_of(scene))[1] is analyse(structure_of(thicker))[1]


def test_a_sum_is_differentiable_both_ways():
    total = GatherSum.build(np.array([0, 1, 1, 0, 1]), np.array([4, 0, 2, 1, 3]), 2)
    expected = np.array([[0, 1, 0, 0, 1], [1, 0, 1, 1, 0]])
    np.testing.assert_array_equal(jax.jacfwd(total)(jnp.zeros(5)), expected)
    np.testing.assert_array_equal(jax.jacrev(total)(jnp.zeros(5)), expected)


def test_nothing_to_compute():
    scene = js.Scene(rectangle(1.0, 1.0, [1, 1]), SECTION, [js.clamped(np.arange(4))])
    with pytest.raises(ValueError, match="Every degree of freedom is held"):
        js.simulate(scene, js.GeneralizedEnergyMomentum(), dt=0.1, t_end=1.0)
