"""The library of scenes: each function returns a `jaxshell.Scene` with the literature's geometry and loads."""

from jaxshell.scenes.paper import free_plate, opened_cap, spherical_cap

PAPER = {"cap": spherical_cap, "plate": free_plate, "opened_cap": opened_cap}
"""The scenes of Yang & Xia 2014, under the names that the command line uses."""

__all__ = ["PAPER", "free_plate", "opened_cap", "spherical_cap"]
