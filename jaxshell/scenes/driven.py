"""Scenes that are dropped, bent by driven hubs, and shaken: contact, finite rotations, records (SI units).

All of it is chosen here; what each is compared with stands in docs/scenes.md.
"""

import numpy as np

from jaxshell.model import generators
from jaxshell.model.connectors import RigidBody
from jaxshell.model.damping import RayleighDamping
from jaxshell.model.grids import grid
from jaxshell.model.history import History
from jaxshell.model.initial import Initial
from jaxshell.model.loads import Gravity
from jaxshell.model.masses import PointMass
from jaxshell.model.mesh import Mesh
from jaxshell.model.obstacles import Plane
from jaxshell.model.scene import Defaults, Scene
from jaxshell.model.sections import Section
from jaxshell.model.supports import DOFS, Support, clamped
from jaxshell.numerics.checks import check_number, check_positive_number

_GRAVITY = 9.81


def dropped_tray(divisions: tuple[int, int] = (8, 6), friction: float = 0.0, height: float = 1.0) -> Scene:
    """Aluminium tray that falls on one of its corners and clatters on the floor (SI units).

    A bottom of 400 × 280 mm with a slanted rim 25 mm high, h 1 mm, E 70 GPa, ν 0.3, ρ 2700, tilted by 35° and 20°.
    It starts 2 mm above the floor with the velocity of a fall from `height`, under gravity; `friction` is Coulomb's
    coefficient against the floor, 0 for none. Nothing dissipates but friction: what the bounces lose in height is
    kinetic and strain energy of vibrations. divisions = (along, across) of the bottom; the rim is one cell more on
    each side. Watches the floor's "fx", "fy", "fz" and "depth" (of penetration), and "centre" (uz).
    """
    check_positive_number("height", height)
    thickness, gap = 1e-3, 2e-3
    mesh = _tray(*generators.counts("dropped_tray", divisions, (2, 2)))
    about_x, about_y = np.radians([35.0, 20.0])
    tilt = np.array([[1, 0, 0], [0, np.cos(about_x), -np.sin(about_x)], [0, np.sin(about_x), np.cos(about_x)]])
    tilt = tilt @ np.array([[np.cos(about_y), 0, np.sin(about_y)], [0, 1, 0], [-np.sin(about_y), 0, np.cos(about_y)]])
    nodes = np.asarray(mesh.nodes) @ tilt.T
    nodes[:, 2] += 0.5 * thickness + gap - nodes[:, 2].min()
    centre = mesh.nearest_node([0.0, 0.0, 0.0])
    mesh = Mesh(nodes, mesh.triangles)
    return Scene(
        mesh,
        Section(thickness, 70e9, 0.3, 2700.0),
        loads=(Gravity([0.0, 0.0, -_GRAVITY]),),
        initial=Initial.rigid(mesh, velocity=(0.0, 0.0, -((2.0 * _GRAVITY * height) ** 0.5))),
        obstacles=(Plane([0.0, 0.0, 0.0], [0.0, 0.0, 1.0], friction=friction, name="floor"),),
        name="dropped_tray",
        watch={f"f{axis}": ("floor", f"f{axis}") for axis in "xyz"}
        | {"depth": ("floor", "penetration"), "centre": (centre, "uz")},
        defaults=Defaults(
            dt=2e-4,
            t_end=0.15,
            save_every=5,
            picture_times=(0.0, 0.02, 0.04, 0.06, 0.1, 0.15),
            units="SI",
            method=("exact",),
        ),
    )


def tape_spring(divisions: tuple[int, int] = (48, 8), angle: float = 120.0, folded: Initial | None = None) -> Scene:
    """Steel tape whose ends are turned against each other until it snaps into a fold; or let go (SI units).

    K. A. Seffen & S. Pellegrino, "Deployment dynamics of tape springs", Proc. R. Soc. Lond. A 455 (1999) 1003-1048:
    beyond a peak the tape folds, and the moment stays near M* = (1 + ν) D α with the fold's radius near R, of the
    tape's bending stiffness D, opening angle α and radius R. Here 120 mm long, R 15 mm, α 80°, h 0.1 mm, E 210 GPa, ν
    0.3, ρ 7850. Its ends are in rigid hubs of 1 g, nodes "left" and "right" (the last two of the mesh) at the
    sections' centroids. They are turned by half of `angle` [degrees] each, in 0.2 s, smoothly, in opposite sense (the
    edges in tension), and may come nearer to each other. The tape has internal damping, β = 10 µs.

    `folded`, where another run ended, is the start of the tape's release: then the left hub is held, and nothing
    holds the right one. divisions = (along, around), both even. Watches "crown" and "edge" (uz) at mid-length, and
    "end x", "end z" of the right hub.
    """
    check_positive_number("angle", angle)
    along, around = generators.counts("tape_spring", divisions, (2, 2))
    if along % 2 or around % 2:
        raise ValueError(f"divisions must be even, so that there is a node in the middle, but are {divisions}.")
    length, radius, opening = 0.12, 0.015, np.radians(80.0)
    x, turn = grid(np.linspace(0, length, along + 1), np.linspace(-opening / 2, opening / 2, around + 1))
    centroid = radius * np.sin(opening / 2) / (opening / 2)
    nodes = np.stack([x, radius * np.sin(turn), radius * np.cos(turn) - centroid], 1)
    mesh = Mesh(nodes, _mirrored(along, around))
    hubs = (("left", 0.0), ("right", length))
    bodies = [
        RigidBody(np.flatnonzero(np.abs(x - at) < 1e-9), (at, 0.0, 0.0), mass=1e-3, inertia=4e-8, name=name)
        for name, at in hubs
    ]
    # Smooth, so that the driven hubs get no blows.
    times = np.linspace(0.0, 1.0, 101)
    smooth = History(0.2 * times, 0.5 - 0.5 * np.cos(np.pi * times))
    half = angle * np.pi / 360
    turned = (
        Support("left", DOFS, rotation=(0.0, 1.0, 0.0), angle=half, history=smooth),
        Support("right", DOFS[1:], rotation=(0.0, -1.0, 0.0), angle=half, history=smooth),
    )
    middle = (around + 1) * (along // 2)
    right = (along + 1) * (around + 1) + 1
    return Scene(
        mesh,
        Section(1e-4, 210e9, 0.3, 7850.0),
        turned if folded is None else (clamped("left"),),
        initial=folded,
        name="tape_spring" if folded is None else "released_tape_spring",
        watch={"crown": (middle + around // 2, "uz"), "edge": (middle, "uz")}
        | {"end x": (right, "ux"), "end z": (right, "uz")},
        defaults=Defaults(dt=5e-4, t_end=0.22, save_every=4, picture_times=_BENT, units="SI", method=("exact",))
        if folded is None
        else Defaults(dt=5e-5, t_end=0.03, save_every=4, picture_times=_RELEASED, units="SI", method=("exact",)),
        damping=RayleighDamping(beta=1e-5),
        connectors=bodies,
    )


_BENT = (0.0, 0.03, 0.06, 0.1, 0.14, 0.2)
_RELEASED = (0.0, 0.005, 0.01, 0.015, 0.02, 0.03)


def shaken_plate(
    divisions: tuple[int, int] = (12, 1),
    tip_mass: float = 0.02,
    acceleration: float = 20.0,
    record: History | None = None,
) -> Scene:
    """Cantilever plate with a mass at its tip on a base that is shaken by a record of its acceleration (SI units).

    Aluminium, 300 × 20 × 2 mm, E 70 GPa, ν 0.3, ρ 2700, along x from the base; `tip_mass` [kg] is shared by the nodes
    of the free edge. The base moves along z with `acceleration` [m/s²] times `record`, by default one period of a
    sine of 0.1 s in samples of 5 ms, after which the base stands still a little further up. Damping is a viscous
    material, β = 0.5 ms. divisions = (along, across). Watches "tip" (uz) and "base" (uz); the difference is what a
    gauge on the plate would show.
    """
    check_positive_number("tip_mass", tip_mass)
    check_number("acceleration", acceleration)
    mesh = generators.rectangle(0.3, 0.02, divisions)
    base, tip = (mesh.nodes_where(lambda x, at=at: np.abs(x[0] - at) < 1e-9) for at in (0.0, 0.3))
    if record is None:
        times = np.linspace(0.0, 0.1, 21)
        record = History(times, np.round(np.sin(2 * np.pi * times / 0.1), 6))
    return Scene(
        mesh,
        Section(0.002, 70e9, 0.3, 2700.0),
        (
            Support(base, "uz", acceleration=acceleration, history=record),
            Support(base, [name for name in DOFS if name != "uz"]),
        ),
        name="shaken_plate",
        watch={"tip": (int(tip[tip.size // 2]), "uz"), "base": (int(base[0]), "uz")},
        defaults=Defaults(
            dt=1e-3,
            t_end=0.4,
            save_every=2,
            picture_times=(0.0, 0.03, 0.06, 0.09, 0.12, 0.15),
            units="SI",
            method=("exact",),
        ),
        damping=RayleighDamping(beta=5e-4),
        masses=(PointMass(tip, tip_mass / tip.size),),
    )


def _mirrored(rows: int, columns: int) -> np.ndarray:
    """As `structured_triangles`, but with diagonals that mirror each other across both middles: (2·rows·columns, 3)."""
    i, j = grid(np.arange(rows), np.arange(columns))
    a = i * (columns + 1) + j
    b, c, d = a + columns + 1, a + columns + 2, a + 1
    along = ((2 * i < rows) == (2 * j < columns))[:, None]  # the diagonal a-c, else b-d
    first = np.where(along, np.stack([a, b, c], 1), np.stack([a, b, d], 1))
    second = np.where(along, np.stack([a, c, d], 1), np.stack([b, c, d], 1))
    return np.stack([first, second], 1).reshape(-1, 3)


def _tray(along: int, across: int) -> Mesh:
    """A flat bottom about the origin, and a rim that leans outwards, mitred at its corners."""
    sizes, flare, rim = (0.4, 0.28), 0.015, 0.025

    def places(size, count):
        return np.concatenate([[-size / 2 - flare], np.linspace(-size / 2, size / 2, count + 1), [size / 2 + flare]])

    x, y = grid(places(sizes[0], along), places(sizes[1], across))
    outside = (np.abs(x) > sizes[0] / 2 + 1e-9) | (np.abs(y) > sizes[1] / 2 + 1e-9)
    return Mesh(np.stack([x, y, np.where(outside, rim, 0.0)], 1), _mirrored(along + 2, across + 2))
