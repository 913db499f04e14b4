"""A plane: the half-space behind it is solid."""

from typing import ClassVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.obstacles.base import Obstacle, check_vector, unit, vector
from jaxshell.model.obstacles.outlines import Lines, grid


class Plane(Obstacle):
    """A plane through a point, solid on the side that its normal points away from: a floor, a wall, a press.

    Arguments:
        point: (3,) a point of the plane [length].
        normal: (3,) towards the shell, of any length.

    By name those of every `Obstacle`. Raises ValueError for a normal of zero length.
    """

    kind: ClassVar[str] = "plane"

    point: Float[jax.Array, "3"] = eqx.field(converter=vector("plane point"))
    normal: Float[jax.Array, "3"] = eqx.field(converter=vector("plane normal"))

    def __check_init__(self):
        check_vector("plane point", self.point)
        check_vector("plane normal", self.normal, direction=True)

    def gap(self, x: Float[Array, "3"]) -> Float[Array, ""]:
        return unit(self.normal) @ (x - self.point)

    def gap_between(self, before: Float[Array, "3"], after: Float[Array, "3"]) -> Float[Array, "3"]:
        return unit(self.normal)

    def outline(self, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> Lines:
        return grid(self.point, unit(self.normal), low, high)
