"""A boundary that XLA's fusion does not cross."""

from typing import TypeVar

import jax
from jax.experimental.xla_metadata import set_xla_metadata

T = TypeVar("T")


def formed(values: T) -> T:
    """`values` (a pytree of arrays), formed once and kept, and so are their cotangents in reverse mode.

    XLA's CPU compiler merges what makes an array into every loop that reads it, where each entry makes it anew.
    `jax.lax.optimization_barrier` does not hinder it, since that is gone before fusion; a call that is not to be
    inlined does. Boundaries in the right places halve the time of a tangent with its assembly, and that of the way
    back through a step.
    """
    if jax.default_backend() != "cpu":
        return jax.lax.optimization_barrier(values)
    with set_xla_metadata(inlineable="false"):
        return _unchanged(values)


@jax.jit
def _unchanged(values):
    # Not the bare argument, which JAX would hand past the call.
    return jax.lax.optimization_barrier(values)
