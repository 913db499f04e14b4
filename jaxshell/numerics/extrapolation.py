"""Richardson's extrapolation of results on levels h₁ > h₂ > ... of a mesh, or of a step.

    q(h) = q + c hᵖ,    q = q₂ + (q₂ - q₁)/((h₁/h₂)ᵖ - 1),    |q₂ - q₁| / |q₃ - q₂| = (h₁ᵖ - h₂ᵖ)/(h₂ᵖ - h₃ᵖ).

Two levels give the limit of an order p that is assumed. Three give the order, and show whether there is one: in the
asymptotic range the differences have one direction and shrink. A result of several numbers, such as a history, is one:
distances are the largest of any of them, relative to the largest size. Sources: P. J. Roache, "Quantification of
uncertainty in computational fluid dynamics", Annu. Rev. Fluid Mech. 29 (1997) 123-160; L. Eça & M. Hoekstra, "A
procedure for the estimation of the numerical uncertainty of CFD calculations based on grid refinement studies", J.
Comput. Phys. 262 (2014) 104-130.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import root_scalar

LEAST_ORDER = 0.5
"""Differences that shrink more slowly say nothing of a limit. (Eça & Hoekstra, section 3.)"""
_ABOVE = 1.0
"""An observed order of so much more than the assumed one is chance: the assumed one is taken, and a larger error."""
_ALIKE = 0.5
"""Least cosine of the angle between two differences of one direction."""
_ROUND_OFF = 1e-10
"""Differences of this fraction of the result are none."""
_ORDERS = -2.0, 12.0
"""Orders that are sought."""


class Estimate(NamedTuple):
    """A result on levels, coarse to fine, and what it says of its limit. Errors are relative to the largest size."""

    values: Float[np.ndarray, "levels *k"]
    limit: Float[np.ndarray, "*k"]
    """NaN where the levels do not tell it."""
    order: float | None
    """As the last three levels show it; None of two, and of results that do not depend on the level."""
    errors: Float[np.ndarray, " levels"]
    """Of each level, NaN where the levels do not tell them."""
    uncertainty: float
    """Of the limit; where the levels do not tell it, the largest difference between two of the last three."""
    problem: str = ""
    """Why the levels do not tell a limit; empty where they do."""


def extrapolated(coarse, fine, order: float = 2.0, ratio: float = 2.0):
    """The limit of two levels whose sizes have the given ratio > 1."""
    factor = ratio**order
    return (factor * fine - coarse) / (factor - 1)


def distance(found: Float[np.ndarray, "*k"], expected: Float[np.ndarray, "*k"]) -> float:
    """The largest distance over the largest expected size; 0 between nothing and nothing."""
    largest = float(np.abs(np.asarray(found) - expected).max(initial=0.0))
    size = float(np.abs(expected).max(initial=0.0))
    return 0.0 if largest == 0 else largest / size if size else np.inf


def estimate(values: Sequence, sizes: Sequence[float], order: float = 2.0) -> Estimate:
    """The limit of a result on levels, with the order that is assumed of two levels.

    `values` (of one shape) and `sizes` are given from coarse to fine. Of three levels and more, the order is that of
    the last three; the limit's uncertainty is its distance from the one of the assumed order, and no less than a
    quarter of the finest level's error. Of two it is all of that error. Raises ValueError for a single level.
    """
    stack = np.stack([np.asarray(value, float) for value in values])
    if len(stack) < 2 or len(sizes) != len(stack) or np.any(np.diff(sizes) >= 0):
        raise ValueError(
            f"An extrapolation takes two levels or more, from coarse to fine, but their sizes are {sizes}."
        )
    if not np.all(np.isfinite(stack)):
        return _untold(stack, None, "a result is not finite")
    size = np.abs(stack[-1]).max(initial=0.0)
    steps = np.diff(stack, axis=0)
    largest = [float(np.abs(step).max(initial=0.0)) for step in steps]
    if max(largest[-2:]) <= _ROUND_OFF * size:
        errors = np.array([distance(value, stack[-1]) for value in stack])
        return Estimate(stack, stack[-1], None, errors, distance(stack[-2], stack[-1]))
    ratio = sizes[-2] / sizes[-1]
    assumed = extrapolated(stack[-2], stack[-1], order, ratio)
    if len(stack) == 2:
        return _told(stack, assumed, None, 0.0, 1.0)
    observed, problem = _observed(steps[-2:], largest[-2:], sizes[-3:])
    if problem:
        return _untold(stack, observed, problem)
    assert observed is not None
    taken = observed if observed <= order + _ABOVE else order
    limit = extrapolated(stack[-2], stack[-1], taken, ratio)
    return _told(stack, limit, observed, distance(assumed, limit), 0.25)


def _observed(steps, largest: list[float], sizes: Sequence[float]) -> tuple[float | None, str]:
    """The order that two differences show, and what is wrong with it."""
    one, other = (step.ravel() for step in steps)
    lengths = np.linalg.norm(one) * np.linalg.norm(other)
    cosine = float(one @ other) / lengths if lengths else 1.0
    order = _order_of(largest[0] / largest[1], sizes) if min(largest) > 0 else (np.inf if largest[0] else -np.inf)
    if cosine <= -_ALIKE:
        return None, "the levels oscillate about each other"
    if cosine < _ALIKE:
        return None, "each level differs from the one before in another way"
    if order <= 0:
        return order, "the differences between levels grow"
    if order < LEAST_ORDER:
        return order, f"the differences between levels hardly shrink, with an order of {order:.2g}"
    return order, ""


def _order_of(ratio: float, sizes: Sequence[float]) -> float:
    """The order whose differences have the ratio; within what is sought."""
    h1, h2, h3 = np.asarray(sizes) / sizes[0]

    def excess(p: float) -> float:
        if abs(p) < 1e-9:
            return np.log(h1 / h2) / np.log(h2 / h3) - ratio
        return (h1**p - h2**p) / (h2**p - h3**p) - ratio

    low, high = _ORDERS
    if excess(low) >= 0 or excess(high) <= 0:
        return low if excess(low) >= 0 else high
    return float(root_scalar(excess, bracket=(low, high)).root)


def _told(stack, limit, order: float | None, uncertainty: float, share: float) -> Estimate:
    """An estimate whose uncertainty is at least a share of the finest level's error."""
    errors = np.array([distance(value, limit) for value in stack])
    return Estimate(stack, limit, order, errors, max(uncertainty, share * float(errors[-1])))


def _untold(stack, order: float | None, problem: str) -> Estimate:
    last = stack[-3:]
    spread = float(np.ptp(last, axis=0).max(initial=0.0))
    size = float(np.abs(stack[-1]).max(initial=0.0))
    nothing = np.full(len(stack), np.nan)
    return Estimate(stack, np.full(stack.shape[1:], np.nan), order, nothing, spread / size if size else np.inf, problem)
