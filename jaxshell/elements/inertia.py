"""Inertia of one element: the paper's seven-point form, eqs. (27)-(53), and the traditional form it compares with.

Translations are linear in area coordinates and integrated exactly: ∫ N_a N_b dA = A (1 + δ_ab)/12. Rotations
live at the Gauss points with histories of their own. The incremental rotation *vector* of the step is what is
interpolated, R_G = exp(~Σ N_a θ_a) R_G,n, so that a converged step does not depend on the path of the
iterates; with equal nodal θ_a this is the paper's update of the spins.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.elements.element import Element
from jaxshell.numerics import rotations
from jaxshell.numerics.checks import Real
from jaxshell.numerics.fusion import formed
from jaxshell.numerics.products import cross, dot, product
from jaxshell.numerics.triangles import LINEAR_MASS


def _seven_point_rule() -> tuple[np.ndarray, np.ndarray]:
    """Area coordinates (7, 3) and weights (7,), exact for polynomials of degree 5 (Radon 1948)."""
    root = np.sqrt(15.0)
    points, weights = [[1 / 3] * 3], [9 / 40]
    for b, weight in (((6 + root) / 21, (155 + root) / 1200), ((6 - root) / 21, (155 - root) / 1200)):
        for corner in range(3):
            point = [b] * 3
            point[corner] = 1 - 2 * b
            points.append(point)
            weights.append(weight)
    return np.array(points), np.array(weights)


GAUSS_POINTS, GAUSS_WEIGHTS = _seven_point_rule()


class Spins(eqx.Module):
    """Rotation, material angular velocity and acceleration at points: history of the step."""

    R: Float[Array, "*p 3 3"]
    Omega: Float[Array, "*p 3"]
    Omega_dot: Float[Array, "*p 3"]


class StepFactors(NamedTuple):
    """The generalised mid-point's numbers, eqs. (13), (14), (91), (92): Newmark's β, γ, the α's, and Δt."""

    beta: Real
    gamma: Real
    alpha_m: Real
    alpha_f: Real
    dt: Real

    @classmethod
    def of_spectral_radius(cls, rho, dt) -> "StepFactors":
        """Those of Chung & Hulbert's generalised-α method, eq. (92), for the spectral radius ρ∞."""
        alpha_m, alpha_f = (2.0 * rho - 1.0) / (rho + 1.0), rho / (rho + 1.0)
        return cls(0.25 * (1.0 - alpha_m + alpha_f) ** 2, 0.5 - alpha_m + alpha_f, alpha_m, alpha_f, dt)

    def first(self, increment, rate, acceleration):
        """Velocity at the end of the step, eqs. (13), (104)."""
        b, g, dt = self.beta, self.gamma, self.dt
        return g / (b * dt) * increment - (g / b - 1.0) * rate - (g / (2.0 * b) - 1.0) * dt * acceleration

    def second(self, increment, rate, acceleration):
        """Acceleration at the end of the step, eqs. (14), (105)."""
        b, dt = self.beta, self.dt
        return increment / (b * dt * dt) - rate / (b * dt) - (1.0 / (2.0 * b) - 1.0) * acceleration

    def mid(self, end, start, alpha):
        """(·)_{n+1-α}, eq. (91)."""
        return (1.0 - alpha) * end + alpha * start

    def mid_acceleration(self, increment, rate, acceleration, damping=None):
        """Acceleration at t_{n+1-αm}; with mass-proportional `damping` α plus α times the rate at t_{n+1-αf}."""
        found = self.mid(self.second(increment, rate, acceleration), acceleration, self.alpha_m)
        if damping is not None:
            found = found + damping * self.mid(self.first(increment, rate, acceleration), rate, self.alpha_f)
        return found

    def mid_acceleration_slope(self, damping=None):
        """Derivative of `mid_acceleration` by the increment."""
        slope = (1.0 - self.alpha_m) / (self.beta * self.dt**2)
        if damping is not None:
            slope = slope + damping * (1.0 - self.alpha_f) * self.gamma / (self.beta * self.dt)
        return slope


def apply_inertia(axis, rotary_inertia, vector):
    """I_ρ v = (ρh³/12) (v - t t·v), eq. (32); `axis` (..., 3) is the director t in the frame of v."""
    return rotary_inertia * (vector - axis * jnp.sum(vector * axis, axis=-1, keepdims=True))


def end_of_step(theta, start: Spins, factors: StepFactors) -> Spins:
    """Spins at the end of the step for one point, eqs. (103), (13), (14); θ (3,) is its rotation in the step."""
    material = product(theta, start.R)
    return Spins(
        product(formed(rotations.exp(theta)), start.R),
        factors.first(material, start.Omega, start.Omega_dot),
        factors.second(material, start.Omega, start.Omega_dot),
    )


class PointStart(NamedTuple):
    """A point at the start of the step, with its material vectors turned into space by R_n.

    In that frame Θ is θ itself, and R R_nᵀ is the step's rotation exp(~θ): no matrix of the history is needed.
    """

    director: Float[Array, "*p 3"]
    """R_n e3⁰."""
    rate: Float[Array, "*p 3"]
    """R_n Ω_n."""
    acceleration: Float[Array, "*p 3"]
    """R_n Ω̇_n."""

    @classmethod
    def of(cls, spins: Spins, axis: Float[Array, "3"]) -> "PointStart":
        """For spins (..., 3, 3) of one element with the director `axis` (3,) in its stress-free shape."""
        return cls(
            *(
                product(spins.R, v) if v.ndim == 1 else dot(spins.R, v[..., None, :])
                for v in (axis, spins.Omega, spins.Omega_dot)
            )
        )


def _mid_point(theta, start: PointStart, factors: StepFactors, centrifugal: bool, alpha=None):
    """Ω at the mid-point and a = I_ρ Ω̇ + ~Ω I_ρ Ω over ρh³/12, in the start's frame.

    With mass-proportional damping `alpha` a holds α I_ρ Ω too.
    """
    t, first, second = start.director, start.rate, start.acceleration
    rate = factors.mid(factors.first(theta, first, second), first, factors.alpha_f)
    rate, acceleration = formed((rate, factors.mid_acceleration(theta, first, second, alpha)))
    a = acceleration - dot(acceleration, t) * t
    if centrifugal:
        a = a - dot(rate, t) * cross(rate, t)  # Ω × (Ω - t t·Ω)
    return rate, a


def point_inertia(
    theta, start: PointStart, factors: StepFactors, centrifugal: bool = True, alpha=None
) -> Float[Array, "3"]:
    """R (I_ρ Ω̇ + ~Ω I_ρ Ω) at the generalised mid-point, eqs. (40), (88), (91), for one point, over ρh³/12.

    With mass-proportional damping `alpha` [1/time], where it is not None, R (α I_ρ Ω) is added.
    """
    _, a = _mid_point(theta, start, factors, centrifugal, alpha)
    a = formed(a)
    return factors.mid(rotations.turned(theta, a), a, factors.alpha_f)


def point_director(
    theta, start: PointStart, factors: StepFactors, alpha=None
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Director t and its acceleration R (Ω̇ × e3 + Ω × (Ω × e3)) at the generalised mid-point, averaged as in
    `point_inertia`, for one point. With mass-proportional damping `alpha` its α times rate is added."""
    rate, _ = _mid_point(theta, start, factors, centrifugal=False)
    t, first, second = start.director, start.rate, start.acceleration
    acceleration = factors.mid_acceleration(theta, first, second, alpha)
    averaged = factors.mid(rotations.exp(theta), jnp.eye(3), factors.alpha_f)
    return product(averaged, t), product(averaged, cross(acceleration, t) + cross(rate, cross(rate, t)))


def point_tangent(
    theta, start: PointStart, factors: StepFactors, centrifugal: bool = True, alpha=None
) -> Float[Array, "3 3"]:
    """Derivative of `point_inertia` with respect to θ: M, C_iner and K_iner of eqs. (51), (95), over ρh³/12.

    With δθ = H(θ) δω the paper's form follows by multiplying with H(θ) from the right. K_iner differentiates
    the end's rotation, so it holds R_{n+1} and not the averaged matrix that eq. (95) names. With I_ρ ∝ I - t tᵀ
    the gyroscopic matrix ~Ω I_ρ - ~(I_ρ Ω) is (Ω·t) ~t - (Ω × t) tᵀ.
    """
    rate, a = _mid_point(theta, start, factors, centrifugal, alpha)
    end, t = rotations.exp(theta), start.director
    averaged = factors.mid(end, jnp.eye(3), factors.alpha_f)
    beta, gamma, _, alpha_f, dt = factors
    material = factors.mid_acceleration_slope(alpha) * (jnp.eye(3) - t[:, None] * t[None, :])
    if centrifugal:
        gyroscopic = dot(rate, t) * rotations.skew(t) - cross(rate, t)[:, None] * t[None, :]
        material = material + (1.0 - alpha_f) * gamma / (beta * dt) * gyroscopic
    turning = product(rotations.skew(product(end, a)), rotations.H_inverse(theta))
    return product(averaged, material) - (1.0 - alpha_f) * turning


def mass_matrix(R: Float[Array, "3 3 3"], element: Element) -> Float[Array, "18 18"]:
    """Consistent mass of one element turned by the nodal rotations R: eq. (34) with ṫ_a = -~t_a ω_a.

    A section's first moment ∫ρz dz couples velocities and spins.
    """
    mass = element.area * jnp.asarray(LINEAR_MASS)
    turn = -jax.vmap(rotations.skew)(R @ element.frame[2])
    translational = element.mass_per_area * mass[:, None, :, None] * jnp.eye(3)[None, :, None, :]
    rotational = element.rotary_inertia * jnp.einsum("ab,aki,bkj->aibj", mass, turn, turn)
    coupled = lever = jnp.zeros_like(rotational)
    if element.first_moment is not None:  # v·ṫ of ∫ρz dz
        coupled = element.first_moment * jnp.einsum("ab,bij->aibj", mass, turn)
        lever = jnp.transpose(coupled, (2, 3, 0, 1))
    rows = [jnp.stack([translational, coupled], axis=3), jnp.stack([lever, rotational], axis=3)]
    return jnp.stack(rows, axis=1).reshape(18, 18)
