"""Elastic supports: nodes that springs along the global axes hold where they are."""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.connectors.base import Connector
from jaxshell.model.connectors.ends import given_motion
from jaxshell.model.contribution import Contribution, Elastic, Place, Surface
from jaxshell.model.history import History
from jaxshell.model.mesh import Mesh
from jaxshell.model.sets import SetName, check_on_mesh, nodes_or_name, size_of
from jaxshell.numerics.checks import check_positive, float_array
from jaxshell.numerics.frozen import Frozen


class ElasticSupport(Connector):
    """Nodes held by linear springs along the global axes, whose forces are -k_x u_x, -k_y u_y, -k_z u_z.

    Arguments:
        nodes: node indices, or the name of a set of them.
        stiffness: k [force/length], one value for all directions, (3,) along x, y, z, or (k, 3) for each node.
            Differentiable.
        motion: displacement (3,) [length] of what the springs stand on, multiplied by `history` (in statics by the load
            factor). Differentiable.
        history: how the motion varies in time.
        name: by which it is watched: "fx", "fy", "fz", forces of all its springs on the shell at the end of a step,
            and "energy".

    The displacements u are those from the stress-free shape, less the motion. A spring keeps its axis, however far the
    node moves, as one would on a slide: the force is linear in the displacement, and conserves no angular momentum. The
    energy ½ Σ k u² counts with the strain energy, `EnergyMomentum` keeps it to round-off, and what moves the support
    does external work. Rotations are free: `TorsionSpring` holds one about its axis.
    """

    kind: ClassVar[str] = "elastic support"
    sets: ClassVar[dict[str, str]] = {"nodes": "node"}

    nodes: Frozen | SetName = eqx.field(static=True)
    stiffness: Float[Array, "*k"]
    motion: Float[Array, "3"] | None
    history: History | None

    def __init__(self, nodes, stiffness, motion=None, history: History | None = None, name: str | None = None):
        self.nodes = nodes_or_name("elastic support nodes", nodes)
        self.stiffness = float_array(stiffness, "stiffness")
        self.motion, self.history = given_motion(motion, history)
        self.name = name

    def __check_init__(self):
        check_positive("stiffness", self.stiffness, allow_zero=True)
        count, shape = size_of(self.nodes), self.stiffness.shape
        if shape not in ((), (3,)) and (len(shape) != 2 or shape[1] != 3 or count not in (None, shape[0])):
            raise ValueError(
                f"stiffness must be one value, (3,) along x, y, z, or one of those for each node ({count}, 3), but it "
                f"has shape {shape}."
            )

    def check(self, mesh: Mesh) -> None:
        check_on_mesh("nodes", "node", self.nodes.array, mesh.n_nodes)

    def holds(self, mesh: Mesh) -> list[tuple[np.ndarray, np.ndarray]]:
        """The directions that are stiff."""
        stiff = np.broadcast_to(np.asarray(self.stiffness) > 0, (len(self.nodes.array), 3))
        return [
            (np.array([n]), np.eye(6)[:3][held]) for n, held in zip(self.nodes.array, stiff, strict=True) if held.any()
        ]

    def segments(self, mesh: Mesh) -> np.ndarray:
        return np.repeat(np.asarray(mesh.nodes)[self.nodes.array][:, None], 2, axis=1)

    def parts(self) -> tuple[Contribution, ...]:
        return (Held(self.nodes, self.stiffness, self.motion, self.history),)


class HeldData(NamedTuple):
    """What one node needs."""

    k: Float[Array, "*k 3"]
    x0: Float[Array, "*k 3"]


class Held(Elastic):
    """The forces of springs along the axes on nodes (k,)."""

    nodes: Frozen = eqx.field(static=True, converter=lambda nodes: Frozen(nodes.array[:, None]))
    k: Float[Array, "*k"]
    motion: Float[Array, "3"] | None
    history: History | None

    @property
    def driven(self) -> bool:
        return self.motion is not None

    def groups(self, triangles: np.ndarray) -> Frozen:
        return self.nodes

    def data(self, surface: Surface) -> HeldData:
        x0 = surface.x0[self.nodes.array[:, 0]]
        return HeldData(jnp.broadcast_to(self.k, x0.shape), x0)

    def energy(self, data: HeldData, place: Place) -> Float[Array, ""]:
        return 0.5 * jnp.sum(data.k * self._moved(data, place) ** 2)

    def force(self, data: HeldData, place: Place) -> Float[Array, "1 6"]:
        return jnp.concatenate([-data.k * self._moved(data, place), jnp.zeros(3)])[None]

    def mean_force(self, data: HeldData, start: Place, end: Place) -> Float[Array, "1 6"]:
        moved = 0.5 * (self._moved(data, start) + self._moved(data, end))
        return jnp.concatenate([-data.k * moved, jnp.zeros(3)])[None]

    def stiffness(self, data: HeldData, place: Place) -> Float[Array, "6 6"]:
        return jnp.zeros((6, 6)).at[:3, :3].set(-jnp.diag(data.k))

    def mean_stiffness(self, data: HeldData, start: Place, end: Place) -> Float[Array, "6 6"]:
        return 0.5 * self.stiffness(data, end)

    def quantities(self) -> tuple[str, ...]:
        return ("fx", "fy", "fz", "energy")

    def read(self, data: HeldData, start: Place, end: Place, force, component: str) -> Float[Array, ""]:
        if component == "energy":
            return self.energy(data, end)
        axis = self.quantities().index(component)
        return -data.k[axis] * self._moved(data, end)[axis]

    def _moved(self, data: HeldData, place: Place) -> Float[Array, "3"]:
        moved = place.x[0] - data.x0
        return moved if self.motion is None or self.history is None else moved - self.history(place.time) * self.motion
