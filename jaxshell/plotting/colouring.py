"""What deformed shapes are coloured by: displacements, velocities, stresses, section forces, as smoothed values at the
corners of the triangles; and the error of the mesh, one value for each triangle."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize

from jaxshell.model.gauge import Gauge, gauge_of
from jaxshell.plotting.style import length_unit, plain, scaled
from jaxshell.results.export.units import symbol_of
from jaxshell.results.mesh_errors import check_has_error, mesh_errors
from jaxshell.results.smoothing import nodal, smooth_patches
from jaxshell.results.solution import Solution
from jaxshell.results.stresses import checked_gauge, gauge_field

COLOUR_MAP = ListedColormap(colormaps["viridis"](np.linspace(0.15, 1, 256)))
"""Perceptually uniform and monotone in grey; without its darkest end, in which edges and shades drown."""
_SIGNED = colormaps["coolwarm"]
"""Of what has a sign: white at zero, as dark at either end."""


MOTIONS, MESH_ERROR = ("displacement", "velocity"), "mesh error"
"""Fields besides the texts of gauges."""


class Colouring(NamedTuple):
    """Colours of the triangles in some frames."""

    values: list[np.ndarray]
    """(m, 3) at the triangles' corners of each frame, in the unit of the label."""
    colours: ScalarMappable
    label: str
    divisor: float
    """What the solution's values are divided by."""


def colouring(runs: Sequence[Solution], frames: Sequence[Sequence[int]], field: str = "displacement") -> Colouring:
    """Colours of some frames of each run, one run's after another's, all on one scale.

    `field` is "displacement", "velocity" (how far a point has moved, how fast it is), "mesh error" (`local` of
    `jaxshell.MeshErrors`), or the text of a gauge (`jaxshell.model.gauge`), whose values are smoothed to the nodes.
    Raises ValueError for another text, and for what the section does not have.
    """
    for run in runs:
        if field == MESH_ERROR:
            check_has_error(run.scene)
        elif field not in MOTIONS:
            checked_gauge(run.scene, field)
    values = [
        value for run, chosen in zip(runs, frames, strict=True) for value in field_values(run, list(chosen), field)
    ]
    low, high = min(float(v.min()) for v in values), max(float(v.max()) for v in values)
    largest = max(abs(low), abs(high))
    scene = runs[0].scene
    gauge = gauge_of(field)
    if field == MESH_ERROR:
        label, divisor, unit = "Error of the mesh (energy norm)", 0.01, " in %"
        limits, colour_map = (0.0, largest / divisor), COLOUR_MAP
    elif gauge is None:
        label = field.capitalize()
        # Displacements have the unit of the scale bar beside them.
        divisor, unit = length_unit(scene) if field == "displacement" else scaled(scene, largest, "m/s")
        unit = f" in {unit}" if unit and field == "displacement" else unit
        limits, colour_map = (0.0, largest / divisor), COLOUR_MAP
    else:
        label = name_of(field, gauge)
        divisor, unit = scaled(scene, largest, symbol_of(field))
        if gauge.pick == "von mises":
            low = max(low, 0.0)  # smoothing leaves a little less here and there
        signed = low < 0 < high
        limits = (-largest / divisor, largest / divisor) if signed else (low / divisor, high / divisor)
        colour_map = _SIGNED if signed else COLOUR_MAP
    if limits[0] == limits[1]:
        limits = (limits[0], limits[0] + 1.0) if gauge is None else (limits[0] - 0.5, limits[0] + 0.5)
    colours = ScalarMappable(Normalize(*limits), colour_map)
    return Colouring([value / divisor for value in values], colours, f"{label}{unit}", divisor)


def field_values(run: Solution, frames: list[int], field: str) -> list[np.ndarray]:
    """(m, 3) at the triangles' corners of each of the frames, in the solution's units."""
    if field == MESH_ERROR:
        return _mesh_error(run, frames)
    return _motion(run, frames, field) if field in MOTIONS else _gauge(run, frames, field)


def _mesh_error(run: Solution, frames: list[int]) -> list[np.ndarray]:
    patches = smooth_patches(run.scene)
    return [np.repeat(np.asarray(mesh_errors(run, k, patches=patches).local)[:, None], 3, axis=1) for k in frames]


def _motion(run: Solution, frames: list[int], field: str) -> list[np.ndarray]:
    found = run.frame(frames)
    vectors = np.asarray(found.displacements if field == "displacement" else found.velocities)
    return list(np.linalg.norm(vectors, axis=2)[:, run.scene.mesh.triangles])


def _gauge(run: Solution, frames: list[int], field: str) -> list[np.ndarray]:
    patches = smooth_patches(run.scene)
    # Frame by frame, in one program: all at once may be larger than memory.
    return [np.asarray(nodal(run.scene, gauge_field(run, field, frame), patches=patches)) for frame in frames]


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
