"""The pressure of a liquid at rest on the deformed surface, below a level that may rise and fall."""

import dataclasses
import math
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.contribution import Contribution, Place, Surface
from jaxshell.model.history import History
from jaxshell.model.loads.base import Load, chosen, given_history, number_of_elements
from jaxshell.model.mesh import Mesh
from jaxshell.model.normals import area_vectors
from jaxshell.model.sets import SetName, elements_or_name
from jaxshell.numerics.checks import check_finite, check_shape, float_array, is_concrete
from jaxshell.numerics.frozen import Frozen
from jaxshell.numerics.rotations import skew

_SHARES = (np.ones((3, 3)) + np.eye(3)) / 12.0
"""∫ N_a N_b dA over the area of an element."""
_GAUSS = (0.5 - math.sqrt(3.0) / 6.0, 0.5 + math.sqrt(3.0) / 6.0)
"""Two points, each of weight ½: exact for what is cubic along a step."""


class HydrostaticPressure(Load, Contribution):
    """The pressure p = γ (level - up·x) of a liquid on the deformed surface, and zero above the level.

    Arguments:
        weight: γ = ρg, the liquid's weight per volume [force/length³]. Positive pushes along the elements' normals: the
            liquid is on the side from which they point away, as inside a tank with normals outwards. Around a hull with
            normals outwards it is negative.
        level: the height of the free surface along `up` [length], or a `History` whose values are the heights.
        history: a factor of the weight in time; None is 1 from the start.
        elements: numbers of the elements that are wetted, or the name of a set; None is all.
        up: (3,) against gravity, of any length.

    Differentiable in weight, level and up. The pressure is taken at the nodes, and is linear between them in an
    element: exact where all of it is wet, of second order in the size of those that the free surface crosses. While a
    node passes the surface the stiffness jumps, not the force.

    `EnergyMomentum` takes the mean of the force on the straight paths of the nodes. While factor and level stand still
    and no element crosses the surface, its work is exactly the change of ∫ p dV over the volume swept, the liquid's
    potential; else it is of second order. It counts as external work in both cases. In statics, where the load factor
    scales the weight, a `level` that is a history is that of its end. Raises ValueError for NaN, other shapes, and an
    `up` of no length.
    """

    kind: ClassVar[str] = "hydrostatic pressure"
    value: ClassVar[str] = "weight"
    acts_on: ClassVar[str] = "shell"
    sets: ClassVar[dict[str, str]] = {"elements": "element"}

    weight: Float[jax.Array, ""]
    level: Float[jax.Array, ""] | History
    history: History
    elements: Frozen | SetName | None = eqx.field(static=True)
    up: Float[jax.Array, "3"]

    def __init__(self, weight, level, history: History | None = None, elements=None, up=(0.0, 0.0, 1.0)):
        self.weight = float_array(weight, "weight")
        self.level = level if isinstance(level, History) else float_array(level, "level")
        self.history = given_history(history)
        self.elements = elements_or_name(elements)
        self.up = float_array(up, "up")

    def __check_init__(self):
        shapes = {"weight": (), "level": (), "up": (3,)}
        for name, shape in shapes.items():
            if not isinstance(getattr(self, name), History):
                check_shape(name, getattr(self, name), shape)
                check_finite(name, getattr(self, name))
        if is_concrete(self.up) and not np.any(np.asarray(self.up)):
            raise ValueError("up must have a length, but it is [0, 0, 0].")

    def check(self, mesh: Mesh) -> None:
        number_of_elements(self.elements, mesh)

    def for_statics(self) -> "HydrostaticPressure":
        if not isinstance(self.level, History):
            return self
        return dataclasses.replace(self, level=self.level.values[-1])

    def groups(self, triangles: np.ndarray) -> Frozen:
        return Frozen(chosen(self.elements, triangles))

    def data(self, surface: Surface) -> Float[Array, " m"]:
        """The weight on every element that it acts on."""
        count = len(surface.triangles) if self.elements is None else len(self.elements.array)
        return jnp.broadcast_to(self.weight, (count,))

    def force(self, data, place: Place) -> Float[Array, "3 6"]:
        return _force(place.x, self.history(place.time) * data, self._depths(place.x, self._level(place.time)))

    def stiffness(self, data, place: Place) -> Float[Array, "18 18"]:
        weight = self.history(place.time) * data
        return _stiffness(place.x, weight, self._depths(place.x, self._level(place.time)), self._unit_up())

    def mean_force(self, data, start: Place, end: Place) -> Float[Array, "3 6"]:
        """On the straight path of the nodes."""
        weight = self._mean(data, start, end)
        return sum((0.5 * _force(x, weight, depths) for _, x, depths in self._path(start, end)), jnp.zeros((3, 6)))

    def mean_stiffness(self, data, start: Place, end: Place) -> Float[Array, "18 18"]:
        weight, up = self._mean(data, start, end), self._unit_up()
        parts = (0.5 * along * _stiffness(x, weight, depths, up) for along, x, depths in self._path(start, end))
        return sum(parts, jnp.zeros((18, 18)))

    def _mean(self, data, start: Place, end: Place) -> Float[Array, ""]:
        return 0.5 * (self.history(start.time) + self.history(end.time)) * data

    def _path(self, start: Place, end: Place):
        """At two points of the way: how far along, the nodes' places (3, 3) and their depths (3,)."""
        levels = self._level(start.time), self._level(end.time)
        for along in _GAUSS:
            x = start.x + along * (end.x - start.x)
            yield along, x, self._depths(x, levels[0] + along * (levels[1] - levels[0]))

    def _level(self, time) -> Float[Array, ""]:
        return self.level(time) if isinstance(self.level, History) else self.level

    def _unit_up(self) -> Float[Array, "3"]:
        return self.up / jnp.linalg.norm(self.up)

    def _depths(self, x: Float[Array, "3 3"], level) -> Float[Array, "3"]:
        return level - x @ self._unit_up()


def _force(x: Float[Array, "3 3"], weight, depths: Float[Array, "3"]) -> Float[Array, "3 6"]:
    """∫ N_a p dA n on the nodes of one deformed element, p linear between the nodes; no moments."""
    pressures = weight * jnp.where(depths > 0, depths, 0.0)
    area = area_vectors(x, np.array([[0, 1, 2]]))[0]
    return jnp.zeros((3, 6)).at[:, :3].set((jnp.asarray(_SHARES) @ pressures)[:, None] * area)


def _stiffness(x: Float[Array, "3 3"], weight, depths: Float[Array, "3"], up) -> Float[Array, "18 18"]:
    """Derivative of `_force` by the nodal displacements (rotations do not enter)."""
    shares, wet = jnp.asarray(_SHARES), depths > 0
    pressures = weight * jnp.where(wet, depths, 0.0)
    edges = jnp.stack([x[2] - x[1], x[0] - x[2], x[1] - x[0]])
    # A n changes by ½ ~(opposite edge) δx_b, and the pressure at b by -γ up·δx_b where it is wet.
    turned = (shares @ pressures)[:, None, None, None] * 0.5 * jax.vmap(skew)(edges)[None]
    area = area_vectors(x, np.array([[0, 1, 2]]))[0]
    sunk = (shares * jnp.where(wet, -weight, 0.0))[:, :, None, None] * (area[:, None] * up[None, :])
    K = jnp.zeros((3, 2, 3, 3, 2, 3)).at[:, 0, :, :, 0, :].set(jnp.transpose(turned + sunk, (0, 2, 1, 3)))
    return K.reshape(18, 18)
