"""Springs and cables between nodes, or between nodes and points of space that may move."""

from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.connectors.ends import End, Link, Nodes, Point, check_each, end_of, given_motion, nodes_of
from jaxshell.model.connectors.laws import length_of, mean_positive, positive, ratio
from jaxshell.model.contribution import Contribution, Elastic, Place, Surface
from jaxshell.model.history import History
from jaxshell.model.mesh import Mesh
from jaxshell.numerics.checks import check_switch, float_array, is_concrete
from jaxshell.numerics.frozen import Frozen


class Spring(Link):
    """Springs along the line between two places, of the force k(|r| - l), r from a to b; or cables, which only pull.

    Arguments:
        a: a node, a list of nodes, or the name of a set of them.
        b: as many nodes, joined with those of `a` one by one; or a point of space, floats (3,), or (k, 3), which is
            differentiable. Whole numbers are nodes: the point (0, 0, 1) is (0.0, 0.0, 1.0).
        stiffness: k [force/length], one value or one for each. Differentiable.
        length: l [length] without force, one value or one for each; None is the distance at the start, in the
            stress-free shape. Differentiable.
        tension_only: whether it is slack, without force, where it is shorter than l: a cable.
        motion: displacement (3,) [length] of the points of space, multiplied by `history` (in statics by the load
            factor). Differentiable.
        history: how the motion varies in time.
        name: by which it is watched: "force" (tension is positive), "length", "elongation", all at the end of a step,
            and "energy".

    The energy ½k(|r| - l)² (½k⟨|r| - l⟩² of a cable) counts with the strain energy. `EnergyMomentum` keeps it to
    round-off, with a cable that gets taut within a step too: it takes the mean force ΔV/Δ|r| (r₀ + r₁)/(|r₀| + |r₁|).
    Between nodes it changes no momentum; what moves the points does external work. Raises ValueError for a spring that
    begins with both ends at one place, where it has no direction, unless its `length` is 0.
    """

    kind: ClassVar[str] = "spring"

    a: Nodes
    b: End
    stiffness: Float[Array, "*k"]
    length: Float[Array, "*k"] | None
    tension_only: bool = eqx.field(static=True)
    motion: Float[Array, "3"] | None
    history: History | None

    def __init__(
        self,
        a,
        b,
        stiffness,
        length=None,
        tension_only: bool = False,
        motion=None,
        history: History | None = None,
        name: str | None = None,
    ):
        self.a, self.b = nodes_of("a", a), end_of("b", b)
        self.stiffness = float_array(stiffness, "stiffness")
        self.length = None if length is None else float_array(length, "length")
        self.tension_only = tension_only
        self.motion, self.history = given_motion(motion, history)
        self.name = name

    def __check_init__(self):
        check_each("stiffness", self.stiffness, self.count)
        if self.length is not None:
            check_each("length", self.length, self.count)
        check_switch("tension_only", self.tension_only)
        if self.motion is not None and not isinstance(self.b, Point):
            raise ValueError(
                "motion moves points of space, but b are nodes: a support with a displacement moves those."
            )

    def check(self, mesh: Mesh) -> None:
        super().check(mesh)
        distances = self.distances(mesh)
        if distances is None or (self.length is not None and not is_concrete(self.length)):
            return
        size = np.linalg.norm(np.ptp(np.asarray(mesh.nodes), axis=0))
        without = np.broadcast_to(True if self.length is None else np.asarray(self.length) > 0, distances.shape)
        short = np.flatnonzero((distances <= 1e-12 * size) & without)
        if short.size:
            raise ValueError(
                f"the spring at node {self.nodes.array[short[0], 0]} begins with both ends at one place, where it has "
                "no direction: give length=0.0 for one that pulls them together, or move an end."
            )

    def holds(self, mesh: Mesh) -> list[tuple[np.ndarray, np.ndarray]]:
        """The motion along each spring that is stiff, and taut where it is a cable."""
        x, first = np.asarray(mesh.nodes), self.nodes.array[:, 0]
        second = x[self.nodes.array[:, 1]] if self.points is None else np.asarray(self.points)
        r = second - x[first]
        distances = np.linalg.norm(r, axis=1)
        length = distances if self.length is None else np.asarray(self.length)
        stiff = np.asarray(self.stiffness) > 0
        if self.tension_only:
            stiff = stiff & (distances > length)
        if np.any(np.broadcast_to(length == 0, distances.shape) & (distances == 0)):
            return []  # of no direction, and all
        along = np.where(stiff, 1.0, 0.0)[..., None] * r / np.where(distances > 0, distances, 1.0)[:, None]
        return self.against(np.concatenate([along, np.zeros_like(along)], axis=1))

    def parts(self) -> tuple[Contribution, ...]:
        return (
            Pull(self.nodes, self.points, self.stiffness, self.length, self.tension_only, self.motion, self.history),
        )


class PullData(NamedTuple):
    """What one spring needs."""

    stiffness: Float[Array, "*k"]
    length: Float[Array, "*k"]
    point: Float[Array, "*k 3"] | None


class Pull(Elastic):
    """The force of springs on pairs of nodes (k, 2), or on nodes (k, 1) that points (k, 3) hold."""

    nodes: Frozen = eqx.field(static=True)
    points: Float[Array, "k 3"] | None
    k: Float[Array, "*k"]
    length: Float[Array, "*k"] | None
    tension_only: bool = eqx.field(static=True)
    motion: Float[Array, "3"] | None = None
    history: History | None = None

    @property
    def driven(self) -> bool:
        return self.motion is not None

    def groups(self, triangles: np.ndarray) -> Frozen:
        return self.nodes

    def data(self, surface: Surface) -> PullData:
        count = len(self.nodes.array)
        length = self.length
        if length is None:
            x = surface.x0[self.nodes.array]
            length = jnp.linalg.norm((x[:, 1] if self.points is None else self.points) - x[:, 0], axis=1)
        return PullData(jnp.broadcast_to(self.k, (count,)), jnp.broadcast_to(length, (count,)), self.points)

    def energy(self, data: PullData, place: Place) -> Float[Array, ""]:
        return 0.5 * data.stiffness * self._extension(data, length_of(self._along(data, place))) ** 2

    def force(self, data: PullData, place: Place) -> Float[Array, "c 6"]:
        r = self._along(data, place)
        return self._on_ends(self._mean_factor(data, length_of(r), length_of(r)) * r)

    def mean_force(self, data: PullData, start: Place, end: Place) -> Float[Array, "c 6"]:
        before, after = self._along(data, start), self._along(data, end)
        return self._on_ends(self._mean_factor(data, length_of(before), length_of(after)) * 0.5 * (before + after))

    def quantities(self) -> tuple[str, ...]:
        return ("force", "length", "elongation", "energy")

    def read(self, data: PullData, start: Place, end: Place, force, component: str) -> Float[Array, ""]:
        length = length_of(self._along(data, end))
        if component == "energy":
            return self.energy(data, end)
        if component == "force":
            return data.stiffness * self._extension(data, length)
        return length if component == "length" else length - data.length

    def _along(self, data: PullData, place: Place) -> Float[Array, "3"]:
        """r from the end a to the end b."""
        if data.point is None:
            return place.x[1] - place.x[0]
        moved = 0.0 if self.motion is None or self.history is None else self.history(place.time) * self.motion
        return data.point + moved - place.x[0]

    def _extension(self, data: PullData, length) -> Float[Array, ""]:
        return positive(length - data.length) if self.tension_only else length - data.length

    def _mean_factor(self, data: PullData, before, after) -> Float[Array, ""]:
        """The mean force over the mean length, ΔV/Δ|r| / ½(|r₀| + |r₁|), of two lengths."""
        if not self.tension_only:
            return data.stiffness * (1.0 - ratio(2.0 * data.length, before + after))
        pull = mean_positive(before - data.length, after - data.length)
        return data.stiffness * ratio(2.0 * pull, before + after, jnp.where(data.length > 0, 0.0, 1.0))

    def _on_ends(self, pull: Float[Array, "3"]) -> Float[Array, "c 6"]:
        """Forces on the nodes of a group, of a pull on the end a."""
        forces = pull[None] if self.points is not None else jnp.stack([pull, -pull])
        return jnp.concatenate([forces, jnp.zeros_like(forces)], axis=1)
