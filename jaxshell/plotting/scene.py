"""A scene before it is run: the mesh with its sets, what holds its nodes, what loads them, and what is watched."""

from collections.abc import Sequence
from typing import NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from jaxshell.model.contribution import Contribution
from jaxshell.model.loads import Load
from jaxshell.model.loads.base import DeadLoad
from jaxshell.model.scene import Scene
from jaxshell.model.sections import Regions
from jaxshell.model.supports import ALL, Support, pinned, symmetry
from jaxshell.numerics.checks import check_kind
from jaxshell.plotting.panels import frame, scale_bar, triad
from jaxshell.plotting.projection import View, Window, chosen_view, window_of
from jaxshell.plotting.rendering import Sheet, renderer
from jaxshell.plotting.style import BLACK, COLOURS, GREEN, ORANGE, PURPLE, STYLE, VERMILLION, WIDTH, length_unit, plain
from jaxshell.results.nodal_loads import nodal_loads

_MOST_ARROWS, _MOST_SYMBOLS = 60, 400
_LONGEST = 0.16
"""Length of a load's longest arrow, as a fraction of the picture's longer side."""
_SURFACES = ("#D9DDE3", "#F2DDB5", "#CFE5DA", "#E4D3E6", "#F3CFC6", "#CFE0F1", "#E9E6C3", "#D8D0C6")
"""Of the regions or sets of elements: pale, so that symbols stand out."""
_LOAD_COLOURS = (VERMILLION, PURPLE, ORANGE, GREEN)


class _Arrows(NamedTuple):
    """Vectors of a load at some points."""

    label: str
    points: np.ndarray
    vectors: np.ndarray
    turns: bool
    """Whether they are moments."""


def scene_figure(scene: Scene, *, renderer_name: str = "auto") -> Figure:
    """A scene in its stress-free shape: sets of elements by colours, supports by symbols, loads by arrows, connectors
    by lines, what is watched by stars; a legend names them all, with scale bar and axes.

    Arrows are as long as the largest force of their load where its history is largest; loads are not compared with each
    other. `renderer_name` is "auto", "vtk" or "matplotlib".
    """
    check_kind("scene", scene, Scene, "a jaxshell.Scene")
    nodes, triangles = np.asarray(scene.mesh.nodes), scene.mesh.triangles
    view = chosen_view([nodes], triangles)
    arrows = []
    for load, nodal in nodal_loads(scene):
        factors = np.asarray(load.history.values)
        arrows += _arrows(load, nodes, factors[np.argmax(np.abs(factors))] * np.asarray(nodal))
    size = float(window_of([view.project(nodes)]).size.max())
    tails = [_tails(view, size, each) for each in arrows]
    ends = [found.reshape(-1, 3) for item in scene.items if len(found := item.segments(scene.mesh))]
    seen = [view.project(nodes), *(tail for tail in tails if len(tail)), *map(view.project, ends)]
    window = window_of(seen, margin=0.06)
    with matplotlib.rc_context(STYLE):
        return _figure(scene, view, window, list(zip(arrows, tails, strict=True)), renderer_name)


def _figure(scene: Scene, view: View, window: Window, arrows, renderer_name: str) -> Figure:
    aspect = window.size[1] / window.size[0]
    figure = Figure(figsize=(WIDTH, float(np.clip(0.65 * WIDTH * aspect, 1.6, 5.5)) + 0.8), layout="constrained")
    panel = figure.subplots()
    names, numbers = _surfaces(scene)
    palette = ListedColormap([_SURFACES[i % len(_SURFACES)] for i in range(len(names))])
    colours = ScalarMappable(Normalize(-0.5, len(names) - 0.5), palette)
    values = np.repeat(numbers[:, None].astype(float), 3, axis=1)
    sheet = Sheet(np.asarray(scene.mesh.nodes), scene.mesh.triangles, values)
    frame(panel, window)
    renderer(renderer_name).draw(panel, [sheet], view, window, colours)
    frame(panel, window)
    entries = [
        Patch(facecolor=palette(i), edgecolor="0.6", label=f"{plain(name)}: {_count(np.sum(numbers == i), 'element')}")
        for i, name in enumerate(names)
        if name
    ]
    entries += _draw_supports(panel, scene, view)
    for position, (each, tails) in enumerate(arrows):
        entries.append(_draw_arrows(panel, view, each, tails, _LOAD_COLOURS[position % len(_LOAD_COLOURS)]))
    entries += _draw_items(panel, scene, view)
    entries += _draw_watched(panel, scene, view)
    entries += [_words(text) for text in _without_place(scene)]
    divisor, unit = length_unit(scene)
    scale_bar(panel, window, divisor, unit)
    triad(panel, view)
    if entries:
        figure.legend(handles=entries, loc="outside right upper", fontsize=8, handlelength=1.6)
    figure.suptitle(f"{plain(scene.name)}: supports and loads", fontsize=9.5)
    return figure


def _surfaces(scene: Scene) -> tuple[list[str], np.ndarray]:
    """Names of the regions of the section, else of the sets of elements, and (m,) which one an element is drawn as.

    An element of several sets is drawn as the last; the legend counts what is drawn.
    """
    numbers = np.zeros(scene.mesh.n_elements, int)
    sets = dict(scene.mesh.element_sets)
    if isinstance(scene.section, Regions):
        of_sets = {tuple(array.tolist()): name for name, array in sets.items()}
        names = []
        for i, elements in enumerate(scene.section.elements):
            names.append(of_sets.get(tuple(elements.array.tolist()), f"section {i}"))
            numbers[elements.array] = i
        return names, numbers
    names = ["", *sets]
    for i, array in enumerate(sets.values(), start=1):
        numbers[array] = i
    return names, numbers


def _draw_supports(panel: Axes, scene: Scene, view: View) -> list[Line2D]:
    """A symbol on every node that is held, one kind for each kind of support."""
    kinds: dict[str, list[np.ndarray]] = {}
    for support in scene.supports:
        kinds.setdefault(held_as(support), []).append(support.nodes.array)
    drawn = []
    markers = {"clamped": "s", "pinned": "^"}
    others = iter("DovP<>hX*d" * 10)
    for position, (kind, parts) in enumerate(kinds.items()):
        nodes = np.unique(np.concatenate(parts))
        at = view.project(np.asarray(scene.mesh.nodes)[_some(nodes, _MOST_SYMBOLS)])
        colour = (BLACK, *COLOURS[:1], *COLOURS[2:])[position % len(COLOURS)]
        style = {"color": colour, "marker": markers.get(kind) or next(others), "markersize": 4.0, "linestyle": "none"}
        (line,) = panel.plot(
            at[:, 0], at[:, 1], **style, markerfacecolor="white" if kind != "clamped" else colour, zorder=3
        )
        line.set_label(f"{kind}: {_named(scene, nodes)}{_count(len(nodes), 'node')}")
        drawn.append(line)
    return drawn


def _draw_items(panel: Axes, scene: Scene, view: View) -> list[Line2D]:
    """Lines from end to end of connectors and the like, of one look for each of them."""
    drawn = []
    for position, item in enumerate(scene.items):
        segments = item.segments(scene.mesh)
        if not len(segments):
            continue
        style = {
            "color": COLOURS[(position + 2) % len(COLOURS)],
            "lw": 1.0,
            "marker": "o",
            "markersize": 2.5,
            "zorder": 4,
        }
        for segment in _some(segments, _MOST_SYMBOLS):
            at = view.project(segment)
            (line,) = panel.plot(at[:, 0], at[:, 1], **style)
        name = "" if item.name is None else f" {plain(item.name)}"
        line.set_label(f"{item.kind}{name}: {len(segments)}")
        drawn.append(line)
    return drawn


def _named(scene: Scene, nodes: np.ndarray) -> str:
    """The name of the set of nodes that these are, and a comma; empty where they are none."""
    found = (name for name, array in scene.mesh.node_sets.items() if np.array_equal(array, nodes))
    name = next(found, "")
    return f"{plain(name)}, " if name else ""


def held_as(support: Support) -> str:
    """A support's usual name, such as "clamped", "symmetry x", else what it holds or moves, such as "ux, uy held"."""
    dofs = set(support.dofs)
    if support.rotation is not None:
        return "turned in place" if support.about is None else "turned as one body"
    if support.moves:
        return f"{', '.join(support.dofs)} {'moved' if support.acceleration is None else 'accelerated'}"
    if dofs == set(ALL):
        return "clamped"
    if dofs == set(pinned([0]).dofs):
        return "pinned"
    for normal in "xyz":
        if dofs == set(symmetry([0], normal).dofs):
            return f"symmetry {normal}"
    return f"{', '.join(support.dofs)} held"


def _arrows(load: Load, nodes: np.ndarray, nodal: np.ndarray) -> list[_Arrows]:
    """Of a load its forces and its moments, `nodal` (n, 6), on at most so many nodes."""
    found = []
    for turns, vectors in ((False, nodal[:, :3]), (True, nodal[:, 3:])):
        size = np.linalg.norm(vectors, axis=1)
        loaded = np.flatnonzero(size > 1e-12 * max(float(size.max()), 1e-300))
        if not loaded.size:
            continue
        kept = _some(loaded, _MOST_ARROWS)
        kind = f"moment of {load.kind}" if turns and load.kind != "moment" else load.kind
        found.append(_Arrows(f"{kind}: {_count(len(loaded), 'node')}", nodes[kept], vectors[kept], turns))
    return found


def _tails(view: View, size: float, arrows: _Arrows) -> np.ndarray:
    """(k, 3) where arrows that end at their points begin, in the view."""
    largest = np.linalg.norm(arrows.vectors, axis=1).max()
    return view.project(arrows.points - _LONGEST * size / largest * arrows.vectors)


def _draw_arrows(panel: Axes, view: View, arrows: _Arrows, tails: np.ndarray, colour: str) -> Line2D:
    """Arrows that push at their points; a moment's has two heads, and turns about it as a right-hand screw."""
    tips = view.project(arrows.points)
    style = {"arrowstyle": "-|>", "color": colour, "lw": 1.0, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 8}
    for tip, tail in zip(tips[:, :2], tails[:, :2], strict=True):
        panel.annotate("", tip, tail, arrowprops=style, annotation_clip=False, zorder=4)
        if arrows.turns:
            panel.annotate("", tip - 0.2 * (tip - tail), tail, arrowprops=style, annotation_clip=False, zorder=4)
    return Line2D([], [], color=colour, marker=">", markersize=5, label=arrows.label)


def _draw_watched(panel: Axes, scene: Scene, view: View) -> list[Line2D]:
    nodes, triangles = np.asarray(scene.mesh.nodes), scene.mesh.triangles
    places = {}
    for label, number, component in scene.watch:
        if isinstance(number, str):
            continue
        at = nodes[number] if component in _OF_NODES else nodes[triangles[number]].mean(axis=0)
        places.setdefault(tuple(at), []).append(label)
    drawn = []
    for position, (at, labels) in enumerate(places.items()):
        right, up, _ = view.project(np.array(at)[None])[0]
        style = {"marker": "*", "markersize": 8, "color": COLOURS[(position + 4) % len(COLOURS)], "linestyle": "none"}
        (line,) = panel.plot([right], [up], **style, markeredgecolor="black", markeredgewidth=0.4, zorder=5)
        line.set_label(plain("watched: " + ", ".join(labels)))
        drawn.append(line)
    return drawn


_OF_NODES = ("ux", "uy", "uz", "vx", "vy", "vz")


def _without_place(scene: Scene) -> Sequence[str]:
    """What has no symbol."""
    texts = [f"{load.kind} (no symbol)" for load in scene.loads if not isinstance(load, DeadLoad | Contribution)]
    if scene.initial is not None:
        texts.append("initial state (no symbol)")
    return texts


def _some(numbers: np.ndarray, most: int) -> np.ndarray:
    """At most so many of them, spread evenly."""
    return numbers[np.unique(np.linspace(0, len(numbers) - 1, min(len(numbers), most)).round().astype(int))]


def _words(text: str) -> Line2D:
    return Line2D([], [], linestyle="none", label=text)


def _count(number, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
