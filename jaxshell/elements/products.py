"""Products of small matrices, written out term by term.

For batches of 3 × 3 to 18 × 18 matrices XLA's CPU code for `dot` and for reductions spends most of its time on
overhead. A product written as a sum of outer products fuses with what stands around it and vectorises over
the last axis: measured on one core, 0.23 µs instead of 0.77 µs (`dot`) or 1.6 µs (`jnp.sum`) for the 12-term
18 × 18 product of the material stiffness. Where more is added to a product in the same loop, `jnp.dot` may be the
cheaper, because XLA forms its result once: `jaxshell.elements.corotational.on_rotations` has the figures.
"""

import functools
import operator

from jaxtyping import Array, Float


def product(A: Float[Array, "*a k"], B: Float[Array, "k *b"]) -> Array:
    """Σ_k A[..., k] B[k, ...]: the last axis of A against the first of B."""
    spread = A.shape[:-1] + (1,) * (B.ndim - 1)
    return functools.reduce(operator.add, (A[..., k].reshape(spread) * B[k] for k in range(B.shape[0])))


def transposed_product(A: Float[Array, "k m"], B: Float[Array, "k n"]) -> Float[Array, "m n"]:
    """Aᵀ B."""
    return functools.reduce(operator.add, (A[k][:, None] * B[k][None, :] for k in range(B.shape[0])))


def columns_times(A: Float[Array, "r b 3"], T: Float[Array, "b 3 3"]) -> Float[Array, "r b 3"]:
    """A_b T_b for each block b of three columns."""
    return functools.reduce(operator.add, (A[:, :, k, None] * T[None, :, k, :] for k in range(3)))


def dot(a: Float[Array, "*r k"], b: Float[Array, "*r k"]) -> Float[Array, "*r"]:
    """Σ_k a[..., k] b[..., k]."""
    return functools.reduce(operator.add, (a[..., k] * b[..., k] for k in range(b.shape[-1])))
