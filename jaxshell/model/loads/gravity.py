"""Gravity: a uniform acceleration field."""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Float

from jaxshell.model.history import History
from jaxshell.model.loads.base import DeadLoad, given_history
from jaxshell.numerics.checks import check_finite, check_shape, float_array


class Gravity(DeadLoad):
    """A uniform acceleration field, `acceleration` (3,) [length/time²]."""

    kind: ClassVar[str] = "gravity"
    value: ClassVar[str] = "acceleration"
    acts_on: ClassVar[str] = "shell"

    acceleration: Float[jax.Array, "3"]
    history: History

    def __init__(self, acceleration, history: History | None = None):
        self.acceleration = float_array(acceleration, "acceleration")
        self.history = given_history(history)

    def __check_init__(self):
        check_shape("acceleration", self.acceleration, (3,))
        check_finite("acceleration", self.acceleration)

    def nodal(self, x0, triangles, mass_per_area) -> Float[jax.Array, "n 6"]:
        """(n, 6) force and moment on each node for factor 1."""
        a, b, c = x0[triangles[:, 0]], x0[triangles[:, 1]], x0[triangles[:, 2]]
        area = 0.5 * jnp.linalg.norm(jnp.cross(b - a, c - a), axis=1)
        share = (mass_per_area * area / 3)[:, None] * self.acceleration[None]
        forces = jnp.zeros((x0.shape[0], 6))
        for corner in range(3):
            forces = forces.at[triangles[:, corner], :3].add(share)
        return forces

    def on_masses(self, mass: Float[jax.Array, " k"]) -> Float[jax.Array, "k 3"]:
        return mass[:, None] * self.acceleration
