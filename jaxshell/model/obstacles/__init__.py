"""What the shell touches: rigid obstacles; one file each."""

from jaxshell.model.obstacles.base import Obstacle

OBSTACLES: tuple[type[Obstacle], ...] = ()
"""All of them, in the order of the manual."""

__all__ = ["OBSTACLES", "Obstacle"]
