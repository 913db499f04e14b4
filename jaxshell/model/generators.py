"""Meshes of common shapes: rectangle, cylinder, spherical cap and zone; for scene files and scripts."""

import math

import numpy as np

from jaxshell.model.grids import check_size, grid, structured_triangles
from jaxshell.model.mesh import Mesh
from jaxshell.model.surface import CylindricalSurface, FlatSurface, SphericalSurface
from jaxshell.numerics.checks import check_positive_number, is_concrete, shown, whole_array


def rectangle(length, width, divisions) -> Mesh:
    """0 ≤ x ≤ `length`, 0 ≤ y ≤ `width`, z = 0, normal +z; `divisions` (along x, along y)."""
    columns, rows = counts("rectangle", divisions, (1, 1))
    length, width = _positive(length=length, width=width)
    x, y = grid(np.linspace(0, length, columns + 1), np.linspace(0, width, rows + 1))
    return Mesh(np.stack([x, y, 0 * x], 1), structured_triangles(columns, rows), surface=FlatSurface())


def cylinder(radius, length, divisions, angle=360.0) -> Mesh:
    """Cylinder about the x axis, 0 ≤ x ≤ `length`, normals outwards.

    `angle` [degrees] around, from the +y axis towards +z; 360 closes it. `divisions` (along, around).
    """
    radius, length, angle = _positive(radius=radius, length=length, angle=angle)
    if not is_concrete(angle) or angle > 360:
        raise ValueError(f"angle must be at most 360 degrees, but it is {angle}.")
    closed = angle == 360
    rows, around = counts("cylinder", divisions, (1, 3 if closed else 1))
    turns = np.radians(angle) * np.arange(around + (not closed)) / around
    x, turn = grid(np.linspace(0, length, rows + 1), turns)
    nodes = np.stack([x, radius * np.cos(turn), radius * np.sin(turn)], 1)
    # ∂x × ∂turn points inwards.
    triangles = structured_triangles(rows, around, periodic=closed)[:, [0, 2, 1]]
    return Mesh(nodes, triangles, surface=CylindricalSurface(radius))


def spherical_cap(radius, half_angle, divisions) -> Mesh:
    """Cap of a sphere about the origin, apex on +z, down to the polar angle `half_angle` [degrees].

    A square grid of 2·`divisions` squared cells drawn onto the cap: a node at the apex, no tiny triangles,
    normals outwards. The rim is the mesh's boundary.
    """
    (count,) = counts("spherical_cap", divisions, (1,))
    check_size(2 * count, 2 * count)
    radius, half_angle = _positive(radius=radius, half_angle=half_angle)
    if half_angle >= 180:
        raise ValueError(f"half_angle must be below 180 degrees, but it is {half_angle}.")
    s, t = grid(*[np.arange(-count, count + 1) / count] * 2)
    polar = np.radians(half_angle) * np.maximum(np.abs(s), np.abs(t))
    # Squares |s|, |t| = const become circles, and each quarter of a square's outline a quarter of the circle.
    with np.errstate(divide="ignore", invalid="ignore"):
        across = np.where(np.abs(s) >= np.abs(t), t / s, s / t) * math.pi / 4
    azimuth = np.where(np.abs(s) >= np.abs(t), across + math.pi * (s < 0), math.pi / 2 - across + math.pi * (t < 0))
    azimuth = np.where(polar == 0, 0.0, azimuth)
    triangles = structured_triangles(2 * count, 2 * count)
    return Mesh(_on_sphere(radius, polar, azimuth), triangles, surface=SphericalSurface(radius, chart="square"))


def spherical_zone(radius, top, bottom, divisions) -> Mesh:
    """Ring of a sphere about the origin between polar angles `top` < `bottom` [degrees], normals outwards.

    `divisions` (around, along the meridian).
    """
    around, rows = counts("spherical_zone", divisions, (3, 1))
    radius, top, bottom = _positive(radius=radius, top=top, bottom=bottom)
    if not top < bottom < 180:
        raise ValueError(f"Angles must fulfil 0 < top < bottom < 180 degrees, but are top {top}, bottom {bottom}.")
    polar, azimuth = grid(np.radians(np.linspace(top, bottom, rows + 1)), 2 * math.pi * np.arange(around) / around)
    triangles = structured_triangles(rows, around, periodic=True)
    return Mesh(_on_sphere(radius, polar, azimuth), triangles, surface=SphericalSurface(radius, chart="polar"))


GENERATORS = {f.__name__: f for f in (rectangle, cylinder, spherical_cap, spherical_zone)}


def _on_sphere(radius, polar, azimuth) -> np.ndarray:
    points = [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]
    return radius * np.stack(points, 1)


def counts(shape: str, divisions, least: tuple[int, ...]) -> list[int]:
    """Divisions of a mesh, one number for each of `least`. Raises ValueError for others, and for too many triangles."""
    wanted = f"whole numbers of at least {' and '.join(str(n) for n in least)}"
    found = np.atleast_1d(whole_array(f"divisions of a {shape}", divisions, wanted))
    if found.shape != (len(least),) or np.any(found < least):
        raise ValueError(f"divisions of a {shape} must be {wanted}, but are {shown(divisions)}.")
    check_size(int(found[0]), int(found[-1]) if len(found) > 1 else 1)
    return [int(n) for n in found]


def _positive(**values) -> list:
    """The values, integers as floats. Raises ValueError naming one that is not positive."""
    for name, value in values.items():
        check_positive_number(name, value)
    return [float(value) if isinstance(value, int) else value for value in values.values()]
