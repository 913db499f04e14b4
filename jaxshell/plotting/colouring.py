"""What deformed shapes are coloured by: displacements, stresses, section forces; one value for each triangle."""

from typing import NamedTuple

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize

from jaxshell.model.gauge import Gauge, gauge_of
from jaxshell.plotting.style import plain, scaled
from jaxshell.results.smoothing import nodal
from jaxshell.results.solution import Solution
from jaxshell.results.stresses import gauge_field

COLOUR_MAP = ListedColormap(colormaps["viridis"](np.linspace(0.15, 1, 256)))
"""Perceptually uniform and monotone in grey; without its darkest end, in which edges and shades drown."""
_SIGNED = colormaps["coolwarm"]
"""Of what has a sign: white at zero, as dark at either end."""


class Colouring(NamedTuple):
    """Colours of the triangles in some frames."""

    values: list[np.ndarray]
    """(m,) of each frame, in the unit of the label."""
    colours: ScalarMappable
    label: str


def displaced(run: Solution, displacements: np.ndarray) -> Colouring:
    """By how far each point has moved."""
    distances = [np.linalg.norm(u, axis=1) for u in displacements]
    largest = max(float(d.max()) for d in distances)
    length, unit = scaled(run.scene, largest, "m")
    colours = ScalarMappable(Normalize(0, largest / length if largest > 0 else 1.0), COLOUR_MAP)
    values = [distance[run.scene.mesh.triangles].mean(axis=1) / length for distance in distances]
    return Colouring(values, colours, f"Displacement{unit}")


def contour(run: Solution, frames: list[int], component: str) -> Colouring:
    """By a stress or a section force, smoothed to the nodes. Raises ValueError for a text that names none."""
    fields = [np.asarray(nodal(run.scene, gauge_field(run, component, frame))).mean(axis=1) for frame in frames]
    gauge = gauge_of(component)
    assert gauge is not None  # or gauge_field had complained
    low, high = min(float(f.min()) for f in fields), max(float(f.max()) for f in fields)
    largest = max(abs(low), abs(high))
    divisor, unit = scaled(run.scene, largest, symbol_of(gauge))
    if low < 0 < high:
        limits, colour_map = (-largest / divisor, largest / divisor), _SIGNED
    else:
        limits, colour_map = (low / divisor, high / divisor), COLOUR_MAP
    if limits[0] == limits[1]:
        limits = limits[0] - 0.5, limits[0] + 0.5
    return Colouring(
        [field / divisor for field in fields],
        ScalarMappable(Normalize(*limits), colour_map),
        f"{name_of(component, gauge)}{unit}",
    )


def name_of(component: str, gauge: Gauge) -> str:
    """A gauge's text as it stands on an axis."""
    if gauge.quantity != "stress":
        return f"${gauge.quantity}_{{{component[1:3]}}}$" + (" (material axes)" if gauge.axes == "material" else "")
    if gauge.pick == "von mises":
        return plain(component.replace("von mises", "Von Mises stress,"))
    if isinstance(gauge.pick, str):
        return plain(f"{'Larger' if gauge.pick == 'smax' else 'Smaller'} principal stress, {component[5:]}")
    symbol = r"\tau" if gauge.pick == 2 else r"\sigma"
    return f"${symbol}_{{{component[1:3]}}}$, {plain(component[4:].replace(' material', ' (material axes)'))}"


def symbol_of(gauge: Gauge) -> str:
    """The SI unit of what a gauge reads."""
    return {"stress": "Pa", "N": "N/m", "M": "N"}[gauge.quantity]
