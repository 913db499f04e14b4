"""SI units of what is exported; scenes that do not say that they are in SI have none."""

from jaxshell.model.gauge import gauge_of
from jaxshell.model.quantities import QUANTITIES as OF_ITEMS
from jaxshell.model.scene import Scene

QUANTITIES = {
    "time": "s",
    "load factor": "1",
    "length": "m",
    "angle": "rad",
    "velocity": "m/s",
    "N": "N/m",
    "M": "N",
    "stress": "Pa",
    "strain": "1",
    "curvature": "1/m",
    "energy": "J",
    "linear momentum": "kg m/s",
    "angular momentum": "kg m^2/s",
    "force": "N",
    "moment": "N m",
    "index": "1",
    "none": "",
}
"""The unit of each kind of quantity."""


def unit(scene: Scene, quantity: str) -> str:
    """The unit of one of QUANTITIES in the scene; "" where it is not known."""
    return QUANTITIES[quantity] if scene.defaults is not None and scene.defaults.units == "SI" else ""


def with_unit(name: str, scene: Scene, quantity: str) -> str:
    """`name [unit]`, or the name alone."""
    found = unit(scene, quantity)
    return f"{name} [{found}]" if found not in ("", "1") else name


def symbol_of(component: str) -> str:
    """The SI unit of a watched component."""
    return QUANTITIES[watched_quantity(component)]


def watched_quantity(component: str) -> str:
    """The kind of quantity that a watched component is of."""
    if component in OF_ITEMS:
        return OF_ITEMS[component].kind
    gauge = gauge_of(component)
    return {"u": "length", "v": "velocity"}[component[0]] if gauge is None else gauge.quantity
