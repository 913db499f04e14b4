"""The library of scenes: functions that return a `jaxshell.Scene` with the literature's geometry."""

import inspect
from collections.abc import Callable

from jaxshell.model.scene import Scene
from jaxshell.scenes.driven import dropped_tray, shaken_plate, tape_spring
from jaxshell.scenes.dynamic import (
    flying_cylinder,
    l_shaped_plate,
    snapping_panel,
    spinning_plate,
    suddenly_loaded_cap,
)
from jaxshell.scenes.joined import spun_blade, unfolding_panel
from jaxshell.scenes.paper import free_plate, opened_cap, spherical_cap
from jaxshell.scenes.static import (
    cantilever_end_moment,
    cantilever_end_shear,
    cylinder_pull_out,
    hemisphere,
    hinged_roof,
    pinched_cylinder,
    pinched_semi_cylinder,
    slit_annular_plate,
    twisted_beam,
)

PAPER = {"cap": spherical_cap, "plate": free_plate, "opened_cap": opened_cap}
"""The scenes of Yang & Xia 2014, under the names that the command line uses."""

BY_NAME: dict[str, Callable[..., Scene]] = PAPER | {
    make.__name__: make
    for make in (flying_cylinder, l_shaped_plate, snapping_panel, spinning_plate, suddenly_loaded_cap)
}
BY_NAME |= {make.__name__: make for make in (dropped_tray, tape_spring, shaken_plate)}
BY_NAME |= {make.__name__: make for make in (spun_blade, unfolding_panel)}
"""The scenes that the command line runs by name: the paper's, and the library's others that move."""


def default_divisions(make: Callable) -> int | tuple[int, ...]:
    """The divisions of the mesh that a function of the library takes by default."""
    return inspect.signature(make).parameters["divisions"].default


__all__ = [
    "BY_NAME",
    "PAPER",
    "cantilever_end_moment",
    "cantilever_end_shear",
    "cylinder_pull_out",
    "default_divisions",
    "dropped_tray",
    "flying_cylinder",
    "free_plate",
    "hemisphere",
    "hinged_roof",
    "l_shaped_plate",
    "opened_cap",
    "pinched_cylinder",
    "pinched_semi_cylinder",
    "shaken_plate",
    "slit_annular_plate",
    "snapping_panel",
    "spherical_cap",
    "spinning_plate",
    "spun_blade",
    "suddenly_loaded_cap",
    "tape_spring",
    "twisted_beam",
    "unfolding_panel",
]
