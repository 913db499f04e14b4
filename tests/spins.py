"""The spin of a rotation that is differentiated, for the tests of the rotation maps."""

import jax.numpy as jnp


def axial(W):
    """Axial vector (3,) of the skew part of W (3, 3), ½ [W32-W23, W13-W31, W21-W12]; eq. (5)."""
    return 0.5 * jnp.stack([W[2, 1] - W[1, 2], W[0, 2] - W[2, 0], W[1, 0] - W[0, 1]])
