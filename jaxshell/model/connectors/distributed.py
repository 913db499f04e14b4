"""Distributed couplings (RBE3)."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.connectors.base import Connector
from jaxshell.model.connectors.joint import Conditions, held_by_conditions, named
from jaxshell.model.contribution import Contribution, Place
from jaxshell.model.mesh import Mesh
from jaxshell.model.sets import SetName, check_on_mesh, nodes_or_name
from jaxshell.numerics.checks import check_finite, float_array, is_concrete
from jaxshell.numerics.frozen import Frozen

_THIN = 1e-3
"""Nodes whose second extent is less than this part of the first lie on a line, about which they hold no rotation."""


class Distributed(Connector):
    """A reference that moves with the mean of nodes (RBE3): forces and moments at it are distributed over them.

    Arguments:
        nodes: node indices, or the name of a set; three or more that are not on a line.
        reference: a node, the name of a set that holds it alone, or a point (3,), which becomes a node of the scene's
            mesh with the coupling's `name` as its set.
        weights: of the nodes, (k,), positive; None is equal ones. Differentiable.
        name: the set of the reference.

    The nodes stay free to move against each other, unlike those of a `RigidBody`. With r the arms from their weighted
    mean, the reference's rotation R fits them best (least squares), Σ w (R r) × x = 0, and it stands at x̄ + R r of its
    own arm. Enforced by multipliers: exact at the ends of steps. It does no work and keeps the momenta
    (`EnergyMomentum`). Raises ValueError for nodes on a line.
    """

    kind: ClassVar[str] = "distributed"
    sets: ClassVar[dict[str, str]] = {"nodes": "node", "reference": "node"}

    nodes: Frozen | SetName = eqx.field(static=True)
    reference: Frozen | SetName | None = eqx.field(static=True)
    weights: Float[jax.Array, " k"] | None
    point: Float[jax.Array, "3"] | None

    def __init__(self, nodes, reference=None, weights=None, name: str | None = None, point=None):
        self.nodes = nodes_or_name("distributed nodes", nodes)
        self.reference, place = reference_of(reference, "A distributed coupling")
        self.weights = None if weights is None else float_array(weights, "distributed weights")
        self.point = place if point is None else float_array(point, "distributed point")
        self.name = named(self.kind, name)

    def __check_init__(self):
        if self.weights is not None:
            check_finite("distributed weights", self.weights)
            if is_concrete(self.weights) and np.any(np.asarray(self.weights) <= 0):
                raise ValueError("distributed weights must be positive.")

    def placed(self, mesh: Mesh, number: int) -> tuple[Connector, Mesh]:
        item, mesh = super().placed(mesh, number)
        assert isinstance(item, Distributed)
        if item.reference is None:
            name = f"distributed {number}" if self.name is None else self.name
            place = mesh.nodes[item.nodes.array].mean(axis=0) if self.point is None else self.point
            mesh = mesh.with_points({name: place})
            item = Distributed(item.nodes, mesh.n_nodes - 1, self.weights, name)
        return item, mesh

    def check(self, mesh: Mesh) -> None:
        check_on_mesh("distributed", "node", np.concatenate([self.nodes.array, self._reference]), mesh.n_nodes)
        if self._reference[0] in self.nodes.array:
            raise ValueError(f"The reference, node {self._reference[0]}, is one of the nodes that it is the mean of.")
        if self.weights is not None and self.weights.shape != self.nodes.array.shape:
            raise ValueError(f"weights must be {len(self.nodes.array)}, but have shape {self.weights.shape}.")
        if is_concrete(mesh.nodes):
            x = np.asarray(mesh.nodes)[self.nodes.array]
            extent = np.linalg.svd(x - x.mean(axis=0), compute_uv=False)
            if len(extent) < 2 or extent[1] <= _THIN * extent[0]:
                raise ValueError("Nodes on a line hold no rotation about it: take three that are not, or a RigidBody.")

    @property
    def _reference(self) -> np.ndarray:
        assert self.reference is not None
        return self.reference.array

    @property
    def turning(self) -> np.ndarray:
        return self._reference

    def holds(self, mesh: Mesh) -> list[tuple[np.ndarray, np.ndarray]]:
        return held_by_conditions(self, mesh)

    def parts(self) -> tuple[Contribution, ...]:
        k = len(self.nodes.array)
        weights = jnp.ones(k) if self.weights is None else self.weights
        return (MeanMotion(Frozen(np.concatenate([self._reference, self.nodes.array])[None]), weights),)


class MeanMotion(Conditions):
    """A first node that moves with the mean of the others."""

    weights: Float[jax.Array, " k"]

    @property
    def count(self) -> int:
        return 6

    def data(self, surface):
        """Weights, arms of the nodes and of the reference, and what makes lengths of the moments."""
        x, weights = surface.x0[self.nodes.array[0]], self.weights / jnp.sum(self.weights)
        centre = weights @ x[1:]
        arms = x[1:] - centre
        radius = jnp.sqrt(jnp.sum(weights * jnp.sum(arms * arms, axis=1)))
        return jax.tree.map(lambda a: a[None], (weights, arms, x[0] - centre, jax.lax.stop_gradient(radius)))

    def conditions(self, data, place: Place) -> Float[Array, "6"]:
        weights, arms, own, radius = data
        x, R = place.x[1:], place.R[0]
        apart = place.x[0] - R @ own - weights @ x
        turned = weights @ jnp.cross(arms, x @ R) / radius  # along the reference's axes, as `twist`
        return jnp.concatenate([apart, turned])


def reference_of(given, what: str) -> tuple[Frozen | SetName | None, jax.Array | None]:
    """(node, place) of a reference, one of them None or both. Raises ValueError for what is neither."""
    if given is None:
        return None, None
    if isinstance(given, str | Frozen) or np.size(given) == 1:
        return nodes_or_name(f"{what}'s reference", given), None
    place = float_array(given, f"{what}'s reference")
    if place.shape != (3,):
        raise ValueError(f"{what}'s reference is a node or a point (3,), but has shape {place.shape}.")
    return None, place
