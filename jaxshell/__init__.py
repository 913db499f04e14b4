"""jaxshell: a differentiable solver for the nonlinear dynamics of thin shells with finite rotations, in JAX.

A name is imported when it is first used (PEP 562): `jaxshell --help` need not wait for JAX.
"""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jaxshell import gradients, methods, plotting, scenes
    from jaxshell.advice.advise import advise
    from jaxshell.analyses.adapting import Adapted, adapt
    from jaxshell.analyses.arc_length import solve_arc_length
    from jaxshell.analyses.driver import SimulationError
    from jaxshell.analyses.modal import BucklingModes, Modes, linear_buckling, natural_frequencies
    from jaxshell.analyses.richardson import Estimate, Richardson, richardson
    from jaxshell.analyses.settle import settle
    from jaxshell.analyses.simulation import simulate
    from jaxshell.analyses.statics import reactions, solve_static
    from jaxshell.analyses.step_control import StepControl
    from jaxshell.analyses.sweep.run import sweep
    from jaxshell.files.models import read_model
    from jaxshell.gradients import Checkpointed, Stored
    from jaxshell.methods import (
        HHT,
        Bathe,
        CentralDifference,
        EnergyMomentum,
        GeneralizedAlpha,
        GeneralizedEnergyMomentum,
        Newmark,
    )
    from jaxshell.model.connectors import (
        Dashpot,
        Distributed,
        EdgeTie,
        ElasticSupport,
        Hinge,
        RigidBar,
        RigidBody,
        Slider,
        Spherical,
        Spring,
        Tie,
        TorsionSpring,
    )
    from jaxshell.model.damping import RayleighDamping
    from jaxshell.model.grids import structured_triangles
    from jaxshell.model.imperfection import RandomField
    from jaxshell.model.initial import Initial
    from jaxshell.model.loads import (
        Centrifugal,
        DeadPressure,
        EdgeForce,
        EdgeMoment,
        FollowerEdgeForce,
        FollowerForce,
        Gravity,
        History,
        HydrostaticPressure,
        InitialStrain,
        NodalForce,
        NodalMoment,
        NormalForce,
        Pressure,
        Thermal,
        Traction,
    )
    from jaxshell.model.masses import PointMass
    from jaxshell.model.materials import Isotropic, Orthotropic
    from jaxshell.model.mesh import Mesh
    from jaxshell.model.obstacles import Box, Cylinder, Plane, Sphere
    from jaxshell.model.refinement import coarsen, refine
    from jaxshell.model.scene import Scene
    from jaxshell.model.sections import Cylindrical, GeneralSection, Laminate, Ply, Section
    from jaxshell.model.supports import Support, clamped, pinned, symmetry
    from jaxshell.model.surface import CylindricalSurface, FlatSurface, SphericalSurface, TwistedSurface
    from jaxshell.model.with_shape import with_shape
    from jaxshell.numerics.compiled import COMPILER_OPTIONS
    from jaxshell.numerics.kernels import kernels
    from jaxshell.numerics.plane_stress import principal, von_mises
    from jaxshell.results.export.vtkhdf import VTKHDFWriter
    from jaxshell.results.failure import Strengths, failure_index, failure_index_of, ks
    from jaxshell.results.mass_properties import MassProperties, mass_properties
    from jaxshell.results.mesh_errors import MeshErrors, mesh_errors, mesh_errors_of
    from jaxshell.results.output import Output
    from jaxshell.results.penetration import Penetration, penetration
    from jaxshell.results.section_forces import (
        SectionForces,
        SectionStrains,
        section_forces,
        section_forces_of,
        section_strains,
        section_strains_of,
        strain_energies,
    )
    from jaxshell.results.smoothing import nodal, smooth_patches
    from jaxshell.results.solution import RESULTS, Energy, Momentum, Solution
    from jaxshell.results.stresses import stresses, stresses_of
    from jaxshell.results.sweep import Sweep
    from jaxshell.solvers.linear_solver import KLU, Dense, Pardiso
    from jaxshell.solvers.newton import Newton

    __version__: str

__all__ = [
    "COMPILER_OPTIONS",
    "HHT",
    "KLU",
    "RESULTS",
    "Adapted",
    "Bathe",
    "Box",
    "BucklingModes",
    "CentralDifference",
    "Centrifugal",
    "Checkpointed",
    "Cylinder",
    "Cylindrical",
    "CylindricalSurface",
    "Dashpot",
    "DeadPressure",
    "Dense",
    "Distributed",
    "EdgeForce",
    "EdgeMoment",
    "EdgeTie",
    "ElasticSupport",
    "Energy",
    "EnergyMomentum",
    "Estimate",
    "FlatSurface",
    "FollowerEdgeForce",
    "FollowerForce",
    "GeneralSection",
    "GeneralizedAlpha",
    "GeneralizedEnergyMomentum",
    "Gravity",
    "Hinge",
    "History",
    "HydrostaticPressure",
    "Initial",
    "InitialStrain",
    "Isotropic",
    "Laminate",
    "MassProperties",
    "Mesh",
    "MeshErrors",
    "Modes",
    "Momentum",
    "Newmark",
    "Newton",
    "NodalForce",
    "NodalMoment",
    "NormalForce",
    "Orthotropic",
    "Output",
    "Pardiso",
    "Penetration",
    "Plane",
    "Ply",
    "PointMass",
    "Pressure",
    "RandomField",
    "RayleighDamping",
    "Richardson",
    "RigidBar",
    "RigidBody",
    "Scene",
    "Section",
    "SectionForces",
    "SectionStrains",
    "SimulationError",
    "Slider",
    "Solution",
    "Sphere",
    "Spherical",
    "SphericalSurface",
    "Spring",
    "StepControl",
    "Stored",
    "Strengths",
    "Support",
    "Sweep",
    "Thermal",
    "Tie",
    "TorsionSpring",
    "Traction",
    "TwistedSurface",
    "VTKHDFWriter",
    "adapt",
    "advise",
    "clamped",
    "coarsen",
    "failure_index",
    "failure_index_of",
    "gradients",
    "kernels",
    "ks",
    "linear_buckling",
    "mass_properties",
    "mesh_errors",
    "mesh_errors_of",
    "methods",
    "natural_frequencies",
    "nodal",
    "penetration",
    "pinned",
    "plotting",
    "principal",
    "reactions",
    "read_model",
    "refine",
    "richardson",
    "scenes",
    "section_forces",
    "section_forces_of",
    "section_strains",
    "section_strains_of",
    "settle",
    "simulate",
    "smooth_patches",
    "solve_arc_length",
    "solve_static",
    "strain_energies",
    "stresses",
    "stresses_of",
    "structured_triangles",
    "sweep",
    "symmetry",
    "von_mises",
    "with_shape",
]

_HOMES = {
    "advice.advise": ["advise"],
    "analyses.arc_length": ["solve_arc_length"],
    "analyses.driver": ["SimulationError"],
    "solvers.linear_solver": ["KLU", "Dense", "Pardiso"],
    "model.damping": ["RayleighDamping"],
    "model.imperfection": ["RandomField"],
    "model.initial": ["Initial"],
    "model.loads": [
        "Centrifugal",
        "DeadPressure",
        "EdgeForce",
        "EdgeMoment",
        "FollowerEdgeForce",
        "FollowerForce",
        "Gravity",
        "History",
        "HydrostaticPressure",
        "InitialStrain",
        "NodalForce",
        "NodalMoment",
        "NormalForce",
        "Pressure",
        "Thermal",
        "Traction",
    ],
    "model.grids": ["structured_triangles"],
    "model.materials": ["Isotropic", "Orthotropic"],
    "model.mesh": ["Mesh"],
    "files.models": ["read_model"],
    "gradients": ["gradients", "Checkpointed", "Stored"],
    "methods": [
        "methods",
        "HHT",
        "Bathe",
        "CentralDifference",
        "EnergyMomentum",
        "GeneralizedAlpha",
        "GeneralizedEnergyMomentum",
        "Newmark",
    ],
    "analyses.modal": ["BucklingModes", "Modes", "linear_buckling", "natural_frequencies"],
    "solvers.newton": ["Newton"],
    "results.export.vtkhdf": ["VTKHDFWriter"],
    "results.output": ["Output"],
    "numerics.plane_stress": ["principal", "von_mises"],
    "results.failure": ["Strengths", "failure_index", "failure_index_of", "ks"],
    "results.mass_properties": ["MassProperties", "mass_properties"],
    "results.mesh_errors": ["MeshErrors", "mesh_errors", "mesh_errors_of"],
    "results.penetration": ["Penetration", "penetration"],
    "results.section_forces": [
        "SectionForces",
        "SectionStrains",
        "section_forces",
        "section_forces_of",
        "section_strains",
        "section_strains_of",
        "strain_energies",
    ],
    "results.smoothing": ["nodal", "smooth_patches"],
    "results.stresses": ["stresses", "stresses_of"],
    "model.obstacles": ["Box", "Cylinder", "Plane", "Sphere"],
    "model.refinement": ["coarsen", "refine"],
    "model.scene": ["Scene"],
    "plotting": ["plotting"],
    "scenes": ["scenes"],
    "model.sections": ["Cylindrical", "GeneralSection", "Laminate", "Ply", "Section"],
    "analyses.adapting": ["Adapted", "adapt"],
    "analyses.richardson": ["Estimate", "Richardson", "richardson"],
    "analyses.settle": ["settle"],
    "analyses.simulation": ["simulate"],
    "results.sweep": ["Sweep"],
    "numerics.compiled": ["COMPILER_OPTIONS"],
    "numerics.kernels": ["kernels"],
    "results.solution": ["RESULTS", "Energy", "Momentum", "Solution"],
    "analyses.statics": ["reactions", "solve_static"],
    "analyses.step_control": ["StepControl"],
    "analyses.sweep.run": ["sweep"],
    "model.masses": ["PointMass"],
    "model.connectors": [
        "Dashpot",
        "Distributed",
        "EdgeTie",
        "ElasticSupport",
        "Hinge",
        "RigidBar",
        "RigidBody",
        "Slider",
        "Spherical",
        "Spring",
        "Tie",
        "TorsionSpring",
    ],
    "model.supports": ["Support", "clamped", "pinned", "symmetry"],
    "model.with_shape": ["with_shape"],
    "model.surface": ["CylindricalSurface", "FlatSurface", "SphericalSurface", "TwistedSurface"],
}
"""The public names by their modules. A package's own name stands for the package."""

if not TYPE_CHECKING:  # a type checker that saw `__getattr__` would take every name for known

    def __getattr__(name):
        if name == "__version__":
            from jaxshell.version import version

            return version()
        for home, names in _HOMES.items():
            if name in names:
                module = importlib.import_module(f"jaxshell.{home}")
                globals()[name] = found = module if name == home else getattr(module, name)
                return found
        raise AttributeError(f"module 'jaxshell' has no attribute {name!r}")

    def __dir__():
        return sorted({*globals(), *__all__})
