"""Shapes of natural frequencies and buckling factors."""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from jaxshell.plotting.colouring import COLOUR_MAP
from jaxshell.plotting.panels import frame, scale_bar, triad
from jaxshell.plotting.projection import chosen_view, window_of
from jaxshell.plotting.rendering import Sheet, renderer
from jaxshell.plotting.shapes import _grid
from jaxshell.plotting.style import STYLE, WIDTH, length_unit, title
from jaxshell.results.eigenmodes import Eigenmodes
from jaxshell.results.head import MODES

_MOST_PANELS = 12
_SWING = 0.1
"""The largest displacement that is drawn, as a fraction of the shell's size."""


def plot_modes(found: Eigenmodes, directory, stem: str, renderer_name: str = "auto") -> list[Path]:
    """Draw the mode shapes into `directory`/`stem`_modes.png; returns the file's path, in a list as `plot` does."""
    figure = modes_figure(found, renderer_name)
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    path = directory / f"{stem}_modes.png"
    with matplotlib.rc_context(STYLE):
        figure.savefig(path)
    return [path]


def modes_figure(found: Eigenmodes, renderer_name: str = "auto") -> Figure:
    """A panel for each mode, the first twelve at most, with its frequency or load factor above it.

    Shapes are drawn with a largest displacement of a tenth of the shell's size. `renderer_name` as in
    `jaxshell.plotting.figures`.
    """
    shown = [k for k in range(len(found.values)) if np.isfinite(float(found.values[k]))][:_MOST_PANELS]
    sheets = [_swung(found, k) for k in shown]
    painter, colours = renderer(renderer_name), ScalarMappable(Normalize(0, 1), COLOUR_MAP)
    with matplotlib.rc_context(STYLE):
        nodes = np.asarray(found.scene.mesh.nodes)
        view = chosen_view([nodes], found.scene.mesh.triangles)
        window = window_of([view.project(points) for points in (nodes, *(sheet.points for sheet in sheets))])
        rows, columns, height = _grid(max(1, len(shown)), window.size[1] / window.size[0])
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        for panel in panels:
            frame(panel, window)
        for panel, k, sheet in zip(panels, shown, sheets, strict=False):
            painter.draw(panel, [sheet], view, window, colours)
            panel.set_title(_title(found, k))
        scale_bar(panels[-columns], window, *length_unit(found.scene))
        triad(panels[-columns], view)
        bar = figure.colorbar(colours, ax=panels.tolist(), fraction=0.03, aspect=30, pad=0.02)
        bar.set_label("Displacement over its largest")
        bar.outline.set_visible(False)
        what = "natural modes" if found.kind == MODES else "buckling modes"
        figure.suptitle(title(found.scene, "", f"{what}, displacements not to scale"), fontsize=9.5)
    return figure


def _swung(found: Eigenmodes, k: int) -> Sheet:
    """The shell in the shape of a mode, coloured by how far each point moves over the farthest."""
    nodes, triangles = np.asarray(found.scene.mesh.nodes), found.scene.mesh.triangles
    moves = np.asarray(found.shapes[k])[:, :3]
    distances = np.linalg.norm(moves, axis=1)
    moves, distances = (values / (distances.max() or 1.0) for values in (moves, distances))
    size = float(np.linalg.norm(np.ptp(nodes, axis=0)))
    return Sheet(nodes + _SWING * size * moves, triangles, distances[triangles])


def _title(found: Eigenmodes, k: int) -> str:
    value = float(found.values[k])
    if found.kind != MODES:
        return f"{k + 1}: load factor {value:.4g}"
    if value == 0:
        return f"{k + 1}: rigid motion"
    si = found.scene.defaults is not None and found.scene.defaults.units == "SI"
    return f"{k + 1}: {value:.4g} {'Hz' if si else 'per unit of time'}"
