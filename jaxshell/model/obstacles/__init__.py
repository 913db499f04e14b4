"""What the shell touches: rigid obstacles; one file each."""

from jaxshell.model.obstacles.base import Obstacle
from jaxshell.model.obstacles.box import Box
from jaxshell.model.obstacles.cylinder import Cylinder
from jaxshell.model.obstacles.plane import Plane
from jaxshell.model.obstacles.sphere import Sphere

OBSTACLES: tuple[type[Obstacle], ...] = (Plane, Sphere, Cylinder, Box)
"""All of them, in the order of the manual."""

__all__ = ["OBSTACLES", "Box", "Cylinder", "Obstacle", "Plane", "Sphere"]
