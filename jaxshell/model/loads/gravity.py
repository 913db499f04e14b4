"""Gravity: a uniform acceleration field."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxshell.model.contribution import Contribution, Place, Surface
from jaxshell.model.history import History
from jaxshell.model.loads.base import DeadLoad, chosen, given_history, number_of_elements, on_corners
from jaxshell.model.mesh import Mesh
from jaxshell.model.sets import SetName, elements_or_name
from jaxshell.numerics.checks import check_finite, check_shape, float_array
from jaxshell.numerics.frozen import Frozen


class Gravity(DeadLoad):
    """A uniform acceleration field.

    Arguments:
        acceleration: (3,) [length/time²]. Differentiable.
        history: how it varies in time; None is constant.
        elements: numbers of the elements whose mass it acts on, or the name of a set; None is all of the shell, and
            point masses and rigid bodies.

    Its potential is not recorded: its work counts as external work. Raises ValueError for NaN and other shapes.
    """

    kind: ClassVar[str] = "gravity"
    value: ClassVar[str] = "acceleration"
    acts_on: ClassVar[str] = "shell"
    sets: ClassVar[dict[str, str]] = {"elements": "element"}

    acceleration: Float[jax.Array, "3"]
    history: History
    elements: Frozen | SetName | None = eqx.field(static=True)

    def __init__(self, acceleration, history: History | None = None, elements=None):
        self.acceleration = float_array(acceleration, "acceleration")
        self.history = given_history(history)
        self.elements = elements_or_name(elements)

    def __check_init__(self):
        check_shape("acceleration", self.acceleration, (3,))
        check_finite("acceleration", self.acceleration)

    def check(self, mesh: Mesh) -> None:
        number_of_elements(self.elements, mesh)

    def nodal(self, x0, triangles, mass_per_area) -> Float[jax.Array, "n 6"]:
        """(n, 6) force and moment on each node for factor 1."""
        triangles, mass_per_area = chosen(self.elements, triangles), chosen(self.elements, mass_per_area)
        a, b, c = x0[triangles[:, 0]], x0[triangles[:, 1]], x0[triangles[:, 2]]
        area = 0.5 * jnp.linalg.norm(jnp.cross(b - a, c - a), axis=1)
        return on_corners((mass_per_area * area / 3)[:, None] * self.acceleration[None], triangles, x0.shape[0])

    def on_bending(self) -> "GravityMoments":
        return GravityMoments(self.acceleration, self.history, self.elements)

    def on_masses(self, mass: Float[jax.Array, " k"]) -> Float[jax.Array, "k 3"] | None:
        return mass[:, None] * self.acceleration if self.elements is None else None


class GravityMoments(Contribution):
    """The moments that gravity adds where positions follow the nodes' rotations (`jaxshell.elements.cubic_inertia`).

    With the forces of `Gravity.nodal` these are the forces on the mass as it moves, so that a free shell falls without
    bending. Their potential is linear in the rotations, and their work over a step exactly its change.
    """

    acceleration: Float[jax.Array, "3"]
    history: History
    elements: Frozen | SetName | None = eqx.field(static=True)

    def groups(self, triangles: np.ndarray) -> Frozen:
        return Frozen(triangles)

    def data(self, surface: Surface):
        """The levers (corner, 3) of every element; zero where it does not act."""
        if self.elements is None:
            return surface.levers
        on = np.zeros(len(surface.triangles), bool)
        on[chosen(self.elements, np.arange(len(on)))] = True
        return jnp.where(on[:, None, None], surface.levers, 0.0)

    def force(self, data, place: Place) -> Float[jax.Array, "3 6"]:
        arms = jnp.einsum("aij,aj->ai", place.R, data)
        moments = jnp.cross(arms, self.history(place.time) * self.acceleration)
        return jnp.concatenate([jnp.zeros((3, 3)), moments], axis=1)
