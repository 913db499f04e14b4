"""Gauges: the stress or section force at an element that a text such as "Mxx" or "von mises top" names.

    Nxx Nyy Nxy, Mxx Myy Mxy              section forces
    sxx syy sxy + where                   stresses
    s11 s22 s12 + where                   stresses in the axes of the ply's material
    von mises, smax, smin + where         von Mises' stress; the larger and the smaller principal one

Where is top, bottom, middle, or a ply counted from 0 at the bottom: "ply 2", "ply 2 top", "ply 2 bottom". Components
are in the element's axes (e1 along its edge 1-2), or, with the word "material" at the end, from the section's direction
on. The value is that at the element's middle, the mean of its three points.
"""

import re
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from jaxshell.model.sections import AnySection, Regions
from jaxshell.numerics.checks import shown

PAIRS = {"xx": 0, "yy": 1, "xy": 2, "11": 0, "22": 1, "12": 2}
INVARIANTS = ("von mises", "smax", "smin")
FACES = ("top", "bottom", "middle")
At = str | int | tuple[int, str]
"""Where in the thickness: a face, the middle of a ply, or a face of a ply."""

_FORCE = re.compile(r"([NM])(xx|yy|xy)( material)?")
_WHERE = r"top|bottom|middle|ply \d{1,4}(?: top| bottom| middle)?"
_STRESS = re.compile(rf"(s(?:xx|yy|xy|11|22|12)|von mises|smax|smin) ({_WHERE})( material)?")


class Gauge(NamedTuple):
    """What a gauge's text says."""

    quantity: str
    """"N", "M" or "stress"."""
    pick: int | str
    """A component 0, 1, 2, or one of INVARIANTS."""
    at: At | None
    """Where in the thickness; None of section forces."""
    axes: str
    """"element", "material" or "ply"."""


def gauge_of(text) -> Gauge | None:
    """What the text says; None where it is no gauge's."""
    if not isinstance(text, str):
        return None
    if force := _FORCE.fullmatch(text):
        return Gauge(force[1], PAIRS[force[2]], None, "material" if force[3] else "element")
    if not (stress := _STRESS.fullmatch(text)):
        return None
    what, place, material = stress.groups()
    if material and (what in INVARIANTS or what[1].isdigit()):
        return None  # which have no axes to choose
    axes = "material" if material else "ply" if what[1].isdigit() else "element"
    return Gauge("stress", what if what in INVARIANTS else PAIRS[what[1:]], _at(place), axes)


def _at(place: str) -> At:
    if place in FACES:
        return place
    _, number, *face = place.split()
    return (int(number), face[0] if face else "middle")


def check_gauge(what: str, gauge: Gauge, section: AnySection, mesh, elements=None) -> None:
    """Raise ValueError, which begins with `what`, where the section does not have what the gauge reads.

    `elements` are numbers; None is all.
    """
    if gauge.at is not None:
        check_at(what, gauge.at, section, mesh, elements)
    if gauge.axes == "material" and section.direction_angles(mesh) is None:
        raise ValueError(f"{what}: the section has no direction, from which material axes could be counted.")


def check_at(what: str, at, section: AnySection, mesh, elements=None) -> None:
    """Raise ValueError, which begins with `what`, for a place that is none, or that an element does not have."""
    ply: Any = at[0] if isinstance(at, tuple) and len(at) == 2 else at
    face = at[1] if isinstance(at, tuple) and len(at) == 2 else "middle"
    numbered = isinstance(ply, int | np.integer) and not isinstance(ply, bool)
    if face not in FACES or not (numbered or (not isinstance(at, tuple) and at in FACES)):
        raise ValueError(
            f'{what}: at must be "top", "bottom", "middle", the number of a ply or (number, "top"), '
            f"but it is {shown(at)}."
        )
    counts = ply_counts(section, mesh)
    if counts is None:
        raise ValueError(f"{what}: the section has no layers, and so no stresses; it has section forces.")
    if numbered:
        every = np.arange(mesh.n_elements) if elements is None else np.asarray(elements)
        lacking = every[(ply < 0) | (counts[every] <= ply)]
        if lacking.size:
            raise ValueError(
                f"{what}: there is no ply {ply} in element {lacking[0]} (and in {lacking.size - 1} others), which has "
                f"plies 0 to {counts[lacking[0]] - 1}. elements= chooses those that have it."
            )


def ply_counts(section: AnySection, mesh) -> np.ndarray | None:
    """(m,) number of plies of every element; None where the section, or that of a region, has no layers."""
    if isinstance(section, Regions):
        counts = np.zeros(mesh.n_elements, int)
        for numbers, part in zip(section.elements, section.sections, strict=True):
            of_part = ply_counts(part, mesh)
            if of_part is None:
                return None
            counts[numbers.array] = of_part[numbers.array]
        return counts
    plies = getattr(section, "all_plies", None)
    if plies is None:
        found = eqx.filter_eval_shape(section.layers, mesh)
        if found is None:
            return None
        plies = range(found.z.shape[1])
    return np.full(mesh.n_elements, len(plies))
