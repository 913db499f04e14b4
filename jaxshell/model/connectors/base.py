"""What every connector offers: its parts, its checks, and how scene files write it."""

import abc
from typing import ClassVar, cast

import equinox as eqx
import numpy as np

from jaxshell.model.contribution import Contribution
from jaxshell.model.mesh import Mesh
from jaxshell.model.sets import OfSets


class Connector(OfSets):
    """What joins nodes with each other or with points of space."""

    kind: ClassVar[str]
    """Its name in scene files."""
    name: eqx.AbstractVar[str | None]
    """What watches and messages call it."""

    def placed(self, mesh: Mesh, number: int) -> tuple["Connector", Mesh]:
        """The connector with numbers in place of names, and the mesh with what it needs besides; `number` is its own.

        Called when the scene is made.
        """
        return cast(Connector, self.on(mesh)), mesh

    @property
    def turning(self) -> np.ndarray:
        """The nodes whose rotations mean something to it: of other points they are held."""
        return np.zeros(0, int)

    @abc.abstractmethod
    def parts(self) -> tuple[Contribution, ...]:
        """The contributions that it is made of."""

    def check(self, mesh: Mesh) -> None:
        """Raise ValueError where it does not fit the mesh; called when the scene is made."""
