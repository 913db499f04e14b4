"""Pictures of runs: deformed shapes, watched displacements and velocities, energies, momenta."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure

from jaxshell.plotting.histories import energy_figure, momentum_figure, watched_figure
from jaxshell.plotting.shapes import shapes_figure
from jaxshell.plotting.style import STYLE, plain
from jaxshell.results.solution import Solution


def figures(solutions: Mapping[str, Solution] | Solution, contours: Sequence[str] = ()) -> dict[str, Figure]:
    """The pictures that `plot` writes, by what they show: shapes, displacement, velocity, stress, membrane_force,
    moment, energy, momentum, and one for each of `contours`.

    Shapes are of the first solution. What the solutions do not hold is left out: velocity without a watched
    velocity, histories of a run that failed in its first step. `contours` are texts such as "von mises top", which
    `jaxshell.model.gauge` lists; ValueError for one that names nothing that the section has.
    """
    if isinstance(solutions, Solution):
        solutions = {"": solutions}
    if not solutions:
        raise ValueError("There is no solution to plot.")
    solutions = {plain(name): solution for name, solution in solutions.items()}
    name, first = next(iter(solutions.items()))
    moving = {label: solution for label, solution in solutions.items() if len(solution.times) > 1}
    drawn = {}
    with matplotlib.rc_context(STYLE):
        if len(first.frame_times):
            drawn["shapes"] = shapes_figure(first, name)
            drawn |= {text.replace(" ", "_"): shapes_figure(first, name, text) for text in contours}
        if moving:
            drawn["displacement"] = watched_figure(moving, "u")
            drawn["velocity"] = watched_figure(moving, "v")
            for what, kind in (("stress", "stress"), ("membrane_force", "N"), ("moment", "M")):
                drawn[what] = watched_figure(moving, kind)
            drawn["energy"] = energy_figure(moving)
            drawn["momentum"] = momentum_figure(moving)
    return {what: figure for what, figure in drawn.items() if figure is not None}


def plot(
    solutions: Mapping[str, Solution] | Solution, directory, stem: str, contours: Sequence[str] = ()
) -> list[Path]:
    """Draw one run, or several runs of a scene together, into PNG files `directory`/`stem`_<what>.png.

    Arguments:
        solutions: a solution, or {label: solution} to compare methods.
        directory: made where it does not exist.
        contours: stresses and section forces to colour the deformed shapes by, such as "von mises top".

    Returns the files' paths. The counterparts of Yang & Xia 2014, Figs. 5-8, 10-13 and 15-18.
    """
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    paths = []
    with matplotlib.rc_context(STYLE):
        for what, figure in figures(solutions, contours).items():
            path = directory / f"{stem}_{what}.png"
            figure.savefig(path)
            paths.append(path)
    return paths
