"""Pressure that follows the deformed surface: forces, tangents, and the mean over a step that does exact work."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.contribution import Contribution, Place, Surface
from jaxshell.model.loads.base import OnElements, chosen
from jaxshell.numerics.frozen import Frozen
from jaxshell.numerics.rotations import skew


class Pressure(OnElements, Contribution):
    """A pressure that follows the deformed surface, positive along the elements' normals.

    Arguments:
        pressure: scalar, or (m,) one for each of the elements [force/length²], acting on the deformed area.
        history: how it varies in time; None is constant.
        elements: numbers of the elements that it acts on, or the name of a set; None is all.

    Raises ValueError for anything but finite numbers.
    """

    kind: ClassVar[str] = "pressure"

    def groups(self, triangles: np.ndarray) -> Frozen:
        return Frozen(chosen(self.elements, triangles))

    def data(self, surface: Surface) -> Float[Array, " m"]:
        """The pressure on every element that it acts on."""
        count = len(surface.triangles) if self.elements is None else len(self.elements.array)
        return jnp.broadcast_to(self.pressure, (count,))

    def force(self, data, place: Place) -> Float[Array, "3 6"]:
        return pressure_force(place.x, self.history(place.time) * data)

    def stiffness(self, data, place: Place) -> Float[Array, "18 18"]:
        return pressure_stiffness(place.x, self.history(place.time) * data)

    def mean_force(self, data, start: Place, end: Place) -> Float[Array, "3 6"]:
        """Of the mean pressure on the straight path of the nodes: a constant one does exactly p times the volume."""
        return mean_pressure_force(start.x, end.x - start.x, self._mean(data, start, end))

    def mean_stiffness(self, data, start: Place, end: Place) -> Float[Array, "18 18"]:
        return mean_pressure_stiffness(start.x, end.x - start.x, self._mean(data, start, end))

    def _mean(self, data, start: Place, end: Place) -> Float[Array, ""]:
        return 0.5 * (self.history(start.time) + self.history(end.time)) * data


def pressure_force(x: Float[Array, "3 3"], pressure) -> Float[Array, "3 6"]:
    """Nodal forces p A n/3 of a follower pressure on one deformed element; no moments."""
    normal = jnp.cross(x[1] - x[0], x[2] - x[0]) / 6.0
    return _on_each_node(pressure * normal)


def pressure_stiffness(x: Float[Array, "3 3"], pressure) -> Float[Array, "18 18"]:
    """Derivative of `pressure_force` by the nodal displacements (rotations do not enter)."""
    edges = jnp.stack([x[2] - x[1], x[0] - x[2], x[1] - x[0]])
    block = pressure / 6.0 * jax.vmap(skew)(edges)
    # n = (x2-x1)×(x3-x1)/6 changes by ~(opposite edge) δx_b, at every node alike.
    K = jnp.zeros((3, 2, 3, 3, 2, 3)).at[:, 0, :, :, 0, :].set(jnp.transpose(block, (1, 0, 2))[None])
    return K.reshape(18, 18)


def mean_pressure_force(x: Float[Array, "3 3"], moved: Float[Array, "3 3"], pressure) -> Float[Array, "3 6"]:
    """Follower pressure averaged over the straight path from x to x + moved: a constant one does exact work.

    The normal is quadratic along the path, so that Simpson's rule, a_m × b_m + Δa × Δb/12, is exact.
    """
    middle, change = _edges(x + 0.5 * moved), _edges(moved)
    normal = jnp.cross(middle[0], middle[1]) + jnp.cross(change[0], change[1]) / 12.0
    return _on_each_node(pressure / 6.0 * normal)


def mean_pressure_stiffness(x, moved, pressure) -> Float[Array, "18 18"]:
    """Derivative of `mean_pressure_force` by `moved`: that of the pressure at x + ⅔ moved, halved."""
    return pressure_stiffness(x + 2.0 / 3.0 * moved, 0.5 * pressure)


def _edges(x: Float[Array, "3 3"]) -> Float[Array, "2 3"]:
    return jnp.stack([x[1] - x[0], x[2] - x[0]])


def _on_each_node(force: Float[Array, "3"]) -> Float[Array, "3 6"]:
    return jnp.tile(jnp.concatenate([force, jnp.zeros(3)]), (3, 1))
