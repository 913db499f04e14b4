"""What every connector is to a scene and to scene files."""

from typing import cast

import numpy as np

from jaxshell.model.items import Item
from jaxshell.model.mesh import Mesh


class Connector(Item):
    """What joins nodes with each other or with points of space."""

    def placed(self, mesh: Mesh, number: int) -> tuple["Connector", Mesh]:
        """The connector with numbers in place of names, and the mesh with what it needs besides; `number` is its own.

        Called when the scene is made.
        """
        return cast(Connector, self.on(mesh)), mesh

    @property
    def turning(self) -> np.ndarray:
        """The nodes whose rotations mean something to it: of other points they are held."""
        return np.zeros(0, int)
