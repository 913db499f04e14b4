"""What stands in a panel besides the shell: scale bar, triad of the axes, and labels that do not lie on each other."""

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.transforms import Bbox, BboxBase, ScaledTranslation

from jaxshell.plotting.projection import View, Window

_AXIS_COLOURS = ("#B02418", "#1B7837", "#2B4C9B")
"""Of x, y, z: red, green, blue, as in most programs."""
_BELOW = 0.32
"""How far below a panel the triad has its origin [inch]; the scale bar stands beside it."""


def frame(panel: Axes, window: Window) -> None:
    """Show the window, true to scale, without axes."""
    panel.set_axis_off()
    panel.set_aspect("equal")
    panel.set_xlim(window.low[0], window.high[0])
    panel.set_ylim(window.low[1], window.high[1])


def scale_bar(panel: Axes, window: Window, divisor: float, unit: str) -> None:
    """A bar of a round length below the window's right end: in orthographic projection it holds for every length
    across the view. Lengths are shown divided by `divisor`, with the unit behind them."""
    size = window.size[0] / divisor
    power = 10.0 ** math.floor(math.log10(0.3 * size))
    bar = max(step * power for step in (1, 2, 5) if step * power <= 0.3 * size)
    share = bar / size
    place = panel.transAxes + ScaledTranslation(0, -0.12, panel.figure.dpi_scale_trans)
    ends = [0.97 - share, 0.97]
    panel.plot(ends, [0, 0], color="black", lw=1.5, solid_capstyle="butt", clip_on=False, transform=place)
    text = f"{bar:g} {unit}".rstrip()
    panel.annotate(text, (0.97 - share / 2, 0), (0, -3), place, "offset points", ha="center", va="top", fontsize=8)


def triad(panel: Axes, view: View, inches: float = 0.26) -> None:
    """The directions of x, y and z below the panel's left end; one that points at the viewer is a dot."""
    place = panel.transAxes + ScaledTranslation(0.35, -_BELOW, panel.figure.dpi_scale_trans)
    for axis, (name, colour) in enumerate(zip("xyz", _AXIS_COLOURS, strict=True)):
        tip = 72 * inches * view.axes[axis, :2]
        length = float(np.hypot(*tip))
        if length > 0.1 * 72 * inches:
            arrow = {"arrowstyle": "<|-", "color": colour, "lw": 1.0, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 7}
            panel.annotate("", (0, 0), tuple(tip), place, "offset points", arrowprops=arrow, annotation_clip=False)
        beyond = tip + 6 * (tip / length if length > 0.1 * 72 * inches else np.array([-1.0, -1.0]))
        panel.annotate(
            name, (0, 0), tuple(beyond), place, "offset points", color=colour, ha="center", va="center", fontsize=8
        )


def place_labels(panel: Axes, projected: Sequence[np.ndarray], labels: Sequence[str]) -> list[Bbox]:
    """Write a label beside each shape, where it lies on no other label and, if it can, on no shape.

    `projected` are the shapes (n, 2 or 3) in the panel's coordinates, which are final. A thin line leads from a label
    to its shape. Returns the labels' boxes in pixels.
    """
    figure = panel.get_figure(root=True)
    if figure is not None:
        figure.draw_without_rendering()
    shapes = [panel.transData.transform(p[:, :2]) for p in projected]
    points, inside = np.concatenate(shapes), panel.get_window_extent()
    placed: list[Bbox] = []
    for shape, label in zip(shapes, labels, strict=True):
        text = panel.text(0, 0, label, fontsize=8.5, ha="center", va="center", zorder=6)
        text.set_in_layout(False)
        size = np.array(text.get_window_extent().padded(2.0).size)
        at, anchor = min(_candidates(shape, size), key=lambda option: _cost(*option, size, placed, points, inside))
        box = _box(at, size)
        placed.append(box)
        back = panel.transData.inverted().transform
        text.set_position(tuple(back(at)))
        near = np.clip(anchor, box.min, box.max)
        if np.hypot(*(near - anchor)) > 4:
            ends = back(np.stack([near, anchor]))
            panel.plot(ends[:, 0], ends[:, 1], color="0.35", lw=0.5, zorder=5)
    return placed


def _box(middle: np.ndarray, size: np.ndarray) -> Bbox:
    return Bbox(np.stack([middle - size / 2, middle + size / 2]))


def _candidates(shape: np.ndarray, size: np.ndarray):
    """(centre of a label, point of the shape that it belongs to), the nearest first: above, below and beside."""
    ends = {
        (0, 1): shape[np.argmax(shape[:, 1])],
        (0, -1): shape[np.argmin(shape[:, 1])],
        (1, 0): shape[np.argmax(shape[:, 0])],
        (-1, 0): shape[np.argmin(shape[:, 0])],
    }
    for distance in np.arange(1, 30):
        for side in (0, 1, -1, 2, -2):
            for way, anchor in ends.items():
                out = np.array(way, float)
                across = out[::-1] * side * size * 0.6
                at = anchor + out * (size / 2 + 3 + (distance - 1) * 0.5 * size[1]) + across
                yield at, anchor


def _cost(at, anchor, size, placed: Sequence[Bbox], points: np.ndarray, inside: BboxBase) -> float:
    """Of a label's place: on another label or outside never, on shapes seldom, else the nearer the better."""
    box = _box(at, size)
    cost = np.hypot(*(at - anchor)) / size[1]
    if any(box.overlaps(other) for other in placed):
        cost += 1e6
    if not (inside.x0 <= box.x0 and box.x1 <= inside.x1 and inside.y0 <= box.y0 and box.y1 <= inside.y1):
        cost += 1e5
    covered = ((points >= box.min) & (points <= box.max)).all(axis=1).sum()
    return float(cost + 20 * min(covered, 20))
