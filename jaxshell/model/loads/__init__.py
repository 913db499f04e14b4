"""Loads, one kind a file: those with a fixed direction, those that follow the surface, and initial strains."""

from jaxshell.model.history import History
from jaxshell.model.loads.base import DeadLoad, Load
from jaxshell.model.loads.edge import EdgeForce
from jaxshell.model.loads.gravity import Gravity
from jaxshell.model.loads.initial_strain import InitialStrain, InitialStrains, Thermal
from jaxshell.model.loads.nodal import NodalForce, NodalMoment
from jaxshell.model.loads.normal_force import NormalForce
from jaxshell.model.loads.pressure import Pressure

LOADS: tuple[type[Load], ...] = (
    NodalForce,
    NodalMoment,
    EdgeForce,
    Gravity,
    Pressure,
    NormalForce,
    Thermal,
    InitialStrain,
)
"""Every kind that scene files and result files know."""

__all__ = [
    "LOADS",
    "DeadLoad",
    "EdgeForce",
    "Gravity",
    "History",
    "InitialStrain",
    "InitialStrains",
    "Load",
    "NodalForce",
    "NodalMoment",
    "NormalForce",
    "Pressure",
    "Thermal",
]
