"""The ends of what joins two places: nodes, and nodes or points of space."""

import dataclasses
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.connectors.base import Connector
from jaxshell.model.history import History
from jaxshell.model.mesh import Mesh
from jaxshell.model.sets import SetName, check_on_mesh, nodes_or_name, size_of
from jaxshell.numerics.checks import (
    check_finite,
    check_kind,
    check_positive,
    check_shape,
    float_array,
    is_concrete,
    shown,
)
from jaxshell.numerics.frozen import Frozen


class Nodes(eqx.Module):
    """Nodes at an end: their numbers, or the name of a set until it is in a scene."""

    nodes: Frozen | SetName = eqx.field(static=True, converter=lambda nodes: nodes_or_name("nodes", nodes))


class Point(eqx.Module):
    """A point of space at an end, (3,), or one for each of the nodes at the other, (k, 3)."""

    place: Float[Array, "*k 3"]


class Space(eqx.Module):
    """Space at an end, against which nodes turn."""


End = Nodes | Point | Space


def end_of(name: str, given: Any) -> End:
    """What a user states for an end: a number, a list of them or a set's name, or floats (3,) or (k, 3) of space.

    Raises ValueError calling it `name` for anything else.
    """
    if isinstance(given, Nodes | Point | Space):
        return given
    if isinstance(given, str | Frozen) or _is_whole(given):
        return Nodes(nodes_or_name(name, given))
    place = float_array(given, name)
    if place.shape[-1:] != (3,) or place.ndim > 2:
        raise ValueError(
            f"{name} must be a node, a list of nodes, the name of a set, or a point of space, floats (3,) or (k, 3), "
            f"but it is {shown(given)}."
        )
    check_finite(name, place)
    return Point(place)


def _is_whole(given: Any) -> bool:
    """Whether these are whole numbers, which name nodes."""
    if isinstance(given, list | tuple | range):
        return all(_is_whole(item) for item in given)
    if isinstance(given, jax.Array):
        return bool(jnp.issubdtype(given.dtype, jnp.integer))
    return isinstance(given, int) or (isinstance(given, np.ndarray | np.generic) and given.dtype.kind in "iu")


class Link(Connector):
    """What joins nodes `a` with as many nodes or points `b`, one by one."""

    sets: ClassVar[dict[str, str]] = {"a": "node", "b": "node"}

    a: eqx.AbstractVar[Nodes]
    b: eqx.AbstractVar[End]

    def on(self, mesh: Mesh) -> "Link":
        found = {}
        for name in ("a", "b"):
            end = getattr(self, name)
            if isinstance(end, Nodes) and isinstance(end.nodes, SetName):
                found[name] = Nodes(mesh.node_sets.chosen(str(end.nodes)))
        return dataclasses.replace(self, **found) if found else self

    @property
    def nodes(self) -> Frozen:
        """(k, 2) nodes of the groups, or (k, 1) where they are joined with space."""
        first = self.a.nodes.array
        if isinstance(self.b, Nodes):
            return Frozen(np.stack([first, self.b.nodes.array], axis=1))
        return Frozen(first[:, None])

    @property
    def points(self) -> Float[Array, "k 3"] | None:
        """Points of space at the ends b; None where there are none."""
        if not isinstance(self.b, Point):
            return None
        return jnp.broadcast_to(self.b.place, (len(self.a.nodes.array), 3))

    def check(self, mesh: Mesh) -> None:
        """Raise ValueError for ends that are not as many as the others, and for a node that is joined with itself."""
        first = self.a.nodes.array
        check_on_mesh("a", "node", first, mesh.n_nodes)
        if isinstance(self.b, Point) and self.b.place.shape not in ((3,), (len(first), 3)):
            shape = self.b.place.shape
            raise ValueError(f"b must be one point (3,) or one for each of {len(first)} nodes, but has shape {shape}.")
        if not isinstance(self.b, Nodes):
            return
        second = self.b.nodes.array
        check_on_mesh("b", "node", second, mesh.n_nodes)
        if len(first) != len(second):
            raise ValueError(
                f"a names {len(first)} nodes and b {len(second)}: they are joined one by one. A point of space has "
                "floats, such as (0.0, 0.0, 1.0)."
            )
        if np.any(first == second):
            raise ValueError(f"It joins node {first[first == second][0]} with itself.")

    def distances(self, mesh: Mesh) -> np.ndarray | None:
        """(k,) between the ends at the start; None where JAX traces them."""
        points = self.points
        if not is_concrete(mesh.nodes) or (points is not None and not is_concrete(points)):
            return None
        x = np.asarray(mesh.nodes)
        second = x[self.b.nodes.array] if isinstance(self.b, Nodes) else np.asarray(points)
        return np.linalg.norm(second - x[self.a.nodes.array], axis=1)

    def segments(self, mesh: Mesh) -> np.ndarray:
        x = np.asarray(mesh.nodes)[self.nodes.array]
        ends = x[:, -1] if self.points is None else np.asarray(self.points)
        return np.stack([x[:, 0], ends], axis=1)

    def against(self, rows: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """`holds` of groups whose ends b do something, (k, 6), by their velocity and spin, and ends a the opposite."""
        both = np.concatenate([-rows, rows], axis=1) if self.nodes.array.shape[1] == 2 else rows
        return [(group, row[None]) for group, row in zip(self.nodes.array, both, strict=True) if row.any()]

    @property
    def count(self) -> int | None:
        """How many there are; None where only the name of a set is known."""
        return size_of(self.a.nodes)


def nodes_of(name: str, given: Any) -> Nodes:
    """As `end_of`, of an end that is nodes."""
    found = end_of(name, given)
    if not isinstance(found, Nodes):
        raise ValueError(f"{name} must be a node, a list of nodes or the name of a set, but it is {shown(given)}.")
    return found


def check_each(name: str, value: Float[Array, "..."], count: int | None, allow_zero: bool = True) -> None:
    """Raise ValueError unless `value` is one number or one for each of `count`, none of them negative."""
    check_positive(name, value, allow_zero=allow_zero)
    check_shape_of_each(name, value, count)


def check_shape_of_each(name: str, value: Float[Array, "..."], count: int | None) -> None:
    """Raise ValueError unless `value` is one number or one for each of `count`."""
    if value.ndim > 1 or (count is not None and value.shape not in ((), (count,))):
        raise ValueError(f"{name} must be one value or one for each of {count}, but it has shape {value.shape}.")


def given_motion(motion: Any, history: History | None) -> tuple[Array | None, History | None]:
    """How anchors move: a displacement (3,) times a history; (None, None) where they stand.

    Raises ValueError for one without the other.
    """
    if (motion is None) != (history is None):
        raise ValueError("What moves needs both motion, its displacement (3,), and the history that scales it.")
    if motion is None:
        return None, None
    check_kind("history", history, History, "a jaxshell.History or None")
    vector = float_array(motion, "motion")
    check_shape("motion", vector, (3,))
    check_finite("motion", vector)
    return vector, history
