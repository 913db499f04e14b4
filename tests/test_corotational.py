"""The corotational element: closed forms against `jax.jacfwd` on large states, the paper's form."""

import isotropic
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_linear_elements import (
    PATCH,
    PATCH_TRIANGLES,
    bending_field,
    bending_stiffness,
    membrane_field,
    membrane_stiffness,
)

from jaxshell.elements import corotational
from jaxshell.numerics import rotations

THICKNESS, YOUNG, POISSON, DENSITY = 0.05, 1000.0, 0.3, 2.0
X0 = np.array([[0.1, -0.2, 0.3], [1.1, 0.1, 0.2], [0.4, 0.7, 0.6]])
build = jax.jit(isotropic.element)
internal_force = jax.jit(corotational.internal_force)


@pytest.fixture(scope="module")
def element():
    return build(jnp.asarray(X0), THICKNESS, YOUNG, POISSON, DENSITY)


def large_state(seed: int):
    """A triangle turned by up to π and strained by about 0.2, its nodes turned by up to 1 rad more."""
    rng = np.random.default_rng(seed)
    turn = Rotation.random(random_state=seed)
    x = turn.apply(X0 + 0.1 * rng.normal(size=(3, 3))) + rng.normal(size=3)
    R = (turn * Rotation.from_rotvec(rng.uniform(-0.6, 0.6, (3, 3)))).as_matrix()
    return jnp.asarray(x), jnp.asarray(R)


def move(x, R, dq):
    """The state after displacements and spins dq (18,), eqs. (6), (101)-(103)."""
    dq = dq.reshape(3, 2, 3)
    return x + dq[:, 0], jax.vmap(rotations.exp)(dq[:, 1]) @ R


def relative_error(found, exact) -> float:
    return float(np.abs(np.asarray(found) - np.asarray(exact)).max() / np.abs(np.asarray(exact)).max())


ZERO = jnp.zeros(18)


@jax.jit
def derivatives(x, R, element):
    """(energy's gradient, force; force's derivative, closed form), all by displacements and spins."""

    def energy(dq):
        kin = corotational.kinematics(*move(x, R, dq), element)
        return corotational.strain_energy(kin.deformations, element)

    def force(dq):
        return corotational.internal_force(*move(x, R, dq), element)

    exact = jax.grad(energy)(ZERO), jax.jacfwd(force)(ZERO)
    return *exact, force(ZERO), corotational.tangent_stiffness(x, R, element)


@pytest.mark.parametrize("seed", range(8))
def test_force_and_tangent(seed, element):
    gradient, jacobian, force, tangent = derivatives(*large_state(seed), element)
    assert relative_error(force, gradient) < 1e-11
    assert relative_error(tangent, jacobian) < 1e-11


@jax.jit
def geometric_parts(x, R, f, element):
    """K_G's parts and sum at fixed stresses f: by `jax.jacfwd`, other factors of Λᵀ frozen; closed."""
    fixed = corotational.kinematics(x, R, element)
    local = corotational.local_forces(fixed, f)

    def force(dq, *varying):
        kin = corotational.kinematics(*move(x, R, dq), element)
        kin = fixed._replace(**{name: getattr(kin, name) for name in varying})
        return corotational.to_global(corotational.local_forces(kin, f), kin)

    exact = [
        jax.jacfwd(lambda dq, names=names: force(dq, *names))(ZERO)
        for names in (("frame",), ("coordinates",), ("H",), ("frame", "coordinates", "H"))
    ]
    closed = [
        corotational.rotational_stiffness(local),
        corotational.projection_stiffness(fixed, local),
        corotational.moment_correction_stiffness(fixed, f),
        corotational.geometric_parts(fixed, f, local),
    ]
    return exact, [parts.matrix(fixed) for parts in closed]


@pytest.mark.parametrize("seed", range(4))
def test_geometric_stiffness_at_any_stresses(seed, element):
    """K_GR, K_GP, K_GM, eqs. (75)-(82), and their sum, the derivatives of Tᵀ, P̄ᵀ, H̄ᵀ and of their product."""
    stresses = jnp.asarray(np.random.default_rng(100 + seed).normal(size=12))
    exact, closed = geometric_parts(*large_state(seed), stresses, element)
    for name, jacobian, matrix in zip(("K_GR", "K_GP", "K_GM", "K_G"), exact, closed, strict=True):
        assert relative_error(matrix, jacobian) < 1e-11, name


# --- the paper's 18 entries -------------------------------------------------------------------------------


def frame_of(x):
    """T_GE, eq. (54), rows e1 ∥ edge 1-2, e2, e3."""
    e1 = (x[1] - x[0]) / np.linalg.norm(x[1] - x[0])
    e3 = np.cross(x[1] - x[0], x[2] - x[0])
    e3 /= np.linalg.norm(e3)
    return np.stack([e1, np.cross(e3, e1), e3])


def skew(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def paper_H(theta):
    """H(θ) of eq. (9)."""
    angle = np.linalg.norm(theta)
    if angle == 0:
        return np.eye(3)
    return (
        np.eye(3) - 0.5 * skew(theta) + (1 - 0.5 * angle / np.tan(0.5 * angle)) / angle**2 * skew(theta) @ skew(theta)
    )


def paper_form(x, R):
    """(p̄_d, Λ, K̄_m) of eqs. (55)-(69), with 18 entries each."""
    T, T0 = frame_of(x), frame_of(X0)
    local, local0 = (x - x.mean(axis=0)) @ T.T, (X0 - X0.mean(axis=0)) @ T0.T
    theta = Rotation.from_matrix(T @ R @ T0.T).as_rotvec()
    p = np.concatenate([local - local0, theta], axis=1).ravel()
    (x1, y1), (x2, y2), (x3, y3) = local[:, :2]
    length = np.linalg.norm(x[1] - x[0])
    double_area = np.linalg.norm(np.cross(x[1] - x[0], x[2] - x[0]))
    G = np.zeros((3, 3, 3))
    G[0] = [[0, 0, x3 - x2], [0, 0, y3 - y2], [0, -double_area / length, 0]]
    G[1] = [[0, 0, x1 - x3], [0, 0, y1 - y3], [0, double_area / length, 0]]
    G[2] = [[0, 0, x2 - x1], [0, 0, y2 - y1], [0, 0, 0]]
    G /= double_area
    P, H = np.zeros((18, 18)), np.eye(18)
    for a in range(3):
        H[6 * a + 3 : 6 * a + 6, 6 * a + 3 : 6 * a + 6] = paper_H(theta[a])
        for b in range(3):
            block = P[6 * a : 6 * a + 6, 6 * b : 6 * b + 6]
            block[:3, :3] = ((a == b) - 1 / 3) * np.eye(3) + skew(local[a]) @ G[b]
            block[3:, :3] = -G[b]  # the print of eq. (67) has 0 here
            block[3:, 3:] = (a == b) * np.eye(3)
    K = np.zeros((18, 18))
    membrane = [6 * node + dof for node in range(3) for dof in (0, 1, 5)]
    bending = [6 * node + dof for node in range(3) for dof in (2, 3, 4)]
    xy = jnp.asarray(local0[:, :2])
    K[np.ix_(membrane, membrane)] = membrane_stiffness(xy, THICKNESS, YOUNG, POISSON)
    K[np.ix_(bending, bending)] = bending_stiffness(xy, THICKNESS, YOUNG, POISSON)
    return p, H @ P @ np.kron(np.eye(6), T), K


def test_twelve_entries_say_what_the_papers_eighteen_do(element):
    x, R = large_state(1)
    p, Lambda, K = paper_form(np.asarray(x), np.asarray(R))

    @jax.jit
    def twelve(x, R):
        kin = corotational.kinematics(x, R, element)
        stresses = corotational.stresses(kin.deformations, element)
        material = corotational.stiffness(kin, stresses, element, None, geometric=0.0)
        return corotational.strain_energy(kin.deformations, element), material

    energy, material = twelve(x, R)
    assert float(energy) == pytest.approx(0.5 * p @ K @ p, rel=1e-12)
    assert relative_error(internal_force(x, R, element), Lambda.T @ K @ p) < 1e-12
    assert relative_error(material, Lambda.T @ K @ Lambda) < 1e-12


# --- rigid motions and patches ----------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [1e-8, 0.3, 2.0, np.pi - 1e-9, np.pi, 5.0])
def test_rigid_motion_costs_no_force(angle, element):
    turn = Rotation.from_rotvec(angle * np.array([1.0, -2.0, 2.0]) / 3.0)
    x, R = jnp.asarray(turn.apply(X0) + 10.0), jnp.broadcast_to(jnp.asarray(turn.as_matrix()), (3, 3, 3))
    force = np.asarray(internal_force(x, R, element))
    assert np.abs(force).max() < 1e-10 * YOUNG * THICKNESS  # the force that a strain of 1e-10 costs


def test_forces_turn_with_the_shell_and_balance(element):
    """Objectivity: f(Qx + c, QR) = Q f(x, R); the forces of any state have no resultant and no moment."""
    x, R = large_state(2)
    turn = jnp.asarray(Rotation.from_rotvec([1.0, 2.0, -1.5]).as_matrix())
    force = np.asarray(internal_force(x, R, element)).reshape(3, 2, 3)
    turned = internal_force(x @ turn.T + 3.0, turn @ R, element)
    assert relative_error(turned.reshape(3, 2, 3), force @ np.asarray(turn).T) < 1e-12
    scale = np.abs(force).max()
    assert np.abs(force[:, 0].sum(axis=0)).max() < 1e-13 * scale
    moment = force[:, 1] + np.cross(np.asarray(x), force[:, 0])
    assert np.abs(moment.sum(axis=0)).max() < 1e-12 * scale


@pytest.mark.parametrize("strain", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
@pytest.mark.parametrize("kind", ["membrane", "bending"])
def test_patch_at_a_finite_rotation(kind, strain):
    """Constant strain or curvature on the patch, turned by 2.3 rad: no force on the inner nodes (4 to 7)."""
    turn = Rotation.from_rotvec(2.3 * np.array([2.0, 1.0, -2.0]) / 3.0)
    nodes = np.column_stack([PATCH, np.zeros(len(PATCH))])
    field = np.zeros((len(PATCH), 6))
    if kind == "membrane":
        field[:, [0, 1, 5]] = membrane_field(PATCH, strain).reshape(-1, 3)
    else:
        field[:, [2, 3, 4]] = bending_field(PATCH, strain).reshape(-1, 3)
    turned = np.concatenate([turn.apply(field[:, :3]), turn.apply(field[:, 3:])], axis=1)
    R = jnp.broadcast_to(jnp.asarray(turn.as_matrix()), (3, 3, 3))
    force, largest = np.zeros((len(PATCH), 2, 3)), np.zeros(2)
    tangent = jax.jit(corotational.tangent_stiffness)
    for triangle in PATCH_TRIANGLES:
        one = build(jnp.asarray(nodes[triangle]), THICKNESS, YOUNG, POISSON, DENSITY)
        K = tangent(jnp.asarray(turn.apply(nodes[triangle])), R, one)
        part = np.asarray(K @ turned[triangle].ravel()).reshape(3, 2, 3)
        force[triangle] += part
        largest = np.maximum(largest, np.abs(part).max(axis=(0, 2)))
    assert np.all(np.abs(force[4:]).max(axis=(0, 2)) < 1e-10 * largest)
    assert np.abs(force[:4]).max() > 1e-3 * largest.max()  # the patch's corners carry the strain


def test_derivatives_at_rest(element):
    """At zero rotation, where log and H are singular forms: no force, and the linear stiffness."""
    at_rest = X0, np.stack([np.eye(3)] * 3)
    gradient, jacobian, force, tangent = derivatives(*(jnp.asarray(a) for a in at_rest), element)
    _, Lambda, K = paper_form(*at_rest)
    stiffness = Lambda.T @ K @ Lambda
    assert np.abs(np.stack([gradient, force])).max() < 1e-14 * np.abs(stiffness).max()
    assert relative_error(jacobian, stiffness) < 1e-12
    assert relative_error(tangent, stiffness) < 1e-12
