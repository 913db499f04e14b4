"""What joins nodes with each other or with points of space; one file each."""

from jaxshell.model.connectors.base import Connector
from jaxshell.model.connectors.rigid_body import RigidBody

CONNECTORS: tuple[type[Connector], ...] = (RigidBody,)
"""All of them, in the order of the manual."""

__all__ = ["CONNECTORS", "Connector", "RigidBody"]
