"""What joints between pairs of nodes have in common."""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.connectors.base import Connector
from jaxshell.model.contribution import Constraint, Place, Surface, gradient_between
from jaxshell.model.mesh import Mesh
from jaxshell.model.sets import SetName, check_on_mesh
from jaxshell.numerics.checks import check_text, is_concrete
from jaxshell.numerics.frozen import Frozen

_TOGETHER = 1e-6
"""Nodes no further apart than this part of the mesh's size are in one place."""


class Joint(Connector):
    """A joint between nodes `a` and `b`, one by one: indices, or names of sets."""

    sets: ClassVar[dict[str, str]] = {"a": "node", "b": "node"}
    joins_places: ClassVar[bool] = True
    """Whether the nodes of a pair must be in one place."""

    a: eqx.AbstractVar[Frozen | SetName]
    b: eqx.AbstractVar[Frozen | SetName]

    @property
    def pairs(self) -> Frozen:
        """(k, 2) nodes."""
        return Frozen(np.stack([self.a.array, self.b.array], axis=1))

    def check(self, mesh: Mesh) -> None:
        if len(self.a.array) != len(self.b.array):
            raise ValueError(
                f"A {self.kind} joins nodes one by one, but a has {len(self.a.array)} and b {len(self.b.array)}."
            )
        check_on_mesh(self.kind, "node", self.pairs.array.ravel(), mesh.n_nodes)
        same = self.a.array == self.b.array
        if same.any():
            raise ValueError(f"A {self.kind} joins node {self.a.array[same][0]} with itself.")
        if is_concrete(mesh.nodes):
            nodes = np.asarray(mesh.nodes)
            apart = np.linalg.norm(nodes[self.a.array] - nodes[self.b.array], axis=1)
            size = float(np.linalg.norm(np.ptp(nodes, axis=0)))
            self.check_places(apart, _TOGETHER * size)

    def holds(self, mesh: Mesh) -> list[tuple[np.ndarray, np.ndarray]]:
        return held_by_conditions(self, mesh)

    def check_places(self, apart: np.ndarray, near: float) -> None:
        """Raise ValueError where the distances (k,) of the pairs do not fit; `near` counts as none."""
        if self.joins_places and (apart > near).any():
            k = int(np.argmax(apart))
            raise ValueError(
                f"A {self.kind} joins nodes in one place, but {self.a.array[k]} and {self.b.array[k]} are "
                f"{apart[k]:.4g} apart: put a point there (Mesh.with_points) and let a RigidBody carry it."
            )


def _slopes(part: Constraint, data, place: Place) -> Float[Array, "p c 6"]:
    """Derivatives of the conditions of one group."""
    return gradient_between(lambda place: part.conditions(data, place), place)


def named(kind: str, name: str | None) -> str | None:
    """`name`, checked."""
    if name is not None:
        check_text(f"The name of a {kind}", name)
    return name


class AtGroup(NamedTuple):
    """Conditions of one group of nodes, in a state."""

    nodes: np.ndarray
    """(c,)"""
    slopes: np.ndarray
    """(p, c, 6) by displacements and spins."""
    values: np.ndarray
    """(p,)"""


def conditions_at(item: Connector, mesh: Mesh, x, R) -> list[AtGroup]:
    """The conditions of every group of a connector where the nodes are at x (n, 3), with the rotations R (n, 3, 3)."""
    m, found = mesh.n_elements, []
    size = jnp.linalg.norm(jnp.ptp(mesh.nodes, axis=0))
    surface = Surface(mesh.nodes, mesh.triangles, jnp.zeros(m), jnp.zeros(m), jnp.zeros((m, 3)), size)
    for part in item.parts():
        if isinstance(part, Constraint):
            nodes = part.groups(mesh.triangles).array
            place, data = Place(jnp.asarray(x)[nodes], jnp.asarray(R)[nodes], jnp.zeros(len(nodes))), part.data(surface)
            slopes = jax.vmap(lambda *of_group, part=part: _slopes(part, *of_group))(data, place)
            values = jax.vmap(part.conditions)(data, place)
            found += map(AtGroup, nodes, np.asarray(slopes), np.asarray(values))
    return found


def held_by_conditions(item: Connector, mesh: Mesh) -> list[tuple[np.ndarray, np.ndarray]]:
    """What the conditions of a connector hold where nothing has moved, as `Connector.holds`."""
    R = np.broadcast_to(np.eye(3), (mesh.n_nodes, 3, 3))
    groups = conditions_at(item, mesh, mesh.nodes, R)
    return [(group.nodes, group.slopes.reshape(len(group.slopes), -1)) for group in groups]


def twist(first: Float[Array, "3 3"], second: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """sin φ n of the rotation from the first to the second, along the first's axes.

    Made of products of their columns: it stays where both turn alike, also at the mean of a step, whose matrices are no
    rotations. Along global axes it would turn with them there, and take angular momentum.
    """
    Q = first.T @ second
    return 0.5 * jnp.stack([Q[2, 1] - Q[1, 2], Q[0, 2] - Q[2, 0], Q[1, 0] - Q[0, 1]])


class Conditions(Constraint):
    """Conditions on groups of nodes (k, c), of a joint pairs; each kind has its own."""

    nodes: Frozen = eqx.field(static=True)

    def groups(self, triangles: np.ndarray) -> Frozen:
        return self.nodes


class Together(Conditions):
    """Two nodes in one place."""

    @property
    def count(self) -> int:
        return 3

    def data(self, surface) -> Float[Array, "k 0"]:
        return jnp.zeros((len(self.nodes.array), 0))

    def conditions(self, data, place: Place) -> Float[Array, "3"]:
        return place.x[1] - place.x[0]
