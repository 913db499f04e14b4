"""Torsion springs between the rotations of two nodes, or of a node and space."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.connectors.ends import Link, Nodes, Space, check_each, check_shape_of_each, nodes_of
from jaxshell.model.connectors.torsion import LIMIT, TorsionDamping, TorsionStiffness
from jaxshell.model.contribution import Contribution
from jaxshell.model.mesh import Mesh
from jaxshell.numerics.checks import check_finite, float_array, is_concrete


class TorsionSpring(Link):
    """Springs between the rotations of nodes about an axis: a moment k(φ - φ₀) turns b back against a.

    Arguments:
        a: a node, a list of nodes, or the name of a set of them; the axis turns with it.
        b: as many nodes, joined with those of `a` one by one; None or "space" is space: `a` turns against that.
        axis: (3,) or (k, 3) in global components where nothing has turned; of any length. Differentiable.
        stiffness: k [force·length/rad], one value or one for each. Differentiable.
        angle: φ₀ [rad] without moment, within 3.1 to either side, one value or one for each. Differentiable.
        damping: c [force·length·time/rad] of a moment c dφ/dt besides; None is none. Differentiable.
        name: by which it is watched: "angle" at the end of a step, "moment" (k(φ - φ₀) there, and c dφ/dt of the mean
            rate of the step), and "energy".

    The angle φ is the twist of b against a about the axis, right-handed (of a against space where b is None): 0 where
    both have turned alike. Where the nodes tilt against each other too, the relative rotation is a tilt about an axis
    across, and a twist. It is told within half a turn: beyond 3.1 rad to either side the moment is NaN, and the step
    fails rather than the angle jumps.

    The energy ½k(φ - φ₀)² counts with the strain energy, what the damping takes as dissipated. `EnergyMomentum` has
    both to round-off, at any tilt; two nodes get moments against each other, and the angular momentum stays.
    """

    kind: ClassVar[str] = "torsion spring"

    a: Nodes
    b: Nodes | Space
    axis: Float[Array, "*k 3"]
    stiffness: Float[Array, "*k"]
    angle: Float[Array, "*k"]
    damping: Float[Array, "*k"] | None

    def __init__(self, a, b, axis, stiffness, angle=0.0, damping=None, name: str | None = None):
        self.a = nodes_of("a", a)
        in_space = b is None or isinstance(b, Space) or (isinstance(b, str) and b == "space")
        self.b = Space() if in_space else nodes_of("b", b)
        self.axis = float_array(axis, "axis")
        self.stiffness, self.angle = float_array(stiffness, "stiffness"), float_array(angle, "angle")
        self.damping = None if damping is None else float_array(damping, "damping")
        self.name = name

    def __check_init__(self):
        check_axis(self.axis, self.count)
        check_each("stiffness", self.stiffness, self.count)
        if self.damping is not None:
            check_each("damping", self.damping, self.count)
        check_shape_of_each("angle", self.angle, self.count)
        check_finite("angle", self.angle)
        if is_concrete(self.angle) and np.any(np.abs(np.asarray(self.angle)) > LIMIT):
            raise ValueError(f"angle must lie within {LIMIT} rad to either side, but it is {np.asarray(self.angle)}.")

    @property
    def turning(self) -> np.ndarray:
        return self.nodes.array.ravel()

    def holds(self, mesh: Mesh) -> list[tuple[np.ndarray, np.ndarray]]:
        """The twist about each axis that is stiff."""
        axis = np.broadcast_to(np.asarray(self.axis), (len(self.a.nodes.array), 3))
        turns = axis / np.linalg.norm(axis, axis=1, keepdims=True) * (np.asarray(self.stiffness) > 0)[..., None]
        return self.against(np.concatenate([np.zeros_like(turns), turns], axis=1))

    def parts(self) -> tuple[Contribution, ...]:
        axis = jnp.broadcast_to(self.axis, (len(self.a.nodes.array), 3))
        found: tuple[Contribution, ...] = (TorsionStiffness(self.nodes, axis, self.stiffness, self.angle),)
        return found if self.damping is None else (*found, TorsionDamping(self.nodes, axis, self.damping))


def check_axis(axis: Float[Array, "*k 3"], count: int | None) -> None:
    """Raise ValueError for an axis of no length, and for another number of them than one or `count`."""
    check_finite("axis", axis)
    if axis.shape != (3,) and (axis.ndim != 2 or axis.shape[1] != 3 or count not in (None, axis.shape[0])):
        raise ValueError(f"axis must have shape (3,) or ({count}, 3), but it has shape {axis.shape}.")
    if is_concrete(axis):
        long = np.linalg.norm(np.asarray(axis), axis=-1) > 0
        if not np.all(long):
            raise ValueError("axis must have a length, but it is (0, 0, 0).")
