"""The scenes of the benchmarks, and their plain description for programs that know nothing of jaxshell."""

from pathlib import Path

import numpy as np

import jaxshell as js

SCENES = {
    "cap": js.scenes.spherical_cap,
    "opened_cap": js.scenes.opened_cap,
    "plate": js.scenes.free_plate,
    # A scene for trying the benchmarks themselves.
    "tiny": lambda divisions=3: js.scenes.spherical_cap(divisions),
}


def write_case(scene: js.Scene, path: Path) -> Path:
    """Nodes, triangles, section (scalars), held degrees of freedom and nodal loads with their histories, as npz."""
    triangles = scene.mesh.connectivity.array
    section = scene.section
    mass_per_area = np.full(len(triangles), float(section.thickness) * float(section.density))
    patterns, histories = [], {}
    for k, load in enumerate(scene.loads):
        patterns.append(load.nodal(scene.mesh.nodes, triangles, mass_per_area))
        histories[f"history_{k}_times"] = np.atleast_1d(load.history.times)
        histories[f"history_{k}_values"] = np.atleast_1d(load.history.values)
    np.savez(
        path,
        nodes=scene.mesh.nodes,
        triangles=triangles,
        **{n: getattr(section, n) for n in ("thickness", "young_modulus", "poisson_ratio", "density")},
        held=scene.held_dofs,
        load_patterns=np.array(patterns),
        **histories,
    )
    return path
