"""What every obstacle is to a scene and to scene files."""

from jaxshell.model.items import Item


class Obstacle(Item):
    """A rigid body that nodes of the shell touch from outside.

    Its parts are the normal force, and friction where it has some.
    """
