"""Deformed shapes in orthographic projection, true to scale, coloured by displacements, stresses or section forces."""

import math

import numpy as np
from matplotlib.figure import Figure

from jaxshell.model.scene import Scene
from jaxshell.model.supports import symmetry
from jaxshell.plotting.colouring import colouring
from jaxshell.plotting.obstacles import draw_obstacles
from jaxshell.plotting.panels import frame, place_labels, scale_bar, triad
from jaxshell.plotting.projection import chosen_view, window_of
from jaxshell.plotting.rendering import Polygons, Renderer, Sheet
from jaxshell.plotting.style import WIDTH, length_unit, scaled, title
from jaxshell.results.solution import Solution

_MOST_PANELS = 6


def shapes_figure(
    run: Solution, name: str = "", field: str = "displacement", renderer: Renderer | None = None
) -> Figure:
    """The deformed shell at the scene's picture times: a panel each, or one picture along its flight.

    Coloured by a `field` (`colouring`); drawn by `renderer`, None for matplotlib's polygons.
    """
    scene, renderer = run.scene, renderer or Polygons()
    chosen = picture_frames(run)
    times = np.asarray(run.frame_times)[chosen]
    displacements = np.asarray(run.frame(chosen.tolist()).displacements)
    coloured = colouring([run], [chosen.tolist()], field)
    sheets = [whole(scene, u, values) for u, values in zip(displacements, coloured.values, strict=True)]
    view = chosen_view([sheet.points for sheet in sheets], sheets[0].triangles)
    projected = [view.project(sheet.points) for sheet in sheets]
    flies = _flies(np.asarray(scene.mesh.nodes), displacements)
    window = window_of(projected, 0.09 if flies else 0.04)
    static = run.analysis == "static"
    seconds, time_unit = (1.0, "") if static else scaled(scene, float(run.frame_times[-1]), "s")
    labels = [f"{'λ' if static else 't'} = {t / seconds:.4g}{time_unit[3:]}" for t in times]
    rows, columns, height = (1, 1, 4.6) if flies else _grid(len(times), window.size[1] / window.size[0])

    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel in panels:
        frame(panel, window)
    if flies:
        renderer.draw(panels[0], sheets, view, window, coloured.colours)
    else:
        for panel, sheet, label in zip(panels, sheets, labels, strict=False):
            renderer.draw(panel, [sheet], view, window, coloured.colours)
            panel.set_title(label)
    for panel, number in zip(panels, [chosen[-1]] if flies else chosen, strict=False):
        draw_obstacles(panel, run, view, float(run.frame_times[number]), np.concatenate([s.points for s in sheets]))
    last_row = panels[-columns:]
    scale_bar(last_row[0], window, *length_unit(scene))
    triad(last_row[0], view)
    bar = figure.colorbar(coloured.colours, ax=panels.tolist(), fraction=0.03, aspect=30, pad=0.02)
    bar.set_label(coloured.label)
    bar.outline.set_visible(False)
    what = "shapes along the flight" if flies else "deformed shapes"
    figure.suptitle(title(scene, name, f"{what}, true to scale") + _mirrors(scene), fontsize=9.5)
    if flies:
        place_labels(panels[0], projected, labels)
    return figure


def whole(scene: Scene, displacements: np.ndarray, values: np.ndarray) -> Sheet:
    """The deformed shell, mirrored at its planes of symmetry; `values` (m, 3) at the corners of its triangles."""
    points = np.asarray(scene.mesh.nodes) + displacements
    planes = symmetry_planes(scene)
    for axis, value in planes:
        image = points.copy()
        image[:, axis] = 2 * value - image[:, axis]
        points = np.concatenate([points, image])
    copies = 2 ** len(planes)
    triangles = np.concatenate([scene.mesh.triangles + scene.mesh.n_nodes * copy for copy in range(copies)])
    return Sheet(points, triangles, np.tile(values, (copies, 1)))


def symmetry_planes(scene: Scene) -> list[tuple[int, float]]:
    """(axis, coordinate) of each plane of symmetry that supports state, with the shell on one side of it."""
    nodes = np.asarray(scene.mesh.nodes)
    tolerance = 1e-6 * np.ptp(nodes, axis=0).max()
    planes = {}
    for support in scene.supports:
        for axis, normal in enumerate("xyz"):
            if support.moves or set(support.dofs) != set(symmetry([0], normal).dofs):
                continue
            held = nodes[support.nodes.array, axis]
            beyond = nodes[:, axis] - held[0]
            one_side = beyond.min() >= -tolerance or beyond.max() <= tolerance
            if np.ptp(held) <= tolerance and one_side:
                planes.setdefault(axis, float(held[0]))
    return sorted(planes.items())


def picture_frames(run: Solution) -> np.ndarray:
    """Indices of the frames nearest to the scene's picture times, or of a few evenly spaced ones.

    Times that the run does not reach, or that it begins after, are left out; so at least its ends are drawn.
    """
    times = np.asarray(run.frame_times)
    wanted = () if run.scene.defaults is None else run.scene.defaults.picture_times
    reached = [t for t in wanted if times[0] * (1 - 1e-9) <= t <= times[-1] * (1 + 1e-9)]
    if not wanted or len(reached) < 2:
        reached = np.linspace(times[0], times[-1], _MOST_PANELS).tolist()
    elif max(wanted) > times[-1] * (1 + 1e-9):
        reached.append(times[-1])  # where a run stopped early
    return np.unique([int(np.argmin(np.abs(times - t))) for t in reached])


def _mirrors(scene: Scene) -> str:
    """What a title says about planes of symmetry."""
    planes = symmetry_planes(scene)
    if not planes:
        return ""
    divisor, unit = length_unit(scene)
    places = [
        f"{'xyz'[axis]} = {round(value / divisor, 9):g}{' ' + unit if value and unit else ''}" for axis, value in planes
    ]
    return f"\nthe modelled part mirrored at {' and '.join(places)}"


def _flies(nodes: np.ndarray, displacements: np.ndarray) -> bool:
    """Whether the shell moves by more than its size, so that its shapes can stand side by side."""
    way = displacements.mean(axis=1)
    return bool(np.linalg.norm(np.ptp(way, axis=0)) > np.linalg.norm(np.ptp(nodes, axis=0)))


def _grid(count: int, aspect: float) -> tuple[int, int, float]:
    """Rows, columns and height of a figure of `count` panels of the given height over width."""

    def figure_height(columns):
        return 1.2 + math.ceil(count / columns) * (0.9 * WIDTH / columns * aspect + 0.35)

    # As few gaps as can be, then nearest to a page's half.
    columns = min(range(1, min(4, count) + 1), key=lambda c: abs(figure_height(c) - 4.2) + 0.6 * (-count % c))
    return math.ceil(count / columns), columns, figure_height(columns)
