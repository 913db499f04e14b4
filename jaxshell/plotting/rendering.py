"""Shells in a panel: rendered with true depth by VTK where PyVista is installed, else as polygons of matplotlib.

Both draw the same sheets in the same window, with the same colours, light and mesh lines; labels, bars and axes are
matplotlib's in either case. Polygons are sorted by their middles (painter's algorithm), so that triangles that pierce
each other, or hang over each other in a ring, may come out in the wrong order; and each has one colour.
"""

import abc
import importlib.util
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection

from jaxshell.numerics.checks import check_choice
from jaxshell.plotting import offscreen
from jaxshell.plotting.projection import View, Window
from jaxshell.plotting.style import WIDTH

RENDERERS = ("auto", "vtk", "matplotlib")
_DOTS = 240.0
"""Pixels to an inch of what VTK renders; pictures have 200 of them, so that edges come out smooth."""
_FINE = 5.0
"""Mesh lines closer than so many pixels are left out: they would be all that one sees."""


class Sheet(NamedTuple):
    """A surface to draw."""

    points: np.ndarray
    """(n, 3)"""
    triangles: np.ndarray
    """(m, 3)"""
    values: np.ndarray
    """(m, 3) at the triangles' corners, to be coloured."""


class Renderer(abc.ABC):
    """Draws sheets into a panel."""

    @abc.abstractmethod
    def draw(self, panel: Axes, sheets: Sequence[Sheet], view: View, window: Window, colours: ScalarMappable) -> Artist:
        """Add the sheets to the panel, which shows the window of the view already; returns what was added."""


class Polygons(Renderer):
    """matplotlib's polygons."""

    def draw(self, panel, sheets, view, window, colours) -> Artist:
        corners = np.concatenate([view.project(sheet.points)[sheet.triangles] for sheet in sheets])
        faces = colours.to_rgba(np.concatenate([sheet.values.mean(axis=1) for sheet in sheets]))
        faces[:, :3] *= offscreen.shade(corners)[:, None]
        order = np.argsort(corners[:, :, 2].mean(axis=1))
        edges = faces * np.array([0.7, 0.7, 0.7, 1.0]) if _lines(corners, window, _inches(panel)) else faces
        outlines = list(corners[order, :, :2])
        return panel.add_collection(
            PolyCollection(outlines, facecolors=faces[order], edgecolors=edges[order], linewidths=0.25)
        )


class Rendered(Renderer):
    """VTK's picture, in another process; `fallback` draws where that fails, or it raises offscreen.RenderingFailed."""

    def __init__(self, fallback: Renderer | None, dots: float | None = None):
        self.fallback, self.dots = fallback, _DOTS if dots is None else dots

    def draw(self, panel, sheets, view, window, colours) -> Artist:
        try:
            image = offscreen.image(self._job(panel, sheets, view, window, colours))
        except offscreen.RenderingFailed:
            if self.fallback is None:
                raise
            return self.fallback.draw(panel, sheets, view, window, colours)
        extent = (window.low[0], window.high[0], window.low[1], window.high[1])
        return panel.imshow(image, extent=extent, origin="upper", aspect="equal", zorder=1)

    def _job(self, panel, sheets, view, window, colours) -> dict[str, Any]:
        corners = np.concatenate([view.project(sheet.points)[sheet.triangles] for sheet in sheets])
        inches = _inches(panel)
        pixels = np.clip(np.round(self.dots * inches * window.size / window.size.max()), 8, 4096).astype(int)
        colour_map = np.asarray(colours.get_cmap()(np.arange(colours.get_cmap().N)))
        return {
            "corners": corners,
            "values": np.concatenate([sheet.values for sheet in sheets]),
            "colours": np.round(255 * colour_map).astype(np.uint8),
            "limits": tuple(map(float, colours.get_clim())),
            "window": (*map(float, window.low), *map(float, window.high)),
            "pixels": tuple(map(int, pixels)),
            "lines": _lines(corners, window, inches),
        }


def renderer(name: str = "auto", dots: float | None = None) -> Renderer:
    """ "vtk", "matplotlib", or "auto": VTK where PyVista is installed and renders, else matplotlib. `dots` are VTK's
    pixels to an inch; None suits still pictures.

    Raises ValueError for another name; ImportError for "vtk" without PyVista.
    """
    check_choice("renderer", name, RENDERERS)
    polygons = Polygons()
    if name == "matplotlib":
        return polygons
    if importlib.util.find_spec("pyvista") is None:
        if name == "vtk":
            raise ImportError('renderer="vtk" needs PyVista: pip install pyvista')
        return polygons
    return Rendered(polygons if name == "auto" else None, dots)


def _inches(panel: Axes) -> float:
    """About how long the longer side of the panel's picture is."""
    figure = panel.get_figure(root=True)
    spec = panel.get_subplotspec()
    rows, columns = (1, 1) if spec is None else spec.get_gridspec().get_geometry()
    width, height = (WIDTH, WIDTH) if figure is None else figure.get_size_inches()
    return float(max(width / columns, height / rows))


def _lines(corners: np.ndarray, window: Window, inches: float) -> bool:
    """Whether lines of the mesh are far enough apart to be drawn."""
    lengths = np.linalg.norm(np.roll(corners, 1, axis=1) - corners, axis=2)
    return bool(np.median(lengths) / window.size.max() * inches * 200 > _FINE)
