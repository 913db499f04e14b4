"""Invariants of plane stresses (σxx, σyy, τxy): von Mises' stress and the principal values."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.numerics.checks import float_array


class Principal(NamedTuple):
    """Principal values of plane tensors."""

    values: Float[Array, "*b 2"]
    """The larger, then the smaller."""
    angle: Float[Array, "*b"]
    """From the axis x to the direction of the larger one [rad], in (-π/2, π/2]; 0 where they are equal."""


def von_mises(stress) -> Float[Array, "*b"]:
    """√(σxx² - σxx σyy + σyy² + 3 τxy²) of stresses (..., 3) = (σxx, σyy, τxy) [their unit].

    It does not depend on the axes. Its derivative at zero stress is taken as zero. Raises ValueError for another last
    axis.
    """
    sx, sy, t = _components(stress)
    return _root(sx * sx - sx * sy + sy * sy + 3.0 * t * t)


def principal(stress) -> Principal:
    """Principal values and their angle of plane stresses, or section forces, (..., 3) = (xx, yy, xy).

    Of strains halve the last entry, γ. Where both values are equal the angle is 0, and derivatives are those of the
    mean alone. Raises ValueError for another last axis.
    """
    sx, sy, t = _components(stress)
    half = 0.5 * (sx - sy)
    radius = _root(half * half + t * t)
    mean = 0.5 * (sx + sy)
    turned = (half != 0) | (t != 0)
    angle = 0.5 * jnp.arctan2(jnp.where(turned, t, 0.0), jnp.where(turned, half, 1.0))
    return Principal(jnp.stack([mean + radius, mean - radius], axis=-1), angle)


def _components(stress):
    stress = float_array(stress, "stress")
    if stress.ndim < 1 or stress.shape[-1] != 3:
        raise ValueError(f"stress must have shape (..., 3), (σxx, σyy, τxy), but it has shape {stress.shape}.")
    return stress[..., 0], stress[..., 1], stress[..., 2]


def _root(square):
    """The root, with the derivative 0 at 0."""
    positive = square > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)
