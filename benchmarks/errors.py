"""The figures of docs/errors.md: estimates of the mesh's error beside the error that it is.

    python benchmarks/errors.py                            # all tables (some ten minutes), into the page
    python benchmarks/errors.py recovered                  # one of them

Tables go between the page's markers `<!-- NAME -->` and `<!-- end NAME -->`, and to the screen. Statics are linear, by
SciPy's solver. `recovered`: the error is the distance, in the norm of energy, of a mesh's section forces from those of
the finest mesh, which is four times as fine or more. `deflections`: from the limit of the three finest meshes, two levels
beyond. `motions`: from the answers of the continuous problems that jaxshell ships.
"""

import dataclasses
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).parent.parent))

import jax
import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import jaxshell as js
from benchmarks.accuracy import held_cap, linear_displacements, normals_of, stiffness, watched
from benchmarks.pages import table, write
from jaxshell import scenes
from jaxshell.advice.limits import limit_reference
from jaxshell.advice.references import run_error
from jaxshell.model import generators
from jaxshell.numerics.extrapolation import estimate
from jaxshell.results.section_forces import elements_of

jax.config.update("jax_enable_x64", True)

PAGE = Path(__file__).parent.parent / "docs" / "errors.md"
SHAPES = ("flat", "curved")


def clamped_plate(n: int) -> js.Scene:
    """A square plate clamped on all sides, under pressure."""
    mesh = generators.rectangle(1.0, 1.0, (n, n))
    edge = mesh.nodes_where(lambda x: np.max(np.abs(x[:2] - 0.5), axis=0) > 0.5 - 1e-9)
    load = js.DeadPressure(1e-4)
    watch = {"middle": (mesh.nearest_node([0.5, 0.5, 0]), "uz")}
    return js.Scene(mesh, js.Section(0.01, 1e7, 0.3, 1.0), [js.clamped(edge)], [load], watch=watch)


class Case(NamedTuple):
    """A problem of linear statics."""

    name: str
    make: Callable
    meshes: tuple
    finer: tuple
    """Meshes besides, for deflections alone."""


CASES = (
    Case("clamped plate", clamped_plate, (4, 8, 16, 32, 64), ()),
    Case("cap", scenes.spherical_cap, (5, 10, 20, 40), (80,)),
    Case("opened cap, h = 0.4", lambda d: held_cap(d, 0.4), ((12, 3), (24, 6), (48, 12), (96, 24)), ((192, 48),)),
    Case("opened cap, h = 0.1", lambda d: held_cap(d, 0.1), ((12, 3), (24, 6), (48, 12), (96, 24)), ((192, 48),)),
    Case("pinched hemisphere", scenes.hemisphere, ((4, 4), (8, 8), (16, 16), (32, 32), (64, 64)), ((128, 128),)),
    Case("pinched cylinder", scenes.pinched_cylinder, ((8, 8), (16, 16), (32, 32), (64, 64)), ((128, 128),)),
    Case("slit annulus", scenes.slit_annular_plate, ((3, 24), (6, 48), (12, 96), (24, 192)), ((48, 384),)),
    Case("hinged roof", scenes.hinged_roof, ((4, 4), (8, 8), (16, 16), (32, 32)), ()),
)
MOTIONS = (
    (scenes.opened_cap, ((12, 3), (24, 6), (48, 12)), 0.01, 1.0),
    (scenes.spherical_cap, (5, 10, 20), 2e-6, 1e-4),
    (scenes.free_plate, ((15, 3), (30, 6), (60, 12)), 5e-5, 5e-3),
    (scenes.suddenly_loaded_cap, (5, 10, 20), 5e-6, 4e-4),
    (scenes.snapping_panel, ((4, 8), (8, 16), (16, 32)), 1e-3, 0.1),
    (scenes.flying_cylinder, ((2, 16), (4, 32), (8, 64)), 0.02, 2.0),
)
"""Scenes of the library, meshes, step and end; those are left out of which no answer is shipped."""


class Solved(NamedTuple):
    """A mesh's linear answer."""

    scene: js.Scene
    displacements: np.ndarray
    energy: float
    forces: np.ndarray
    """(m, 3, 2, 3): N and M at the mid-edges."""
    scale: float
    """Of the small displacements that they were computed from."""


def solved(scene: js.Scene, matrices) -> Solved:
    u = linear_displacements(scene, normals_of(scene), matrices)
    loads = np.asarray(sum(load.nodal(scene.mesh.nodes, scene.mesh.triangles, None) for load in scene.loads))
    scale = 1e-6 / np.abs(u[:, 3:]).max()  # rotations so small that all is linear
    forces = js.section_forces_of(scene, *small(u, scale))
    return Solved(scene, u, 0.5 * float(np.sum(loads * u)), np.stack([forces.N, forces.M], axis=2) / scale, scale)


def small(u: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray]:
    return scale * u[:, :3], Rotation.from_rotvec(scale * u[:, 3:]).as_matrix()


# --- the error that it is ---------------------------------------------------------------------------------

_CUT = 4
"""Every edge is cut into so many where an integral over an element is taken."""
_CORNERS = np.array([[1, -1, 1], [1, 1, -1], [-1, 1, 1.0]])
"""A linear field at the corners from its values at the mid-edges."""


def places() -> np.ndarray:
    """(p, 3) barycentric coordinates of the middles of an element's equal parts."""
    found = []
    for i in range(_CUT):
        for j in range(_CUT - i):
            found += [(i + 1 / 3, j + 1 / 3)] + [(i + 2 / 3, j + 2 / 3)] * (j < _CUT - i - 1)
    a, b = np.array(found).T / _CUT
    return np.stack([1 - a - b, a, b], 1)


def tensors_at(fine: Solved, points: np.ndarray) -> np.ndarray:
    """(q, 2, 3, 3) recovered N and M of a fine mesh at points on or near it, as tensors in space."""
    smooth = np.asarray(js.nodal(fine.scene, fine.forces, components="forces"))
    frames = np.asarray(elements_of(fine.scene).frame)[:, :2]
    plane = np.stack([smooth[..., [0, 2]], smooth[..., [2, 1]]], axis=-2)
    spatial = np.einsum("mai,mckab,mbj->mckij", frames, plane, frames)
    x = np.asarray(fine.scene.mesh.nodes)[fine.scene.mesh.triangles]
    _, near = cKDTree(x.mean(axis=1)).query(points, k=8)
    one, other = (x[near, k] - x[near, 0] for k in (1, 2))
    seen = points[:, None] - x[near, 0]
    a, b, c, d, e = (np.sum(u * v, axis=-1) for u, v in
                     ((one, one), (one, other), (other, other), (one, seen), (other, seen)))  # fmt: skip
    second, third = (c * d - b * e) / (a * c - b * b), (a * e - b * d) / (a * c - b * b)
    weights = np.stack([1 - second - third, second, third], axis=-1)
    best = weights.min(axis=-1).argmax(axis=1)
    rows = np.arange(len(points))
    weights = np.clip(weights[rows, best], 0, 1)
    weights /= weights.sum(axis=1, keepdims=True)
    return np.einsum("qc,qckij->qkij", weights, spatial[near[rows, best]])


def true_error(coarse: Solved, fine: Solved) -> float:
    """Distance of section forces in the norm of energy, over the fine mesh's energy."""
    x = np.asarray(coarse.scene.mesh.nodes)[coarse.scene.mesh.triangles]
    points = np.einsum("pc,mci->mpi", places(), x)
    elements = elements_of(coarse.scene)
    frames = np.asarray(elements.frame)[:, :2]
    exact = tensors_at(fine, points.reshape(-1, 3)).reshape(*points.shape[:2], 2, 3, 3)
    exact = np.einsum("mai,mpkij,mbj->mpkab", frames, exact, frames)
    exact = np.stack([exact[..., 0, 0], exact[..., 1, 1], exact[..., 0, 1]], axis=-1)
    own = np.einsum("pc,cq,mqki->mpki", places(), _CORNERS, coarse.forces)
    off = (own - exact).reshape(*own.shape[:2], 6)
    inverse = np.linalg.inv(np.asarray(elements.section.matrix))
    density = 0.5 * np.einsum("mpi,mij,mpj->m", off, inverse, off) / off.shape[1]
    return float(np.sqrt(density @ np.asarray(elements.area) / fine.energy))


# --- tables -----------------------------------------------------------------------------------------------


def recovered() -> str:
    rows, makers = [], {shape: stiffness(shape) for shape in SHAPES}
    for name, make, meshes, _ in CASES:
        for shape in SHAPES:
            found = [solved(js.with_shape(make(d), shape), makers[shape]) for d in meshes]
            for divisions, each in zip(meshes[:-2], found, strict=False):
                own = js.mesh_errors_of(each.scene, *small(each.displacements, each.scale))
                told, true = float(own.relative), true_error(each, found[-1])
                off = abs(each.energy / found[-1].energy - 1) ** 0.5
                rows.append(
                    [name, named(divisions), shape, *map(percent, (true, told)), f"{told / true:.2f}", percent(off)]
                )
                print(*rows[-1], flush=True)
    return table(["", "mesh", "shape", "true", "recovered", "ratio", "√ of the energy's error"], rows)


def deflections() -> str:
    rows, matrices = [], stiffness("flat")
    for name, make, meshes, finer in CASES:
        meshes += finer
        family = [make(divisions) for divisions in meshes]
        found = [watched(scene, linear_displacements(scene, normals_of(scene), matrices)) for scene in family]
        sizes = [scene.mesh.n_elements**-0.5 for scene in family]
        limit = float(estimate(found[-3:], sizes[-3:]).limit)
        for k in range(1, len(meshes) - 2):  # so that no estimate is made of the meshes that the limit is made of
            true = abs(found[k] / limit - 1)
            cells = [percent(true)]
            for coarser, finer in ((1, 0), (2, 0), (1, 1)):
                if coarser > k:
                    cells.append("")
                    continue
                chosen = slice(k - coarser, k + finer + 1)
                cells.append(_cell(estimate(found[chosen], sizes[chosen]), coarser, true))
            rows.append([name, named(meshes[k]), *cells])
            print(*rows[-1], sep="  ", flush=True)
    return table(["", "mesh", "true", "one coarser", "two coarser", "one coarser, one finer"], rows)


def _cell(found: js.Estimate, level: int, true: float) -> str:
    if found.problem:
        return f"none: {found.problem.replace('the differences between levels', 'differences')}"
    told = float(found.errors[level])
    return f"{percent(told)} (× {told / true:.2f}{'' if found.order is None else f', order {found.order:.1f}'})"


def motions() -> str:
    rows = []
    for make, meshes, dt, t_end in MOTIONS:
        family = [make(divisions) for divisions in meshes]
        reference = limit_reference(family[1], t_end)
        if reference is None:
            continue
        runs: dict[int, js.Solution] = {}

        def run(scene, step=dt, t_end=t_end, runs=runs) -> js.Solution:
            found = js.simulate(scene, js.EnergyMomentum(), dt=step, t_end=t_end)
            return runs.setdefault(scene.mesh.n_elements, found) if step == dt else found  # noqa: B023

        watch = [each for each in family[1].watch if each[2].startswith("u")]
        family = [dataclasses.replace(scene, watch={k: v for k, *v in _of(scene, watch)}) for scene in family]
        two = js.richardson(family[:2], run, half_step=lambda scene, run=run, dt=dt: run(scene, 0.5 * dt))
        three = js.richardson(family, lambda scene, runs=runs, run=run: runs.get(scene.mesh.n_elements) or run(scene))
        true = run_error(reference, runs[family[1].mesh.n_elements])
        mesh = max(two.error(label) for label in two.mesh)
        step = max(two.step_error(label) for label in two.mesh)
        both = max(float(found.errors[1]) for found in three.mesh.values())
        cells = [
            percent(true),
            f"{reference.uncertainty:.1e}",
            percent(mesh),
            percent(step),
            f"{(mesh + step) / true:.2f}",
        ]
        cells.append(percent(both) if np.isfinite(both) else "none")
        rows.append([f"`{make.__name__}`", named(meshes[1]), f"{t_end:g}", *cells])
        print(*rows[-1], flush=True)
    head = ["", "mesh", "to", "true", "known to", "mesh, one coarser", "step", "sum over true", "mesh, one finer too"]
    return table(head, rows)


def _of(scene: js.Scene, watch) -> list[tuple]:
    """The scene's own entries of the same labels."""
    labels = {label for label, _, _ in watch}
    return [each for each in scene.watch if each[0] in labels]


def named(divisions) -> str:
    return "×".join(map(str, np.atleast_1d(divisions)))


def percent(part: float) -> str:
    return f"{100 * part:.2g} %" if part < 1 else f"{100 * part:.0f} %"


TABLES = {"recovered": recovered, "deflections": deflections, "motions": motions}


def main() -> None:
    write(__doc__, PAGE, TABLES)


if __name__ == "__main__":
    main()
