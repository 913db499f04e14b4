"""What joins nodes with each other or with points of space; one file each."""

from jaxshell.model.connectors.base import Connector

CONNECTORS: tuple[type[Connector], ...] = ()
"""All of them, in the order of the manual."""

__all__ = ["CONNECTORS", "Connector"]
