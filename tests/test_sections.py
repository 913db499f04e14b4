"""Materials, laminates, general sections and regions: stiffnesses, the coupled element, patch tests, bad input.

Runs and solutions of laminates are in test_laminates.py.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from layups import CARBON, GLASS, PLIES, STEEL, UNSYMMETRIC, relative, resultants
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import splu

import jaxshell as js
from jaxshell.elements import corotational
from jaxshell.elements.element import Element, constant_strains, corners, strain_matrices
from jaxshell.elements.membrane import membrane_stiffness
from jaxshell.model.generators import rectangle
from jaxshell.model.sections.base import BETA_0_MINIMUM, optimal_beta0

# --- stiffnesses ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("offset", [0.0, 0.3e-3])
def test_stiffnesses_of_another_package(offset):
    """composipy 1.7.5, whose A, B, D are about the middle: the shift follows by hand."""
    composipy = pytest.importorskip("composipy")
    plies = []
    for material, thickness, _ in PLIES:
        moduli = (
            material.young_modulus_1,
            material.young_modulus_2,
            material.poisson_ratio_12,
            material.shear_modulus_12,
        )
        plies.append(composipy.OrthotropicMaterial(*map(float, moduli), thickness))
    other = composipy.LaminateProperty([angle for _, _, angle in PLIES], plies)
    found = resultants(js.Laminate(UNSYMMETRIC.plies, offset=offset))
    assert relative(found.A, other.A) < 1e-12
    assert relative(found.B, other.B + offset * other.A) < 1e-12
    assert relative(found.D, other.D + 2 * offset * other.B + offset**2 * other.A) < 1e-12
    mass = np.array([float(material.density) * thickness for material, thickness, _ in PLIES])
    top = np.cumsum([thickness for _, thickness, _ in PLIES]) - sum(thickness for _, thickness, _ in PLIES) / 2
    z = np.stack([top - [thickness for _, thickness, _ in PLIES], top]) + offset
    assert found.mass_per_area == pytest.approx(mass.sum(), rel=1e-14)
    assert found.first_moment == pytest.approx((mass * z.mean(0)).sum(), rel=1e-12)
    assert found.rotary_inertia == pytest.approx((mass * (z[0] ** 2 + z[0] * z[1] + z[1] ** 2) / 3).sum(), rel=1e-12)


def tensor(C) -> np.ndarray:
    """C_ijkl of a plane-stress matrix."""
    index = np.array([[0, 2], [2, 1]])
    return np.asarray(C)[index[:, :, None, None], index]


@pytest.mark.parametrize(
    "section", [UNSYMMETRIC, js.GeneralSection(*(resultants(UNSYMMETRIC).__dict__[name] for name in "ABD"), 1.0)]
)
def test_axes_of_an_element(section):
    """Stiffnesses turn as tensors of fourth order: e1 of element 1 lies at 45 degrees."""
    first, second = resultants(section, element=0), resultants(section, element=1)
    c = np.sqrt(0.5)
    turn = np.array([[c, c], [-c, c]])  # rows e1, e2
    for name in "ABD":
        turned = np.einsum("ai,bj,ck,dl,ijkl->abcd", turn, turn, turn, turn, tensor(getattr(first, name)))
        assert relative(tensor(getattr(second, name)), turned) < 1e-14


def test_directions():
    """A vector, a field and a cylinder's directions name the same plies."""
    plies = UNSYMMETRIC.plies
    ways = [
        [0.0, 2.0, 5.0],
        np.tile([0.0, 0.1, 0.0], (2, 1)),
        js.Cylindrical([0.0, 3.0, 0.0], [0.5, 0.0, 1.0]),
        js.Cylindrical([-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], "circumference"),
    ]
    expected = resultants(js.Laminate([js.Ply(p.material, p.thickness, p.angle + 90.0) for p in plies]))
    for way in ways:
        found = resultants(js.Laminate(plies, direction=way))
        assert relative(found.A, expected.A) < 1e-12 and relative(found.B, expected.B) < 1e-12


@pytest.mark.parametrize("layup", ["[0/60/-60]s", "[45/-45/0/90]s", "[0/36/72/108/144]s"])
def test_quasi_isotropic_layups(layup):
    """A is isotropic, B vanishes, D is neither."""
    whole = js.Laminate.from_layup(layup, CARBON, 0.125e-3)
    found = resultants(js.Laminate(whole.all_plies))
    A = found.A
    expected = A[0, 0] * np.array([[1, 0, 0], [0, 1, 0], [0, 0, 0]]) + A[0, 1] * np.array(
        [[0, 1, 0], [1, 0, 0], [0, 0, 0]]
    )
    expected[2, 2] = 0.5 * (A[0, 0] - A[0, 1])
    assert relative(A, expected) < 1e-14
    assert np.abs(found.B).max() < 1e-14 * np.abs(A).max() * float(whole.thickness)
    assert abs(found.D[0, 0] - found.D[1, 1]) > 0.01 * found.D[0, 0]
    assert resultants(whole).B is None and whole.symmetric


def test_balanced_layups():
    """No shear with stretch; symmetric angle plies bend with twist, and antisymmetric ones stretch with twist."""
    h = 4 * 0.125e-3
    for layup in ("[30/-30]s", "[30/-30/30/-30]"):
        found = resultants(js.Laminate(js.Laminate.from_layup(layup, CARBON, 0.125e-3).all_plies))
        A, B, D = (np.abs(getattr(found, name)) for name in "ABD")
        assert A[:2, 2].max() < 1e-14 * A.max()
        if layup.endswith("s"):
            assert B.max() < 1e-14 * A.max() * h and D[:2, 2].min() > 0.05 * D[2, 2]
        else:
            assert D[:2, 2].max() < 1e-14 * D.max()
            assert B[:2, 2].min() > 0.01 * A.max() * h and B[:2, :2].max() < 1e-14 * A.max() * h


def test_drilling_factor():
    """β0 is (1 - 4ν²)/2 of isotropic matrices and of none other than carbon's bound, and does not see the axes."""
    for ratio in (0.0, 0.3, 0.45):
        C = js.Isotropic(7.0, ratio, 1.0).stiffness()
        assert float(optimal_beta0(C)) == pytest.approx(0.5 * (1 - 4 * ratio**2), rel=1e-12)
    values = [
        resultants(js.Laminate([js.Ply(GLASS, 1.0, angle), js.Ply(STEEL, 0.5)])).beta0
        for angle in (0.0, 17.0, 45.0, 122.0)
    ]
    np.testing.assert_allclose(values, values[0], rtol=1e-12)
    assert values[0] > 0.05
    assert resultants(js.Laminate([js.Ply(CARBON, 1.0, 20.0)])).beta0 == BETA_0_MINIMUM


# --- the element ------------------------------------------------------------------------------------------

TRIANGLE = np.array([[0.1, 0.0, 0.2], [1.0, 0.1, 0.0], [0.3, 0.9, 0.4]])
ONE = js.Mesh(TRIANGLE, [[0, 1, 2]])


@jax.jit
def build(x0, section) -> Element:
    return jax.vmap(Element.build)(x0, section)


def element_of(section) -> Element:
    return jax.tree.map(lambda a: a[0], build(jnp.asarray(TRIANGLE)[None], section.resultants(ONE)))


def K_hat(element: Element) -> np.ndarray:
    """K̂, (12, 12)."""
    zero = np.zeros((6, 6)) if element.K_coupling is None else np.asarray(element.K_coupling)
    return np.block([[np.asarray(element.K_membrane), zero], [zero.T, np.asarray(element.K_bending)]])


@pytest.mark.parametrize("halves", [False, True])
def test_one_isotropic_ply_is_the_isotropic_section(halves):
    h = 2e-3
    plain = element_of(js.Section(h, 210e9, 0.3, 7850.0))
    ply = js.Laminate([js.Ply(STEEL, h / 2, 35.0)], symmetric=True) if halves else js.Laminate([js.Ply(STEEL, h, 35.0)])
    found = element_of(ply)
    assert relative(found.K_membrane, plain.K_membrane) < 1e-14
    assert relative(found.K_bending, plain.K_bending) < 1e-14
    assert found.mass_per_area == pytest.approx(float(plain.mass_per_area), rel=1e-14)
    assert found.rotary_inertia == pytest.approx(float(plain.rotary_inertia), rel=1e-14)
    if halves:
        assert found.K_coupling is None
    else:
        assert np.abs(found.K_coupling).max() < 1e-15 * h * np.abs(plain.K_membrane).max()


@pytest.mark.parametrize(
    "section", [js.Section(2e-3, 210e9, 0.3, 1.0), UNSYMMETRIC, js.Laminate([js.Ply(CARBON, 1e-3, 40.0)])]
)
def test_stiffness_is_the_gram_matrix_of_the_strains(section):
    """Σ_p BᵀSB over the mid-edges: today's membrane and bending stiffness to round-off, and the coupling."""
    element = element_of(section)
    of_membrane, of_bending = (np.asarray(b) for b in strain_matrices(element))
    B = np.concatenate(
        [np.pad(of_membrane, ((0, 0), (0, 0), (0, 6))), np.pad(of_bending, ((0, 0), (0, 0), (6, 0)))], axis=1
    )
    gram = float(element.area) / 3 * np.einsum("pij,ik,pkl->jl", B, np.asarray(element.section.matrix), B)
    found = K_hat(element)
    for rows in (slice(0, 6), slice(6, 12)):
        for columns in (slice(0, 6), slice(6, 12)):
            scale = np.sqrt(np.abs(gram[rows, rows]).max() * np.abs(gram[columns, columns]).max())
            assert np.abs(found[rows, columns] - gram[rows, columns]).max() < 1e-14 * scale


def test_constant_strains():
    """The deformations of a constant state have its strain and curvature at all three points."""
    element = element_of(UNSYMMETRIC)
    strain, curvature = np.array([1.0, -0.4, 0.7]), np.array([0.3, 1.1, -0.6])
    e = np.asarray(constant_strains(element.coordinates, jnp.asarray(strain), jnp.asarray(curvature)))
    of_membrane, of_bending = strain_matrices(element)
    for at_point in range(3):
        np.testing.assert_allclose(of_membrane[at_point] @ e[:6], strain, atol=1e-14)
        np.testing.assert_allclose(of_bending[at_point] @ e[6:], curvature, atol=1e-14)


STATES = 64


@jax.jit
def _at_rest(x, elements):
    one = jnp.broadcast_to(jnp.eye(3), (3, 3, 3))
    return jax.vmap(lambda x, element: corotational.tangent_stiffness(x, one, element))(x, elements)


def stiffnesses(mesh, section) -> np.ndarray:
    """(m, 18, 18) of the undeformed shell; one program for meshes of every size."""
    x, given = np.asarray(mesh.nodes)[mesh.triangles], section.resultants(mesh)
    m, found = len(x), []
    for begin in range(0, m, STATES):
        numbers = np.arange(begin, begin + STATES) % m
        at, some = jnp.asarray(x[numbers]), jax.tree.map(lambda a, chosen=numbers: a[chosen], given)
        found.append(np.asarray(_at_rest(at, build(at, some))))
    return np.concatenate(found)[:m]


def solved(mesh, section, prescribed: dict, loads) -> np.ndarray:
    """(n, 6) linear displacements and rotations, with {degree of freedom: value} prescribed."""
    K = stiffnesses(mesh, section)
    dofs = (6 * mesh.triangles[:, :, None] + np.arange(6)).reshape(-1, 18)
    rows, columns = np.repeat(dofs, 18, axis=1).ravel(), np.tile(dofs, (1, 18)).ravel()
    size = 6 * mesh.n_nodes
    total = coo_matrix((K.ravel(), (rows, columns)), (size, size)).tocsc()
    u = np.zeros(size)
    u[list(prescribed)] = list(prescribed.values())
    free = np.setdiff1d(np.arange(size), list(prescribed))
    u[free] = splu(total[free][:, free]).solve((loads.ravel() - total @ u)[free])
    return u.reshape(-1, 6)


def test_coupled_element_has_six_rigid_motions():
    """Shifted and carbon alone too, where β0 is at its bound; all other deformations cost energy."""
    offset = js.Laminate(UNSYMMETRIC.plies, offset=2e-3)
    for section in (UNSYMMETRIC, offset, js.Laminate([js.Ply(CARBON, 1e-3, 20.0)])):
        element = element_of(section)
        scale = np.repeat([1.0, 1.0, float(section.thickness)], [3, 3, 6])  # deformations of like energy
        deformed = np.linalg.eigvalsh(K_hat(element) / scale[:, None] / scale)
        K = stiffnesses(ONE, section)[0]
        spectrum = np.linalg.eigvalsh(K)
        assert np.abs(spectrum[:6]).max() < 1e-14 * spectrum[-1] and spectrum[6] > 0
        assert deformed[0] > 1e-6 * deformed[-1]
        assert np.linalg.matrix_rank(K_hat(element) / scale[:, None] / scale, tol=1e-10 * deformed[-1]) == 12


def test_drilling_of_carbon_is_weak_but_there():
    """β0 at its bound: rotations about the normal that bend no fibre cost little, and the element keeps its rank."""
    C = CARBON.stiffness()
    xy = corners(element_of(UNSYMMETRIC).coordinates)
    at_bound, isotropic = (
        np.linalg.eigvalsh(membrane_stiffness(xy, C, beta0)) for beta0 in jnp.array([BETA_0_MINIMUM, 0.32])
    )
    assert np.sum(at_bound > 1e-9 * at_bound[-1]) == np.sum(isotropic > 1e-9 * isotropic[-1]) == 6
    print(
        f"softest deformation over the stiffest: {at_bound[3] / at_bound[-1]:.1e}, with β0 = 0.32 {isotropic[3] / isotropic[-1]:.1e}"
    )
    assert 1e-5 < at_bound[3] / at_bound[-1] < isotropic[3] / isotropic[-1]


# MacNeal & Harder's patch (1985), cut into triangles, with inner nodes 4 to 7.
PATCH = js.Mesh(
    [[0, 0, 0], [0.24, 0, 0], [0.24, 0.12, 0], [0, 0.12, 0], [0.04, 0.02, 0], [0.18, 0.03, 0], [0.16, 0.08, 0], [0.08, 0.08, 0]],
    [[0, 1, 4], [1, 5, 4], [1, 2, 5], [2, 6, 5], [2, 3, 6], [3, 7, 6], [3, 0, 7], [0, 4, 7], [4, 5, 6], [4, 6, 7]],
)  # fmt: skip


@pytest.mark.parametrize("state", range(7))
def test_patch_of_constant_resultants(state):
    """Prescribed at the rim, a state of constant strain and curvature is found inside, with N and M of the section."""
    section = js.Laminate(UNSYMMETRIC.plies, offset=0.4e-3)
    both = np.eye(7, 6)[state] if state < 6 else np.array([0.4, -0.7, 0.9, 0.2, 0.5, -0.3])
    (exx, eyy, shear), (kxx, kyy, twist) = both[:3], both[3:]
    x, y, _ = np.asarray(PATCH.nodes).T
    w = -0.5 * (kxx * x**2 + kyy * y**2 + twist * x * y)
    tilts = -kyy * y - 0.5 * twist * x, kxx * x + 0.5 * twist * y
    exact = np.stack([exx * x + 0.5 * shear * y, 0.5 * shear * x + eyy * y, w, *tilts, 0 * x], axis=1)
    prescribed = {6 * node + dof: exact[node, dof] for node in range(4) for dof in range(6)}
    u = solved(PATCH, section, prescribed, np.zeros((8, 6)))
    np.testing.assert_allclose(u, exact, atol=1e-10 * np.abs(exact).max())
    # Energy ½ (N·ε + M·κ) times the area.
    S = np.asarray(resultants(section, PATCH).matrix)
    e1 = np.asarray(PATCH.nodes)[1] - np.asarray(PATCH.nodes)[0]
    assert e1[1] == 0  # element 0 has the axes of the plane
    energy = sum(
        0.5 * u[t].ravel() @ K @ u[t].ravel() for t, K in zip(PATCH.triangles, stiffnesses(PATCH, section), strict=True)
    )
    assert float(energy) == pytest.approx(0.5 * both @ S @ both * 0.24 * 0.12, rel=1e-10)


@pytest.mark.parametrize(("load", "kept"), [("moment", (2e-3, 5e-3)), ("shear", (2e-3, 6e-3))])
def test_a_shifted_reference_surface_moves_like_the_middle(load, kept):
    """A cantilever 4 by 1, h = 0.1, ν = 0.3, whose nodes lie h/2 and 2h below its middle: the error falls with the mesh.

    The tip's deflection at 32 × 8 cells is -94.45 and -94.17 against -94.53 (moment), 249.4 and 248.4 against 249.75.
    """
    errors = []
    for columns in (8, 16, 32):
        mesh = rectangle(4.0, 1.0, [columns, columns // 4])
        x = np.asarray(mesh.nodes)
        tip = np.flatnonzero(x[:, 0] == 4.0)
        loads = np.zeros((len(x), 6))
        loads[tip, 4 if load == "moment" else 2] = np.convolve(np.ones(len(tip) - 1), [0.5, 0.5]) / (len(tip) - 1)
        held = {6 * node + dof: 0.0 for node in np.flatnonzero(x[:, 0] == 0) for dof in range(6)}
        ply, at = [js.Ply(js.Isotropic(1e6, 0.3, 1.0), 0.1)], mesh.nearest_node([4.0, 0.5, 0.0])
        plain, *shifted = [
            solved(mesh, js.Laminate(ply, offset=np.array(z)), held, loads)[at, 2] for z in (0.0, 0.05, 0.2)
        ]
        errors.append([abs(value / plain - 1) for value in shifted])
    assert np.all(np.diff(errors, axis=0) < 0) and np.all(np.array(errors[-1]) < kept)
