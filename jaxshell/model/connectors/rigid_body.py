"""Rigid bodies: nodes that keep their places to each other, and the point that moves them."""

from collections.abc import Sequence
from typing import Any, ClassVar, cast

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from jaxshell.model.connectors.base import Connector
from jaxshell.model.connectors.distributed import reference_of
from jaxshell.model.contribution import Contribution
from jaxshell.model.masses import check_masses, tensor
from jaxshell.model.mesh import Mesh
from jaxshell.model.sets import SetName, check_on_mesh, nodes_or_name
from jaxshell.numerics.checks import check_text, float_array
from jaxshell.numerics.frozen import Frozen


class RigidBody(Connector):
    """Nodes that move as one rigid body with a reference node (RBE2).

    Arguments:
        nodes: node indices, or the name of a set; empty for a body that no shell hangs on.
        reference: the node that moves the body: its index, the name of a set that holds it alone, or a point (3,) in
            space, which becomes a node of the scene's mesh with the body's `name` as its set. None is the mean place
            of the nodes. Loads, supports, driven motion and springs at the reference are the body's.
        mass: besides what its nodes carry [mass], at the reference. Differentiable.
        inertia: (3, 3), or one value for a ball: tensor about the reference in global axes at the start
            [mass·length²]. Differentiable.
        name: the set of the reference, and what watches call the body.

    The nodes' degrees of freedom are eliminated: no stiffness stands for rigidity. With `EnergyMomentum` energy and
    momenta are kept exactly. Raises ValueError for a reference among several, and an inertia that no body has.
    """

    kind: ClassVar[str] = "rigid body"
    sets: ClassVar[dict[str, str]] = {"nodes": "node", "reference": "node"}

    nodes: Frozen | SetName = eqx.field(static=True)
    reference: Frozen | SetName | None = eqx.field(static=True)
    point: Float[jax.Array, "3"] | None
    mass: Float[jax.Array, ""]
    inertia: Float[jax.Array, "3 3"] | None

    def __init__(self, nodes, reference=None, mass: Any = 0.0, inertia=None, name: str | None = None, point=None):
        self.nodes = Frozen([]) if _is_empty(nodes) else nodes_or_name("rigid body nodes", nodes)
        self.reference, place = reference_of(reference, "A rigid body")
        self.point = place if point is None else float_array(point, "rigid body point")
        self.mass = float_array(mass, "rigid body mass")
        self.inertia = None if inertia is None else tensor(inertia, "rigid body inertia")
        self.name = name

    def __check_init__(self):
        if self.name is not None:
            check_text("A rigid body's name", self.name)
        check_masses("rigid body", self.mass, self.inertia)
        if self.mass.shape != ():
            raise ValueError(f"A rigid body has one mass, but it has shape {self.mass.shape}.")
        alone = isinstance(self.nodes, Frozen) and not self.nodes.array.size
        if alone and self.reference is None and self.point is None:
            raise ValueError("A rigid body without nodes needs a reference: a node or a point (3,).")
        if isinstance(self.reference, Frozen) and len(self.reference.array) > 1:
            raise ValueError(
                f"A rigid body's reference is one node, but the set holds {len(self.reference.array)}: choose one."
            )

    def placed(self, mesh: Mesh, number: int) -> tuple["RigidBody", Mesh]:
        """The body with numbers in place of names, and the mesh with its reference, where that is no node yet."""
        body = cast(RigidBody, self.on(mesh))
        if body.reference is not None:
            return body, mesh
        name = f"body {number}" if self.name is None else self.name
        place = mesh.nodes[body.nodes.array].mean(axis=0) if self.point is None else self.point
        mesh = mesh.with_points({name: place})
        return RigidBody(body.nodes, mesh.n_nodes - 1, self.mass, self.inertia, name), mesh

    @property
    def turning(self) -> np.ndarray:
        return np.array([self.master])

    @property
    def master(self) -> int:
        """The node of the reference."""
        assert self.reference is not None
        return int(self.reference.array[0])

    @property
    def followers(self) -> np.ndarray:
        """The nodes but for the reference."""
        return np.setdiff1d(self.nodes.array, [self.master])

    def parts(self) -> tuple[Contribution, ...]:
        return ()

    def check(self, mesh: Mesh) -> None:
        for what, numbers in (("rigid body", self.nodes.array), ("reference", np.array([self.master]))):
            check_on_mesh(what, "node", numbers, mesh.n_nodes)


def check_bodies(bodies: Sequence[RigidBody], supports) -> None:
    """Raise ValueError for a node in two bodies, and for one that a support holds besides its body."""
    owner: dict[int, int] = {}
    for number, body in enumerate(bodies):
        for node in body.followers.tolist():
            if node in owner:
                raise ValueError(f"Node {node} is in two rigid bodies, {owner[node]} and {number}: make them one.")
            owner[node] = number
    for number, body in enumerate(bodies):
        if body.master in owner:
            raise ValueError(
                f"Node {body.master} is the reference of rigid body {number} and a node of body {owner[body.master]}: "
                "make them one, or join them."
            )
    for position, support in enumerate(supports):
        for node in support.nodes.array.tolist():
            if node in owner:
                raise ValueError(
                    f"support {position} holds node {node} of rigid body {owner[node]}, which its reference moves: "
                    f"support the reference, node {bodies[owner[node]].master}."
                )


def _is_empty(nodes) -> bool:
    return not isinstance(nodes, str) and np.size(getattr(nodes, "array", nodes)) == 0
