"""Load against displacement: the paths of statics and arc length, of one or several runs."""

import math
from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from jaxshell.plotting.histories import watched_axis
from jaxshell.plotting.style import WIDTH, line, plain, scaled
from jaxshell.results.solution import Solution

_MOST_COLUMNS = 3


def path_figure(runs: Mapping[str, Solution]) -> Figure:
    """A panel for each watched quantity, the load factor above it; the largest displacement where nothing is watched.

    Unstable equilibria are hollow circles.
    """
    scene = next(iter(runs.values())).scene
    drawn = [(label, component) for label, _, component in scene.watch] or [("", "")]
    columns = min(_MOST_COLUMNS, len(drawn))
    rows = math.ceil(len(drawn) / columns)
    figure = Figure(figsize=(WIDTH if columns > 1 else 0.7 * WIDTH, 2.8 * rows + 0.5), layout="constrained")
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
    for panel, (label, component) in zip(panels, drawn, strict=False):
        curves = {name: _curve(run, label) for name, run in runs.items() if not label or label in run.watched}
        values = [values for values, _ in curves.values()]
        if label:
            divisor, text = watched_axis(scene, label, component, max(float(np.max(np.abs(v))) for v in values))
        else:
            divisor, unit = scaled(scene, max(float(np.max(v)) for v in values), "m")
            text = f"Largest displacement{unit}"
        for position, (name, (values, factors)) in enumerate(curves.items()):
            _draw(panel, name, runs[name], np.asarray(values) / divisor, np.asarray(factors), position)
        panel.set_xlabel(text)
    for panel in panels[len(drawn) :]:
        panel.set_axis_off()
    for panel in panels[: len(drawn) : columns]:
        panel.set_ylabel("Load factor")
    figure.suptitle(_title(runs), fontsize=9.5)
    handles = {str(item.get_label()): item for item in panels[0].get_lines() if item.get_label()[0] != "_"}
    if len(handles) > 1:
        figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=len(handles))
    return figure


def _curve(run: Solution, label: str):
    """(values, load factors): of every step, or, where nothing is watched, of every frame."""
    if label:
        return run.watched[label], run.times
    return np.linalg.norm(np.asarray(run.displacements), axis=2).max(axis=1), run.frame_times


def _draw(panel, name: str, run: Solution, values, factors, position: int) -> None:
    style = line(position)
    text = name if name else "equilibria"
    panel.plot(values, factors, label=text, marker="o", markersize=2.5, **style)
    if run.stable is None or np.all(run.stable) or len(run.stable) != len(values):
        return
    unstable = ~np.asarray(run.stable)
    hollow = {"marker": "o", "markersize": 4, "markerfacecolor": "white", "linestyle": "none"}
    panel.plot(values[unstable], factors[unstable], label="unstable", color=style["color"], **hollow)


def _title(runs: Mapping[str, Solution]) -> str:
    first = next(iter(runs.values()))
    kinds = {"static": "load steps", "arc-length": "arc length"}
    kind = kinds.get(str(first.stats.get("analysis")), "statics")
    return plain(f"{first.scene.name}: load and displacement ({kind})")
