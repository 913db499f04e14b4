"""Supports: which displacements and rotations of which nodes are held, or follow a prescribed motion."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxshell.model.history import History
from jaxshell.model.sets import OfSets, SetName, nodes_or_name
from jaxshell.numerics.checks import (
    check_finite,
    check_kind,
    check_number,
    check_shape,
    float_array,
    is_concrete,
    shown,
)
from jaxshell.numerics.directions import across, unit_vector
from jaxshell.numerics.frozen import Frozen

DOFS = ("ux", "uy", "uz", "rx", "ry", "rz")
ALL = DOFS
TURNS = DOFS[3:]


class Support(OfSets):
    """Hold degrees of freedom of nodes, in global axes or in others, or move them as a history says.

    Arguments:
        nodes: node indices, or the name of a set.
        dofs: names out of ux, uy, uz (displacements) and rx, ry, rz (rotations about the global axes); None is all six,
            or, with `rotation`, what that prescribes. A rotation that is held is left out of every step's turn. Where
            ONE is held and a node turns about both others, where that leads depends on the steps, with the second
            order of the turn: hold two (a hinge) or three.
        displacement: prescribed displacement [length], scalar or one per entry of `dofs`; multiplied by
            `history`. None holds the degrees of freedom where they are. Only for ux, uy, uz. Differentiable.
        history: how the prescribed motion varies in time (statics goes by the load factor instead); zero at
            time 0, where runs start, or the support would jump. Of an acceleration it may start anywhere.
        rotation: (3,) an axis, of any length but zero: all three rotations of the nodes are prescribed, a finite turn
            by the angle `angle` times `history` about this fixed direction, by the right-hand rule. Displacements
            among `dofs` are held. Differentiable.
        angle: [rad], of any size, multiplied by `history`; None is 1, so that the history is the angle. Differentiable.
        about: (3,) a point of the axis: the nodes' displacements are prescribed too, x(t) = c + R(t) (x(0) - c). The
            nodes turn as one rigid body, a hub. Without it each node turns in its place. Differentiable.
        acceleration: prescribed acceleration [length/time²], scalar or one per entry of `dofs`; multiplied by
            `history`. The displacement is the double integral of this record, from rest at time 0, exact for what is
            linear between the samples (`History.double_integral`): one in space, with whatever drift the record has.
            The last sample lasts: end a record with zero. In statics, where there is no time, the degrees of freedom
            are held. Only for ux, uy, uz. Differentiable.
        axes: (3, 3) unit vectors, row by row, along which `dofs` and their values are meant in place of x, y and z: a
            slanted support. They stay as they are. All supports of a node have the same. Differentiable.
        normal: (3,) in place of axes: "x" is along it, and "y" and "z" are across, wherever that is.

    A step may turn nodes by less than half a turn; `simulate` refuses longer ones. Nodes that have a velocity at time 0
    (a slope of the history there) have it from the start, whatever the scene's `Initial` says of them. Every other kink
    of a history is a blow, after which the velocities of the moved nodes swing about those of the history; histories
    that are smooth, or have samples in every step, give none.

    Raises ValueError for unknown names, empty selections, an axis of zero length, prescribed motions that do not fit
    each other or `dofs`, and histories that do not start from zero.
    """

    sets: ClassVar[dict[str, str]] = {"nodes": "node"}

    nodes: Frozen | SetName = eqx.field(static=True)
    dofs: tuple[str, ...] = eqx.field(static=True)
    displacement: Float[jax.Array, "*d"] | None
    history: History | None
    rotation: Float[jax.Array, "3"] | None
    angle: Float[jax.Array, ""] | None
    about: Float[jax.Array, "3"] | None
    acceleration: Float[jax.Array, "*d"] | None
    axes: Float[jax.Array, "3 3"] | None

    def __init__(
        self,
        nodes,
        dofs=None,
        displacement=None,
        history=None,
        *,
        rotation=None,
        angle=None,
        about=None,
        acceleration=None,
        axes=None,
        normal=None,
    ):
        self.nodes = nodes_or_name("support nodes", nodes)
        if dofs is None:
            dofs = ALL if rotation is None or about is not None else TURNS
        if not isinstance(dofs, str | list | tuple):
            raise ValueError(f"A support's dofs must be names out of {', '.join(DOFS)}, but are {shown(dofs)}.")
        self.dofs = (dofs,) if isinstance(dofs, str) else tuple(dofs)
        if history is not None:
            check_kind("A support's history", history, History, "a jaxshell.History or None")
        given = {"displacement": displacement, "rotation": rotation, "acceleration": acceleration}
        given = [name for name, value in given.items() if value is not None]
        if len(given) > 1:
            raise ValueError(f"A support has one motion, but this one has {' and '.join(given)}: make one for each.")
        if given and history is None:
            raise ValueError(f"A prescribed {given[0]} needs a history (jaxshell.History) that says when it acts.")
        if history is not None and not given:
            raise ValueError(
                "A support with a history needs the displacement, rotation or acceleration that the history scales."
            )
        for name, value in (("angle", angle), ("about", about)):
            if value is not None and rotation is None:
                raise ValueError(f"A support's {name} belongs to a rotation: give its axis as rotation=(x, y, z).")
        if rotation is not None and angle is None:
            angle = 1.0

        def floats(name, value):
            return None if value is None else float_array(value, f"prescribed {name}")

        self.displacement, self.acceleration = (
            floats("displacement", displacement),
            floats("acceleration", acceleration),
        )
        self.rotation, self.angle = floats("rotation", rotation), floats("angle", angle)
        self.about = None if about is None else float_array(about, "A rotation's about")
        self.history = history
        self.axes = _axes(axes, normal)

    def __check_init__(self):
        if self.axes is not None and self.rotation is not None:
            raise ValueError("A prescribed rotation has an axis of its own: leave the support's axes out.")
        if not self.dofs:
            raise ValueError("A support must hold at least one of " + ", ".join(DOFS) + ".")
        for name in self.dofs:
            if not isinstance(name, str) or name not in DOFS:
                raise ValueError(
                    f"A support holds {shown(name)}, which does not exist. Choose out of {', '.join(DOFS)}."
                )
        if len(set(self.dofs)) < len(self.dofs):
            raise ValueError(f"A support names a degree of freedom twice: {', '.join(self.dofs)}.")
        if self.displacement is not None:
            self._check_straight("displacement", self.displacement)
        if self.acceleration is not None:
            self._check_straight("acceleration", self.acceleration)
        if self.rotation is not None:
            self._check_rotation()
        if self.history is not None and self.acceleration is None:
            _check_starts("rotation" if self.displacement is None else "displacement", self.history)

    def _check_straight(self, what: str, value) -> None:
        """Of a displacement or an acceleration."""
        check_finite(f"prescribed {what}", value)
        known = [()] if isinstance(self.nodes, SetName) else [self.dof_numbers.shape]
        if value.shape not in ((), (len(self.dofs),), *known):
            raise ValueError(
                f"prescribed {what} must be one value or one for each of {', '.join(self.dofs)}, but it has "
                f"shape {value.shape}."
            )
        turning = [name for name in self.dofs if name in TURNS]
        if turning:
            raise ValueError(
                f"Only displacements can be prescribed, but the support names {', '.join(turning)}: turn nodes with "
                "rotation=(x, y, z), hold rotations by another support."
            )

    def _check_rotation(self) -> None:
        check_shape("A rotation's axis", self.rotation, (3,))
        check_finite("A rotation's axis", self.rotation)
        if is_concrete(self.rotation) and not np.any(np.asarray(self.rotation)):
            raise ValueError("A rotation's axis has zero length: give a direction such as (0, 0, 1).")
        check_number("A rotation's angle", self.angle)
        wanted = TURNS
        if self.about is not None:
            check_shape("A rotation's about", self.about, (3,))
            check_finite("A rotation's about", self.about)
            wanted = ALL
        absent = [name for name in wanted if name not in self.dofs]
        if absent:
            reason = "" if self.about is None else " about a point"
            raise ValueError(
                f"A prescribed rotation{reason} moves {', '.join(wanted)}, but the support's dofs lack "
                f"{', '.join(absent)}: leave dofs out."
            )

    @property
    def moves(self) -> bool:
        """Whether it has a prescribed motion."""
        return self.history is not None

    @property
    def moves_with_load(self) -> bool:
        """Whether its motion is in proportion to the load factor in statics, which knows no accelerations."""
        return self.displacement is not None or self.rotation is not None

    @property
    def dof_numbers(self) -> np.ndarray:
        """(k, d) numbers 6·node + dof of the degrees of freedom held."""
        return 6 * self.nodes.array[:, None] + np.array([DOFS.index(name) for name in self.dofs])

    def values(self, time) -> Float[jax.Array, "k d"]:
        """(k, d) prescribed displacements at `time`, of a support with `displacement`; else zero."""
        shape = self.dof_numbers.shape
        if self.displacement is None or self.history is None:
            return jnp.zeros(shape)
        return jnp.broadcast_to(self.displacement, shape) * self.history(time)


def _axes(axes, normal) -> Float[jax.Array, "3 3"] | None:
    """Rows along which a slanted support holds; None where it is none. Raises ValueError for what are no axes."""
    if axes is None and normal is None:
        return None
    if axes is not None and normal is not None:
        raise ValueError("A support has axes or a normal, not both.")
    if axes is None:
        normal = unit_vector(normal, "A support's normal")
        return across(normal)
    axes = float_array(axes, "A support's axes")
    check_shape("A support's axes", axes, (3, 3))
    check_finite("A support's axes", axes)
    if is_concrete(axes):
        error = np.abs(np.asarray(axes) @ np.asarray(axes).T - np.eye(3)).max()
        if error > _ORTHOGONAL or np.linalg.det(np.asarray(axes)) < 0:
            raise ValueError(
                "A support's axes must be three unit vectors, row by row, at right angles and right-handed, but they "
                f"are {np.asarray(axes).tolist()}."
            )
    return axes


_ORTHOGONAL = 1e-8


def slanted_axes(supports) -> tuple[np.ndarray, Float[jax.Array, "s 3 3"]]:
    """(s,) nodes with axes of their own, ascending, and their axes as columns.

    Raises ValueError for a node that two supports hold along different axes.
    """
    found: dict[int, tuple[int, Float[jax.Array, "3 3"] | None]] = {}
    for position, support in enumerate(supports):
        for node in support.nodes.array.tolist():
            first, axes = found.setdefault(node, (position, support.axes))
            if axes is support.axes or _same(axes, support.axes):
                continue
            raise ValueError(f"supports {first} and {position} hold node {node} along different axes: give them one.")
    nodes = sorted(node for node, (_, axes) in found.items() if axes is not None)
    columns = [jnp.swapaxes(found[node][1], 0, 1) for node in nodes]  # pyright: ignore[reportArgumentType]
    return np.array(nodes, int), jnp.stack(columns) if nodes else jnp.zeros((0, 3, 3))


def _same(first, second) -> bool:
    if first is None or second is None:
        return False
    return not (is_concrete(first) and is_concrete(second)) or np.array_equal(np.asarray(first), np.asarray(second))


def _check_starts(what: str, history: History) -> None:
    """Raise ValueError for a history of a motion that is not where the nodes are at time 0."""
    if not (is_concrete(history.times) and is_concrete(history.values)):
        return
    first = float(np.interp(0.0, np.asarray(history.times), np.asarray(history.values)))
    if first != 0.0:
        raise ValueError(
            f"The history of a prescribed {what} must be zero at time 0, but it is {first:g}: the support would jump. "
            "Start with a ramp, or put the nodes where they begin."
        )


def clamped(nodes) -> Support:
    """All six degrees of freedom of the nodes held."""
    return Support(nodes, ALL)


def pinned(nodes) -> Support:
    """The displacements of the nodes held, their rotations free."""
    return Support(nodes, ("ux", "uy", "uz"))


def symmetry(nodes, normal) -> Support:
    """Nodes in a plane of symmetry with the given normal: "x", "y", "z", or a vector (3,)."""
    held = {"x": ("ux", "ry", "rz"), "y": ("uy", "rx", "rz"), "z": ("uz", "rx", "ry")}
    if isinstance(normal, str):
        if normal not in held:
            raise ValueError(f"normal must be 'x', 'y', 'z' or a vector (3,), but it is {shown(normal)}.")
        return Support(nodes, held[normal])
    return Support(nodes, held["x"], normal=normal)
