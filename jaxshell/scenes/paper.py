"""The three scenes of Yang & Xia 2014, section VI: clamped spherical cap, free plate, top-opened spherical cap."""

import math
from collections.abc import Sequence

import numpy as np

from jaxshell.model.generators import counts
from jaxshell.model.grids import chain, grid, structured_triangles
from jaxshell.model.loads import EdgeForce, History, Load, NodalForce
from jaxshell.model.mesh import Mesh
from jaxshell.model.scene import Defaults, Scene
from jaxshell.model.sections import Section
from jaxshell.model.supports import Support, clamped, symmetry
from jaxshell.model.surface import FlatSurface, SphericalSurface
from jaxshell.numerics.checks import check_number


def spherical_cap(divisions: int = 10, force: float = 444.8, thickness: float = 4e-4) -> Scene:
    """Clamped spherical cap under a step force at its apex (section VI.A; SI units).

    One quarter by symmetry, 2·divisions² triangles; radius 0.1209 m, half angle 10.9°, edge clamped,
    E 68.94 GPa, ν 0.3, ρ 2618 kg/m³. `force` [N] is the whole cap's; the quarter carries a quarter.
    Point (i, j) of the grid lies at polar angle 10.9°·max(i, j)/divisions. Watches "apex" (uz).
    """
    check_number("force", force)
    mesh, supports = clamped_quarter("spherical_cap", 0.1209, 10.9, divisions)
    return Scene(
        mesh,
        Section(thickness, 68.94e9, 0.3, 2618.0),
        supports,
        (NodalForce([0], [0.0, 0.0, -0.25 * force]),),
        name="spherical_cap",
        watch={"apex": (0, "uz"), "apex velocity": (0, "vz")},
        defaults=Defaults(
            dt=2e-6,
            t_end=1e-3,
            picture_times=(0.0, 5e-5, 1e-4, 1.25e-4, 1.5e-4, 2e-4),
            methods=(("EMC", 1.0, 0.0), ("EDMC1", 0.8, 0.0), ("EDMC2", 1.0, 0.05)),
            units="SI",
            # H as the paper gives it; R (1 - cos 10.9°) is 0.002181 m.
            axes=(("apex", -0.002182, "Deflection $w_A/H$"),),
        ),
    )


def clamped_quarter(scene: str, radius: float, half_angle: float, divisions: int) -> tuple[Mesh, tuple[Support, ...]]:
    """A quarter of a spherical cap about +z, its apex node 0, with a clamped edge and symmetry at x = 0 and y = 0.

    `half_angle` in degrees. Raises ValueError for the `divisions` of the function `scene`.
    """
    (divisions,) = counts(scene, divisions, (1,))
    s, t = grid(*[np.arange(divisions + 1) / divisions] * 2)
    polar = math.radians(half_angle) * np.maximum(s, t)
    with np.errstate(divide="ignore", invalid="ignore"):
        azimuth = np.where(s >= t, 0.25 * np.pi * t / s, 0.5 * np.pi - 0.25 * np.pi * s / t)
    azimuth = np.where(polar == 0, 0.0, azimuth)
    nodes = radius * np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], 1)
    surface = SphericalSurface(radius, chart="square")
    mesh = Mesh(nodes, structured_triangles(divisions, divisions), surface=surface)
    supports = (
        clamped(np.flatnonzero(np.maximum(s, t) == 1)),
        symmetry(np.flatnonzero(t == 0), "y"),
        symmetry(np.flatnonzero(s == 0), "x"),
    )
    return mesh, supports


def free_plate(divisions: tuple[int, int] = (15, 3), loads: Sequence[Load] | None = None) -> Scene:
    """Rectangular plate in free flight, bending and twisting (section VI.B; SI units).

    0.3 × 0.06 × 0.002 m, E 206 GPa, ν 0, ρ 7800 kg/m³, no supports; divisions[0]·divisions[1]·2 triangles.

    ASSUMPTION. The paper shows where its loads act only in a figure, and f(t), eq. (106), rising to 4e4 at
    2 ms and falling to zero at 4 ms, would crumple the plate as a nodal force. Here f(t) is a line load in
    N/m: 0.8 f along +x and +z on the short edge x = 0; 0.4 f along -z on the short edge x = 0.3 m; and on
    the far part of the short edges, y ≥ 0.02 m, once more 0.4 f, along +z at x = 0 and -z at x = 0.3 m, which
    twists; an edge across y = 0.02 m has as much less per length. The plate bends, twists and flies off with linear
    and angular momentum.
    `loads` replaces all of it.
    """
    columns, rows = counts("free_plate", divisions, (1, 1))
    length, width = 0.3, 0.06
    x, y = grid(*[np.linspace(0, 1, c + 1) for c in (columns, rows)])
    nodes = np.stack([length * x, width * y, 0 * x], 1)
    mesh = Mesh(nodes, structured_triangles(columns, rows), surface=FlatSurface())
    if loads is None:
        pulse = History([0.0, 0.002, 0.004], [0.0, 4e4, 0.0])
        left, right = np.flatnonzero(x == 0), np.flatnonzero(x == 1)
        covered = np.clip(np.arange(1, rows + 1) - rows / 3, 0, 1)  # part of every edge beyond y = 0.02 m
        covered = covered[covered > 1e-9]
        twist, far = 0.4 * covered[:, None] * [0.0, 0.0, 1.0], len(covered) + 1
        loads = (
            EdgeForce(chain(left), [0.8, 0.0, 0.8], pulse),
            EdgeForce(chain(right), [0.0, 0.0, -0.4], pulse),
            EdgeForce(chain(left[-far:]), twist, pulse),
            EdgeForce(chain(right[-far:]), -twist, pulse),
        )
    return Scene(
        mesh,
        Section(0.002, 206e9, 0.0, 7800.0),
        (),
        tuple(loads),
        name="free_plate",
        watch={"corner x": (0, "ux"), "corner": (0, "uz")},
        defaults=Defaults(
            dt=5e-5,
            t_end=0.1,
            picture_times=tuple(0.004 * k for k in range(11)),
            methods=(("EMC", 1.0, 0.0), ("EDMC1", 0.95, 0.0), ("EDMC2", 1.0, 0.02)),
            units="SI",
        ),
    )


def opened_cap(divisions: tuple[int, int] = (48, 10), force: float = 1.0, thickness: float = 0.4) -> Scene:
    """Spherical cap with its top cut off, buckling under a ring of forces (section VI.C; SI units).

    Radius 12.16 m, from polar angle 18.594° (top ring) to 55.668° (bottom ring), E 1000 Pa, ν 0.3,
    ρ 0.1 kg/m³; z held on the bottom ring, and nothing else. A force min(t, 1)·`force` [N] in -z on each of
    48 top-ring nodes, as a load along the edges of the ring, whose resultant is the same on any number of nodes. So
    finer meshes have a limit: refined, forces on 48 nodes would become forces on points. divisions = (around, along
    the meridian from the bottom ring). Watches "A", the top-ring node at azimuth 0 (uz).
    """
    check_number("force", force)
    around, meridian = counts("opened_cap", divisions, (3, 1))
    radius, top, bottom = 12.16, math.radians(18.594), math.radians(55.668)
    i, j = grid(np.arange(meridian + 1), np.arange(around))
    polar, azimuth = bottom + (top - bottom) * i / meridian, 2 * np.pi * j / around
    nodes = radius * np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], 1)
    ring = np.flatnonzero(i == meridian)
    length = 2 * around * radius * math.sin(top) * math.sin(math.pi / around)  # of the ring's edges
    # Rows climb towards the apex, so the outward normal asks for the second direction to run first.
    triangles = structured_triangles(meridian, around, periodic=True)[:, [0, 2, 1]]
    return Scene(
        Mesh(nodes, triangles, surface=SphericalSurface(radius, chart="polar")),
        Section(thickness, 1000.0, 0.3, 0.1),
        (Support(np.flatnonzero(i == 0), "uz"),),
        (EdgeForce(chain(np.append(ring, ring[0])), [0.0, 0.0, -48 * force / length], History.ramp(1.0)),),
        name="opened_cap",
        watch={"A": (int(ring[0]), "uz"), "A velocity": (int(ring[0]), "vz")},
        defaults=Defaults(
            dt=0.01,
            t_end=5.0,
            picture_times=(0.0, 1.0, 2.0, 2.2, 2.5, 3.0, 4.0, 5.0),
            methods=(("EMC", 1.0, 0.0), ("EDMC1", 0.8, 0.0), ("EDMC2", 1.0, 0.2)),
            units="SI",
        ),
    )
