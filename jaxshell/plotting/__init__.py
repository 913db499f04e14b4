"""Pictures of runs: deformed shapes, watched displacements and velocities, energies, momenta; films, a window, and
pictures of scenes before they run."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import equinox as eqx
import jax
import matplotlib
import numpy as np
from matplotlib.figure import Figure

from jaxshell.plotting import rendering
from jaxshell.plotting.histories import energy_figure, momentum_figure, watched_figure
from jaxshell.plotting.movie import animate
from jaxshell.plotting.paths import path_figure
from jaxshell.plotting.scene import scene_figure
from jaxshell.plotting.shapes import shapes_figure
from jaxshell.plotting.style import STYLE
from jaxshell.plotting.titles import named_runs
from jaxshell.plotting.window import view
from jaxshell.results.solution import Solution

__all__ = ["animate", "figures", "plot", "scene_figure", "view"]


def figures(
    solutions: Mapping[str, Solution] | Solution, contours: Sequence[str] = (), renderer: str = "auto"
) -> dict[str, Figure]:
    """The pictures that `plot` writes, by what they show: shapes, displacement, velocity, stress, membrane_force,
    moment, energy, momentum, connectors_force (and _moment, _length, _angle, _energy: of obstacles too), and one for
    each of `contours`; of statics shapes, path and contours.

    Shapes are of the first solution. What the solutions do not hold is left out: velocity without a watched
    velocity, histories of a run that failed in its first step, momentum of a shell that supports hold.

    Arguments:
        contours: fields to colour the shapes by, besides displacement: "velocity", "mesh error", or texts such as
            "von mises top", which `jaxshell.model.gauge` lists.
        renderer: what draws shapes: "vtk" (true depth; needs PyVista), "matplotlib", or "auto": the first that works.

    Raises ValueError for a contour that names nothing that the section has, and for another renderer; ImportError for
    "vtk" without PyVista, and RuntimeError where it cannot render.
    """
    runs = named_runs(solutions)
    name, first = next(iter(runs.items()))
    moving = {label: _on_host(solution) for label, solution in runs.items() if len(solution.times) > 1}
    painter = rendering.renderer(renderer)
    drawn = {}
    with matplotlib.rc_context(STYLE):
        if len(first.frame_times):
            drawn["shapes"] = shapes_figure(first, name, renderer=painter)
            drawn |= {text.replace(" ", "_"): shapes_figure(first, name, text, painter) for text in contours}
        if moving and first.analysis == "static":
            drawn["path"] = path_figure(moving)
        elif moving:
            drawn["displacement"] = watched_figure(moving, "u")
            drawn["velocity"] = watched_figure(moving, "v")
            for what, kind in (("stress", "stress"), ("membrane_force", "N"), ("moment", "M")):
                drawn[what] = watched_figure(moving, kind)
            for kind in ("force", "moment", "length", "angle", "energy"):
                drawn[f"connectors_{kind}"] = watched_figure(moving, f"{kind} of item")
            drawn["energy"] = energy_figure(moving)
            drawn["momentum"] = momentum_figure(moving)
    return {what: figure for what, figure in drawn.items() if figure is not None}


def _on_host(run: Solution) -> Solution:
    """Its histories as NumPy's arrays: of JAX's, each sum and quotient that is drawn would be compiled first."""

    def histories(run: Solution):
        return run.times, run.watched, run.energy, run.momentum

    return eqx.tree_at(histories, run, jax.tree.map(np.asarray, histories(run)))


def plot(
    solutions: Mapping[str, Solution] | Solution,
    directory,
    stem: str,
    contours: Sequence[str] = (),
    renderer: str = "auto",
) -> list[Path]:
    """Draw one run, or several runs of a scene together, into PNG files `directory`/`stem`_<what>.png.

    Arguments:
        solutions: a solution, or {label: solution} to compare methods.
        directory: made where it does not exist.
        contours, renderer: as of `figures`, which also says what is raised.

    Returns the files' paths. The counterparts of Yang & Xia 2014, Figs. 5-8, 10-13 and 15-18.
    """
    drawn = figures(solutions, contours, renderer)
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    paths = []
    with matplotlib.rc_context(STYLE):
        for what, figure in drawn.items():
            path = directory / f"{stem}_{what}.png"
            figure.savefig(path)
            paths.append(path)
    return paths
