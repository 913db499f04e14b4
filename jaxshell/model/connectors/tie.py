"""Ties of single degrees of freedom."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.connectors.joint import Conditions, Joint, named
from jaxshell.model.connectors.slider import Locked
from jaxshell.model.contribution import Contribution, Place
from jaxshell.model.sets import SetName, nodes_or_name
from jaxshell.numerics.checks import shown
from jaxshell.numerics.frozen import Frozen

_ROTATIONS = ("rx", "ry", "rz")
_DOFS = ("ux", "uy", "uz", *_ROTATIONS)


class Tie(Joint):
    """Displacements of two nodes along global axes that stay equal, and rotations.

    Arguments:
        a, b: nodes, or names of sets, tied one by one; they may be apart.
        dofs: out of ux, uy, uz, one or several; rx, ry, rz all three, since finite rotations about single axes have no
            meaning (see `Hinge`).
        name: what watches call it.

    Enforced by multipliers: exact at the ends of steps. It does no work and keeps linear momentum (`EnergyMomentum`);
    angular momentum too where the nodes are in one place and all three displacements are tied. Raises ValueError for
    unknown names and for single rotations.
    """

    kind: ClassVar[str] = "tie"
    joins_places: ClassVar[bool] = False

    a: Frozen | SetName = eqx.field(static=True)
    b: Frozen | SetName = eqx.field(static=True)
    dofs: tuple[str, ...] = eqx.field(static=True)

    def __init__(self, a, b, dofs=_DOFS, name: str | None = None):
        self.a, self.b = nodes_or_name("tie a", a), nodes_or_name("tie b", b)
        self.dofs = (dofs,) if isinstance(dofs, str) else tuple(dofs)
        self.name = named(self.kind, name)

    def __check_init__(self):
        strange = [dof for dof in self.dofs if dof not in _DOFS]
        if strange or not self.dofs or len(set(self.dofs)) < len(self.dofs):
            raise ValueError(f"A tie's dofs must be names out of {', '.join(_DOFS)}, but are {shown(list(self.dofs))}.")
        if self._turns and not set(_ROTATIONS) <= set(self.dofs):
            raise ValueError(f"A tie has all of {', '.join(_ROTATIONS)} or none, but has {', '.join(self.dofs)}.")

    @property
    def _turns(self) -> bool:
        return bool(set(_ROTATIONS) & set(self.dofs))

    @property
    def turning(self) -> np.ndarray:
        return self.pairs.array.ravel() if self._turns else np.zeros(0, int)

    def parts(self) -> tuple[Contribution, ...]:
        axes = tuple(axis for axis, dof in enumerate(_DOFS[:3]) if dof in self.dofs)
        moved = (Alike(self.pairs, axes),) if axes else ()
        return (*moved, Locked(self.pairs)) if self._turns else moved


class Alike(Conditions):
    """Two nodes with equal displacements along some global axes."""

    axes: tuple[int, ...] = eqx.field(static=True)

    @property
    def count(self) -> int:
        return len(self.axes)

    def data(self, surface) -> Float[Array, "k 3"]:
        x = surface.x0[self.nodes.array]
        return x[:, 1] - x[:, 0]

    def conditions(self, data, place: Place) -> Float[Array, " p"]:
        return (place.x[1] - place.x[0] - data)[jnp.array(self.axes)]
