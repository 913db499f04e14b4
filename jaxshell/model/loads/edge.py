"""Forces and moments with a fixed direction on edges."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Float

from jaxshell.model.history import History
from jaxshell.model.loads.base import DeadLoad, check_vectors, given_history
from jaxshell.model.sets import SetName, size_of
from jaxshell.numerics.checks import check_shape, float_array, node_indices, whole_array
from jaxshell.numerics.frozen import Frozen


class EdgeForce(DeadLoad):
    """A force with a fixed direction per reference length of edges.

    Arguments:
        edges: (k, 2) node indices of the edges' ends, or the name of a set of sides.
        force: (3,) or (k, 3) [force/length]; half of each edge's resultant goes to each of its ends.
    """

    kind: ClassVar[str] = "edge force"
    value: ClassVar[str] = "force"
    acts_on: ClassVar[str] = "edges"

    sets: ClassVar[dict[str, str]] = {"edges": "side"}

    edges: Frozen | SetName = eqx.field(static=True)
    force: Float[jax.Array, "*k 3"]
    history: History

    def __init__(self, edges, force, history: History | None = None):
        self.edges = edges_or_name(edges)
        self.force = float_array(force, "edge force")
        self.history = given_history(history)

    def __check_init__(self):
        check_vectors("edge force", self.force, size_of(self.edges))

    @property
    def nodes(self) -> Frozen:
        """Both ends of all edges."""
        return Frozen(self.edges.array.ravel())

    def nodal(self, x0, triangles, mass_per_area) -> Float[jax.Array, "n 6"]:
        """(n, 6) force and moment on each node for factor 1."""
        return _on_ends(x0, self.edges, self.force, slice(0, 3))


class EdgeMoment(DeadLoad):
    """A moment with a fixed direction in space per reference length of edges.

    Arguments:
        edges: (k, 2) node indices of the edges' ends, or the name of a set of sides.
        moment: (3,) or (k, 3) [force]; half of each edge's resultant goes to each of its ends. Differentiable.
        history: how it varies in time; None is constant.

    A moment of fixed direction has no potential where the shell turns about several axes; its work counts as external
    work, by `EnergyMomentum` as that of a `NodalMoment` on the Cayley vectors of the steps. Raises ValueError for NaN
    and for another number of values than edges.
    """

    kind: ClassVar[str] = "edge moment"
    value: ClassVar[str] = "moment"
    acts_on: ClassVar[str] = "edges"

    sets: ClassVar[dict[str, str]] = {"edges": "side"}

    edges: Frozen | SetName = eqx.field(static=True)
    moment: Float[jax.Array, "*k 3"]
    history: History

    def __init__(self, edges, moment, history: History | None = None):
        self.edges = edges_or_name(edges)
        self.moment = float_array(moment, "edge moment")
        self.history = given_history(history)

    def __check_init__(self):
        check_vectors("edge moment", self.moment, size_of(self.edges))

    @property
    def nodes(self) -> Frozen:
        """Both ends of all edges."""
        return Frozen(self.edges.array.ravel())

    def nodal(self, x0, triangles, mass_per_area) -> Float[jax.Array, "n 6"]:
        """(n, 6) force and moment on each node for factor 1."""
        return _on_ends(x0, self.edges, self.moment, slice(3, 6))


def _on_ends(x0, edges: Frozen | SetName, vector, part: slice) -> Float[jax.Array, "n 6"]:
    """Half of each edge's resultant on each of its ends, as forces or moments, a `part` of the six."""
    first, second = edges.array.T
    length = jnp.linalg.norm(x0[second] - x0[first], axis=1, keepdims=True)
    share = 0.5 * length * jnp.broadcast_to(vector, length.shape[:1] + (3,))
    return jnp.zeros((x0.shape[0], 6)).at[first, part].add(share).at[second, part].add(share)


def edges_or_name(edges) -> Frozen | SetName:
    """Pairs of nodes, or the name of a set of sides. Raises ValueError for anything else."""
    if isinstance(edges, str):
        return SetName(edges)
    edges = edges.array if isinstance(edges, Frozen) else whole_array("edges", edges, "pairs of node indices")
    check_shape("edges", edges, (None, 2))
    node_indices("edge nodes", edges.ravel())
    return Frozen(edges)
