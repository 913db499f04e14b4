"""A branch that copies nothing."""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

T = TypeVar("T")


def when(condition: Bool[Array, ""], function: Callable[[T], T], value: T) -> T:
    """`function(value)` where the condition holds, else `value`: both pytrees of the same arrays.

    Within loops XLA copies what one branch of `jax.lax.cond` reads and another hands through, such as the factored
    matrix in Newton's iteration; a loop of one turn leaves it where it is. Not to be differentiated in reverse mode.
    """
    return jax.lax.while_loop(
        lambda carry: carry[0], lambda carry: (jnp.array(False), function(carry[1])), (condition, value)
    )[1]
