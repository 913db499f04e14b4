"""Obstacles in pictures of shapes: their outlines, over the shell."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from jaxshell.plotting.projection import View
from jaxshell.results.penetration import moved
from jaxshell.results.solution import Solution

_COLOUR, _ALPHA = "0.35", 0.45


def draw_obstacles(panel: Axes, run: Solution, view: View, time: float, around: np.ndarray) -> None:
    """Add the outlines of the scene's obstacles at a time, around the points (n, 3) of the shell."""
    low, high = around.min(axis=0), around.max(axis=0)
    for obstacle in run.scene.obstacles:
        shift = moved(run, obstacle, np.array([time]))[0]
        lines = [view.project(line + shift)[:, :2] for line in obstacle.outline(low - shift, high - shift)]
        panel.add_collection(
            LineCollection(lines, colors=_COLOUR, alpha=_ALPHA, linewidths=0.6, zorder=3), autolim=False
        )
