"""Forces of springs in one coordinate, and their means over a step, in closed form.

A mean m̄ of a force V'(e) over a step from e₀ to e₁ does exactly the work of the energy: m̄ (e₁ - e₀) = V(e₁) - V(e₀).
"""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

Scalar = Float[Array, ""]


def length_of(r: Float[Array, "3"]) -> Scalar:
    """|r|, whose derivative at zero is taken as zero."""
    square = r @ r
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)


def ratio(part: Scalar, whole: Scalar, otherwise: Any = 0.0) -> Scalar:
    """part/whole, and something else where the whole, which is never negative, is zero."""
    return jnp.where(whole > 0, part / jnp.where(whole > 0, whole, 1.0), otherwise)


def positive(e: Scalar) -> Scalar:
    """⟨e⟩: e where it is positive, else zero."""
    return jnp.where(e > 0, e, 0.0)


def mean_positive(before: Scalar, after: Scalar) -> Scalar:
    """The mean of ⟨e⟩ over a step, exact for the energy ½⟨e⟩²: ½(⟨e₀⟩ + ⟨e₁⟩)(⟨e₁⟩ - ⟨e₀⟩)/(e₁ - e₀).

    The last factor is 1 where both are positive, and between 0 and 1 where one is: then e₁ - e₀ is no less than either.
    """
    both = (before > 0) & (after > 0)
    low, high = jnp.minimum(before, after), jnp.maximum(before, after)
    across = (high > 0) & ~both
    part = jnp.where(across, high / jnp.where(across, high - low, 1.0), 1.0)
    return 0.5 * (positive(before) + positive(after)) * part
