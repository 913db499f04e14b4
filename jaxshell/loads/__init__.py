"""Loads, one kind a file: those with a fixed direction, and those that follow the surface."""

from jaxshell.history import History
from jaxshell.loads.base import DeadLoad, Load
from jaxshell.loads.edge import EdgeForce
from jaxshell.loads.gravity import Gravity
from jaxshell.loads.nodal import NodalForce, NodalMoment
from jaxshell.loads.normal_force import NormalForce
from jaxshell.loads.pressure import Pressure

LOADS: tuple[type[Load], ...] = (NodalForce, NodalMoment, EdgeForce, Gravity, Pressure, NormalForce)
"""Every kind that scene files and result files know."""

__all__ = [
    "LOADS",
    "DeadLoad",
    "EdgeForce",
    "Gravity",
    "History",
    "Load",
    "NodalForce",
    "NodalMoment",
    "NormalForce",
    "Pressure",
]
