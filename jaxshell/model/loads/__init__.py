"""Loads, one kind a file: those with a fixed direction, those that follow the surface, and initial strains."""

from jaxshell.model.history import History
from jaxshell.model.loads.base import DeadLoad, Load
from jaxshell.model.loads.centrifugal import Centrifugal
from jaxshell.model.loads.edge import EdgeForce, EdgeMoment
from jaxshell.model.loads.follower_edge import FollowerEdgeForce
from jaxshell.model.loads.follower_force import FollowerForce
from jaxshell.model.loads.gravity import Gravity
from jaxshell.model.loads.hydrostatic import HydrostaticPressure
from jaxshell.model.loads.initial_strain import InitialStrain, InitialStrains, Thermal
from jaxshell.model.loads.nodal import NodalForce, NodalMoment
from jaxshell.model.loads.normal_force import NormalForce
from jaxshell.model.loads.pressure import Pressure
from jaxshell.model.loads.traction import DeadPressure, Traction

LOADS: tuple[type[Load], ...] = (
    NodalForce,
    NodalMoment,
    EdgeForce,
    EdgeMoment,
    Gravity,
    Centrifugal,
    Pressure,
    HydrostaticPressure,
    DeadPressure,
    Traction,
    NormalForce,
    FollowerForce,
    FollowerEdgeForce,
    Thermal,
    InitialStrain,
)
"""Every kind that scene files and result files know."""

__all__ = [
    "LOADS",
    "Centrifugal",
    "DeadLoad",
    "DeadPressure",
    "EdgeForce",
    "EdgeMoment",
    "FollowerEdgeForce",
    "FollowerForce",
    "Gravity",
    "History",
    "HydrostaticPressure",
    "InitialStrain",
    "InitialStrains",
    "Load",
    "NodalForce",
    "NodalMoment",
    "NormalForce",
    "Pressure",
    "Thermal",
    "Traction",
]
