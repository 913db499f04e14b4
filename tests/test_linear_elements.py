"""The linear triangles: OPT membrane and DKT plate against Kratos, patch tests and exact bending."""

from functools import partial
from pathlib import Path

import isotropic
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

membrane_stiffness = jax.jit(isotropic.membrane_stiffness)
bending_stiffness = jax.jit(isotropic.bending_stiffness)
plane_stress_matrix = jax.jit(isotropic.plane_stress_matrix)

DATA = Path(__file__).parent / "data"
MEMBRANE = [6 * node + dof for node in range(3) for dof in (0, 1, 5)]
BENDING = [6 * node + dof for node in range(3) for dof in (2, 3, 4)]
THICKNESS, YOUNG, POISSON = 0.1, 1000.0, 0.3
TRIANGLE = jnp.array([[0.0, 0.0], [1.0, 0.1], [0.3, 0.9]])

# The patch of MacNeal & Harder (1985): a 0.24 x 0.12 rectangle, four inner nodes, here cut into triangles.
PATCH = np.array([[0, 0], [0.24, 0], [0.24, 0.12], [0, 0.12], [0.04, 0.02], [0.18, 0.03], [0.16, 0.08], [0.08, 0.08]])
PATCH_TRIANGLES = np.array(
    [
        [0, 1, 4],
        [1, 5, 4],
        [1, 2, 5],
        [2, 6, 5],
        [2, 3, 6],
        [3, 7, 6],
        [3, 0, 7],
        [0, 4, 7],
        [4, 5, 6],
        [4, 6, 7],
    ]
)
PATCH_AREA = 0.24 * 0.12
INNER = np.arange(12, 24)  # the degrees of freedom of nodes 4 to 7


def assemble(element_stiffness, nodes, triangles, *material):
    stiffness = np.zeros((3 * len(nodes), 3 * len(nodes)))
    for triangle in triangles:
        freedoms = (3 * triangle[:, None] + np.arange(3)).ravel()
        stiffness[np.ix_(freedoms, freedoms)] += element_stiffness(jnp.array(nodes[triangle]), *material)
    return stiffness


def membrane_field(nodes, strain):
    """Nodal degrees of freedom of a constant strain with some rigid motion."""
    exx, eyy, gxy = strain
    x, y = nodes.T
    turn = 0.37
    u = 0.2 + exx * x + (0.5 * gxy - turn) * y
    v = -0.1 + (0.5 * gxy + turn) * x + eyy * y
    return np.stack([u, v, np.full_like(u, turn)], axis=1).ravel()


def bending_field(nodes, curvature):
    """Nodal degrees of freedom of a constant curvature (-w,xx, -w,yy, -2 w,xy) with some rigid motion."""
    kxx, kyy, kxy = curvature
    x, y = nodes.T
    w = 0.3 - 0.2 * x + 0.1 * y - 0.5 * (kxx * x**2 + kyy * y**2 + kxy * x * y)
    w_x = -0.2 - kxx * x - 0.5 * kxy * y
    w_y = 0.1 - kyy * y - 0.5 * kxy * x
    return np.stack([w, w_y, -w_x], axis=1).ravel()


def test_the_element_that_kratos_forms():
    """data/kratos_element_stiffness.csv: ShellThinElementCorotational3D3N of Kratos Multiphysics 10.4.4."""
    reference = np.loadtxt(DATA / "kratos_element_stiffness.csv", delimiter=",")
    nodes = np.array([[0, 0, 0], [1, 0.1, 0], [0.3, 0.9, 0]])
    e1 = (nodes[1] - nodes[0]) / np.linalg.norm(nodes[1] - nodes[0])
    e3 = np.array([0.0, 0.0, 1.0])
    T = np.stack([e1, np.cross(e3, e1), e3])
    xy = jnp.array((nodes @ T.T)[:, :2])
    local = np.zeros((18, 18))
    local[np.ix_(MEMBRANE, MEMBRANE)] = membrane_stiffness(xy, THICKNESS, YOUNG, POISSON, beta0=4 / 9)
    local[np.ix_(BENDING, BENDING)] = bending_stiffness(xy, THICKNESS, YOUNG, POISSON)
    to_local = np.kron(np.eye(6), T)
    stiffness = to_local.T @ local @ to_local
    assert np.abs(stiffness - reference).max() < 1e-12 * np.abs(reference).max()
    assert np.linalg.matrix_rank(stiffness, tol=1e-10 * np.abs(stiffness).max()) == 12


@pytest.mark.parametrize("element_stiffness", [membrane_stiffness, bending_stiffness])
def test_rank_and_sign(element_stiffness):
    stiffness = np.array(element_stiffness(TRIANGLE, THICKNESS, YOUNG, POISSON))
    eigenvalues = np.linalg.eigvalsh(stiffness) / np.linalg.norm(stiffness, 2)
    assert np.abs(eigenvalues[:3]).max() < 1e-14  # three rigid motions
    assert eigenvalues[3] > 1e-4


@pytest.mark.parametrize("rigid_motion", [(1, 0, 0), (0, 1, 0), (0, 0, 1)])
def test_rigid_motions_cost_nothing(rigid_motion):
    a, b, c = rigid_motion
    x, y = np.array(TRIANGLE).T
    in_plane = np.stack([a - c * y, b + c * x, c + 0 * x], axis=1).ravel()
    out_of_plane = np.stack([a - b * x + c * y, c + 0 * x, b + 0 * x], axis=1).ravel()
    for element_stiffness, motion in ((membrane_stiffness, in_plane), (bending_stiffness, out_of_plane)):
        stiffness = np.array(element_stiffness(TRIANGLE, THICKNESS, YOUNG, POISSON))
        assert np.abs(stiffness @ motion).max() < 1e-14 * np.abs(stiffness).max()


@pytest.mark.parametrize("strain", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.4, -0.7, 0.9)])
@pytest.mark.parametrize(
    ("element_stiffness", "field", "section"),
    [(membrane_stiffness, membrane_field, THICKNESS), (bending_stiffness, bending_field, THICKNESS**3 / 12)],
)
def test_patch(element_stiffness, field, section, strain):
    """Constant strain or curvature: inner nodes find it, without force, and the energy is exact."""
    stiffness = assemble(element_stiffness, PATCH, PATCH_TRIANGLES, THICKNESS, YOUNG, POISSON)
    exact = field(PATCH, strain)
    solved = exact.copy()
    outer = np.setdiff1d(np.arange(24), INNER)
    solved[INNER] = np.linalg.solve(stiffness[np.ix_(INNER, INNER)], -stiffness[np.ix_(INNER, outer)] @ exact[outer])
    np.testing.assert_allclose(solved, exact, atol=1e-10 * np.abs(exact).max())
    C = np.array(plane_stress_matrix(YOUNG, POISSON))
    energy = 0.5 * section * PATCH_AREA * (strain @ C @ strain)
    np.testing.assert_allclose(0.5 * exact @ stiffness @ exact, energy, rtol=1e-10)


@pytest.mark.parametrize("poisson_ratio", [-0.2, 0.0, 0.3, 0.45])
@pytest.mark.parametrize("aspect_ratio", [1, 2, 4, 8, 16])
@pytest.mark.parametrize("diagonal", [[[0, 1, 2], [0, 2, 3]], [[0, 1, 3], [1, 2, 3]]])
def test_in_plane_bending_is_exact_for_every_aspect_ratio(aspect_ratio, poisson_ratio, diagonal):
    """Felippa (2003), section 6: a rectangle of two triangles under pure bending, energy ratio 1."""
    length, depth, curvature = float(aspect_ratio), 1.0, 0.01
    x, y = 0.5 * length * np.array([-1, 1, 1, -1]), 0.5 * depth * np.array([-1, -1, 1, 1])
    # u = -κ x y, v = κ (x² + ν y²)/2, θ = κ x; v is the same at all corners and left out as a rigid motion.
    motion = np.stack([-curvature * x * y, 0 * x, curvature * x], axis=1).ravel()
    nodes = np.stack([x, y], axis=1)
    stiffness = assemble(membrane_stiffness, nodes, np.array(diagonal), THICKNESS, YOUNG, poisson_ratio)
    energy = 0.5 * YOUNG * THICKNESS * depth**3 / 12 * curvature**2 * length
    # At 16 the terms of the sum are 1e5 times the energy, so that round-off alone is worth 2e-11 of it.
    np.testing.assert_allclose(0.5 * motion @ stiffness @ motion / energy, 1.0, rtol=1e-10)


def test_beta0_keeps_the_rank_for_an_incompressible_material():
    at_half = np.array(membrane_stiffness(TRIANGLE, THICKNESS, YOUNG, 0.5))
    np.testing.assert_array_equal(at_half, membrane_stiffness(TRIANGLE, THICKNESS, YOUNG, 0.5, beta0=0.01))
    assert np.linalg.matrix_rank(at_half, tol=1e-8 * np.abs(at_half).max()) == 6


@pytest.mark.parametrize("element_stiffness", [membrane_stiffness, bending_stiffness])
def test_the_numbering_of_the_corners_does_not_matter(element_stiffness):
    turned = np.roll(np.arange(9), -3)
    stiffness = np.array(element_stiffness(TRIANGLE, THICKNESS, YOUNG, POISSON))
    renumbered = element_stiffness(jnp.roll(TRIANGLE, -1, axis=0), THICKNESS, YOUNG, POISSON)
    np.testing.assert_allclose(renumbered, stiffness[np.ix_(turned, turned)], atol=1e-14 * np.abs(stiffness).max())


@pytest.mark.parametrize(
    ("element_stiffness", "power"),
    [(membrane_stiffness, 1), (bending_stiffness, 3)],
    ids=["membrane", "bending"],
)
def test_derivatives_by_every_argument(element_stiffness, power):
    by_thickness = jax.jacfwd(element_stiffness, argnums=1)(TRIANGLE, THICKNESS, YOUNG, POISSON)
    stiffness = element_stiffness(TRIANGLE, THICKNESS, YOUNG, POISSON)
    np.testing.assert_allclose(by_thickness, power / THICKNESS * stiffness, rtol=1e-11, atol=1e-11)
    arguments = (TRIANGLE, jnp.array(0.9), jnp.array(1.1), jnp.array(POISSON))
    check_grads(element_stiffness, arguments, order=1, modes=["fwd", "rev"], rtol=1e-5, atol=1e-5)
    if element_stiffness is membrane_stiffness:
        by_beta0 = partial(membrane_stiffness, *arguments)
        check_grads(by_beta0, (jnp.array(0.4),), order=1, modes=["fwd", "rev"], rtol=1e-5, atol=1e-5)
