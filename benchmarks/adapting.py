"""The figures of docs/adapting.md: errors of deflections on uniform and on adapted meshes, and what is estimated of them.

    python benchmarks/adapting.py                          # all tables, into the page
    python benchmarks/adapting.py cap                      # some of them

Everything is linear, as in `benchmarks/accuracy.py`, whose stiffnesses SciPy's sparse solver takes: a mesh costs no
program of its own but that of its recovered forces. Tables go between the page's markers, and to the screen.
"""

import sys
import warnings
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import jax
import jax.numpy as jnp
import numpy as np

import jaxshell as js
from benchmarks.accuracy import linear_displacements, normals_of, stiffness
from benchmarks.pages import table, write
from jaxshell import scenes
from jaxshell.numerics.rotations import exp

jax.config.update("jax_enable_x64", True)

PAGE = Path(__file__).parent.parent / "docs" / "adapting.md"
SMALL = 1e-6
"""What the limit of the deflection is scaled to where section forces are recovered: everything is linear there."""
CAP = 0.0018574
"""Limit of the clamped cap's linear deflection [m]: curved elements on 20, 40 and 80 divisions, extrapolated."""
CYLINDER = 65.95
"""Limit of the pinched cylinder's, as in `benchmarks/accuracy.py`."""


def linear(shape: str, size: float):
    """An analysis for `js.adapt`: the linear deflection of a scene, as a static solution in which `size` is small."""
    matrices = stiffness(shape)

    def analysis(scene: js.Scene) -> js.Solution:
        u = linear_displacements(scene, normals_of(scene), matrices)
        small = SMALL / size * u
        one = jnp.ones(1)
        zero, none = 0.0 * one, jnp.zeros((1, 3))
        watched = {
            label: jnp.asarray([u[node, ("ux", "uy", "uz").index(c)]])
            for label, node, c in scene.watch
            if c in ("ux", "uy", "uz")
        }
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


def compared(make, limit: float, uniform, start, shape: str, most: int) -> list[list[str]]:
    """Rows for uniform meshes, and for those of `adapt` from one of them."""
    analysis, rows = linear(shape, limit), []
    label = make(start).watch[0][0]
    for divisions in uniform:
        scene = js.with_shape(make(divisions), shape)
        error = float(np.abs(analysis(scene).watched[label][-1])) / limit - 1.0
        unknowns = 6 * scene.mesh.n_nodes - len(scene.held_dofs)
        rows.append([shape, "uniform", str(scene.mesh.n_elements), str(unknowns), f"{100 * error:+.2f}", "", "", ""])
        print(*rows[-1], flush=True)
    deflections = []

    def noted(scene):
        found = analysis(scene)
        deflections.append(float(np.abs(found.watched[label][-1])))
        return found

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # which says that 1e-3 was not met
        adapted = js.adapt(js.with_shape(make(start), shape), 1e-3, analysis=noted, most_elements=most)
    for mesh, deflection in zip(adapted.rounds, deflections, strict=True):
        error = deflection / limit - 1.0
        figures = [f"{100 * value:.2f}" for value in (mesh.recovered, mesh.estimate)]
        row = [shape, "adapted", str(mesh.elements), str(mesh.unknowns), f"{100 * error:+.2f}"]
        rows.append([*row, *figures, f"{mesh.estimate / abs(error):.1f}"])
        print(*rows[-1], flush=True)
    return rows


HEADER = ["shape", "meshes", "elements", "unknowns", "error, %", "recovered, %", "estimate, %", "estimate / error"]


def cylinder() -> str:
    """The pinched cylinder under its points' loads."""
    rows = compared(lambda n: scenes.pinched_cylinder((n, n)), CYLINDER, (8, 12, 16, 20, 24, 32), 8, "flat", 1600)
    return table(HEADER, rows)


def cap() -> str:
    """The clamped cap under the force at its apex."""
    return table(HEADER, compared(scenes.spherical_cap, CAP, (4, 6, 8, 10, 12, 14, 20), 4, "flat", 600))


TABLES = {"cylinder": cylinder, "cap": cap}


def main() -> None:
    write(__doc__, PAGE, TABLES)


if __name__ == "__main__":
    main()
