"""Ties of nodes to edges of another mesh."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.connectors.base import Connector
from jaxshell.model.connectors.joint import Conditions, held_by_conditions, named, twist
from jaxshell.model.contribution import Contribution, Place
from jaxshell.model.mesh import Mesh
from jaxshell.model.sets import SetName, check_on_mesh, nodes_or_name
from jaxshell.numerics.checks import check_shape, is_concrete, whole_array
from jaxshell.numerics.frozen import Frozen

_FAR = 0.5
"""A node further from every edge than this part of the nearest one's length is not meant to be tied to it."""


class EdgeTie(Connector):
    """Nodes tied to edges, where the meshes of two parts do not match.

    Arguments:
        nodes: those that are tied, or the name of a set. Each goes with the nearest of the edges.
        edges: (k, 2) node indices of the edges' ends, or the name of a set of sides.
        rotations: whether the nodes turn with the edges too; False makes a hinge of them.
        name: what watches call it.

    A node stays where it is on its edge, x_s = Σ w_k (x_k + R_k r) with the offset r that it has at the start and the
    weights w_k of its place between the ends, and turns with the (chordal) mean of the ends' rotations. Enforced by
    multipliers: exact at the ends of steps. It does no work and keeps the momenta (`EnergyMomentum`). Raises ValueError
    for a node that is an end of its edge, and for one that is far from all of them.
    """

    kind: ClassVar[str] = "edge tie"
    sets: ClassVar[dict[str, str]] = {"nodes": "node", "edges": "side"}

    nodes: Frozen | SetName = eqx.field(static=True)
    edges: Frozen | SetName = eqx.field(static=True)
    rotations: bool = eqx.field(static=True)

    def __init__(self, nodes, edges, rotations: bool = True, name: str | None = None):
        self.nodes = nodes_or_name("edge tie nodes", nodes)
        if isinstance(edges, str):
            self.edges = SetName(edges)
        else:
            edges = getattr(edges, "array", edges)
            self.edges = Frozen(whole_array("edge tie edges", edges, "pairs of node indices"))
            check_shape("edge tie edges", self.edges.array, (None, 2))
        self.rotations = bool(rotations)
        self.name = named(self.kind, name)

    def placed(self, mesh: Mesh, number: int) -> tuple[Connector, Mesh]:
        """With one edge for each node, the nearest."""
        item, _ = super().placed(mesh, number)
        assert isinstance(item, EdgeTie)
        check_on_mesh("edge tie", "node", np.concatenate([item.nodes.array, item.edges.array.ravel()]), mesh.n_nodes)
        if not is_concrete(mesh.nodes):
            if len(item.edges.array) != len(item.nodes.array):
                raise ValueError("An edge tie chooses its edges by known places: make the scene outside of jax.grad.")
            return item, mesh
        x = np.asarray(mesh.nodes)
        start, end = x[item.edges.array[:, 0]], x[item.edges.array[:, 1]]
        along = end - start
        point = x[item.nodes.array][:, None]
        part = np.clip(np.sum((point - start) * along, axis=2) / np.sum(along * along, axis=1), 0.0, 1.0)
        apart = np.linalg.norm(start + part[..., None] * along - point, axis=2)
        nearest = np.argmin(apart, axis=1)
        for k, (node, edge) in enumerate(zip(item.nodes.array, nearest, strict=True)):
            ends = item.edges.array[edge]
            if node in ends:
                raise ValueError(f"Node {node} is an end of the edge {ends.tolist()} that it would be tied to.")
            if apart[k, edge] > _FAR * np.linalg.norm(along[edge]):
                raise ValueError(
                    f"Node {node} is {apart[k, edge]:.4g} from the nearest edge, {ends.tolist()}: it is no part of it."
                )
        return EdgeTie(item.nodes, item.edges.array[nearest], item.rotations, item.name), mesh

    @property
    def turning(self) -> np.ndarray:
        return np.concatenate([self.nodes.array, self.edges.array.ravel()])

    def holds(self, mesh: Mesh) -> list[tuple[np.ndarray, np.ndarray]]:
        return held_by_conditions(self, mesh)

    def parts(self) -> tuple[Contribution, ...]:
        groups = Frozen(np.concatenate([self.nodes.array[:, None], self.edges.array], axis=1))
        return (OnEdge(groups), WithEdge(groups)) if self.rotations else (OnEdge(groups),)


class OnEdge(Conditions):
    """A node that stays at its place on an edge; groups are the node and the ends."""

    @property
    def count(self) -> int:
        return 3

    def data(self, surface) -> tuple[Float[Array, "k 2"], Float[Array, "k 3"]]:
        weights = weights_on(surface.x0[self.nodes.array])
        x = surface.x0[self.nodes.array]
        return weights, x[:, 0] - jnp.einsum("ke,kei->ki", weights, x[:, 1:])

    def conditions(self, data, place: Place) -> Float[Array, "3"]:
        weights, offset = data
        return place.x[0] - weights @ (place.x[1:] + place.R[1:] @ offset)


class WithEdge(Conditions):
    """A node that turns with the mean of an edge's ends."""

    @property
    def count(self) -> int:
        return 3

    def data(self, surface) -> tuple[Float[Array, "k 2"], Float[Array, " k"]]:
        weights = weights_on(surface.x0[self.nodes.array])
        return weights, jnp.broadcast_to(surface.size, weights.shape[:1])

    def conditions(self, data, place: Place) -> Float[Array, "3"]:
        weights, size = data
        return size * (weights[0] * twist(place.R[1], place.R[0]) + weights[1] * twist(place.R[2], place.R[0]))


def weights_on(x: Float[Array, "k 3 3"]) -> Float[Array, "k 2"]:
    """Of the ends (1, 2) of edges, for the place of the nodes 0 between them."""
    along = x[:, 2] - x[:, 1]
    part = jnp.sum((x[:, 0] - x[:, 1]) * along, axis=1) / jnp.sum(along * along, axis=1)
    part = jnp.clip(part, 0.0, 1.0)
    return jnp.stack([1.0 - part, part], axis=1)
