"""The figures of docs/adapting.md: errors of deflections on uniform and on adapted meshes, and what is estimated of them.

    python benchmarks/adapting.py                          # all tables, into the page
    python benchmarks/adapting.py cap                      # some of them

Everything is linear, as in `benchmarks/accuracy.py`, whose stiffnesses SciPy's sparse solver takes: a mesh costs no
program of its own but that of its recovered forces. Tables go between the page's markers, and to the screen.
"""

import dataclasses
import sys
import warnings
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).parent.parent))

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np

import jaxshell as js
from benchmarks.accuracy import dofs_of, element_matrices, linear_displacements, normals_of, stiffness
from benchmarks.pages import table, write
from jaxshell import scenes
from jaxshell.model import generators
from jaxshell.model.sections.scaled import Scaled
from jaxshell.numerics.rotations import exp
from jaxshell.plotting.style import STYLE

jax.config.update("jax_enable_x64", True)

PAGE = Path(__file__).parent.parent / "docs" / "adapting.md"
SMALL = 1e-6
"""What the limit of the deflection is scaled to where section forces are recovered: everything is linear there."""
CAP = 0.0018574
"""Limit of the clamped cap's linear deflection [m]: curved elements on 20, 40 and 80 divisions, extrapolated."""
CYLINDER, SIDE = 65.796, 0.18527
"""The pinched cylinder's under the force and a quarter turn from it, by `benchmarks/pinched_series.py`."""
PLACE = 4.83582e-3
"""Limit of the deflection of `floor` at its place: of 32 and 64 divisions, extrapolated with the order 2 that they show
beside 24 and 48."""
AXES = ("ux", "uy", "uz")


def linear(shape: str, size: float):
    """An analysis for `js.adapt`: the linear deflection of a scene, as a static solution in which `size` is small.

    What is watched has the derivatives by the elements' stiffnesses that a goal asks for: -zᵀ K_e u of each element e,
    with the displacements z under a unit force at what is watched.
    """
    matrices = stiffness(shape)

    def analysis(scene: js.Scene) -> js.Solution:
        factors = scene.section.factors if isinstance(scene.section, Scaled) else None
        scene = scene if factors is None else dataclasses.replace(scene, section=scene.section.section)
        normals = normals_of(scene)
        u = linear_displacements(scene, normals, matrices)
        small = SMALL / size * u
        one = jnp.ones(1)
        zero, none = 0.0 * one, jnp.zeros((1, 3))
        watched = {}
        for label, node, component in scene.watch:
            if component not in AXES:
                continue
            axis = AXES.index(component)
            watched[label] = jnp.asarray(u[node, axis])[None]
            if factors is not None:
                unit = js.NodalForce([node], np.eye(3)[axis])
                z = linear_displacements(dataclasses.replace(scene, loads=(unit,)), normals, matrices).ravel()
                dofs, K = dofs_of(scene.mesh.triangles), element_matrices(scene, normals, matrices)
                gradient = -np.einsum("mi,mij,mj->m", z[dofs], K, u.ravel()[dofs])
                watched[label] += jnp.asarray(gradient) @ (factors - 1.0)
        return js.Solution(
            scene,
            one,
            watched,
            js.Energy(zero, zero, zero, zero),
            js.Momentum(none, none),
            jnp.zeros(1, int),
            one,
            jnp.asarray(small[None, :, :3]),
            jax.vmap(exp)(jnp.asarray(small[:, 3:]))[None],
            jnp.zeros((1, len(u), 3)),
            analysis="static",
        )

    return analysis


class Way(NamedTuple):
    """What `compared` makes rows of."""

    shape: str
    uniform: tuple[int, ...]
    start: int
    most: int
    """Elements, of adapted meshes."""


def compared(make, label: str, limit: float, way: Way, goals=(None,)) -> list[list[str]]:
    """Rows for uniform meshes, for one of them bisected everywhere, by halves of all edges, and for those of `adapt` from
    it; errors of what is watched as `label`."""
    analysis, rows = linear(way.shape, limit), []

    def row(kind: str, scene, deflection: float, *more: float) -> None:
        error = abs(deflection) / limit - 1.0
        unknowns = 6 * scene.mesh.n_nodes - len(scene.held_dofs)
        figures = [f"{100 * value:.2f}" for value in more]
        worth = [f"{more[-1] / abs(error):.1f}"] if more else [""] * 3
        rows.append(
            [way.shape, kind, str(scene.mesh.n_elements), str(unknowns), f"{100 * error:+.2f}", *figures, *worth]
        )
        print(*rows[-1], flush=True)

    for divisions in way.uniform:
        scene = js.with_shape(make(divisions), way.shape)
        row("uniform", scene, float(analysis(scene).watched[label][-1]))
    scene = js.with_shape(make(way.start), way.shape)
    for _ in range(2):
        scene = js.refine(scene, 2, elements=np.arange(scene.mesh.n_elements))
        row("bisected", scene, float(analysis(scene).watched[label][-1]))
    for goal in goals:
        done = []

        def noted(scene, done=done):
            found = analysis(scene)
            if not isinstance(scene.section, Scaled):
                done.append((scene, float(found.watched[label][-1])))
            return found

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # which says that 1e-3 was not met
            start = js.with_shape(make(way.start), way.shape)
            adapted = js.adapt(start, 1e-3, analysis=noted, most_elements=way.most, goal=goal)
        for mesh, (scene, deflection) in zip(adapted.rounds, done, strict=True):
            row("adapted" if goal is None else f"adapted to {goal}", scene, deflection, mesh.recovered, mesh.estimate)
    return rows


HEADER = ["shape", "meshes", "elements", "unknowns", "error, %", "recovered, %", "estimate, %", "estimate / error"]


def pinched(n: int) -> js.Scene:
    return scenes.pinched_cylinder((n, n))


def cylinder() -> str:
    """The pinched cylinder under its points' loads."""
    ways = Way("flat", (8, 12, 16, 20, 24, 32), 8, 1600), Way("curved", (8, 12, 16, 20, 24, 32), 8, 1000)
    return table(HEADER, [row for way in ways for row in compared(pinched, "A", CYLINDER, way)])


def cap() -> str:
    """The clamped cap under the force at its apex."""
    ways = Way("flat", (4, 6, 8, 10, 12, 14, 20), 4, 600), Way("curved", (4, 6, 8, 10, 14, 20), 4, 600)
    return table(HEADER, [row for way in ways for row in compared(scenes.spherical_cap, "apex", CAP, way)])


def floor(n: int) -> js.Scene:
    """A clamped plate of 4 by 1 on 4n by n squares, with a large force on its left half and a small one on its right.

    Watches "middle", under the large force, and "place", a quarter beside the small one.
    """
    mesh = generators.rectangle(4.0, 1.0, (4 * n, n))
    edge = mesh.nodes_where(lambda x: (np.abs(x[0] - 2.0) > 2.0 - 1e-9) | (np.abs(x[1] - 0.5) > 0.5 - 1e-9))
    large, small, place = (mesh.nearest_node([x, 0.5, 0.0]) for x in (1.0, 3.0, 3.25))
    loads = js.NodalForce([large], [0.0, 0.0, -10.0]), js.NodalForce([small], [0.0, 0.0, -1.0])
    section, watch = js.Section(0.01, 1e7, 0.3, 1.0), {"middle": (large, "uz"), "place": (place, "uz")}
    return js.Scene(mesh, section, (js.clamped(edge),), loads, name="floor", watch=watch)


def goal() -> str:
    """The deflection of a place of the plate, with and without a goal."""
    way = Way("flat", (4, 8, 12, 16, 24), 4, 1500)
    return table(HEADER, compared(floor, "place", PLACE, way, (None, "place")))


def side() -> str:
    """The pinched cylinder's deflection a quarter turn from the load, with and without a goal."""
    way = Way("flat", (8, 12, 16, 20, 24, 32), 8, 1000)
    return table(HEADER, compared(pinched, "B", SIDE, way, (None, "B")))


def picture() -> str:
    """The adapted mesh of the cylinder, coloured by its error."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = js.adapt(pinched(8), 1e-3, analysis=linear("flat", CYLINDER), most_elements=800)
    figure = js.plotting.figures(found.solution, ["mesh error"])["mesh_error"]
    name = "pictures/adapted_cylinder.png"
    with matplotlib.rc_context(STYLE):
        figure.savefig(PAGE.parent / name)
    return (
        f"![The pinched cylinder on {found.scene.mesh.n_elements} triangles, coloured by the error of its mesh]({name})"
    )


TABLES = {"picture": picture, "cylinder": cylinder, "cap": cap, "goal": goal, "side": side}


def main() -> None:
    write(__doc__, PAGE, TABLES)


if __name__ == "__main__":
    main()
