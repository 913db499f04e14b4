"""Shells that are driven and joined: a blade that its hub spins up, and a solar panel that unfolds (SI units).

ASSUMPTION, all dimensions and materials: the scenes are in the manner of the literature on flexible multibody systems,
and none of them is a copy of a published one.
"""

import jax
import jax.numpy as jnp
import numpy as np

from jaxshell.model import generators
from jaxshell.model.connectors import Hinge, RigidBody
from jaxshell.model.history import History
from jaxshell.model.initial import Initial
from jaxshell.model.loads import Centrifugal, NodalForce
from jaxshell.model.mesh import Mesh
from jaxshell.model.scene import Defaults, Scene
from jaxshell.model.sections import Section
from jaxshell.model.supports import Support, clamped
from jaxshell.numerics.checks import Real, check_number, check_positive_number
from jaxshell.numerics.rotations import exp

HUB_RADIUS = 0.1
"""Of the blade's hub [m]."""


def spun_blade(
    divisions: tuple[int, int] = (12, 2),
    speed: Real = 60.0,
    spin_up: Real = 0.3,
    kick: Real = 100.0,
    turning_axes: bool = False,
) -> Scene:
    """Blade on a hub that spins it up: centrifugal stiffening, flapping, lead and lag (SI units).

    A strip of 1 × 0.05 × 0.01 m along x, E 70 GPa, ν 0, ρ 2700, flat in its plane of rotation, on a rigid hub of radius
    0.1 m, 1 kg and 0.005 kg m² about z, at the origin. The hub is turned about z at the rate `speed` [rad/s] times
    3s² - 2s³ with s = t/`spin_up`, and at `speed` from there on. Then a pulse of 5 ms and `kick` [N] along z at the tip
    sets the blade flapping. The drive's torque is the reaction of the node in the set "hub"
    (`simulate(..., reactions=True)`).

    With `turning_axes` the same blade at rest in axes that turn with it at `speed`: the hub is held, and `Centrifugal`
    acts. Its frequencies are `natural_frequencies(scene, about=solve_static(scene, [1.0]))`.

    ASSUMPTION, all of it. divisions = (along, across), across even. Watches "tip x", "tip y" and "flap" (uz), in the
    middle of the tip.
    """
    for name, value in (("speed", speed), ("kick", kick)):
        check_number(name, value)
    check_positive_number("spin_up", spin_up)
    length, width = 1.0, 0.05
    along, across = generators.counts("spun_blade", divisions, (1, 2))
    if across % 2:
        raise ValueError(f"divisions[1] must be even, so that there is a node amid the tip, but it is {across}.")
    flat = generators.rectangle(length, width, (along, across))
    mesh = Mesh(flat.nodes + jnp.array([HUB_RADIUS, -width / 2, 0.0]), flat.triangles)
    root, tip = np.arange(across + 1), mesh.n_nodes - 1 - np.arange(across + 1)
    hub = RigidBody(root, (0.0, 0.0, 0.0), mass=1.0, inertia=np.diag([0.003, 0.003, 0.005]), name="hub")
    axis = jnp.array([0.0, 0.0, 1.0])
    if turning_axes:
        support, load = clamped("hub"), Centrifugal(speed * axis)
    else:
        support = Support("hub", rotation=axis, about=(0, 0, 0), angle=speed * spin_up, history=_spun_up(spin_up))
        pulse = History(spin_up + np.array([0.0, 2.5e-3, 5e-3]), [0.0, 1.0, 0.0])
        load = NodalForce(tip, kick / len(tip) * axis, pulse)
    middle = int(tip[across // 2])
    return Scene(
        mesh,
        Section(0.01, 70e9, 0.0, 2700.0),
        (support,),
        (load,),
        name="spun_blade",
        watch={"tip x": (middle, "ux"), "tip y": (middle, "uy"), "flap": (middle, "uz")},
        connectors=(hub,),
        defaults=Defaults(
            dt=5e-4, t_end=0.6, save_every=10, picture_times=tuple(0.1 * k for k in range(7)), units="SI"
        ),
    )


def _spun_up(end: Real) -> History:
    """∫ (3s² - 2s³) ds with s = t/`end`, in 600 samples, and 1 a `end` from there on, for a thousand times that."""
    s = np.linspace(0.0, 1.0, 601)
    return History(end * np.append(s, 1000.0), np.append(s**3 - 0.5 * s**4, 999.5))


def unfolding_panel(
    divisions: tuple[int, int] = (12, 8), stiffness: Real = 4.0, damping: Real = 3.0, held: bool = False
) -> Scene:
    """Solar panel of three plates that unfolds by spring hinges on a satellite (SI units).

    Plates of 0.8 × 0.6 × 0.02 m, E 2 GPa, ν 0.3, ρ 150: 3 kg/m², about as stiff as a sandwich of that thickness. They
    are in one row along x, free of stress, where the panel is deployed; at the start they are folded, at rest, by 85°
    at the satellite and by 170° between plates. Two hinges at each of the three lines, each with a torsion spring of
    `stiffness` [N m/rad], at rest 0.1 rad beyond the deployed shape, viscous friction `damping` [N m s/rad], and a stop
    of 200 N m/rad at the deployed shape. The satellite is a rigid body of 100 kg and 10 kg m², 0.5 m before the panel;
    `held` holds it. Free, it turns while the panel unfolds: nothing acts from outside, and both momenta stay zero.

    ASSUMPTION, all of it. divisions = (along, across) of each plate. Watches "tip x" and "tip z", at a corner of the
    last plate, and "springs", the energy of springs and stops.
    """
    length, width, folded = 0.8, 0.6, np.radians(85.0)
    one = generators.rectangle(length, width, divisions)
    n, across = one.n_nodes, one.n_nodes // (divisions[0] + 1)
    nodes = jnp.concatenate([one.nodes + jnp.array([length * k, 0.0, 0.0]) for k in range(3)])
    triangles = np.concatenate([one.triangles + n * k for k in range(3)])
    mesh = Mesh(nodes, triangles, coincident="allow").with_points({"left": nodes[0], "right": nodes[across - 1]})
    root, near, far = 3 * n + np.arange(2), np.array([0, across - 1]), np.array([n - across, n - 1])
    connectors = (
        RigidBody(root, (-0.5, width / 2, 0.0), mass=100.0, inertia=10.0, name="satellite"),
        # Plates fold to either side by turns: at the middle line the far plate is the first of the pair.
        Hinge(
            np.concatenate([root, near + n, far + n]),
            np.concatenate([near, far, near + 2 * n]),
            (0.0, 1.0, 0.0),
            stiffness=stiffness,
            angle=0.1,
            damping=damping,
            stops=(-3.0, 0.0),
            stop_stiffness=200.0,
            name="hinges",
        ),
    )
    R = jax.vmap(exp)(folded * jnp.array([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]))
    begins = length * (jnp.cumsum(R[:, :, 0], axis=0) - R[:, :, 0])
    places = begins[:, None] + jnp.einsum("kij,nj->kni", R, one.nodes)
    return Scene(
        mesh,
        Section(0.02, 2e9, 0.3, 150.0),
        (clamped("satellite"),) if held else (),
        initial=Initial(displacements=places.reshape(-1, 3) - nodes, rotations=jnp.repeat(R, n, axis=0)),
        name="unfolding_panel",
        watch={"tip x": (3 * n - 1, "ux"), "tip z": (3 * n - 1, "uz"), "springs": ("hinges", "energy")},
        connectors=connectors,
        defaults=Defaults(
            dt=5e-3, t_end=4.0, save_every=10, picture_times=(0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 4.0), units="SI"
        ),
    )
