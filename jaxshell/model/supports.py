"""Supports: which displacements and rotations of which nodes are held, or follow a prescribed motion."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxshell.model.history import History
from jaxshell.model.sets import OfSets, SetName, nodes_or_name
from jaxshell.numerics.checks import check_finite, check_kind, float_array, is_concrete, shown
from jaxshell.numerics.frozen import Frozen

DOFS = ("ux", "uy", "uz", "rx", "ry", "rz")
ALL = DOFS


class Support(OfSets):
    """Hold degrees of freedom of nodes, in global axes.

    Arguments:
        nodes: node indices, or the name of a set.
        dofs: names out of ux, uy, uz (displacements) and rx, ry, rz (rotations about the global axes). A rotation
            that is held is left out of every step's turn. Where ONE is held and a node turns about both others,
            where that leads depends on the steps, with the second order of the turn: hold two (a hinge) or three.
        displacement: prescribed displacement [length], scalar or one per entry of `dofs`; multiplied by
            `history`. None holds the degrees of freedom where they are. Only for ux, uy, uz. Differentiable.
        history: how the prescribed displacement varies in time (statics goes by the load factor instead); zero at
            time 0, where runs start, or the support would jump.

    Raises ValueError for unknown names, empty selections, prescribed rotations, and histories that do not start
    from zero.
    """

    sets: ClassVar[dict[str, str]] = {"nodes": "node"}

    nodes: Frozen | SetName = eqx.field(static=True)
    dofs: tuple[str, ...] = eqx.field(static=True)
    displacement: Float[jax.Array, "*d"] | None
    history: History | None

    def __init__(self, nodes, dofs=ALL, displacement=None, history=None):
        self.nodes = nodes_or_name("support nodes", nodes)
        if not isinstance(dofs, str | list | tuple):
            raise ValueError(f"A support's dofs must be names out of {', '.join(DOFS)}, but are {shown(dofs)}.")
        self.dofs = (dofs,) if isinstance(dofs, str) else tuple(dofs)
        if history is not None:
            check_kind("A support's history", history, History, "a jaxshell.History or None")
        if displacement is not None and history is None:
            raise ValueError("A prescribed displacement needs a history (jaxshell.History) that says when it acts.")
        if history is not None and displacement is None:
            raise ValueError("A support with a history needs the displacement that the history scales.")
        self.displacement = None if displacement is None else float_array(displacement, "prescribed displacement")
        self.history = None if displacement is None else history

    def __check_init__(self):
        if not self.dofs:
            raise ValueError("A support must hold at least one of " + ", ".join(DOFS) + ".")
        for name in self.dofs:
            if not isinstance(name, str) or name not in DOFS:
                raise ValueError(
                    f"A support holds {shown(name)}, which does not exist. Choose out of {', '.join(DOFS)}."
                )
        if len(set(self.dofs)) < len(self.dofs):
            raise ValueError(f"A support names a degree of freedom twice: {', '.join(self.dofs)}.")
        if self.displacement is not None and self.history is not None:
            check_finite("prescribed displacement", self.displacement)
            known = [()] if isinstance(self.nodes, SetName) else [self.dof_numbers.shape]
            if self.displacement.shape not in ((), (len(self.dofs),), *known):
                raise ValueError(
                    f"prescribed displacement must be one value or one for each of {', '.join(self.dofs)}, but it has "
                    f"shape {self.displacement.shape}."
                )
            turning = [name for name in self.dofs if name.startswith("r")]
            if turning:
                raise ValueError(f"Only displacements can be prescribed, but the support names {', '.join(turning)}.")
            if is_concrete(self.history.times) and is_concrete(self.history.values):
                first = float(np.interp(0.0, np.asarray(self.history.times), np.asarray(self.history.values)))
                if first != 0.0:
                    raise ValueError(
                        f"The history of a prescribed displacement must be zero at time 0, but it is {first:g}: the "
                        "support would jump. Start with a ramp, or put the nodes where they begin."
                    )

    @property
    def dof_numbers(self) -> np.ndarray:
        """(k, d) numbers 6·node + dof of the degrees of freedom held."""
        return 6 * self.nodes.array[:, None] + np.array([DOFS.index(name) for name in self.dofs])

    def values(self, time) -> Float[jax.Array, "k d"]:
        """(k, d) prescribed displacements at `time`."""
        shape = self.dof_numbers.shape
        if self.displacement is None or self.history is None:
            return jnp.zeros(shape)
        return jnp.broadcast_to(self.displacement, shape) * self.history(time)


def clamped(nodes) -> Support:
    """All six degrees of freedom of the nodes held."""
    return Support(nodes, ALL)


def pinned(nodes) -> Support:
    """The displacements of the nodes held, their rotations free."""
    return Support(nodes, ("ux", "uy", "uz"))


def symmetry(nodes, normal: str) -> Support:
    """Nodes in a plane of symmetry with the given normal, "x", "y" or "z"."""
    held = {"x": ("ux", "ry", "rz"), "y": ("uy", "rx", "rz"), "z": ("uz", "rx", "ry")}
    if not isinstance(normal, str) or normal not in held:
        raise ValueError(f"normal must be 'x', 'y' or 'z', but it is {shown(normal)}.")
    return Support(nodes, held[normal])
