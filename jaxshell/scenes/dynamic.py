"""Dynamic benchmarks: snapping panel, and shells in free flight that bend, tumble and spin.

The papers below show some of their loads and supports in figures only. What was chosen here instead is marked
ASSUMPTION: then compare with the papers' curves in kind, not digit by digit.
"""

import numpy as np

from jaxshell.model import generators
from jaxshell.model.grids import chain, grid, structured_triangles
from jaxshell.model.initial import Initial
from jaxshell.model.loads import EdgeForce, History, NodalForce, Pressure
from jaxshell.model.mesh import Mesh
from jaxshell.model.scene import Defaults, Scene
from jaxshell.model.sections import Section
from jaxshell.model.supports import pinned
from jaxshell.model.surface import CylindricalSurface
from jaxshell.numerics.checks import check_number, float_array
from jaxshell.scenes.paper import clamped_quarter


def snapping_panel(divisions: tuple[int, int] = (8, 16), force: float = 5e7) -> Scene:
    """Cylindrical panel pushed through along its crown (SI units).

    D. Kuhl & E. Ramm, "Generalized energy-momentum method for non-linear adaptive shell dynamics", Comput.
    Methods Appl. Mech. Eng. 178 (1999) 343-366: radius 5 m, half angle 30°, h 0.1 m, E 200 GPa, ν 0.25,
    ρ 1e4 kg/m³, force rising to 5e7 N at 0.2 s and constant from there, straight edges hinged.
    ASSUMPTION: length 5 m, and `force` in N per metre of the crown, along all of it, as plane-strain models of this
    panel have it: the panel's limit load (`solve_arc_length`) is then 1.8e7 N/m, while a force on the one node at the
    centre would have to be above 1.2e8 N. The whole panel, free to snap asymmetrically.
    divisions = (along, around), both even. Watches "centre" (uz).
    """
    check_number("force", force)
    along, around = generators.counts("snapping_panel", divisions, (2, 2))
    if along % 2 or around % 2:
        raise ValueError(f"divisions must be even, so that there is a node at the centre, but are {divisions}.")
    radius, length, half_angle = 5.0, 5.0, np.pi / 6
    x, turn = grid(np.linspace(0, length, along + 1), np.linspace(-half_angle, half_angle, around + 1))
    nodes = np.stack([x, radius * np.sin(turn), radius * np.cos(turn)], 1)
    mesh = Mesh(nodes, structured_triangles(along, around), surface=CylindricalSurface(radius))
    centre = mesh.nearest_node([length / 2, 0, radius])
    crown, edges = (np.flatnonzero(np.abs(np.abs(turn) - angle) < 1e-9) for angle in (0.0, half_angle))
    return Scene(
        mesh,
        Section(0.1, 200e9, 0.25, 1e4),
        (pinned(edges),),
        (EdgeForce(chain(crown), [0.0, 0.0, -force], History.ramp(0.2)),),
        name="snapping_panel",
        watch={"centre": (centre, "uz")},
        defaults=Defaults(dt=1e-3, t_end=0.3, picture_times=(0.0, 0.05, 0.1, 0.15, 0.2, 0.3), units="SI"),
    )


def suddenly_loaded_cap(divisions: int = 10, pressure: float = 600.0) -> Scene:
    """Clamped spherical cap under a pressure that is there at once and stays (inches, pounds, seconds).

    K.-J. Bathe, E. Ramm & E. L. Wilson, "Finite element formulations for large deformation dynamic analysis", Int. J.
    Numer. Methods Eng. 9 (1975) 353-386, and others since: radius 22.27 in, half angle 26.67°, h 0.41 in, E 10.5e6 psi,
    ν 0.3, ρ 2.45e-4 lb s²/in⁴, 600 psi on the outside. The first peaks that they give are from -0.087 to -0.093 in. One
    quarter by symmetry, 2·divisions² triangles; the pressure follows the surface. Watches "apex" (uz).
    """
    check_number("pressure", pressure)
    mesh, supports = clamped_quarter("suddenly_loaded_cap", 22.27, 26.67, divisions)
    return Scene(
        mesh,
        Section(0.41, 10.5e6, 0.3, 2.45e-4),
        supports,
        (Pressure(pressure=float_array(-pressure, "pressure"), history=History.constant(), elements=None),),
        name="suddenly_loaded_cap",
        watch={"apex": (0, "uz")},
        defaults=Defaults(dt=5e-6, t_end=1e-3, picture_times=tuple(1e-4 * k for k in range(0, 11, 2))),
    )


def flying_cylinder(divisions: tuple[int, int] = (4, 32)) -> Scene:
    """Short cylinder pushed at four generators and let go: free flight with moderate bending.

    J. C. Simo & N. Tarnow, "A new energy and momentum conserving algorithm for the non-linear dynamics of
    shells", Int. J. Numer. Methods Eng. 37 (1994) 2527-2549: radius 7.5, length 3, h 0.02, E 2e8, ν 0.25, ρ
    1. ASSUMPTION: a pulse from 0 at t = 0 over 10 at t = 0.5 to 0 at t = 1, (0, -1, -1) times it shared by
    the two ends of the generators at 0° and 180°, (1, 1, 1) times it by those at 90° and 270°. Strictly a force on a
    point has no limit in a membrane: every halving of the mesh adds some F/(π E h), here 4e-7, to motions of tens.
    divisions = (along, around), around a multiple of 4. Watches "A x" and "A y", at an end of the generator at 0°.
    """
    along, around = generators.counts("flying_cylinder", divisions, (1, 4))
    if around % 4:
        raise ValueError(f"divisions[1] must be a multiple of 4, but it is {around}.")
    mesh = generators.cylinder(7.5, 3.0, divisions)
    pulse = History([0.0, 0.5, 1.0], [0.0, 10.0, 0.0])

    def ends(quarter):
        first = quarter * around // 4
        return [first, along * around + first]

    return Scene(
        mesh,
        Section(0.02, 2e8, 0.25, 1.0),
        (),
        tuple(
            NodalForce(ends(quarter), 0.5 * np.array(direction), pulse)
            for quarter, direction in enumerate(2 * [[0.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
        ),
        name="flying_cylinder",
        watch={"A x": (0, "ux"), "A y": (0, "uy")},
        defaults=Defaults(dt=0.02, t_end=10.0, picture_times=tuple(float(k) for k in range(0, 11, 2))),
    )


def l_shaped_plate(divisions: int = 4) -> Scene:
    """Two plates that meet at a right angle, struck and let go: a fold in free flight (SI units).

    In the manner of the L-shaped bodies of J. C. Simo & N. Tarnow (1992, 1994). ASSUMPTION, all of it: legs
    of 0.6 × 0.2 m along x and along z from a common edge, h 4 mm, E 70 GPa, ν 0.3, ρ 2700; line forces on
    the two free ends, pulses of 0.02 s. `divisions` per 0.2 m. Watches "end z" (ux) and "end x" (uz),
    corners of the legs' ends.
    """
    (divisions,) = generators.counts("l_shaped_plate", divisions, (1,))
    count = 3 * divisions
    along = np.concatenate([np.arange(count, 0, -1), np.arange(count + 1)])
    i, j = grid(np.arange(2 * count + 1), np.arange(divisions + 1))
    leg, y = 0.6 * along[i] / count, 0.2 * j / divisions
    up = i < count  # the leg along z comes first
    nodes = np.stack([np.where(up, 0.0, leg), y, np.where(up, leg, 0.0)], 1)
    mesh = Mesh(nodes, structured_triangles(2 * count, divisions))
    pulse = History([0.0, 0.01, 0.02], [0.0, 1.0, 0.0])
    top, end = np.flatnonzero(i == 0), np.flatnonzero(i == 2 * count)
    return Scene(
        mesh,
        Section(4e-3, 70e9, 0.3, 2700.0),
        (),
        (
            EdgeForce(chain(top), [2e3, 1e3, 1e3], pulse),
            EdgeForce(chain(end), [1e3, -1e3, 2e3], pulse),
        ),
        name="l_shaped_plate",
        watch={"end z": (int(top[0]), "ux"), "end x": (int(end[0]), "uz")},
        defaults=Defaults(dt=5e-4, t_end=0.5, picture_times=tuple(0.1 * k for k in range(6)), units="SI"),
    )


def spinning_plate(divisions: int = 8, spin: tuple[float, float, float] = (0.0, 20.0, 60.0)) -> Scene:
    """Square plate that spins, by default about no principal axis: centrifugal stress, nutation (SI units).

    ASSUMPTION, all of it: 0.5 × 0.5 × 0.005 m, E 70 GPa, ν 0.3, ρ 2700, no supports, no loads, angular
    velocity `spin` [rad/s] about its middle. Energy and momenta are those of the start for ever. Watches
    "corner x" and "corner z".
    """
    side = 0.5
    (divisions,) = generators.counts("spinning_plate", divisions, (1,))
    mesh = generators.rectangle(side, side, (divisions, divisions))
    return Scene(
        mesh,
        Section(0.005, 70e9, 0.3, 2700.0),
        (),
        (),
        initial=Initial.rigid(mesh, angular_velocity=spin),
        name="spinning_plate",
        watch={"corner x": (0, "ux"), "corner z": (0, "uz")},
        defaults=Defaults(dt=2e-4, t_end=0.5, picture_times=tuple(0.1 * k for k in range(6)), units="SI"),
    )
