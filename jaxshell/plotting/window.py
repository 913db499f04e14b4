"""A window to look at runs in: turn, zoom, and move in time with a slider. PyVista's; in notebooks a page by trame."""

import contextlib
import importlib.util
import itertools
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping
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
_PLACES = {
    False: {"title": 0.92, "bar": 0.81, "slider": 0.08},
    True: {"title": 0.02, "bar": 0.11},
}
"""Heights in a window; and in a notebook, where PyVista's menu is at the top."""
_UNDER_MENU = (
    "position: fixed; top: 62px; left: 20px; width: 460px; display: flex; gap: 12px; align-items: center; "
    "white-space: nowrap; background: white"
)
"""Style of the slider in a notebook's page."""
_pages = itertools.count()
"""Numbers the sliders of a notebook's pages, which share a server."""


class Stage(NamedTuple):
    """A plotter with the runs on it, one beside the other."""

    plotter: Any
    show: Callable[[float], None]
    """Shows the frames that are nearest to a time, in the solutions' unit."""
    clock: "Clock"


class Clock(NamedTuple):
    """What the slider goes through."""

    start: float
    end: float
    divisor: float
    """What the solutions' times are divided by."""
    label: str
    unit: str


def view(solutions: Mapping[str, Solution] | Solution, field: str = "displacement", *, notebook: bool | None = None):
    """Open a window on one run, or on several side by side, with a slider for the time.

    Arguments:
        field: what colours the shapes: "displacement", "velocity", "mesh error", or a gauge's text such as "von mises
            top".
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
    with _quiet():
        plotter = pyvista.Plotter(shape=(1, len(runs)), notebook=notebook, title="jaxshell")
    stage = staged(runs, field, plotter, notebook)
    if notebook:
        return _page(stage)
    if any(name in type(plotter.render_window).__name__ for name in _OFF_SCREEN):
        plotter.close()
        raise OSError(_NO_DISPLAY)
    _add_slider(stage)
    plotter.show()
    return None


def staged(runs: Mapping[str, Solution], field: str, plotter, notebook: bool = False) -> Stage:
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
        _add(plotter, mesh, coloured, place, _PLACES[notebook]["bar"])
        head = spoken(f"{title(run.scene, name, '').rstrip(': ')}\n{coloured.label}")
        plotter.add_text(head, position=(0.01, _PLACES[notebook]["title"]), viewport=True, font_size=9, name="title")
        plotter.add_axes(viewport=(0.0, 0.2, 0.18, 0.4))
        _look(plotter, run)
    if len(meshes) > 1:
        plotter.link_views()
    return Stage(plotter, _shower(plotter, runs, field, coloured, meshes), _clock(runs))


def _clock(runs: Mapping[str, Solution]) -> Clock:
    first = next(iter(runs.values()))
    start = min(float(run.frame_times[0]) for run in runs.values())
    end = max(float(run.frame_times[-1]) for run in runs.values())
    if first.analysis == "static":
        return Clock(start, end, 1.0, "Load factor", "")
    divisor, unit = scaled(first.scene, end, "s")
    return Clock(start, end, divisor, "Time", unit.removeprefix(" in "))


def _shower(plotter, runs: Mapping[str, Solution], field: str, coloured: Colouring, meshes) -> Callable[[float], None]:
    times = [np.asarray(run.frame_times) for run in runs.values()]

    def show(time: float) -> None:
        for run, stored, mesh in zip(runs.values(), times, meshes, strict=True):
            sheet = _sheet(run, int(np.abs(stored - time).argmin()), field, coloured)
            mesh.points = _surface(sheet)[0]
            mesh.point_data["values"] = sheet.values.ravel()
        plotter.render()

    return show


def _add_slider(stage: Stage) -> None:
    """VTK's, at the bottom of a window."""
    clock, height = stage.clock, _PLACES[False]["slider"]
    stage.plotter.subplot(0, 0)
    stage.plotter.add_slider_widget(
        lambda value: stage.show(value * clock.divisor),
        (clock.start / clock.divisor, clock.end / clock.divisor),
        value=clock.start / clock.divisor,
        title=f"{clock.label} in {clock.unit}" if clock.unit else clock.label,
        pointa=(0.25, height),
        pointb=(0.75, height),
        title_height=0.02,
        slider_width=0.02,
        tube_width=0.004,
        fmt="%.4g",
        interaction_event="always",
    )


def _page(stage: Stage) -> Any:
    """What shows the runs in a notebook's page, with a slider in PyVista's menu there."""
    clock, name = stage.clock, f"jaxshell_time_{next(_pages)}"

    def items() -> None:
        from trame.widgets import html, vuetify3

        with html.Div(style=_UNDER_MENU):
            vuetify3.VSlider(
                v_model=(name, clock.start / clock.divisor),
                min=clock.start / clock.divisor,
                max=clock.end / clock.divisor,
                step=(clock.end - clock.start) / clock.divisor / 1000 or 1.0,
                hide_details=True,
                density="compact",
            )
            html.Span(f"{clock.label} {{{{ Number({name}).toPrecision(4) }}}} {clock.unit}", style="width: 12em")

    shown = stage.plotter.show(jupyter_backend="trame", jupyter_kwargs={"add_menu_items": items}, return_viewer=True)
    viewer = shown.viewer
    viewer.server.state[viewer.EDGES] = True  # as they are drawn, not as the menu begins

    @viewer.server.state.change(name)
    def move(**state) -> None:
        stage.show(float(state[name]) * clock.divisor)
        viewer.update()

    return shown


def spoken(text: str) -> str:
    """A text of matplotlib's as VTK writes it: without formulas, and without Greek, which its letters lack."""
    for mark, letter in ((r"\sigma_", "Stress "), (r"\tau_", "Shear stress "), (r"\$", "\0")):
        text = text.replace(mark, letter)
    return re.sub(r"_?\{(\w+)\}", r"\1", text).replace("$", "").replace("\0", "$")


def _add(plotter, mesh, coloured: Colouring, place: int, height: float) -> None:
    low, high = coloured.colours.get_clim()
    plotter.add_mesh(
        mesh,
        scalars="values",
        clim=[low, high],
        cmap=coloured.colours.get_cmap(),
        show_edges=True,
        edge_opacity=0.3,
        ambient=0.3,
        scalar_bar_args={
            "title": " " * (place + 1),  # one bar for each place: PyVista tells them apart by their titles
            "vertical": False,
            "position_x": 0.2,
            "position_y": height,
            "width": 0.6,
            "height": 0.09,
            "label_font_size": 12,
            "fmt": "%.3g",
        },
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


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Without what VTK warns of while it looks for a display: `view` says what is missing, and notebooks need none."""
    from vtkmodules.vtkCommonCore import vtkLogger

    before = vtkLogger.GetCurrentVerbosityCutoff()
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)
    try:
        yield
    finally:
        vtkLogger.SetStderrVerbosity(before)


def _pyvista() -> Any:
    try:
        import pyvista
    except ImportError:
        raise ImportError("Windows are PyVista's: pip install pyvista") from None
    return pyvista
