"""jaxshell: a differentiable solver for the nonlinear dynamics of thin shells with finite rotations, in JAX."""

from jaxshell import scenes
from jaxshell.arc_length import solve_arc_length
from jaxshell.linear_solver import KLU, Dense, Pardiso
from jaxshell.loads import EdgeForce, Gravity, History, NodalForce, NodalMoment, Pressure
from jaxshell.mesh import Mesh, structured_triangles
from jaxshell.methods import (
    HHT,
    Bathe,
    CentralDifference,
    EnergyMomentum,
    GeneralizedAlpha,
    GeneralizedEnergyMomentum,
    Newmark,
)
from jaxshell.modal import BucklingModes, Modes, linear_buckling, natural_frequencies
from jaxshell.newton import Newton
from jaxshell.scene import Initial, Scene
from jaxshell.section import Section
from jaxshell.simulate import SimulationError, simulate
from jaxshell.solution import RESULTS, Energy, Momentum, Solution
from jaxshell.statics import reactions, solve_static
from jaxshell.step_control import StepControl
from jaxshell.supports import Support, clamped, pinned, symmetry

__all__ = [
    "HHT",
    "KLU",
    "RESULTS",
    "Bathe",
    "BucklingModes",
    "CentralDifference",
    "Dense",
    "EdgeForce",
    "Energy",
    "EnergyMomentum",
    "GeneralizedAlpha",
    "GeneralizedEnergyMomentum",
    "Gravity",
    "History",
    "Initial",
    "Mesh",
    "Modes",
    "Momentum",
    "Newmark",
    "Newton",
    "NodalForce",
    "NodalMoment",
    "Pardiso",
    "Pressure",
    "Scene",
    "Section",
    "SimulationError",
    "Solution",
    "StepControl",
    "Support",
    "clamped",
    "linear_buckling",
    "natural_frequencies",
    "pinned",
    "reactions",
    "scenes",
    "simulate",
    "solve_arc_length",
    "solve_static",
    "structured_triangles",
    "symmetry",
]
