"""A point force along the surface's normal, with which it turns."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.contribution import Contribution, Place, Surface
from jaxshell.model.history import History
from jaxshell.model.loads.base import Load, given_history
from jaxshell.model.sets import SetName, nodes_or_name, size_of
from jaxshell.numerics.checks import check_finite, float_array
from jaxshell.numerics.frozen import Frozen
from jaxshell.numerics.rotations import skew


class NormalForce(Load, Contribution):
    """Forces on nodes along the shell's normal, which turn with the nodes, as a thruster's does.

    Arguments:
        nodes: node indices, or the name of a set.
        magnitude: one value for each of the nodes, or (k,) [force]; positive along the elements' normals.
            Differentiable.
        history: how it varies in time; None is constant.

    The normal of a node is the mean of its elements' in the stress-free shape, weighted by area; it turns with the
    node. The force has no potential, and its work counts as external work: `EnergyMomentum` changes the energy by
    exactly that of the mean of the forces at the ends of a step. Raises ValueError for NaN and for another number of
    values than nodes.
    """

    kind: ClassVar[str] = "normal force"
    value: ClassVar[str] = "magnitude"

    sets: ClassVar[dict[str, str]] = {"nodes": "node"}

    nodes: Frozen | SetName = eqx.field(static=True)
    magnitude: Float[jax.Array, "*k"]
    history: History

    def __init__(self, nodes, magnitude, history: History | None = None):
        self.nodes = nodes_or_name("normal force nodes", nodes)
        self.magnitude = float_array(magnitude, "normal force")
        self.history = given_history(history)

    def __check_init__(self):
        check_finite("normal force", self.magnitude)
        count = size_of(self.nodes)
        if self.magnitude.shape not in ((), (count,)) and (count is not None or self.magnitude.ndim != 1):
            raise ValueError(f"magnitude must be one value or {count}, but has shape {self.magnitude.shape}.")

    def groups(self, triangles: np.ndarray) -> Frozen:
        return Frozen(self.nodes.array[:, None])

    def data(self, surface: Surface) -> Float[Array, "k 3"]:
        """The forces before the shell moves."""
        normals = jnp.zeros_like(surface.x0)
        for corner in range(3):
            normals = normals.at[surface.triangles[:, corner]].add(surface.area[:, None] * surface.normals)
        chosen = normals[self.nodes.array]
        return jnp.broadcast_to(self.magnitude, chosen.shape[:1])[:, None] * (
            chosen / jnp.linalg.norm(chosen, axis=1, keepdims=True)
        )

    def force(self, data, place: Place) -> Float[Array, "1 6"]:
        turned = self.history(place.time) * (place.R[0] @ data)
        return jnp.concatenate([turned, jnp.zeros(3)])[None]

    def stiffness(self, data, place: Place) -> Float[Array, "6 6"]:
        """δf = δω × f."""
        return jnp.zeros((6, 6)).at[:3, 3:].set(-skew(self.force(data, place)[0, :3]))
