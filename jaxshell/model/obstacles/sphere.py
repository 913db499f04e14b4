"""A sphere, solid inside or outside."""

from typing import ClassVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.obstacles.base import Obstacle, check_vector, vector
from jaxshell.model.obstacles.distances import size, size_between
from jaxshell.model.obstacles.outlines import Lines, circle
from jaxshell.numerics.checks import check_positive_number, check_switch, floats


class Sphere(Obstacle):
    """A sphere.

    Arguments:
        centre: (3,) [length].
        radius: [length].
        inside: the shell lies in the sphere, as in a container.

    By name those of every `Obstacle`. Forces have no moment about the centre. Raises ValueError for a
    radius that is not positive.
    """

    kind: ClassVar[str] = "sphere"

    centre: Float[jax.Array, "3"] = eqx.field(converter=vector("sphere centre"))
    radius: Float[jax.Array, ""] = eqx.field(converter=floats("sphere radius"))
    inside: bool = eqx.field(static=True, default=False, kw_only=True)

    def __check_init__(self):
        check_vector("sphere centre", self.centre)
        check_positive_number("sphere radius", self.radius)
        check_switch("sphere inside", self.inside)

    @property
    def _sign(self) -> float:
        return -1.0 if self.inside else 1.0

    def gap(self, x: Float[Array, "3"]) -> Float[Array, ""]:
        return self._sign * (size(x - self.centre) - self.radius)

    def gap_between(self, before: Float[Array, "3"], after: Float[Array, "3"]) -> Float[Array, "3"]:
        return self._sign * size_between(before - self.centre, after - self.centre)

    def outline(self, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> Lines:
        return [circle(self.centre, axis, float(self.radius)) for axis in np.eye(3)]
