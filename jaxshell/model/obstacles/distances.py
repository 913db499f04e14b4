"""Distances and their discrete gradients: what over a step, times the step's increments, is exactly the change.

Each is written in quotients that lose no digits where increments are small, and is the gradient where they vanish.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float


def size(y: Float[Array, " d"]) -> Float[Array, ""]:
    """|y|, with a derivative of zero at zero."""
    square = jnp.sum(y * y)
    return jnp.where(square > 0.0, jnp.sqrt(jnp.where(square > 0.0, square, 1.0)), 0.0)


def size_between(before: Float[Array, " d"], after: Float[Array, " d"]) -> Float[Array, " d"]:
    """D with D·(after - before) = |after| - |before|: the sum of the ends over the sum of their sizes."""
    total = size(before) + size(after)
    return (before + after) / jnp.where(total > 0.0, total, 1.0)


def outside_of(a: Float[Array, " d"]) -> Float[Array, ""]:
    """Signed distance from what lies where all a are negative, a_i the distances from its faces: negative inside.

    √(Σ max(a_i, 0)²) + min(max a_i, 0), as of a box: flat beside its faces, round about edges and corners.
    """
    return size(jnp.maximum(a, 0.0)) + jnp.minimum(jnp.max(a), 0.0)


def outside_between(before: Float[Array, " d"], after: Float[Array, " d"]) -> Float[Array, " d"]:
    """D with D·(after - before) = outside_of(after) - outside_of(before).

    The round part has the quotient of its squares. The part inside changes with one coordinate after the other, in one
    order and in the other, of which D is the mean: so it is the same for a step taken backwards.
    """
    round_part = size_between(jnp.maximum(before, 0.0), jnp.maximum(after, 0.0)) * kept(before, after, 0.0, jnp.inf)
    order = range(before.shape[0])
    flat = 0.5 * (_one_by_one(before, after, order) + _one_by_one(before, after, reversed(order)))
    return round_part + flat


def _one_by_one(before, after, order) -> Float[Array, " d"]:
    """Quotients of min(max a_i, 0) as the coordinates change in this order."""
    found, now = jnp.zeros_like(before), before
    for i in order:
        # As a function of a_i it is a_i between the largest of the others and zero, and constant beyond.
        others = jnp.max(now.at[i].set(-jnp.inf))
        found = found.at[i].set(kept(before[i], after[i], jnp.minimum(others, 0.0), 0.0))
        now = now.at[i].set(after[i])
    return found


def kept(before, after, low, high) -> Float[Array, "..."]:
    """What of a change is left after both ends are clipped to [low, high]: 1 within, 0 beyond."""
    change = after - before
    is_still = change == 0.0
    is_within = (jnp.minimum(before, after) >= low) & (jnp.maximum(before, after) <= high)
    divisor = jnp.where(is_still | is_within, 1.0, change)
    quotient = (jnp.clip(after, low, high) - jnp.clip(before, low, high)) / divisor
    # Still on the border of both: half of each, so that a gradient on an inner edge is the mean of its sides.
    at_rest = 0.5 * ((before >= low) & (before <= high)) + 0.5 * ((before > low) & (before < high))
    return jnp.where(is_still, at_rest, jnp.where(is_within, 1.0, quotient))
