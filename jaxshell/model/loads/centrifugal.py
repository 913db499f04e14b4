"""Centrifugal forces: a shell at rest in axes that spin."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.contribution import Contribution, Place, Surface
from jaxshell.model.history import History
from jaxshell.model.loads.base import Load, given_history
from jaxshell.model.masses import Masses, euler_tensor
from jaxshell.numerics.checks import check_finite, check_shape, float_array
from jaxshell.numerics.frozen import Frozen
from jaxshell.numerics.triangles import LINEAR_MASS


class Centrifugal(Load, Contribution):
    """The scene is seen from axes that spin: all that has mass is pushed away from their axis.

    Arguments:
        spin: (3,) angular velocity of the axes [rad/time]. Differentiable.
        centre: (3,) a point of the axis; None is the origin. Differentiable.
        history: of the forces, which go with the square of the spin; None is constant.

    For statics (the load factor f means a spin of √f times `spin`) and for `natural_frequencies` about what that finds,
    which adds what turns moving masses aside (gyroscopic forces). A run in time would need them too: `simulate` refuses
    this load; drive the hub there (`Support(rotation=...)`). Forces are those of the consistent mass -∫ρ ω × (ω × x)
    at the deformed places, directors, point masses and rigid bodies included. Raises ValueError for NaN and other
    shapes.
    """

    kind: ClassVar[str] = "centrifugal"
    value: ClassVar[str] = "spin"
    acts_on: ClassVar[str] = "shell"
    in_time: ClassVar[bool] = False

    spin: Float[jax.Array, "3"]
    centre: Float[jax.Array, "3"]
    history: History

    def __init__(self, spin, centre=None, history: History | None = None):
        self.spin = float_array(spin, "spin")
        self.centre = jnp.zeros(3) if centre is None else float_array(centre, "centre")
        self.history = given_history(history)

    def __check_init__(self):
        for name in ("spin", "centre"):
            check_shape(name, getattr(self, name), (3,))
            check_finite(name, getattr(self, name))

    def groups(self, triangles: np.ndarray) -> Frozen:
        return Frozen(triangles)

    def data(self, surface: Surface) -> Any:
        """Area times ∫ρ zᵏ dz, k = 0, 1, 2, and the normals."""
        first = jnp.zeros_like(surface.area) if surface.first_moment is None else surface.first_moment
        moments = jnp.stack([surface.mass_per_area, first, surface.rotary_inertia], axis=1)
        return surface.area[:, None] * moments, surface.normals

    def force(self, data, place: Place) -> Float[Array, "3 6"]:
        moments, normal = data
        zeroth, first, second = moments
        mass, t = jnp.asarray(LINEAR_MASS), place.R @ normal
        pushed = self.history(place.time) * mass @ self._away(place.x - self.centre)
        tilted = self.history(place.time) * mass @ self._away(t)
        moment = jnp.cross(t, first * pushed + second * tilted)
        return jnp.concatenate([zeroth * pushed + first * tilted, moment], axis=1)

    def on_masses_of(self, masses: Masses) -> Contribution:
        """What it does to point masses."""
        return CentrifugalMasses(self.spin, self.centre, self.history, masses)

    def _away(self, arms: Float[Array, "c 3"]) -> Float[Array, "c 3"]:
        return away(self.spin, arms)


class CentrifugalMasses(Contribution):
    """Centrifugal forces and moments of point masses; groups are single nodes, one for every mass and tensor."""

    spin: Float[jax.Array, "3"]
    centre: Float[jax.Array, "3"]
    history: History
    masses: Masses

    def groups(self, triangles: np.ndarray) -> Frozen:
        return Frozen(np.concatenate([self.masses.nodes.array, self.masses.turning.array])[:, None])

    def data(self, surface: Surface) -> Any:
        """Masses and Euler's tensors ½ tr(J) I - J, zeros where a group is of the other."""
        k, r = len(self.masses.mass), len(self.masses.inertia)
        mass = jnp.concatenate([self.masses.mass, jnp.zeros(r)])
        return mass, jnp.concatenate([jnp.zeros((k, 3, 3)), euler_tensor(self.masses.inertia)])

    def force(self, data, place: Place) -> Float[Array, "1 6"]:
        mass, euler = data
        columns = place.R[0].T
        pushed = mass * away(self.spin, place.x[0] - self.centre)
        moment = jnp.sum(jnp.cross(columns, euler @ away(self.spin, columns)), axis=0)
        return self.history(place.time) * jnp.concatenate([pushed, moment])[None]


def away(spin: Float[Array, "3"], arms: Float[Array, "*c 3"]) -> Float[Array, "*c 3"]:
    """-ω × (ω × r)."""
    return -jnp.cross(spin, jnp.cross(spin, arms))
