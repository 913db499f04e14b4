"""Where Newton starts: extrapolation of the last steps' increments, common to all implicit methods.

The mean rates of the last four steps are kept. Their changes d_n = r_n - r_{n-1} are extrapolated linearly,
d_{n+1} ≈ c₁ d_n + c₂ d_{n-1}, with the two coefficients that would have been best one step earlier (least
squares, displacements and rotations apart). Smooth motion is extrapolated, while noise at the step's own
frequency is not amplified, as it would be by fixed coefficients.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.numerics import rotations

HISTORY = 4
Rates = Float[Array, "4 n 6"]


def initial_rates(v: Float[Array, "n 3"], omega: Float[Array, "n 3"]) -> Rates:
    """History of a run that starts with velocities v and angular velocities ω."""
    return jnp.broadcast_to(jnp.concatenate([v, omega], axis=1), (HISTORY, *v.shape[:1], 6))


def remember(rates: Rates, increments: Float[Array, "n 6"], dt) -> Rates:
    """History after a step with these increments."""
    return jnp.concatenate([(increments / dt)[None], rates[:-1]])


def extrapolate(rates: Rates, dt) -> Float[Array, "n 6"]:
    """Increments from which the next step's Newton starts."""
    return dt * jnp.concatenate([_next(rates[:, :, :3]), _next(rates[:, :, 3:])], axis=1)


def rigid(rates: Rates, x: Float[Array, "n 3"], dt) -> Float[Array, "n 6"]:
    """Increments of the rigid motion that fits the last step's displacements best; rotations as Cayley vectors.

    Rigid about the mid-point positions, Δx = Δc + θ × (x_m - c_m), which the Cayley transform does exactly.
    """
    moved = dt * rates[0, :, :3]
    centre, middle = jnp.mean(moved, axis=0), x - 0.5 * moved
    arms, relative = middle - jnp.mean(middle, axis=0), moved - centre
    inertia = jnp.sum(arms * arms) * jnp.eye(3) - arms.T @ arms
    theta = jnp.linalg.solve(inertia, jnp.sum(jnp.cross(arms, relative), axis=0))
    turned = rotations.cayley(theta)
    arms = x - jnp.mean(x, axis=0)
    return jnp.concatenate([centre + arms @ turned.T - arms, jnp.broadcast_to(theta, x.shape)], axis=1)


def _next(rates):
    change = (rates[:-1] - rates[1:]).reshape(HISTORY - 1, -1)
    before = change[1:]
    normal = before @ before.T
    # The ridge makes the system solvable where changes vanish or are parallel.
    ridge = 1e-10 * jnp.trace(normal) + jnp.finfo(normal.dtype).tiny
    (a, b), (_, c) = normal + ridge * jnp.eye(2)
    p, q = before @ change[0]
    best = jnp.stack([c * p - b * q, a * q - b * p]) / (a * c - b * b + jnp.finfo(normal.dtype).tiny)
    return rates[0] + jnp.tensordot(best, change[:2].reshape(2, *rates.shape[1:]), 1)
