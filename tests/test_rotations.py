"""Finite rotations: values, and first and second derivatives in both modes, from 0 to π.

The scalar functions are held against power series summed in exact rational arithmetic (Bernoulli numbers
for η and μ), the maps against scipy, against their defining equations and against autodiff of each other.
"""

from fractions import Fraction
from math import comb, factorial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from spins import axial

from jaxshell.numerics import rotations

TERMS = 60
BERNOULLI = [Fraction(1)]
for m in range(1, 2 * TERMS + 1):
    BERNOULLI.append(-Fraction(sum(comb(m + 1, k) * BERNOULLI[k] for k in range(m))) / (m + 1))
EXACT_SERIES = {
    "sine_ratio": [Fraction((-1) ** k, factorial(2 * k + 1)) for k in range(TERMS)],
    "cosine_ratio": [Fraction((-1) ** k, factorial(2 * k + 2)) for k in range(TERMS)],
    "sine_remainder_ratio": [Fraction((-1) ** k, factorial(2 * k + 3)) for k in range(TERMS)],
    "eta": [abs(BERNOULLI[2 * k]) / factorial(2 * k) for k in range(1, TERMS + 1)],
}
EXACT_SERIES["mu"] = [2 * k * c for k, c in enumerate(EXACT_SERIES["eta"])][1:]  # μ = 2 dη/d(θ²)

# The axes of the tests: random ones, and ones along and between coordinate axes, where log has to choose.
AXES = np.concatenate(
    [
        np.random.default_rng(1).normal(size=(40, 3)),
        np.eye(3),
        -np.eye(3),
        1.0 - np.eye(3),
        [[1.0, -1.0, 0.0]],
    ]
)
AXES = AXES / np.linalg.norm(AXES, axis=1)[:, None]
GENERATORS = jnp.stack([rotations.skew(e) for e in jnp.eye(3)], axis=-1)  # ∂~θ/∂θ, last axis is θ's
PRODUCTS = jnp.einsum("abi,bcj->acij", GENERATORS, GENERATORS)
PRODUCTS = PRODUCTS + PRODUCTS.swapaxes(2, 3)  # ∂²(~θ~θ)/∂θ∂θ


def exact(name, theta_sq, order):
    x = Fraction(float(theta_sq))
    terms = EXACT_SERIES[name]
    for _ in range(order):
        terms = [k * c for k, c in enumerate(terms)][1:]
    return float(sum(c * x**k for k, c in enumerate(terms)))


def compiled(**derivatives):
    return {mode: jax.jit(jax.vmap(derivative)) for mode, derivative in derivatives.items()}


def jacobians(function):
    """Forward and reverse, over a batch."""
    return compiled(forward=jax.jacfwd(function), reverse=jax.jacrev(function))


def hessians(function):
    """The ways that Newton and an optimiser differentiate twice, over a batch."""
    return compiled(
        forward_reverse=jax.jacfwd(jax.jacrev(function)),
        reverse_forward=jax.jacrev(jax.jacfwd(function)),
    )


def on_axes(*angles):
    """Rotation vectors of every angle about every axis, (k, 3)."""
    return jnp.array(np.concatenate([angle * AXES for angle in angles]))


@pytest.mark.parametrize("name", EXACT_SERIES)
def test_scalar_functions_and_their_derivatives(name):
    function = getattr(rotations, name)
    points = jnp.array([0.0, 1e-300, 1e-20, 1e-9, 1e-4, 0.03, 0.3, 0.999999, 1.0, 1.000001, 1.7, 4.0, 8.0, 9.8])
    scale = [abs(exact(name, 0.0, order)) for order in range(3)]
    for order, derivatives, tolerance in (
        (0, compiled(value=function), 1e-15),
        (1, jacobians(function), 2e-14),
        (2, hessians(function), 1e-12),
    ):
        expected = np.array([exact(name, x, order) for x in points])
        for mode, derivative in derivatives.items():
            error = np.abs(derivative(points) - expected) / np.maximum(np.abs(expected), scale[order])
            assert error.max() < tolerance, (order, mode, error)


def test_eta_and_mu_against_the_closed_forms_of_the_paper_up_to_two_pi():
    t = jnp.array([2.0, 3.0, np.pi, 4.0, 5.0, 6.0, 6.2])
    eta = (1 - t / 2 / np.tan(t / 2)) / t**2
    mu = (t**2 + 4 * np.cos(t) + t * np.sin(t) - 4) / (4 * t**4 * np.sin(t / 2) ** 2)
    np.testing.assert_allclose(jax.vmap(rotations.eta)(t**2), eta, rtol=2e-14)
    np.testing.assert_allclose(jax.vmap(rotations.mu)(t**2), mu, rtol=1e-13)


def test_skew_is_the_cross_product_and_axial_undoes_it():
    v, w = jnp.array([1.0, -2.0, 3.0]), jnp.array([0.3, 0.5, -0.7])
    np.testing.assert_allclose(rotations.skew(v) @ w, np.cross(v, w), rtol=1e-15)
    np.testing.assert_array_equal(axial(rotations.skew(v) + jnp.outer(w, w)), v)


@pytest.mark.parametrize("angle", [0.0, 1e-8, 0.5, 0.9999, 1.0001, 2.0, np.pi, 5.0, 20.0])
def test_exp_against_scipy(angle):
    theta = on_axes(angle)
    R = jax.vmap(rotations.exp)(theta)
    np.testing.assert_allclose(R, Rotation.from_rotvec(np.array(theta)).as_matrix(), atol=1e-14)


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-12, 1e-6, 1e-3, 0.1, 1.0, 1.5707, 1.5709, 2.0, 2.2, 3.0, 3.1415])
def test_log_undoes_exp(angle):
    theta = on_axes(angle)
    back = jax.vmap(lambda t: rotations.log(rotations.exp(t)))(theta)
    np.testing.assert_allclose(back, theta, atol=1e-14 * min(angle, 1.0))


def test_log_at_exactly_pi():
    R = jnp.array(2 * AXES[:, :, None] * AXES[:, None, :] - np.eye(3))  # a half turn, to round-off
    theta = np.array(jax.vmap(rotations.log)(R))
    sign = np.sign(np.sum(theta * AXES, axis=1))  # both ±π n are right
    np.testing.assert_allclose(theta * sign[:, None], np.pi * AXES, atol=1e-14)
    half_turn_about_z = jnp.diag(jnp.array([-1.0, -1.0, 1.0]))
    np.testing.assert_allclose(np.abs(rotations.log(half_turn_about_z)), [0, 0, np.pi], atol=1e-15)


def test_H_is_the_derivative_of_log_by_the_spin():
    """Eq. (11), δθ = H δω. It is also the test of log's own first derivatives up to π."""
    thetas = on_axes(0.0, 1e-12, 1e-3, 0.5, 2.0, 2.2, 3.1, np.pi - 1e-7)

    def spun(both):
        return rotations.log(rotations.exp(both[:3]) @ rotations.exp(both[3:]))

    at_no_spin = jnp.concatenate([jnp.zeros_like(thetas), thetas], axis=1)
    H = jax.vmap(rotations.H)(thetas)
    for mode, jacobian in jacobians(spun).items():
        np.testing.assert_allclose(jacobian(at_no_spin)[:, :, :3], H, atol=1e-13, err_msg=mode)


def test_H_inverse():
    """dω = H⁻¹ dθ: the inverse of H, and by itself the spin of exp, ~ω = dR Rᵀ."""

    def spin_of_exp(theta):
        dR = jnp.einsum("abk,cb->ack", jax.jacfwd(rotations.exp)(theta), rotations.exp(theta))
        return jax.vmap(axial, in_axes=2, out_axes=1)(dR)

    thetas = on_axes(0.0, 1e-3, 0.9999, 1.0001, 3.0, 5.0)
    H_inverse = jax.vmap(rotations.H_inverse)(thetas)
    np.testing.assert_allclose(H_inverse, jax.jit(jax.vmap(spin_of_exp))(thetas), atol=2e-14)
    identity = np.broadcast_to(np.eye(3), H_inverse.shape)
    np.testing.assert_allclose(jax.vmap(rotations.H)(thetas) @ H_inverse, identity, atol=2e-14)


def test_cayley():
    thetas = on_axes(0.0, 1e-9, 0.3, 2.0, 40.0)
    R = np.array(jax.vmap(rotations.cayley)(thetas))
    half_spin = 0.5 * np.array(jax.vmap(rotations.skew)(thetas))
    np.testing.assert_allclose(R @ R.swapaxes(1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-14)
    by_definition = np.linalg.solve(np.eye(3) - half_spin, np.eye(3) + half_spin)
    np.testing.assert_allclose(R, by_definition, atol=1e-13)


# Near zero each map is I + b ~θ + c ~θ~θ + O(θ³) with these constants (b, c).
@pytest.mark.parametrize(
    ("name", "b", "c"),
    [("exp", 1.0, 1 / 2), ("cayley", 1.0, 1 / 2), ("H", -1 / 2, 1 / 12), ("H_inverse", 1 / 2, 1 / 6)],
)
def test_derivatives_at_zero(name, b, c):
    function = getattr(rotations, name)
    zero = jnp.zeros((1, 3))
    np.testing.assert_array_equal(function(zero[0]), np.eye(3))
    for mode, jacobian in jacobians(function).items():
        np.testing.assert_allclose(jacobian(zero)[0], b * GENERATORS, atol=1e-16, err_msg=mode)
    for mode, hessian in hessians(function).items():
        np.testing.assert_allclose(hessian(zero)[0], c * PRODUCTS, atol=1e-16, err_msg=mode)


def test_second_derivatives_of_log_after_exp_vanish():
    """With exp's own second derivatives, tested above, those of log."""
    thetas = on_axes(0.0, 1e-9, 1e-4, 0.2, 1.0, 2.1, 3.1)
    for mode, hessian in hessians(lambda theta: rotations.log(rotations.exp(theta))).items():
        assert np.abs(hessian(thetas)).max() < 1e-12, mode


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, 1.0, 3.0, np.pi, 5.0])
def test_a_vector_is_turned_as_by_the_matrix(angle):
    theta = jnp.asarray(angle * AXES)
    v = jnp.asarray(np.random.default_rng(2).normal(size=theta.shape))
    matrices = jax.vmap(rotations.exp)(theta)
    np.testing.assert_allclose(jax.vmap(rotations.turned)(theta, v), jnp.einsum("nij,nj->ni", matrices, v), atol=2e-15)
    by_theta = jax.vmap(jax.jacfwd(rotations.turned))(theta, v)
    expected = jnp.einsum("nijk,nj->nik", jax.vmap(jax.jacfwd(rotations.exp))(theta), v)
    np.testing.assert_allclose(by_theta, expected, atol=1e-14)
