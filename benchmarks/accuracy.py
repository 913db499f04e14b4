"""The figures of docs/accuracy.md: what the surface and the inertia of an element bring on the same mesh.

    python benchmarks/accuracy.py                          # all tables (some ten minutes), into the page
    python benchmarks/accuracy.py plates                   # some of them

Tables go between the page's markers `<!-- NAME -->` and `<!-- end NAME -->`, and to the screen. Errors are to limits
that the page states. `cost` times whole steps: on a machine that does nothing else.
"""

import dataclasses
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sparse
from scipy.sparse.linalg import spsolve

import jaxshell as js
from benchmarks.pages import table, write
from jaxshell import scenes
from jaxshell.elements import corotational
from jaxshell.elements.element import Element
from jaxshell.elements.shape import Tangents
from jaxshell.model import generators
from jaxshell.model.corner_normals import corner_normals
from jaxshell.model.edges import Edges
from jaxshell.model.sections.isotropic import isotropic
from jaxshell.model.supports import ALL

jax.config.update("jax_enable_x64", True)

PAGE = Path(__file__).parent.parent / "docs" / "accuracy.md"
SHAPES = ("flat", "curved", "relaxed")
FORMS = (("flat", "linear"), ("flat", "cubic"), ("curved", "linear"), ("curved", "cubic"))
CAP = {0.3: -0.1817, 0.5: -0.512, 1.0: -2.540}
"""Limits of the opened cap's displacement A, by extrapolation of the flat element over 24×5, 48×10, 96×20."""


def opened_cap() -> str:
    """A at three times, with EnergyMomentum at Δt = 0.005."""
    rows = []
    for mesh in ((24, 5), (48, 10), (96, 20)):
        for shape, inertia in FORMS:
            scene = js.with_shape(scenes.opened_cap(mesh), shape)
            run = js.simulate(scene, js.EnergyMomentum(inertia=inertia), dt=0.005, t_end=1.0)
            found = [float(run.watched["A"][round(t / 0.005)]) for t in CAP]
            errors = [f"{a:.4f} ({a / b - 1:+.1%})" for a, b in zip(found, CAP.values(), strict=True)]
            rows.append(["×".join(map(str, mesh)), shape, inertia, *errors])
    return table(["mesh", "shape", "inertia", *(f"A({t})" for t in CAP)], rows)


CLAMPED = (35.985, 73.394, 73.394, 108.22, 131.58)
FREE = (13.468, 19.596, 24.270, 34.801, 34.801)


def plates() -> str:
    """Frequencies of square plates, errors in per cent."""
    young, ratio, thickness, density = 1e7, 0.3, 0.005, 2.0
    unit = np.sqrt(young * thickness**2 / (12 * (1 - ratio**2) * density)) / (2 * np.pi)
    rows = []
    for name, exact in (("free", FREE), ("clamped", CLAMPED)):
        for n in (4, 8, 16):
            mesh = generators.rectangle(1.0, 1.0, (n, n))
            edge = mesh.nodes_where(lambda x: np.max(np.abs(x[:2] - 0.5), axis=0) > 0.5 - 1e-9)
            supports = (js.Support(edge, ALL),) if name == "clamped" else ()
            scene = js.Scene(mesh, js.Section(thickness, young, ratio, density), supports)
            for inertia in ("linear", "cubic"):
                found = js.natural_frequencies(scene, 5, rigid_modes=False, inertia=inertia).frequencies
                errors = np.asarray(found) / unit / np.array(exact) - 1
                rows.append([f"{name} {n}×{n}", inertia, *(f"{100 * e:+.2f}" for e in errors)])
    return table(["plate", "inertia", "1", "2", "3", "4", "5"], rows)


def held_cap(divisions, thickness) -> js.Scene:
    """The opened cap, with its motions as a rigid body held: they move nothing else."""
    scene = scenes.opened_cap(divisions, thickness=thickness)
    x = np.asarray(scene.mesh.nodes)
    rim = np.flatnonzero(x[:, 2] < x[:, 2].min() + 1e-9)
    near = [int(rim[np.argmin(np.linalg.norm(x[rim, :2] / 10 - to, axis=1))]) for to in ((1, 0), (-1, 0), (0, 1))]
    more = js.Support(near[:2], "uy"), js.Support(near[2:], "ux")
    return dataclasses.replace(scene, supports=(*scene.supports, *more))


def static_cases() -> list[tuple]:
    """(name, limit of the first watched deflection under the scene's loads if all were linear, meshes)."""
    return [
        ("pinched hemisphere", 9.355, [((n, n), scenes.hemisphere((n, n))) for n in (4, 8, 16)]),
        ("opened cap, h = 0.4", 0.7585, [(d, held_cap(d, 0.4)) for d in ((12, 3), (24, 5), (48, 10))]),
        ("opened cap, h = 0.1", 6.563, [(d, held_cap(d, 0.1)) for d in ((12, 3), (24, 5), (48, 10))]),
        ("pinched cylinder", 65.796, [((n, n), scenes.pinched_cylinder((n, n))) for n in (8, 16, 32)]),
        ("pinched semi-cylinder", 81.9, [((n, n), scenes.pinched_semi_cylinder((n, n))) for n in (8, 16, 32)]),
        ("pull-out of a cylinder", 45.464, [((n, n), scenes.cylinder_pull_out((n, n))) for n in (8, 16)]),
        ("hinged roof", 7.4847, [((n, n), scenes.hinged_roof((n, n))) for n in (4, 8, 16)]),
        ("twisted beam", 0.0053990, [((n, n // 4), scenes.twisted_beam((n, n // 4))) for n in (8, 16)]),
    ]


_BATCH = 1024
"""Elements at a time: one program for all meshes."""


def stiffness(shape: str):
    """A function of corners (k, 3, 3), normals there and the section's values: stiffness matrices (k, 18, 18) at rest."""

    def one(x, normals, thickness, young_modulus, poisson_ratio):
        section = isotropic(thickness, young_modulus, poisson_ratio, 1.0)
        marks = (jnp.ones(()) if shape == kind else None for kind in ("curved", "relaxed"))
        element = Element.build(x, section, None if shape == "flat" else Tangents(normals, *marks))
        return corotational.tangent_stiffness(x, jnp.broadcast_to(jnp.eye(3), (3, 3, 3)), element)

    return jax.jit(jax.vmap(one, in_axes=(0, 0, None, None, None)))


def element_matrices(scene: js.Scene, normals, matrices) -> np.ndarray:
    """(m, 18, 18) the elements' stiffness matrices at rest."""
    section, triangles = scene.section, scene.mesh.triangles
    nodes = np.asarray(scene.mesh.nodes)
    values = [float(value) for value in (section.thickness, section.young_modulus, section.poisson_ratio)]
    padded = np.resize(np.arange(len(triangles)), -(-len(triangles) // _BATCH) * _BATCH).reshape(-1, _BATCH)
    found = [np.asarray(matrices(nodes[triangles[k]], normals[k], *values)) for k in padded]
    return np.concatenate(found)[: len(triangles)]


def dofs_of(triangles) -> np.ndarray:
    """(m, 18) degrees of freedom of triangles."""
    return (6 * triangles[:, :, None] + np.arange(6)).reshape(-1, 18)


def linear_displacements(scene: js.Scene, normals, matrices) -> np.ndarray:
    """(n, 6) displacements and rotations under the scene's loads, if all were linear; by SciPy's sparse solver."""
    mesh, triangles = scene.mesh, scene.mesh.triangles
    found, dofs = element_matrices(scene, normals, matrices), dofs_of(triangles)
    rows, columns, size = np.repeat(dofs, 18, axis=1).ravel(), np.tile(dofs, (1, 18)).ravel(), 6 * mesh.n_nodes
    K = sparse.csc_matrix((found.ravel(), (rows, columns)), (size, size))
    loads = sum(np.asarray(load.nodal(mesh.nodes, triangles, np.ones(len(triangles)))) for load in scene.loads)
    free = np.setdiff1d(np.arange(size), scene.held_dofs)
    u = np.zeros(size)
    u[free] = spsolve(K[free][:, free], np.asarray(loads).ravel()[free])
    return u.reshape(-1, 6)


def normals_of(scene: js.Scene) -> np.ndarray:
    """(m, 3, 3) normals at the elements' corners."""
    edges = Edges(scene.mesh.triangles)
    return np.asarray(jax.jit(lambda x: corner_normals(x, edges).normals)(scene.mesh.nodes))


def watched(scene: js.Scene, displacements: np.ndarray) -> float:
    """The first deflection that the scene watches."""
    _, node, component = scene.watch[0]
    return abs(displacements[node, ("ux", "uy", "uz").index(component)])


def statics() -> str:
    """Errors of linear deflections in per cent."""
    rows, makers = [], {shape: stiffness(shape) for shape in SHAPES}
    for name, limit, meshes in static_cases():
        for mesh, scene in meshes:
            normals = normals_of(scene)
            found = [watched(scene, linear_displacements(scene, normals, makers[shape])) for shape in SHAPES]
            errors = [value / limit - 1 for value in found]
            rows.append([name, "×".join(map(str, mesh)), *(f"{100 * e:+.2f}" for e in errors)])
            print(*rows[-1], flush=True)
    return table(["", "mesh", *SHAPES], rows)


def cost() -> str:
    """Times of a step of EnergyMomentum on the opened cap, beside that of the flat element with linear inertia."""
    seconds = {}
    forms = (*FORMS, ("relaxed", "linear"))
    for repeat in range(4):  # the first compiles
        for form in forms:
            scene = js.with_shape(scenes.opened_cap(), form[0])
            began = time.perf_counter()
            run = js.simulate(scene, js.EnergyMomentum(inertia=form[1]), dt=0.01, t_end=2.0)
            jax.block_until_ready(run.displacements)
            if repeat:
                taken = time.perf_counter() - began, float(np.mean(run.iterations[1:]))
                seconds[form] = min(seconds.get(form, taken), taken)
    least = seconds[forms[0]][0]
    rows = [[*form, f"{1e3 * s / 200:.2f}", f"{s / least:.2f}", f"{i:.2f}"] for form, (s, i) in seconds.items()]
    return table(["shape", "inertia", "ms a step", "ratio", "iterations a step"], rows)


TABLES = {"opened_cap": opened_cap, "plates": plates, "statics": statics, "cost": cost}


def main() -> None:
    write(__doc__, PAGE, TABLES)


if __name__ == "__main__":
    main()
