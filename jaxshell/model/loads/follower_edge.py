"""Forces on deformed edges: per deformed length, along axes that turn with the edge or stay where they are."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.contribution import Contribution, Place, Surface
from jaxshell.model.history import History
from jaxshell.model.loads.base import Load, check_vectors, given_history
from jaxshell.model.loads.edge import edges_or_name
from jaxshell.model.mesh import Mesh
from jaxshell.model.sets import SetName, size_of
from jaxshell.numerics.checks import check_choice, float_array
from jaxshell.numerics.frozen import Frozen

AXES = ("edge", "global")


class FollowerEdgeForce(Load, Contribution):
    """A force per deformed length of edges, which turns with them or keeps its direction.

    Arguments:
        edges: (k, 2) node indices of the edges' ends, or the name of a set of sides.
        components: (3,) or (k, 3) [force/length] on the deformed length; half of each edge's resultant goes to each of
            its ends. Differentiable.
        history: how it varies in time; None is constant.
        axes: "edge" for components along the normal of the edge in the deformed surface, outwards (a tension is
            positive); along the edge, the way its element goes round it, counter-clockwise about the normal; and along
            the element's normal. They turn with the edge. "global" for components along the global axes.

    Along "edge" each edge must be of one element only, whose three nodes say where the axes are; it has no stiffness by
    rotations. The force has no potential, and its work counts as external work: `EnergyMomentum` changes the energy by
    exactly that of the mean of the forces at the ends of a step, which is second order. Raises ValueError for NaN, for
    another number of values than edges, and for an edge that is no element's, or along "edge" of several.
    """

    kind: ClassVar[str] = "follower edge force"
    value: ClassVar[str] = "components"
    acts_on: ClassVar[str] = "edges"

    sets: ClassVar[dict[str, str]] = {"edges": "side"}

    edges: Frozen | SetName = eqx.field(static=True)
    components: Float[jax.Array, "*k 3"]
    history: History
    axes: str = eqx.field(static=True)

    def __init__(self, edges, components, history: History | None = None, axes: str = "edge"):
        self.edges = edges_or_name(edges)
        self.components = float_array(components, "follower edge force")
        self.history = given_history(history)
        self.axes = axes

    def __check_init__(self):
        check_vectors("follower edge force", self.components, size_of(self.edges))
        check_choice("axes", self.axes, AXES)

    @property
    def nodes(self) -> Frozen:
        """Both ends of all edges."""
        return Frozen(self.edges.array.ravel())

    def check(self, mesh: Mesh) -> None:
        _, count = _elements_of(self.edges.array, mesh.triangles)
        wrong = count != 1 if self.axes == "edge" else count == 0
        if wrong.any():
            edge, number = self.edges.array[np.argmax(wrong)].tolist(), int(count[np.argmax(wrong)])
            if not number:
                raise ValueError(f"{edge} is no edge of an element.")
            raise ValueError(
                f"The edge {edge} is of {number} elements, so that no side of it is the outer one: along "
                'axes="edge" an edge must be of one element. Use axes="global", or an EdgeForce.'
            )

    def groups(self, triangles: np.ndarray) -> Frozen:
        if self.axes == "global":
            return self.edges if isinstance(self.edges, Frozen) else Frozen(self.edges.array)
        return Frozen(_elements_of(self.edges.array, triangles)[0])

    def data(self, surface: Surface) -> Float[Array, "k 3"]:
        return jnp.broadcast_to(self.components, (len(self.edges.array), 3))

    def force(self, data, place: Place) -> Float[Array, "c 6"]:
        along = place.x[1] - place.x[0]
        if self.axes == "global":
            whole = jnp.linalg.norm(along) * data
        else:
            normal = jnp.cross(along, place.x[2] - place.x[0])
            normal = normal / jnp.linalg.norm(normal)
            outwards = jnp.cross(along, normal)
            whole = data[0] * outwards + data[1] * along + data[2] * jnp.linalg.norm(along) * normal
        half = 0.5 * self.history(place.time) * whole
        return jnp.zeros((place.x.shape[0], 6)).at[:2, :3].set(half)


def _elements_of(edges: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(k, 3) the nodes of an element that has the edge, its ends first, as the element goes round; and (k,) how many
    elements have it. Of an edge without elements the nodes say nothing."""
    rows = triangles[:, [[0, 1, 2], [1, 2, 0], [2, 0, 1]]].reshape(-1, 3)
    size = max(int(triangles.max()), int(edges.max())) + 1

    def number(ends):
        ends = np.sort(ends.astype(np.int64), axis=1)
        return ends[:, 0] * size + ends[:, 1]

    order = np.argsort(number(rows[:, :2]), kind="stable")
    known, wanted = number(rows[:, :2])[order], number(edges)
    first, last = np.searchsorted(known, wanted), np.searchsorted(known, wanted, side="right")
    return rows[order[np.minimum(first, len(order) - 1)]], last - first
