"""A point force along the surface's normal, with which it turns."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.model.contribution import Surface
from jaxshell.model.history import History
from jaxshell.model.loads.base import given_history
from jaxshell.model.loads.follower_force import TurningForce, normals_before
from jaxshell.model.mesh import Mesh
from jaxshell.model.normals import check_normals
from jaxshell.model.sets import SetName, nodes_or_name, size_of
from jaxshell.numerics.checks import check_finite, float_array
from jaxshell.numerics.frozen import Frozen


class NormalForce(TurningForce):
    """Forces on nodes along the shell's normal, which turn with the nodes, as a thruster's does.

    Arguments:
        nodes: node indices, or the name of a set.
        magnitude: one value for each of the nodes, or (k,) [force]; positive along the elements' normals.
            Differentiable.
        history: how it varies in time; None is constant.

    The normal of a node is the mean of its elements' in the stress-free shape, weighted by area; it turns with the
    node. The force has no potential, and its work counts as external work: `EnergyMomentum` changes the energy by
    exactly that of the mean of the forces at the ends of a step. Raises ValueError for NaN, for another number of
    values than nodes, and where the surface has no normal.
    """

    kind: ClassVar[str] = "normal force"
    value: ClassVar[str] = "magnitude"

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

    def check(self, mesh: Mesh) -> None:
        check_normals(mesh.nodes, mesh.triangles, self.nodes.array)

    def data(self, surface: Surface) -> Float[Array, "k 3"]:
        normals = normals_before(surface, self.nodes)
        return jnp.broadcast_to(self.magnitude, normals.shape[:1])[:, None] * normals
