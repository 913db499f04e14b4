"""A window to look at runs in: turn, zoom, and move in time with a slider. PyVista's; in notebooks by trame."""

import importlib.util
import os
import sys
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from jaxshell.plotting.colouring import Colouring, colouring, field_values
from jaxshell.plotting.projection import chosen_view
from jaxshell.plotting.rendering import Sheet
from jaxshell.plotting.shapes import whole
from jaxshell.plotting.style import scaled, title
from jaxshell.plotting.titles import named_runs
from jaxshell.results.solution import Solution

_MOST_SCALED = 60
"""The scale of colours is that of so many frames, spread over the run."""
_NO_DISPLAY = (
    "There is no display to open a window on. `jaxshell animate` and `jaxshell plot` need none; in a notebook, "
    "jaxshell.plotting.view shows the run in the page."
)
_OFF_SCREEN = ("EGL", "OSOpenGL")
"""In the names of VTK's windows that nobody sees."""


class Stage(NamedTuple):
    """A plotter with the runs on it, one beside the other."""

    plotter: Any
    show: Callable[[float], None]
    """Shows the frames that are nearest to a time, in the solutions' unit."""


def view(solutions: Mapping[str, Solution] | Solution, field: str = "displacement", *, notebook: bool | None = None):
    """Open a window on one run, or on several side by side, with a slider for the time.

    Arguments:
        field: what colours the shapes: "displacement", "velocity", or a gauge's text such as "von mises top".
        notebook: whether to show it in a notebook's page; None finds out.

    Returns when the window is closed; in a notebook at once, with what shows it. Raises ImportError without PyVista, or
    in a notebook without trame, OSError where there is no display, and ValueError as `figures`.
    """
    pyvista = _pyvista()
    runs = named_runs(solutions)
    notebook = _in_notebook() if notebook is None else notebook
    if notebook and importlib.util.find_spec("trame") is None:
        raise ImportError("In notebooks PyVista needs trame: pip install 'pyvista[jupyter]'")
    if not notebook and sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        raise OSError(_NO_DISPLAY)
    stage = staged(runs, field, pyvista.Plotter(shape=(1, len(runs)), notebook=notebook, title="jaxshell"))
    if notebook:
        return stage.plotter.show(jupyter_backend="trame", return_viewer=True)
    if any(name in type(stage.plotter.render_window).__name__ for name in _OFF_SCREEN):
        stage.plotter.close()
        raise OSError(_NO_DISPLAY)
    stage.plotter.show()
    return None


def staged(runs: Mapping[str, Solution], field: str, plotter) -> Stage:
    """Put the runs on a plotter with as many places."""
    pyvista = _pyvista()
    frames = [_spread(run) for run in runs.values()]
    coloured = colouring(list(runs.values()), frames, field)
    meshes = []
    for place, (name, run) in enumerate(runs.items()):
        plotter.subplot(0, place)
        sheet = _sheet(run, 0, field, coloured)
        mesh = pyvista.PolyData.from_regular_faces(*_surface(sheet))
        mesh.point_data["values"] = sheet.values.ravel()
        meshes.append(mesh)
        _add(plotter, mesh, coloured, place)
        plotter.add_text(title(run.scene, name, "").rstrip(": ").replace(r"\$", "$"), font_size=9, name="title")
        plotter.add_axes()
        _look(plotter, run)
    if len(meshes) > 1:
        plotter.link_views()
    return Stage(plotter, _slider(plotter, runs, field, coloured, meshes))


def _slider(plotter, runs: Mapping[str, Solution], field: str, coloured: Colouring, meshes) -> Callable[[float], None]:
    first = next(iter(runs.values()))
    times = [np.asarray(run.frame_times) for run in runs.values()]
    end = max(float(t[-1]) for t in times)
    divisor, unit = scaled(first.scene, end, "s")

    def show(time: float) -> None:
        for run, stored, mesh in zip(runs.values(), times, meshes, strict=True):
            sheet = _sheet(run, int(np.abs(stored - time).argmin()), field, coloured)
            mesh.points = _surface(sheet)[0]
            mesh.point_data["values"] = sheet.values.ravel()
        plotter.render()

    plotter.subplot(0, 0)
    plotter.add_slider_widget(
        lambda value: show(value * divisor),
        (float(min(t[0] for t in times)) / divisor, end / divisor),
        value=float(min(t[0] for t in times)) / divisor,
        title="Load factor" if first.analysis == "static" else f"Time{unit}",
        pointa=(0.25, 0.08),
        pointb=(0.75, 0.08),
        title_height=0.02,
        slider_width=0.02,
        tube_width=0.004,
        fmt="%.4g",
        interaction_event="always",
    )
    return show


def _add(plotter, mesh, coloured: Colouring, place: int) -> None:
    low, high = coloured.colours.get_clim()
    plotter.add_mesh(
        mesh,
        scalars="values",
        clim=[low, high],
        cmap=coloured.colours.get_cmap(),
        show_edges=True,
        edge_opacity=0.3,
        ambient=0.3,
        scalar_bar_args={"title": f"{coloured.label}{' ' * place}", "vertical": True, "fmt": "%.3g"},
    )


def _look(plotter, run: Solution) -> None:
    """From the direction of the still pictures, at all frames."""
    shapes = [_points(run, frame) for frame in _spread(run)]
    axes = chosen_view(shapes, whole(run.scene, np.zeros_like(run.scene.mesh.nodes), _none(run)).triangles).axes
    low, high = np.min([s.min(0) for s in shapes], axis=0), np.max([s.max(0) for s in shapes], axis=0)
    plotter.view_vector(axes[:, 2], viewup=(0, 0, 1), bounds=[v for pair in zip(low, high, strict=True) for v in pair])


def _spread(run: Solution) -> list[int]:
    return np.unique(np.linspace(0, len(run.frame_times) - 1, _MOST_SCALED).round().astype(int)).tolist()


def _none(run: Solution) -> np.ndarray:
    return np.zeros((run.scene.mesh.n_elements, 3))


def _points(run: Solution, frame: int) -> np.ndarray:
    return whole(run.scene, np.asarray(run.frame(frame).displacements), _none(run)).points


def _sheet(run: Solution, frame: int, field: str, coloured: Colouring) -> Sheet:
    values = field_values(run, [frame], field)[0] / coloured.divisor
    return whole(run.scene, np.asarray(run.frame(frame).displacements), values)


def _surface(sheet: Sheet) -> tuple[np.ndarray, np.ndarray]:
    """Points and faces with a point for every corner, so that values may jump from triangle to triangle."""
    points = sheet.points[sheet.triangles].reshape(-1, 3)
    return points, np.arange(len(points)).reshape(-1, 3)


def _in_notebook() -> bool:
    shell = sys.modules.get("IPython")
    running = shell.get_ipython() if shell is not None else None
    return type(running).__name__ == "ZMQInteractiveShell"


def _pyvista() -> Any:
    try:
        import pyvista
    except ImportError:
        raise ImportError("Windows are PyVista's: pip install pyvista") from None
    return pyvista
