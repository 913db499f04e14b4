"""Point forces that turn with their nodes: a force in axes that are attached to the material."""

import abc
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.contribution import Contribution, Place, Surface
from jaxshell.model.history import History
from jaxshell.model.loads.base import Load, check_vectors, given_history
from jaxshell.model.mesh import Mesh
from jaxshell.model.normals import area_vectors, check_normals, summed_normals
from jaxshell.model.sets import SetName, nodes_or_name, size_of
from jaxshell.numerics.checks import float_array, is_concrete
from jaxshell.numerics.frozen import Frozen
from jaxshell.numerics.rotations import skew

_NORMAL = 1e-6
"""A direction whose part in the surface is a smaller fraction of it is normal to the surface."""


class TurningForce(Load, Contribution):
    """Forces on nodes that turn with them, f = R f₀; a subclass states f₀, the forces before the shell moves (`data`).

    They have no potential, and their work counts as external work: `EnergyMomentum` changes the energy by exactly that
    of the mean of the forces at the ends of a step, which is second order.
    """

    sets: ClassVar[dict[str, str]] = {"nodes": "node"}

    nodes: eqx.AbstractVar[Frozen | SetName]

    def groups(self, triangles: np.ndarray) -> Frozen:
        return Frozen(self.nodes.array[:, None])

    @abc.abstractmethod
    def data(self, surface: Surface) -> Float[Array, "k 3"]:
        """The forces before the shell moves."""

    def force(self, data, place: Place) -> Float[Array, "1 6"]:
        turned = self.history(place.time) * (place.R[0] @ data)
        return jnp.concatenate([turned, jnp.zeros(3)])[None]

    def stiffness(self, data, place: Place) -> Float[Array, "6 6"]:
        """δf = δω × f."""
        return jnp.zeros((6, 6)).at[:3, 3:].set(-skew(self.force(data, place)[0, :3]))


class FollowerForce(TurningForce):
    """Forces on nodes with any direction, which turn with the nodes, as that of a jet that is bolted on.

    Arguments:
        nodes: node indices, or the name of a set.
        components: (3,) for each of the nodes, or (k, 3) [force]: the force before the shell moves, along the global
            axes; or, where a `direction` is given, along the axes of the surface at the node: the direction, what is at
            right angles to it in the surface (normal × direction), and the normal.
        history: how it varies in time; None is constant.
        direction: (3,) or (k, 3), of any length; its projection onto the surface at the node is the first axis there.

    The normal of a node is the mean of its elements' in the stress-free shape, weighted by area. Differentiable in
    components and direction. The force has no potential, and its work counts as external work: `EnergyMomentum` changes
    the energy by exactly that of the mean of the forces at the ends of a step. Raises ValueError for NaN, for another
    number of values than nodes, and where a direction is normal to the surface or the surface has no normal.
    """

    kind: ClassVar[str] = "follower force"
    value: ClassVar[str] = "components"

    nodes: Frozen | SetName = eqx.field(static=True)
    components: Float[jax.Array, "*k 3"]
    history: History
    direction: Float[jax.Array, "*k 3"] | None

    def __init__(self, nodes, components, history: History | None = None, direction=None):
        self.nodes = nodes_or_name("follower force nodes", nodes)
        self.components = float_array(components, "follower force")
        self.history = given_history(history)
        self.direction = None if direction is None else float_array(direction, "direction")

    def __check_init__(self):
        check_vectors("follower force", self.components, size_of(self.nodes))
        if self.direction is not None:
            check_vectors("direction", self.direction, size_of(self.nodes))

    def check(self, mesh: Mesh) -> None:
        if self.direction is None:
            return
        nodes = self.nodes.array
        check_normals(mesh.nodes, mesh.triangles, nodes)
        if not (is_concrete(mesh.nodes) and is_concrete(self.direction)):
            return
        normals = np.asarray(summed_normals(area_vectors(mesh.nodes, mesh.triangles), mesh.triangles, mesh.n_nodes))
        directions = np.broadcast_to(np.asarray(self.direction), (len(nodes), 3))
        sizes = np.linalg.norm(directions, axis=1) * np.linalg.norm(normals[nodes], axis=1)
        bad = ~(np.linalg.norm(np.cross(normals[nodes], directions), axis=1) > _NORMAL * sizes)
        if bad.any():
            which = int(np.argmax(bad))
            raise ValueError(
                f"The direction {directions[which].tolist()} is normal to the surface at node {nodes[which]}, where it "
                "says no axis in the surface: choose another there, as (k, 3), one for each node."
            )

    def data(self, surface: Surface) -> Float[Array, "k 3"]:
        given = jnp.broadcast_to(self.components, (len(self.nodes.array), 3))
        if self.direction is None:
            return given
        normals = normals_before(surface, self.nodes)
        along = jnp.broadcast_to(self.direction, given.shape)
        along = along - jnp.sum(along * normals, axis=1, keepdims=True) * normals
        along = along / jnp.linalg.norm(along, axis=1, keepdims=True)
        return given[:, :1] * along + given[:, 1:2] * jnp.cross(normals, along) + given[:, 2:] * normals


def normals_before(surface: Surface, nodes: Frozen | SetName) -> Float[Array, "k 3"]:
    """The normals of nodes before the shell moves."""
    vectors = surface.area[:, None] * surface.normals
    chosen = summed_normals(vectors, surface.triangles, len(surface.x0))[nodes.array]
    return chosen / jnp.linalg.norm(chosen, axis=1, keepdims=True)
