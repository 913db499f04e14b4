"""From where a shell is seen: orthographic views, z up, chosen so that no strip and no sheet is seen along itself."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

_AZIMUTH = -60.0
"""Usual direction of the viewer about z, from x [degrees]."""
_ELEVATION, _LOW, _HIGH = 22.0, 15.0, 35.0
_FLAT, _PLANE = 0.15, 0.02
"""A shell that never rises above _FLAT of its width is seen from lower, or its height would not show; one that never
rises above _PLANE of it from higher, as a plan."""
_GOOD = 0.75
"""The usual direction is kept where it shows at least so much of what the best one does."""


class View(NamedTuple):
    """An orthographic view."""

    axes: np.ndarray
    """(3, 3); its columns are the directions to the right, up, and towards the viewer."""

    def project(self, points: np.ndarray) -> np.ndarray:
        """(n, 3) right, up and towards the viewer."""
        return points @ self.axes


class Window(NamedTuple):
    """What a panel shows, in coordinates of a view."""

    low: np.ndarray
    """(2,) left and bottom."""
    high: np.ndarray

    @property
    def size(self) -> np.ndarray:
        return self.high - self.low


def view_from(azimuth: float, elevation: float) -> View:
    """The view of someone who stands in these directions [degrees] about z from x, and above the plane x, y."""
    a, e = math.radians(azimuth), math.radians(elevation)
    towards = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    right = np.array([-math.sin(a), math.cos(a), 0.0])
    return View(np.stack([right, np.cross(towards, right), towards], axis=1))


def chosen_view(shapes: Sequence[np.ndarray], triangles: np.ndarray) -> View:
    """The view of deformed shapes (n, 3): the usual one, or turned about z where that shows much more of them."""
    span = np.max([s.max(0) for s in shapes], axis=0) - np.min([s.min(0) for s in shapes], axis=0)
    width = max(span[0], span[1])
    elevation = _ELEVATION if span[2] >= _FLAT * width else _LOW if span[2] >= _PLANE * width else _HIGH
    turns = sorted(range(-150, 181, 30), key=lambda turn: (abs(turn), turn < 0))
    views = [view_from(_AZIMUTH + turn, elevation) for turn in turns]
    shown = np.array([_shown(view, shapes, triangles) for view in views])
    return views[int(np.argmax(shown >= _GOOD * shown.max()))]


def window_of(projected: Sequence[np.ndarray], margin: float = 0.04) -> Window:
    """What holds all points, and a margin around them as a fraction of the larger side."""
    low = np.min([p[:, :2].min(0) for p in projected], axis=0)
    high = np.max([p[:, :2].max(0) for p in projected], axis=0)
    edge = margin * (high - low).max()
    return Window(low - edge, high + edge)


def _shown(view: View, shapes: Sequence[np.ndarray], triangles: np.ndarray) -> float:
    """How well a view shows the shapes: the length of them that it keeps, and, with less weight, how much of their area
    faces it. Zero for what is seen along itself."""
    return float(np.mean([np.sqrt(_facing(view, shape, triangles)) * _length(view, shape) for shape in shapes]))


def _facing(view: View, shape: np.ndarray, triangles: np.ndarray) -> float:
    x = shape[triangles]
    areas = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    return float(np.abs(areas @ view.axes[:, 2]).sum() / np.linalg.norm(areas, axis=1).sum())


def _length(view: View, shape: np.ndarray) -> float:
    """The largest extent seen over the largest that there is, both of the points' second moments."""
    moments = np.cov((shape - shape.mean(axis=0)).T)
    seen = view.axes[:, :2].T @ moments @ view.axes[:, :2]
    return float(math.sqrt(np.linalg.eigvalsh(seen)[-1] / np.linalg.eigvalsh(moments)[-1]))
