"""Static benchmarks with large displacements and rotations, and the twisted beam.

Source, unless said otherwise: K. Y. Sze, X. H. Liu & S. H. Lo, "Popular benchmark problems for geometric
nonlinear analysis of shells", Finite Elem. Anal. Des. 40 (2004) 1551-1569 (called Sze below). Units as in the
source (the densities are arbitrary: statics does not see them). Load factor 1 is the source's largest load.
"""

import math

import numpy as np

from jaxshell.model import generators
from jaxshell.model.grids import chain, grid, structured_triangles
from jaxshell.model.loads import EdgeForce, NodalForce, NodalMoment
from jaxshell.model.mesh import Mesh
from jaxshell.model.scene import Scene
from jaxshell.model.sections import Section
from jaxshell.model.supports import Support, clamped, pinned, symmetry
from jaxshell.model.surface import CylindricalSurface, FlatSurface, SphericalSurface, TwistedSurface
from jaxshell.numerics.checks import check_number

_DENSITY = 1.0


def cantilever_end_shear(divisions: tuple[int, int] = (32, 2), force: float = 4.0) -> Scene:
    """Cantilever bent by a shear force at its tip (Sze, section 3.1).

    10 × 1 × 0.1, E 1.2e6, ν 0; clamped at x = 0, `force` along +z spread over the edge x = 10.
    divisions = (along, across). Watches "tip u" (ux) and "tip w" (uz), at the middle of the edge where the
    mesh has a node there.
    """
    check_number("force", force)
    mesh = generators.rectangle(10.0, 1.0, divisions)
    return Scene(
        mesh,
        Section(0.1, 1.2e6, 0.0, _DENSITY),
        (clamped(mesh.nodes_where(lambda x: x[0] < 1e-9)),),
        (EdgeForce(chain(_tip(mesh, 10.0)), [0.0, 0.0, force]),),
        name="cantilever_end_shear",
        watch=_tip_watch(mesh, 10.0),
    )


def cantilever_end_moment(divisions: tuple[int, int] = (40, 1), moment: float = 50.0 * math.pi / 3.0) -> Scene:
    """Cantilever rolled up to a full circle by a moment at its tip (Sze, section 3.2).

    12 × 1 × 0.1, E 1.2e6, ν 0; clamped at x = 0, `moment` about -y at x = 12. Exact: a circle arc of
    curvature M/EI, EI = 100; the default closes the circle. divisions = (along, across). Watches "tip u"
    and "tip w".
    """
    check_number("moment", moment)
    mesh = generators.rectangle(12.0, 1.0, divisions)
    tip = _tip(mesh, 12.0)
    share = np.full(tip.size, 1.0 / (tip.size - 1))
    share[[0, -1]] *= 0.5
    return Scene(
        mesh,
        Section(0.1, 1.2e6, 0.0, _DENSITY),
        (clamped(mesh.nodes_where(lambda x: x[0] < 1e-9)),),
        (NodalMoment(tip, share[:, None] * np.array([0.0, -1.0, 0.0]) * moment),),
        name="cantilever_end_moment",
        watch=_tip_watch(mesh, 12.0),
    )


def slit_annular_plate(divisions: tuple[int, int] = (10, 80), force: float = 0.8) -> Scene:
    """Annular plate with a radial slit, one lip lifted (Sze, section 3.3).

    Radii 6 and 10, h 0.03, E 21e6, ν 0; one lip clamped, the other under a line force `force` (per length)
    along +z. divisions = (radial, around). Watches "A" and "B" (uz), the loaded lip's inner and outer corner.
    """
    check_number("force", force)
    radial, around = generators.counts("slit_annular_plate", divisions, (1, 3))
    i, j = grid(np.arange(radial + 1), np.arange(around + 1))
    r, angle = 6.0 + 4.0 * i / radial, 2 * np.pi * j / around
    nodes = np.stack([r * np.cos(angle), r * np.sin(angle), 0 * r], 1)
    triangles = structured_triangles(radial, around)
    # The lips of the slit coincide.
    mesh = Mesh(nodes, triangles, coincident="allow", surface=FlatSurface(chart="polar"))
    lip = np.flatnonzero(j == 0)
    return Scene(
        mesh,
        Section(0.03, 21e6, 0.0, _DENSITY),
        (clamped(np.flatnonzero(j == around)),),
        (EdgeForce(chain(lip), [0.0, 0.0, force]),),
        name="slit_annular_plate",
        watch={"A": (int(lip[0]), "uz"), "B": (int(lip[-1]), "uz")},
    )


def cylinder_pull_out(divisions: tuple[int, int] = (16, 24), force: float = 40e3) -> Scene:
    """Open cylinder pulled apart by two opposite forces at mid-length (Sze, section 3.5).

    R 4.953, length 10.35, h 0.094, E 10.5e6, ν 0.3125; free ends. One eighth by symmetry carries a quarter of
    `force`. divisions = (along half the length, around a quarter). Watches "A" (outwards under the load),
    "B" and "C" (inwards, a quarter turn from it, at mid-length and at the end).
    """
    check_number("force", force)
    radius, half = 4.953, 10.35 / 2
    mesh = generators.cylinder(radius, half, divisions, angle=90.0)
    top, side = mesh.nearest_node([0, 0, radius]), mesh.nearest_node([0, radius, 0])
    return Scene(
        mesh,
        Section(0.094, 10.5e6, 0.3125, _DENSITY),
        _quarter_cylinder_symmetry(mesh),
        (NodalForce([top], [0.0, 0.0, 0.25 * force]),),
        name="cylinder_pull_out",
        watch={"A": (top, "uz"), "B": (side, "uy"), "C": (mesh.nearest_node([half, radius, 0]), "uy")},
    )


def pinched_cylinder(divisions: tuple[int, int] = (40, 40), force: float = 12e3) -> Scene:
    """Cylinder over rigid diaphragms, pinched by two opposite forces at mid-length (Sze, section 3.6).

    R 100, length 200, h 1, E 30e3, ν 0.3; the diaphragms hold the ends in their plane and leave them free
    along the axis. One eighth by symmetry carries a quarter of `force`. divisions = (along half the length,
    around a quarter). Watches "A" (uz, downwards under the load) and "B" (uy, outwards a quarter turn from
    it).
    """
    check_number("force", force)
    radius, half = 100.0, 100.0
    mesh = generators.cylinder(radius, half, divisions, angle=90.0)
    top, side = mesh.nearest_node([0, 0, radius]), mesh.nearest_node([0, radius, 0])
    end = mesh.nodes_where(lambda x: x[0] > half - 1e-9)
    return Scene(
        mesh,
        Section(1.0, 30e3, 0.3, _DENSITY),
        (*_quarter_cylinder_symmetry(mesh), Support(end, ("uy", "uz", "rx"))),
        (NodalForce([top], [0.0, 0.0, -0.25 * force]),),
        name="pinched_cylinder",
        watch={"A": (top, "uz"), "B": (side, "uy")},
    )


def pinched_semi_cylinder(divisions: tuple[int, int] = (32, 32), force: float = 2000.0) -> Scene:
    """Semi-cylinder clamped at one end, pinched at the crown of the other (Sze, section 3.7, isotropic).

    R 101.6, length 304.8, h 3, E 2068.5, ν 0.3; on the straight edges the vertical displacement and the
    rotation about the axis are held. Half of it, by symmetry, carries half of `force`, downwards.
    divisions = (along, around a quarter). Watches "A" (uz under the load).
    """
    check_number("force", force)
    radius, length = 101.6, 304.8
    mesh = generators.cylinder(radius, length, divisions, angle=90.0)
    crown = mesh.nearest_node([0, 0, radius])
    return Scene(
        mesh,
        Section(3.0, 2068.5, 0.3, _DENSITY),
        (
            clamped(mesh.nodes_where(lambda x: x[0] > length - 1e-9)),
            symmetry(mesh.nodes_where(lambda x: np.abs(x[1]) < 1e-9 * radius), "y"),
            Support(mesh.nodes_where(lambda x: np.abs(x[2]) < 1e-9 * radius), ("uz", "rx")),
        ),
        (NodalForce([crown], [0.0, 0.0, -0.5 * force]),),
        name="pinched_semi_cylinder",
        watch={"A": (crown, "uz")},
    )


def hinged_roof(divisions: tuple[int, int] = (16, 16), thickness: float = 12.7, force: float = 3000.0) -> Scene:
    """Shallow cylindrical roof hinged on its straight edges, snapping through (Sze, section 3.8, isotropic).

    R 2540, length 508, half angle 0.1 rad, E 3102.75, ν 0.3; `thickness` 12.7 snaps through, 6.35 snaps
    back as well. One quarter by symmetry carries a quarter of the central `force`. Curved edges free. First
    studied by Sabir & Lock (1972). divisions = (along half the length, around half). Watches "centre" (uz).
    """
    check_number("force", force)
    radius, half, angle = 2540.0, 254.0, 0.1
    along, around = generators.counts("hinged_roof", divisions, (1, 1))
    x, turn = grid(np.linspace(0, half, along + 1), np.linspace(0, angle, around + 1))
    nodes = np.stack([x, radius * np.sin(turn), radius * np.cos(turn)], 1)
    mesh = Mesh(nodes, structured_triangles(along, around), surface=CylindricalSurface(radius))
    return Scene(
        mesh,
        Section(thickness, 3102.75, 0.3, _DENSITY),
        (
            pinned(np.flatnonzero(turn == turn.max())),
            symmetry(np.flatnonzero(x == 0), "x"),
            symmetry(np.flatnonzero(turn == 0), "y"),
        ),
        (NodalForce([0], [0.0, 0.0, -0.25 * force]),),
        name="hinged_roof",
        watch={"centre": (0, "uz")},
    )


def hemisphere(divisions: tuple[int, int] = (16, 16), force: float = 100.0) -> Scene:
    """Hemisphere with an 18° hole under two inward and two outward forces at its equator (Sze, section 3.4).

    R 10, h 0.04, E 6.825e7, ν 0.3; hole and equator free. One quarter by symmetry; `force` is the one that
    the quarter carries at either of its equator's ends, half of the whole hemisphere's. divisions = (around
    a quarter, along the meridian). Watches "inward" (uy, on the y axis) and "outward" (ux, on the x axis).
    """
    check_number("force", force)
    around, rows = generators.counts("hemisphere", divisions, (1, 1))
    radius = 10.0
    i, j = grid(np.arange(rows + 1), np.arange(around + 1))
    polar, azimuth = np.radians(90.0 - 72.0 * i / rows), 0.5 * np.pi * j / around
    nodes = radius * np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], 1)
    # Rows climb towards the hole, so the outward normal asks for the second direction to run first.
    triangles = structured_triangles(rows, around)[:, [0, 2, 1]]
    mesh = Mesh(nodes, triangles, surface=SphericalSurface(radius, chart="polar"))
    return Scene(
        mesh,
        Section(0.04, 6.825e7, 0.3, _DENSITY),
        (
            symmetry(np.flatnonzero(j == 0), "y"),
            symmetry(np.flatnonzero(j == around), "x"),
            # Up and down is free in the source; one node holds it.
            Support([0], "uz"),
        ),
        (NodalForce([0], [force, 0.0, 0.0]), NodalForce([around], [0.0, -force, 0.0])),
        name="hemisphere",
        watch={"inward": (around, "uy"), "outward": (0, "ux")},
    )


def twisted_beam(divisions: tuple[int, int] = (24, 4), load: str = "in-plane") -> Scene:
    """Cantilever twisted by 90° over its length, unit force at the tip: a test of warped geometry.

    12 × 1.1 × 0.32, E 29e6, ν 0.22. R. H. MacNeal & R. L. Harder, "A proposed standard set of problems to
    test finite element accuracy", Finite Elem. Anal. Des. 1 (1985) 3-20. `load` "in-plane" acts along the
    tip's width (+z), "out-of-plane" across it (+y). divisions = (along, across). Watches "tip" in that
    direction.
    """
    if load not in ("in-plane", "out-of-plane"):
        raise ValueError(f'load must be "in-plane" or "out-of-plane", but it is {load!r}.')
    length, width = 12.0, 1.1
    flat = generators.rectangle(length, width, divisions)
    x, across = np.asarray(flat.nodes)[:, 0], np.asarray(flat.nodes)[:, 1] - width / 2
    turn = 0.5 * np.pi * x / length
    nodes = np.stack([x, across * np.cos(turn), across * np.sin(turn)], 1)
    mesh = Mesh(nodes, flat.triangles, surface=TwistedSurface(0.5 * np.pi / length))
    direction, component = ([0.0, 0.0, 1.0], "uz") if load == "in-plane" else ([0.0, 1.0, 0.0], "uy")
    return Scene(
        mesh,
        Section(0.32, 29e6, 0.22, _DENSITY),
        (clamped(mesh.nodes_where(lambda x: x[0] < 1e-9)),),
        (EdgeForce(chain(_tip(mesh, length)), np.array(direction) / width),),
        name="twisted_beam",
        watch={"tip": (mesh.nearest_node([length, 0, 0]), component)},
    )


def _quarter_cylinder_symmetry(mesh: Mesh) -> tuple[Support, ...]:
    """Planes of symmetry of an eighth of a cylinder about x: mid-length, crown and side."""
    size = float(np.max(np.asarray(mesh.nodes)))
    return tuple(
        symmetry(mesh.nodes_where(lambda x, axis=axis: np.abs(x[axis]) < 1e-9 * size), "xyz"[axis]) for axis in range(3)
    )


def _tip(mesh: Mesh, length: float) -> np.ndarray:
    """Nodes of the edge x = length, in order across it."""
    return mesh.nodes_where(lambda x: x[0] > length - 1e-9)


def _tip_watch(mesh: Mesh, length: float) -> dict[str, tuple[int, str]]:
    nodes = _tip(mesh, length)
    middle = int(nodes[nodes.size // 2])
    return {"tip u": (middle, "ux"), "tip w": (middle, "uz")}
