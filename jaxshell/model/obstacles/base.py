"""What every obstacle offers: its gap, its parts, its checks, and how scene files write it."""

import abc
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.contribution import Contribution
from jaxshell.model.history import History
from jaxshell.model.items import Item
from jaxshell.model.mesh import Mesh
from jaxshell.model.obstacles.contact import Friction, NormalContact, half_thickness
from jaxshell.model.obstacles.outlines import Lines
from jaxshell.model.sections import AnySection
from jaxshell.model.sections.base import Layers
from jaxshell.model.sets import SetName, check_on_mesh, nodes_or_name
from jaxshell.numerics.checks import (
    check_finite,
    check_kind,
    check_number,
    check_positive,
    check_positive_number,
    check_shape,
    float_array,
    is_concrete,
    optional_floats,
)
from jaxshell.numerics.compiled import compiled_for_frames
from jaxshell.numerics.frozen import Frozen

_ROUND_OFF, _AT_REST = 1e-9, 1e-3
"""A shell may start inside an obstacle by this part of its size; one whose initial shape is given by more."""


def _nodes(nodes) -> Frozen | SetName | None:
    return nodes if nodes is None or isinstance(nodes, Frozen) else nodes_or_name("obstacle nodes", nodes)


def _friction(value) -> Any:
    """An exact zero as None: it leaves friction out of the compiled program."""
    is_zero = isinstance(value, int | float) and not isinstance(value, bool) and value == 0
    return None if is_zero or value is None else float_array(value, "friction")


class Obstacle(Item):
    """A rigid body that nodes of the shell touch. Arguments that all have, by name:

        nodes: node numbers, or the name of a set; None is all nodes of elements. Points, which belong to none, touch it
            where they are named, and given an `area`, a `stiffness`, an `offset` and with friction a `slip`.
        stiffness: k [force/length³], the pressure of a unit of penetration; None chooses it from the section.
        friction: Coulomb's coefficient μ; 0 is frictionless, and not compiled.
        slip: v0 [length/time], the velocity from which on friction slides; None chooses it from the section.
        offset: distance of the shell's skin from its nodes [length]; None is half the thickness, 0 the middle surface.
            Of points the radius.
        area: of each of the points among the nodes [length²]: k times it is its stiffness.
        motion, history: the obstacle is moved by motion (3,) [length] times the history. Statics goes by the load
            factor instead.
        name: for reports and messages.

    All floats are differentiable. Raises ValueError naming what is out of range.
    """

    sets: ClassVar[dict[str, str]] = {"nodes": "node"}

    nodes: Frozen | SetName | None = eqx.field(static=True, default=None, converter=_nodes, kw_only=True)
    stiffness: Float[jax.Array, ""] | None = eqx.field(
        default=None, converter=optional_floats("stiffness"), kw_only=True
    )
    friction: Float[jax.Array, ""] | None = eqx.field(default=0.0, converter=_friction, kw_only=True)
    """None is none."""
    slip: Float[jax.Array, ""] | None = eqx.field(default=None, converter=optional_floats("slip"), kw_only=True)
    offset: Float[jax.Array, ""] | None = eqx.field(default=None, converter=optional_floats("offset"), kw_only=True)
    area: Float[jax.Array, ""] | None = eqx.field(default=None, converter=optional_floats("area"), kw_only=True)
    motion: Float[jax.Array, "3"] | None = eqx.field(default=None, converter=optional_floats("motion"), kw_only=True)
    history: History | None = eqx.field(default=None, kw_only=True)

    # --- what each states ------------------------------------------------------------------------------------

    @abc.abstractmethod
    def gap(self, x: Float[Array, "3"]) -> Float[Array, ""]:
        """Signed distance of a point from the obstacle where it stands at first: negative inside."""

    @abc.abstractmethod
    def gap_between(self, before: Float[Array, "3"], after: Float[Array, "3"]) -> Float[Array, "3"]:
        """D with D·(after - before) = gap(after) - gap(before) exactly; where both are one point the gradient."""

    @abc.abstractmethod
    def outline(self, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> Lines:
        """Lines that show it where it stands at first, in a picture of the space between two corners."""

    # --- what all have ---------------------------------------------------------------------------------------

    @property
    def has_friction(self) -> bool:
        return self.friction is not None

    @property
    def is_moving(self) -> bool:
        return self.motion is not None

    def moved(self, time) -> Any:
        """How far it has moved (3,); 0.0 of one that stands."""
        return 0.0 if self.motion is None or self.history is None else self.motion * self.history(time)

    def parts(self) -> tuple[Contribution, ...]:
        """The normal force, and friction where it has some."""
        return (NormalContact(self), Friction(self)) if self.has_friction else (NormalContact(self),)

    def touching(self, triangles: np.ndarray) -> np.ndarray:
        """Numbers of the nodes that may touch it."""
        return np.unique(triangles) if self.nodes is None else self.nodes.array

    def called(self, position: int) -> str:
        """Its name, or what it is called by its place in the scene's list."""
        return f"obstacle {position}" if self.name is None else self.name

    def __check_init__(self):
        for name in ("stiffness", "slip", "area"):
            if getattr(self, name) is not None:
                check_positive_number(f"{self.kind} {name}", getattr(self, name))
        for name in ("friction", "offset"):
            if getattr(self, name) is not None:
                check_number(f"{self.kind} {name}", getattr(self, name))
                check_positive(f"{self.kind} {name}", getattr(self, name), allow_zero=True)
        if self.slip is not None and not self.has_friction:
            raise ValueError(f"slip is of friction, which this {self.kind} has none of: give it a friction.")
        check_kind(f"{self.kind} history", self.history, History | None, "a jaxshell.History or None")
        if (self.motion is None) != (self.history is None):
            raise ValueError(f"A {self.kind} that moves needs both: motion (3,) and the history that scales it.")
        if self.motion is not None:
            check_vector(f"{self.kind} motion", self.motion)

    def check(self, mesh: Mesh) -> None:
        if self.nodes is not None:
            check_on_mesh(self.kind, "node", self.nodes.array, mesh.n_nodes)
        elif not mesh.n_elements:
            raise ValueError("the scene has no elements, whose nodes touch it where none are named: give its nodes.")
        points = np.setdiff1d(self.touching(mesh.triangles), mesh.triangles)
        if not points.size:
            if self.area is not None:
                raise ValueError("area is of points that belong to no element, and none touches it: leave it out.")
            return
        needed = ("area", "stiffness", "offset", *(("slip",) if self.has_friction else ()))
        missing = [name for name in needed if getattr(self, name) is None]
        if missing:
            raise ValueError(
                f"node {points[0]} belongs to no element, and has no share of a surface that could touch: give "
                f"{', '.join(missing)}."
            )

    def check_passing(self, beside: np.ndarray) -> None:
        """Raise ValueError where masses `beside` the shell, nodes (k,), would pass through unasked."""
        if self.nodes is None and beside.size:
            raise ValueError(
                f"node {beside[0]} has a mass and hangs on no element: where no nodes are named it would pass through "
                f"this {self.kind}. Name the nodes that touch it, points with an area, or without them."
            )

    def skin(self, section: AnySection, mesh: Mesh) -> Float[Array, " k"]:
        """Distance of the skin from the nodes that may touch.

        Raises ValueError where it is not given and half the thickness is not known, or is another on either side.
        """
        nodes = self.touching(mesh.triangles)
        if self.offset is not None:
            return jnp.broadcast_to(self.offset, nodes.shape)
        return _half_thickness(even_layers(section, mesh).z, mesh)[nodes]

    def meeting(self, section: AnySection, mesh: Mesh, x, shift: Any) -> "Meeting":
        """How the shell stands to it with nodes at x (n, 3), when it has moved by `shift` (3,)."""
        nodes = self.touching(mesh.triangles)
        skin = self.skin(section, mesh)
        depth, normals = _meeting(self, jnp.asarray(x)[nodes], jnp.broadcast_to(shift, (3,)), skin)
        return Meeting(nodes, depth, skin, normals)

    def check_start(self, section: AnySection, mesh: Mesh, x: Any, given: bool) -> None:
        """Raise ValueError where the shell starts inside, at positions x (n, 3), and where no thickness is known.

        A `given` initial shape may penetrate, as one does that was at rest on the obstacle: by the skin's distance, or
        by a thousandth of the shell's size.
        """
        nodes, depth, skin, _ = self.meeting(section, mesh, x, self.moved(jnp.zeros(())))
        if not (is_concrete(depth) and is_concrete(skin)):
            return
        depth, skin = np.asarray(depth), np.asarray(skin)
        worst = int(np.argmax(depth))
        size = np.linalg.norm(np.ptp(np.asarray(mesh.nodes), axis=0))
        if depth[worst] > (max(_AT_REST * size, skin[worst]) if given else _ROUND_OFF * size):
            raise ValueError(
                f"the shell starts inside this {self.kind}: node {nodes[worst]} by {depth[worst]:.4g}, with its skin "
                f"{skin[worst]:.4g} from the nodes. Move one of the two; offset=0 touches with the middle surface."
            )


class Meeting(NamedTuple):
    """How k nodes of a shell stand to an obstacle."""

    nodes: np.ndarray
    depth: Float[Array, " k"]
    """How deep the skin is inside [length]; negative outside."""
    skin: Float[Array, " k"]
    """Its distance from the nodes [length]."""
    normals: Float[Array, "k 3"]
    """Out of the obstacle."""


@compiled_for_frames
def _meeting(obstacle: Obstacle, x: Float[Array, "k 3"], shift: Float[Array, "3"], skin: Float[Array, " k"]):
    seen = x - shift
    return skin - jax.vmap(obstacle.gap)(seen), jax.vmap(obstacle.gap_between)(seen, seen)


@compiled_for_frames
def _half_thickness(z: Float[Array, "m p 2"], mesh: Mesh) -> Float[Array, " n"]:
    corners = mesh.nodes[mesh.triangles]
    area = 0.5 * jnp.linalg.norm(jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return half_thickness(z, area, mesh.triangles, mesh.n_nodes)


def even_layers(section: AnySection, mesh: Mesh) -> Layers:
    """Those of a section. Raises ValueError where half the thickness is not the distance of the skin from the nodes."""
    layers = section.layers(mesh)
    if layers is None:
        raise ValueError("the section has no thickness that is known: give the offset of the skin from the nodes.")
    z = layers.z
    if is_concrete(z):
        bottom, top = np.asarray(z)[:, 0, 0], np.asarray(z)[:, -1, 1]
        uneven = np.abs(top + bottom) > 1e-9 * (top - bottom)
        if uneven.any():
            element = int(np.argmax(uneven))
            raise ValueError(
                f"the nodes of element {element} are not in the middle of its thickness: give the offset of the skin "
                "that touches from the nodes."
            )
    return layers


def check_vector(name: str, value, direction: bool = False) -> None:
    """Raise ValueError unless `value` is a finite vector (3,); a `direction` has a length too."""
    check_shape(name, value, (3,))
    check_finite(name, value)
    if direction and is_concrete(value) and not np.any(np.asarray(value)):
        raise ValueError(f"{name} must be a direction, but it is zero.")


def unit(vector: Float[Array, "3"]) -> Float[Array, "3"]:
    return vector / jnp.linalg.norm(vector)


def vector(name: str):
    """The converter of a field that is a vector."""
    return lambda value: float_array(value, name)
