"""The local frame of a triangle, and its mass."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.numerics.products import cross


def local_frame(x: Float[Array, "3 3"]) -> tuple[Float[Array, "3 3"], Float[Array, "3"]]:
    """Rows e1 ∥ edge 1-2, e2, e3 normal, eq. (54), and the local coordinates (l, b̄x, b̄y), from x (3, 3)."""
    a, b = x[1] - x[0], x[2] - x[0]
    length = jnp.sqrt(jnp.sum(a * a))
    normal = cross(a, b)
    double_area = jnp.sqrt(jnp.sum(normal * normal))
    e1, e3 = a / length, normal / double_area
    frame = jnp.stack([e1, cross(e3, e1), e3])
    return frame, jnp.stack([length, jnp.sum(b * e1), double_area / length])


LINEAR_MASS = (np.ones((3, 3)) + np.eye(3)) / 12.0
"""∫ N_a N_b dA / A, of linear functions."""
