"""A round cylinder, solid inside or outside, endless or with two ends."""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.obstacles.base import Obstacle, check_vector, unit, vector
from jaxshell.model.obstacles.distances import outside_between, outside_of, size, size_between
from jaxshell.model.obstacles.outlines import Lines, circle
from jaxshell.numerics.checks import check_positive_number, check_switch, floats, optional_floats


class Cylinder(Obstacle):
    """A cylinder: a roller, a mandrel, a pipe.

    Arguments:
        point: (3,) a point of the axis [length]; of a cylinder with ends its middle.
        axis: (3,) along it, of any length.
        radius: [length].
        length: between its flat ends [length]; None is endless.
        inside: the shell lies in the cylinder; with ends, in a closed can.

    By name those of every `Obstacle`. Forces on the round side have no moment about the axis. Raises
    ValueError for an axis of zero length, a radius or a length that is not positive.
    """

    kind: ClassVar[str] = "cylinder"

    point: Float[jax.Array, "3"] = eqx.field(converter=vector("cylinder point"))
    axis: Float[jax.Array, "3"] = eqx.field(converter=vector("cylinder axis"))
    radius: Float[jax.Array, ""] = eqx.field(converter=floats("cylinder radius"))
    length: Float[jax.Array, ""] | None = eqx.field(default=None, converter=optional_floats("cylinder length"))
    inside: bool = eqx.field(static=True, default=False, kw_only=True)

    def __check_init__(self):
        check_vector("cylinder point", self.point)
        check_vector("cylinder axis", self.axis, direction=True)
        check_positive_number("cylinder radius", self.radius)
        if self.length is not None:
            check_positive_number("cylinder length", self.length)
        check_switch("cylinder inside", self.inside)

    @property
    def _sign(self) -> float:
        return -1.0 if self.inside else 1.0

    def gap(self, x: Float[Array, "3"]) -> Float[Array, ""]:
        distances = self._distances(*self._split(x))
        return self._sign * (distances[0] if self.length is None else outside_of(distances))

    def gap_between(self, before: Float[Array, "3"], after: Float[Array, "3"]) -> Float[Array, "3"]:
        ends = self._split(before), self._split(after)
        radial = size_between(ends[0][0], ends[1][0])
        if self.length is None:
            return self._sign * radial
        D = outside_between(*(self._distances(*end) for end in ends))
        along = size_between(ends[0][1][None], ends[1][1][None])
        return self._sign * (D[0] * radial + D[1] * along * unit(self.axis))

    def outline(self, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> Lines:
        point, axis = np.asarray(self.point), np.asarray(unit(self.axis))
        if self.length is None:
            middle = axis @ (0.5 * (low + high) - point)
            half = 0.5 * float(np.linalg.norm(high - low))
        else:
            middle, half = 0.0, 0.5 * float(self.length)
        ends = [point + (middle + side * half) * axis for side in (-1.0, 1.0)]
        rims = [circle(end, axis, float(self.radius)) for end in ends]
        return [*rims, *(np.stack([rims[0][k], rims[1][k]]) for k in range(0, len(rims[0]) - 1, 9))]

    def _split(self, x: Float[Array, "3"]) -> tuple[Float[Array, "3"], Float[Array, ""]]:
        """Away from the axis, and along it."""
        arm, axis = x - self.point, unit(self.axis)
        height = axis @ arm
        return arm - height * axis, height

    def _distances(self, away: Float[Array, "3"], height: Float[Array, ""]) -> Any:
        """From the round side and from the nearer end."""
        side = size(away) - self.radius
        return side[None] if self.length is None else jnp.stack([side, jnp.abs(height) - 0.5 * self.length])
