"""Deformed shapes in orthographic projection, true to scale, coloured by displacements, stresses or section forces."""

import math

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from jaxshell.model.scene import Scene
from jaxshell.model.supports import symmetry
from jaxshell.plotting.colouring import contour, displaced
from jaxshell.plotting.style import WIDTH, scaled
from jaxshell.results.solution import Solution

_AZIMUTH, _ELEVATION, _LOW_ELEVATION = math.radians(-60.0), math.radians(22.0), math.radians(11.0)
_FLAT = 0.15
"""A shell that never rises above this fraction of its width is seen from lower, or its height would not show."""
_MOST_PANELS = 6


def shapes_figure(run: Solution, name: str = "", component: str | None = None) -> Figure:
    """The deformed shell at the scene's picture times: a panel each, or one picture along its flight.

    Coloured by displacements, or by the smoothed values of `component`, the text of a gauge (`jaxshell.model.gauge`).
    """
    scene = run.scene
    chosen = _picture_frames(run)
    times = np.asarray(run.frame_times)[chosen]
    displacements = np.asarray(run.frame(chosen).displacements)
    planes = symmetry_planes(scene)
    shapes = [np.asarray(scene.mesh.nodes) + u for u in displacements]
    colouring = displaced(run, displacements) if component is None else contour(run, chosen.tolist(), component)
    triangles = _mirrored_triangles(scene.mesh.triangles, scene.mesh.n_nodes, 2 ** len(planes))
    shapes = [_mirrored(shape, planes) for shape in shapes]
    values = [np.tile(value, 2 ** len(planes)) for value in colouring.values]
    colours = colouring.colours
    seconds, time_unit = scaled(scene, float(run.frame_times[-1]), "s")
    labels = [f"t = {t / seconds:.4g}{time_unit.replace(' in', '')}" for t in times]
    projected = [_project(shape, _elevation(shapes)) for shape in shapes]
    low = np.min([p[:, :2].min(0) for p in projected], axis=0)
    high = np.max([p[:, :2].max(0) for p in projected], axis=0)
    flies = _flies(np.asarray(scene.mesh.nodes), displacements)
    rows, columns, height = (1, 1, 4.6) if flies else _grid(len(times), (high - low)[1] / (high - low)[0])

    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    if flies:
        _draw(panels[0], projected, shapes, triangles, values, colours)
        _label_shapes(panels[0], projected, labels)
    else:
        for i, label in enumerate(labels):
            _draw(panels[i], [projected[i]], [shapes[i]], triangles, [values[i]], colours)
            panels[i].set_title(label)
    margin = 0.04 * (high - low).max()
    for panel in panels:
        panel.set_axis_off()
        panel.set_aspect("equal")
        panel.set_xlim(low[0] - margin, high[0] + margin)
        panel.set_ylim(low[1] - margin, high[1] + margin)
    _scale_bar(panels[len(times) - 1 if not flies else 0], scene, low, high)
    bar = figure.colorbar(colours, ax=panels.tolist(), fraction=0.03, aspect=30, pad=0.02)
    bar.set_label(colouring.label)
    bar.outline.set_visible(False)
    figure.suptitle(_title(name, planes), fontsize=9.5)
    return figure


def symmetry_planes(scene: Scene) -> list[tuple[int, float]]:
    """(axis, coordinate) of each plane of symmetry that supports state, with the shell on one side of it."""
    nodes = np.asarray(scene.mesh.nodes)
    tolerance = 1e-6 * np.ptp(nodes, axis=0).max()
    planes = {}
    for support in scene.supports:
        for axis, normal in enumerate("xyz"):
            if support.displacement is not None or set(support.dofs) != set(symmetry([0], normal).dofs):
                continue
            held = nodes[support.nodes.array, axis]
            beyond = nodes[:, axis] - held[0]
            one_side = beyond.min() >= -tolerance or beyond.max() <= tolerance
            if np.ptp(held) <= tolerance and one_side:
                planes.setdefault(axis, float(held[0]))
    return sorted(planes.items())


def _title(name: str, planes) -> str:
    title = "Deformed shapes, true to scale" + (f" ({name})" if name else "")
    if planes:
        mirrors = " and ".join(f"{'xyz'[axis]} = {round(value, 12):g}" for axis, value in planes)
        title += f"; the modelled part mirrored at {mirrors}"
    return title


def _picture_frames(run: Solution) -> np.ndarray:
    """Indices of the frames nearest to the scene's picture times, or of a few evenly spaced ones."""
    times = np.asarray(run.frame_times)
    wanted = () if run.scene.defaults is None else run.scene.defaults.picture_times
    # Of a run that stopped early, the times that it reached, and where it stopped.
    reached = [t for t in wanted if t <= times[-1] * (1 + 1e-9)]
    if len(reached) < len(wanted):
        reached.append(times[-1])
    if not reached:
        reached = np.linspace(times[0], times[-1], _MOST_PANELS)
    return np.unique([int(np.argmin(np.abs(times - t))) for t in reached])


def _flies(nodes: np.ndarray, displacements: np.ndarray) -> bool:
    """Whether the shell moves by more than its size, so that its shapes can stand side by side."""
    way = displacements.mean(axis=1)
    return bool(np.linalg.norm(np.ptp(way, axis=0)) > np.linalg.norm(np.ptp(nodes, axis=0)))


def _mirrored(points: np.ndarray, planes) -> np.ndarray:
    for axis, value in planes:
        image = points.copy()
        image[:, axis] = 2 * value - image[:, axis]
        points = np.concatenate([points, image])
    return points


def _mirrored_triangles(triangles: np.ndarray, n_nodes: int, copies: int) -> np.ndarray:
    return np.concatenate([triangles + n_nodes * copy for copy in range(copies)])


def _elevation(shapes) -> float:
    span = np.max([s.max(0) for s in shapes], axis=0) - np.min([s.min(0) for s in shapes], axis=0)
    return _LOW_ELEVATION if span[2] < _FLAT * max(span[0], span[1]) else _ELEVATION


def _project(points: np.ndarray, elevation: float) -> np.ndarray:
    """(n, 3) right, up and towards the viewer."""
    ca, sa, ce, se = math.cos(_AZIMUTH), math.sin(_AZIMUTH), math.cos(elevation), math.sin(elevation)
    towards = np.array([ce * ca, ce * sa, se])
    right = np.array([-sa, ca, 0.0])
    return points @ np.stack([right, np.cross(towards, right), towards], axis=1)


def _draw(panel, projected, shapes, triangles, values, colours) -> None:
    """Triangles of all shapes, the farthest first (painter's algorithm), shaded by how they face a light."""
    corners = np.concatenate([p[triangles] for p in projected])
    solid = np.concatenate([shape[triangles] for shape in shapes])
    normals = np.cross(solid[:, 1] - solid[:, 0], solid[:, 2] - solid[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    light = np.array([0.3, -0.6, 0.75]) / np.linalg.norm([0.3, -0.6, 0.75])
    faces = colours.to_rgba(np.concatenate(values))
    faces[:, :3] *= 0.72 + 0.28 * np.abs(normals @ light)[:, None]
    order = np.argsort(corners[:, :, 2].mean(axis=1))
    edges = faces * np.array([0.7, 0.7, 0.7, 1.0])
    outlines = list(corners[order, :, :2])
    panel.add_collection(PolyCollection(outlines, facecolors=faces[order], edgecolors=edges[order], linewidths=0.25))


def _label_shapes(panel, projected, labels) -> None:
    """Each shape's time above its highest point, and above the labels that stand there already."""
    # Sizes of a line of text in the picture's units: nothing is laid out yet.
    width, height = np.ptp(np.concatenate([p[:, :2] for p in projected]), axis=0)
    inch = max(width / (0.8 * WIDTH), height / (0.8 * panel.figure.get_figheight()))
    line, letter = 0.2 * inch, 0.08 * inch
    placed = []
    for p, label in zip(projected, labels, strict=True):
        x, y = p[np.argmax(p[:, 1]), :2]
        while near := [k for h, k in placed if abs(x - h) < letter * len(label) and abs(y - k) < 0.99 * line]:
            y = max(near) + line
        placed.append((x, y))
        panel.annotate(label, (x, y), (0, 4), textcoords="offset points", ha="center", va="bottom")


def _scale_bar(panel, scene: Scene, low, high) -> None:
    """A bar of a round length: in orthographic projection it holds for every length across the view."""
    size = high[0] - low[0]
    power = 10.0 ** math.floor(math.log10(0.3 * size))
    bar = max(step * power for step in (1, 2, 5) if step * power <= 0.3 * size)
    divisor, unit = scaled(scene, bar, "m")
    y = low[1] - 0.02 * (high - low).max()
    panel.plot([high[0] - bar, high[0]], [y, y], color="black", lw=1.5, solid_capstyle="butt", clip_on=False)
    text = f"{bar / divisor:g}{unit.replace(' in', '')}"
    panel.annotate(text, (high[0] - bar / 2, y), (0, -3), textcoords="offset points", ha="center", va="top")


def _grid(count: int, aspect: float) -> tuple[int, int, float]:
    """Rows, columns and height of a figure of `count` panels of the given height over width."""

    def figure_height(columns):
        return 0.6 + math.ceil(count / columns) * (0.9 * WIDTH / columns * aspect + 0.35)

    # As few gaps as can be, then nearest to a page's half.
    columns = min(range(1, min(4, count) + 1), key=lambda c: abs(figure_height(c) - 4.2) + 0.6 * (-count % c))
    return math.ceil(count / columns), columns, figure_height(columns)
