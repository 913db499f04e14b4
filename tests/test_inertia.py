"""Inertia of one element: the paper's seven-point form, eqs. (27)-(53), written out and differentiated."""

from math import factorial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxshell.elements import inertia
from jaxshell.elements.inertia import GAUSS_POINTS, GAUSS_WEIGHTS, LINEAR_MASS, Spins, StepFactors
from jaxshell.numerics import rotations

AXIS = np.array([2.0, -1.0, 2.0]) / 3.0
I_RHO = 0.7
AREA, MASS = 1.3, 2.1
TENSOR = I_RHO * (np.eye(3) - np.outer(AXIS, AXIS))  # eq. (32)
# (ρ∞ = 1: EMC; ρ∞ = 0.8: EDMC1) and the values at the end of the step itself, as eqs. (40) and (51) stand.
AT_THE_END = StepFactors(0.25, 0.5, 0.0, 0.0, 0.01)


def generalized(rho: float, dt: float = 0.01) -> StepFactors:
    """Eq. (92)."""
    alpha_m, alpha_f = (2 * rho - 1) / (rho + 1), rho / (rho + 1)
    return StepFactors(0.25 * (1 - alpha_m + alpha_f) ** 2, 0.5 - alpha_m + alpha_f, alpha_m, alpha_f, dt)


def large_history(seed: int) -> tuple[Spins, np.ndarray]:
    """Spins at seven points, far from rest, and rotation vectors of the three nodes of up to 1 rad."""
    rng = np.random.default_rng(seed)
    R = jnp.asarray(Rotation.random(7, random_state=seed).as_matrix())
    return Spins(R, jnp.asarray(30 * rng.normal(size=(7, 3))), jnp.asarray(1e3 * rng.normal(size=(7, 3)))), (
        rng.uniform(-0.6, 0.6, (3, 3))
    )


def relative_error(found, exact) -> float:
    return float(np.abs(np.asarray(found) - np.asarray(exact)).max() / np.abs(np.asarray(exact)).max())


def test_seven_points_integrate_polynomials_of_degree_five():
    """∫ ς1^i ς2^j ς3^k dA = 2A i! j! k!/(i + j + k + 2)!"""
    for i in range(6):
        for j in range(6 - i):
            for k in range(6 - i - j):
                exact = 2 * factorial(i) * factorial(j) * factorial(k) / factorial(i + j + k + 2)
                found = GAUSS_WEIGHTS @ np.prod(GAUSS_POINTS ** np.array([i, j, k]), axis=1)
                assert found == pytest.approx(exact, rel=1e-14)
    assert np.einsum("g,ga,gb->ab", GAUSS_WEIGHTS, GAUSS_POINTS, GAUSS_POINTS) == pytest.approx(LINEAR_MASS)


def newmark(Theta, Omega, Omega_dot, factors: StepFactors):
    """Angular velocity and acceleration at the end of the step, eqs. (13), (14)."""
    beta, gamma, _, _, dt = factors
    first = gamma / (beta * dt) * Theta - (gamma / beta - 1) * Omega - (gamma / (2 * beta) - 1) * dt * Omega_dot
    return first, Theta / (beta * dt**2) - Omega / (beta * dt) - (1 / (2 * beta) - 1) * Omega_dot


def paper_moment(R_new, start: Spins, factors: StepFactors):
    """R (I_ρ Ω̇ + ~Ω I_ρ Ω) of eq. (40) with Θ, Ω, Ω̇ of eqs. (13), (14), averaged as eqs. (88), (91) say."""
    _, _, alpha_m, alpha_f, _ = factors
    R_n, Omega_n, Omega_dot_n = start.R, start.Omega, start.Omega_dot
    Theta = R_n.T @ rotations.log(R_new @ R_n.T)
    Omega, Omega_dot = newmark(Theta, Omega_n, Omega_dot_n, factors)
    R = (1 - alpha_f) * R_new + alpha_f * R_n
    Omega = (1 - alpha_f) * Omega + alpha_f * Omega_n
    Omega_dot = (1 - alpha_m) * Omega_dot + alpha_m * Omega_dot_n
    tensor = jnp.asarray(TENSOR)
    return R @ (tensor @ Omega_dot + jnp.cross(Omega, tensor @ Omega))


def spin_tangent(theta, start: Spins, axis, factors: StepFactors):
    """The integrand of the rotational block of K_Dyn, eq. (51), without N_a N_b: derivative by the spin δω."""
    stiffness = inertia.point_tangent(theta, inertia.PointStart.of(start, axis), factors)
    return I_RHO * stiffness @ rotations.H(theta)


@jax.jit
def both_K_Dyn(theta, start: Spins, factors: StepFactors):
    """Rotational part (9, 9) of K_Dyn under R_G ← exp(~Δω_G) R_G: by `jax.jacfwd` of eq. (40), and closed.

    θ (3, 3) are the nodal rotation vectors of the step so far, Δω_G = Σ N_a Δω_a the spins of an iterate.
    """
    points = jnp.asarray(GAUSS_POINTS)
    R_now = jax.vmap(rotations.exp)(points @ theta) @ start.R

    def moments(spins):
        R_new = jax.vmap(rotations.exp)(points @ spins.reshape(3, 3)) @ R_now
        found = jax.vmap(paper_moment, in_axes=(0, 0, None))(R_new, start, factors)
        return AREA * jnp.einsum("g,ga,gi->ai", GAUSS_WEIGHTS, points, found).reshape(9)

    closed = jax.vmap(spin_tangent, in_axes=(0, 0, None, None))(points @ theta, start, jnp.asarray(AXIS), factors)
    closed = AREA * jnp.einsum("g,ga,gb,gij->aibj", GAUSS_WEIGHTS, points, points, closed).reshape(9, 9)
    return jax.jacfwd(moments)(jnp.zeros(9)), closed


@pytest.mark.parametrize("factors", [AT_THE_END, generalized(1.0), generalized(0.8), generalized(0.0)])
@pytest.mark.parametrize("seed", range(3))
def test_K_Dyn_at_the_papers_spin_update(seed, factors):
    start, theta = large_history(seed)
    exact, closed = both_K_Dyn(jnp.asarray(theta), start, factors)
    assert relative_error(closed, exact) < 1e-11


def test_K_Dyn_is_eq_51():
    """The integrand of eq. (51) at one point, written out: 1/(βΔt²) M + γ/(βΔt) C_iner + K_iner."""
    start, _ = large_history(3)
    one = jax.tree.map(lambda values: values[0], start)
    theta = jnp.array([0.5, -0.8, 0.4])
    beta, gamma, _, _, dt = AT_THE_END
    R_n, R = np.asarray(one.R), np.asarray(rotations.exp(theta) @ one.R)
    H = np.asarray(rotations.H(theta))
    Theta = R_n.T @ np.asarray(theta)
    Omega = gamma / (beta * dt) * Theta - one.Omega * (gamma / beta - 1) - (gamma / (2 * beta) - 1) * dt * one.Omega_dot
    Omega_dot = Theta / (beta * dt**2) - one.Omega / (beta * dt) - (1 / (2 * beta) - 1) * one.Omega_dot
    Omega = np.asarray(Omega)

    def skew(v):
        return np.cross(np.eye(3), np.asarray(v))

    a = TENSOR @ Omega_dot + np.cross(Omega, TENSOR @ Omega)
    M = R @ TENSOR @ R_n.T @ H
    C = R @ (skew(Omega) @ TENSOR - skew(TENSOR @ Omega)) @ R_n.T @ H
    expected = M / (beta * dt**2) + gamma / (beta * dt) * C - skew(R @ a)
    assert relative_error(spin_tangent(theta, one, jnp.asarray(AXIS), AT_THE_END), expected) < 1e-12


def test_rotary_energy_is_the_directors():
    """½ Ω·I_ρ Ω = ½ (ρh³/12) |ṫ|² with ṫ = R ~Ω e3⁰, since the third inertia is zero; eq. (34)."""
    Omega = np.array([3.0, -2.0, 5.0])
    by_omega = 0.5 * Omega @ np.asarray(inertia.apply_inertia(jnp.asarray(AXIS), I_RHO, jnp.asarray(Omega)))
    assert by_omega == pytest.approx(0.5 * I_RHO * np.sum(np.cross(Omega, AXIS) ** 2), rel=1e-14)
    assert Omega @ TENSOR @ Omega == pytest.approx(2 * by_omega, rel=1e-14)


def test_constant_angular_acceleration_is_followed_exactly():
    """Newmark with γ = ½ about a fixed axis: θ = Ω Δt + ½ Ω̇ Δt² leaves the angular acceleration as it is."""
    dt, axis = 0.1, np.array([0.0, 0.6, 0.8])
    start = Spins(jnp.eye(3), jnp.asarray(3.0 * axis), jnp.asarray(20.0 * axis))
    theta = jnp.asarray((3.0 * dt + 0.5 * 20.0 * dt**2) * axis)
    end = inertia.end_of_step(theta, start, StepFactors(0.25, 0.5, 0.0, 0.0, dt))
    np.testing.assert_allclose(end.Omega, (3.0 + 20.0 * dt) * axis, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(end.Omega_dot, 20.0 * axis, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(end.R, Rotation.from_rotvec(np.array(theta)).as_matrix(), atol=1e-14)
