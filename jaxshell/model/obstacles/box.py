"""A box, solid inside."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.obstacles.base import Obstacle, check_vector, vector
from jaxshell.model.obstacles.distances import outside_between, outside_of, size_between
from jaxshell.model.obstacles.outlines import Lines, edges
from jaxshell.numerics.checks import check_finite, check_positive, check_shape, is_concrete, optional_floats


class Box(Obstacle):
    """A box: a table, a step, a block.

    Arguments:
        centre: (3,) [length].
        sizes: (3,) full lengths of its edges [length].
        axes: (3, 3) directions of its edges, one a row, at right angles; None is the global axes.

    By name those of every `Obstacle`. The gap is the distance from faces, edges and
    corners; inside it is that from the nearest face, which jumps in direction half-way between two: what penetrates as
    far as that is pushed out at the other side. Raises ValueError for sizes that are not positive, and for axes that
    are not of unit length and at right angles.
    """

    kind: ClassVar[str] = "box"

    centre: Float[jax.Array, "3"] = eqx.field(converter=vector("box centre"))
    sizes: Float[jax.Array, "3"] = eqx.field(converter=vector("box sizes"))
    axes: Float[jax.Array, "3 3"] | None = eqx.field(default=None, converter=optional_floats("box axes"))

    def __check_init__(self):
        check_vector("box centre", self.centre)
        check_shape("box sizes", self.sizes, (3,))
        check_positive("box sizes", self.sizes)
        if self.axes is None:
            return
        check_shape("box axes", self.axes, (3, 3))
        check_finite("box axes", self.axes)
        if is_concrete(self.axes):
            error = np.abs(np.asarray(self.axes) @ np.asarray(self.axes).T - np.eye(3)).max()
            if error > 1e-8:
                raise ValueError(
                    f"box axes must be of unit length and at right angles, but their products are off by {error:.2g}."
                )

    def gap(self, x: Float[Array, "3"]) -> Float[Array, ""]:
        return outside_of(self._distances(self._own(x)))

    def gap_between(self, before: Float[Array, "3"], after: Float[Array, "3"]) -> Float[Array, "3"]:
        ends = self._own(before), self._own(after)
        D = (
            outside_between(*map(self._distances, ends))
            * jax.vmap(size_between)(ends[0][:, None], ends[1][:, None])[:, 0]
        )
        return D if self.axes is None else D @ self.axes

    def outline(self, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> Lines:
        axes = np.eye(3) if self.axes is None else np.asarray(self.axes)
        return edges(self.centre, 0.5 * np.asarray(self.sizes)[:, None] * axes)

    def _own(self, x: Float[Array, "3"]) -> Float[Array, "3"]:
        """Coordinates along the edges, from the centre."""
        arm = x - self.centre
        return arm if self.axes is None else self.axes @ arm

    def _distances(self, y: Float[Array, "3"]) -> Float[Array, "3"]:
        """From the nearer of each two faces."""
        return jnp.abs(y) - 0.5 * self.sizes
