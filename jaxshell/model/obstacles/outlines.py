"""Lines that show obstacles in pictures: NumPy only."""

import numpy as np
from jaxtyping import Float

_ROUND = np.linspace(0.0, 2.0 * np.pi, 73)
_GRID = 7
"""So many lines of a plane either way."""

Lines = list[np.ndarray]
"""Polylines (j, 3)."""


def circle(centre, axis, radius: float) -> Float[np.ndarray, "j 3"]:
    """Round an axis (3,) of length 1."""
    across = _across(np.asarray(axis, float))
    return np.asarray(centre) + radius * (np.cos(_ROUND)[:, None] * across[0] + np.sin(_ROUND)[:, None] * across[1])


def grid(point, normal, low, high) -> Lines:
    """A square of a plane beside the space between two corners."""
    normal, middle = np.asarray(normal, float), 0.5 * (np.asarray(low) + np.asarray(high))
    centre = middle - normal * (normal @ (middle - np.asarray(point)))
    a, b = 0.5 * np.linalg.norm(np.asarray(high) - np.asarray(low)) * _across(normal)
    places = np.linspace(-1.0, 1.0, _GRID)
    return [centre + np.stack([s * u - v, s * u + v]) for u, v in ((a, b), (b, a)) for s in places]


def edges(centre, halves: Float[np.ndarray, "3 3"]) -> Lines:
    """The twelve of a box, whose three half edges are the rows."""
    found = []
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        for s in (-1.0, 1.0):
            for t in (-1.0, 1.0):
                middle = np.asarray(centre) + s * halves[j] + t * halves[k]
                found.append(np.stack([middle - halves[i], middle + halves[i]]))
    return found


def _across(axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2 3"]:
    """Two directions at right angles to an axis of length 1, and to each other."""
    first = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first)])
