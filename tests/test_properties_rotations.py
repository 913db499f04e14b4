"""Properties of the rotation maps for any vector: exp and log, H, Cayley, composition, derivatives down to zero.

Each is an identity of the rotation group, so that its error is round-off: some ten operations on numbers of order 1.
"""

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from properties import EPS, PROFILE, numbers, powers, vectors
from spins import axial

from jaxshell.numerics import rotations

ROUND_OFF = 50 * EPS
IDENTITY = np.eye(3)


def rotation_vectors(longest):
    """Any direction; lengths 0 and from 1e-300 to `longest`, evenly in size and evenly in order of magnitude."""

    def scaled(direction, length):
        norm = np.linalg.norm(direction)
        return length * (direction / norm if norm > 1e-6 else np.array([1.0, 0.0, 0.0]))

    lengths = st.one_of(st.just(0.0), numbers(1e-3, longest), powers(-300.0, np.log10(longest)))
    return st.builds(scaled, vectors(None), lengths)


@jax.jit
def maps(theta):
    """exp, log(exp), exp(log(exp)), cay, log(cay), H, H⁻¹ and H⁻¹ of the opposite vector."""
    R, C = rotations.exp(theta), rotations.cayley(theta)
    back = rotations.log(R)
    return (
        R, back, rotations.exp(back), C, rotations.log(C),
        rotations.H(theta), rotations.H_inverse(theta), rotations.H_inverse(-theta),
    )  # fmt: skip


@PROFILE
@given(rotation_vectors(np.pi * (1 - 1e-9)))
def test_log_undoes_exp_up_to_pi(theta):
    """To round-off of θ itself, also where it is tiny; beyond π log gives the shorter way round (next test)."""
    _, back, *_ = maps(theta)
    assert np.abs(np.asarray(back) - theta).max() <= ROUND_OFF * np.linalg.norm(theta)


@PROFILE
@given(rotation_vectors(20.0))
def test_exp_undoes_log_at_any_angle(theta):
    R, back, again, *_ = maps(theta)
    assert np.linalg.norm(back) <= np.pi * (1 + EPS)
    # Sine and cosine of an angle θ carry its own rounding, θ ε.
    assert np.abs(np.asarray(again) - np.asarray(R)).max() <= ROUND_OFF * (1 + np.linalg.norm(theta))


@PROFILE
@given(rotation_vectors(6.0))
def test_H_is_the_inverse_of_the_tangent_map(theta):
    """H H⁻¹ = I; H θ = θ; and exp(θ) = H⁻¹(θ) H(-θ), the left over the right tangent map of SO(3)."""
    R, *_, H, inverse, opposite = (np.asarray(value) for value in maps(theta))
    # H has its pole at 2π: it grows there as 1/(2π - θ), and its rounding with it.
    tolerance = ROUND_OFF * (1 + np.abs(H).max() ** 2)
    assert np.abs(H @ inverse - IDENTITY).max() <= tolerance
    assert np.abs(H @ theta - theta).max() <= tolerance * np.linalg.norm(theta)
    assert np.abs(R @ opposite - inverse).max() <= tolerance
    assert np.abs(opposite - inverse.T).max() <= ROUND_OFF


@PROFILE
@given(rotation_vectors(1e3))
def test_cayley_vector_is_twice_the_tangent_of_half_the_angle(theta):
    """cay(θ) - I = ½ ~θ (cay(θ) + I), what EnergyMomentum rests on, and log cay(θ) = 2 arctan(½|θ|) along θ."""
    *_, C, log_C, _, _, _ = (np.asarray(value) for value in maps(theta))
    length = np.linalg.norm(theta)
    skew = np.cross(IDENTITY, theta)
    assert np.abs(C - IDENTITY - 0.5 * skew @ (C + IDENTITY)).max() <= ROUND_OFF * (1 + length)
    angle = 2.0 * np.arctan(0.5 * length)
    expected = theta * (angle / length) if length > 0 else theta
    assert np.abs(log_C - expected).max() <= ROUND_OFF * angle


@PROFILE
@given(st.lists(rotation_vectors(3.0), min_size=30, max_size=30))
def test_products_stay_rotations(thetas):
    """A chain of 30 steps of exp and of Cayley leaves SO(3) by round-off only, which adds up at most linearly."""
    for place in (0, 3):
        total = IDENTITY
        for theta in thetas:
            total = np.asarray(maps(theta)[place]) @ total
        assert np.abs(total @ total.T - IDENTITY).max() <= len(thetas) * ROUND_OFF
        assert abs(np.linalg.det(total) - 1.0) <= len(thetas) * ROUND_OFF


@jax.jit
def first_derivatives(theta):
    """By forward and reverse mode: spins of exp and of Cayley, and log's derivative along a spin."""

    def spun(dw):
        return rotations.log(rotations.exp(dw) @ rotations.exp(theta))

    found = []
    for jacobian in (jax.jacfwd, jax.jacrev):
        for turn in (rotations.exp, rotations.cayley):
            dR = jnp.einsum("abk,cb->ack", jacobian(turn)(theta), turn(theta))
            found.append(jax.vmap(axial, in_axes=2, out_axes=1)(dR))
        found.append(jacobian(spun)(jnp.zeros(3)))
    return found


@PROFILE
@given(rotation_vectors(3.1))
def test_first_derivatives_from_zero_to_pi(theta):
    """dω = H⁻¹ dθ of exp, dω = (I + ½~θ)/(1 + ¼θ²) dθ of Cayley, dθ = H dω of log, down to θ = 0."""
    *_, H, inverse, _ = (np.asarray(value) for value in maps(theta))
    skew = np.cross(IDENTITY, theta)
    cayley = (IDENTITY + 0.5 * skew) / (1.0 + 0.25 * theta @ theta)
    for found, expected in zip(first_derivatives(theta), 2 * (inverse, cayley, H), strict=True):
        # One derivative multiplies the cancellation at the series' switch by ten at most (test_rotations).
        assert np.abs(np.asarray(found) - expected).max() <= 10 * ROUND_OFF


@jax.jit
def second_derivatives(theta):
    """Hessians of w·log(exp(θ)), which is linear, in both orders of the modes; w = (1, 2, 3)."""

    def linear(theta):
        return rotations.log(rotations.exp(theta)) @ jnp.array([1.0, 2.0, 3.0])

    return jax.jacfwd(jax.jacrev(linear))(theta), jax.jacrev(jax.jacfwd(linear))(theta)


@PROFILE
@given(rotation_vectors(3.1))
def test_second_derivatives_from_zero_to_pi(theta):
    for hessian in second_derivatives(theta):
        assert np.abs(np.asarray(hessian)).max() <= 1e3 * ROUND_OFF  # two derivatives: 1e-12 in test_rotations
