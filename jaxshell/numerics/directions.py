"""Directions in space, and axes across them."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.numerics.checks import check_finite, check_shape, float_array, is_concrete


def unit_vector(value, what: str) -> Float[jax.Array, "3"]:
    """A direction. Raises ValueError calling it `what` for a vector of no length."""
    vector = float_array(value, what)
    check_shape(what, vector, (3,))
    check_finite(what, vector)
    if is_concrete(vector) and not np.linalg.norm(np.asarray(vector)) > 0:
        raise ValueError(f"{what} must have a length, but it is {np.asarray(vector).tolist()}.")
    return vector


def across(axis: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """The unit vector along an axis and two perpendicular ones, as rows."""
    first = axis / jnp.linalg.norm(axis)
    # The coordinate axis that is furthest from it, chosen without derivative.
    other = jnp.eye(3)[jnp.argmin(jnp.abs(jax.lax.stop_gradient(first)))]
    second = jnp.cross(first, other)
    second = second / jnp.linalg.norm(second)
    return jnp.stack([first, second, jnp.cross(first, second)])
