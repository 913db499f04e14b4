"""What every obstacle offers: its parts, its checks, and how scene files write it."""

import abc
from typing import ClassVar

from jaxshell.model.contribution import Contribution
from jaxshell.model.mesh import Mesh
from jaxshell.model.sets import OfSets


class Obstacle(OfSets):
    """A rigid body that nodes of the shell touch from outside."""

    kind: ClassVar[str]
    """Its name in scene files."""

    @abc.abstractmethod
    def parts(self) -> tuple[Contribution, ...]:
        """The contributions that it is made of: the normal force, and friction where it has some."""

    def check(self, mesh: Mesh) -> None:
        """Raise ValueError where it does not fit the mesh; called when the scene is made."""
