"""jaxshell: a differentiable solver for the nonlinear dynamics of thin shells with finite rotations, in JAX.

A name is imported when it is first used (PEP 562): `jaxshell --help` need not wait for JAX.
"""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jaxshell import scenes
    from jaxshell.arc_length import solve_arc_length
    from jaxshell.driver import SimulationError
    from jaxshell.linear_solver import KLU, Dense, Pardiso
    from jaxshell.loads import EdgeForce, Gravity, History, NodalForce, NodalMoment, NormalForce, Pressure
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
    from jaxshell.output import Output
    from jaxshell.scene import Initial, Scene
    from jaxshell.sections import Section
    from jaxshell.simulation import simulate
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
    "NormalForce",
    "Output",
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

_HOMES = {
    "arc_length": ["solve_arc_length"],
    "driver": ["SimulationError"],
    "linear_solver": ["KLU", "Dense", "Pardiso"],
    "loads": ["EdgeForce", "Gravity", "History", "NodalForce", "NodalMoment", "NormalForce", "Pressure"],
    "mesh": ["Mesh", "structured_triangles"],
    "methods": [
        "HHT",
        "Bathe",
        "CentralDifference",
        "EnergyMomentum",
        "GeneralizedAlpha",
        "GeneralizedEnergyMomentum",
        "Newmark",
    ],
    "modal": ["BucklingModes", "Modes", "linear_buckling", "natural_frequencies"],
    "newton": ["Newton"],
    "output": ["Output"],
    "scene": ["Initial", "Scene"],
    "scenes": ["scenes"],
    "sections": ["Section"],
    "simulation": ["simulate"],
    "solution": ["RESULTS", "Energy", "Momentum", "Solution"],
    "statics": ["reactions", "solve_static"],
    "step_control": ["StepControl"],
    "supports": ["Support", "clamped", "pinned", "symmetry"],
}
"""The public names by their modules. None but `scenes` is a module's own name: importing a module sets that name."""

if not TYPE_CHECKING:  # a type checker that saw `__getattr__` would take every name for known

    def __getattr__(name):
        for home, names in _HOMES.items():
            if name in names:
                module = importlib.import_module(f"jaxshell.{home}")
                globals()[name] = found = module if name == home else getattr(module, name)
                return found
        raise AttributeError(f"module 'jaxshell' has no attribute {name!r}")

    def __dir__():
        return sorted({*globals(), *__all__})
