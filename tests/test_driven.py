"""Driven motion: prescribed rotations, hubs that turn as one, accelerated bases, and the integrals of a record."""

import dataclasses

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
import pytest  # noqa: E402
from test_scene_file import read  # noqa: E402

import jaxshell as js  # noqa: E402
from jaxshell.analyses.simulation import check_turns  # noqa: E402
from jaxshell.analyses.statics import proportional  # noqa: E402
from jaxshell.assembly.discretised import Model  # noqa: E402
from jaxshell.assembly.driven import motion_of  # noqa: E402
from jaxshell.assembly.structure import structure_of  # noqa: E402
from jaxshell.assembly.tables import analyse  # noqa: E402
from jaxshell.command.check_scene import described_scene  # noqa: E402
from jaxshell.model.generators import rectangle  # noqa: E402
from jaxshell.numerics.rotations import exp  # noqa: E402

SECTION = js.Section(0.02, 1e8, 0.3, 1000.0)
BLADE = rectangle(1.0, 0.2, [3, 1])
HUB = BLADE.nodes_where(lambda x: x[0] < 1e-9)
CENTRE, AXIS = np.array([-0.1, 0.1, 0.0]), np.array([0.3, 0.0, 1.5])
SAMPLES, SPUN = np.linspace(0.0, 10.0, 401), np.linspace(0.0, 1.0, 401) ** 3
"""A hub that gets faster and faster, from rest to one whole angle."""


def turning(angle, history=None, nodes=HUB):
    """The nodes turned about the axis through the centre."""
    history = js.History(SAMPLES, SPUN) if history is None else history
    return js.Support(nodes, rotation=AXIS, angle=angle, about=CENTRE, history=history)


def balance(run) -> float:
    """What K + S - W and what was dissipated change by, of the largest energy."""
    energy = run.energy
    lost = np.asarray(energy.total + energy.dissipated - energy.external_work)
    return float(np.abs(lost - lost[0]).max() / np.asarray(energy.total).max())


def test_motions_that_are_alike_are_as_each_alone():
    """Shifted, accelerated and turned nodes, two of each kind, and one that has no like."""
    mesh, rise = rectangle(1.0, 1.0, [2, 2]), js.History([0.0, 0.3, 1.0], [0.0, 0.9, -0.5])
    later = js.History([0.0, 0.5, 1.5], [0.0, 2.0, 1.0])
    supports = [
        js.Support([0], "uz", displacement=0.1, history=rise),
        js.Support([1], "uz", displacement=-0.3, history=later),
        js.Support([2], ["ux", "uz"], acceleration=2.0, history=rise),
        js.Support([3], ["ux", "uy"], acceleration=1.5, history=later),
        turning(0.4, rise, [4, 5]),
        turning(-0.2, later, [6, 7]),
        turning(0.7, later, [8]),
    ]
    scene = js.Scene(mesh, SECTION, supports)
    model = Model.build(scene, analyse(structure_of(scene))[0])
    assert len(model.moving) == 4
    alone = [dataclasses.replace(model, moving=(motion_of(s, mesh.nodes, None),)) for s in supports]
    for time in (0.0, 0.2, 0.7):
        for asked in (
            lambda m, time: m.held_displacement(time),
            lambda m, time: m.held_rates(time),
            lambda m, time: m.held_accelerations(time),
            lambda m, time: m.held_increment(time, 0.4),
        ):
            together, expected = asked(model, time), sum(asked(m, time) for m in alone)
            np.testing.assert_allclose(together, expected, rtol=1e-14, atol=1e-15)


# --- histories -------------------------------------------------------------------------------------------


def test_the_integrals_of_a_history_are_exact():
    """Against the polynomials between the samples, on both sides of time 0 and beyond either end."""
    history = js.History([-0.5, 0.25, 1.0], [0.7, -1.0, 2.0])
    # From 0: f = -1 + (0.25 - t) 1.7/0.75 until 0.25, then -1 + 4 (t - 0.25) until 1, then 2.
    slope, start = -1.7 / 0.75, -1.0 + 0.25 * 1.7 / 0.75
    first = start * 0.25 + slope * 0.25**2 / 2
    second = start * 0.25**2 / 2 + slope * 0.25**3 / 6
    until = first - 0.75 + 2 * 0.75**2
    at_end = second + first * 0.75 - 0.75**2 / 2 + 4 * 0.75**3 / 6
    expected = {
        -0.5: (-0.5 * start + slope / 8, start / 8 - slope / 48),
        0.0: (0.0, 0.0),
        0.25: (first, second),
        1.0: (until, at_end),
        3.0: (until + 2 * 2.0, at_end + until * 2 + 2.0 * 2),
    }

    @jax.jit
    def found(history, times):
        first = jax.jvp(history.integral, (times,), (jnp.ones_like(times),))
        second = jax.jvp(history.double_integral, (times,), (jnp.ones_like(times),))
        return *first, *second, history.rate(times), history(times)

    times = jnp.array([*expected, -2.0])
    once, once_rate, twice, twice_rate, rate, values = found(history, times)
    np.testing.assert_allclose(jnp.stack([once, twice], axis=1)[:-1], list(expected.values()), atol=1e-15)
    np.testing.assert_allclose(once[-1], once[0] - 0.7 * 1.5, atol=1e-15)
    np.testing.assert_allclose(once_rate, values, atol=1e-15)
    np.testing.assert_allclose(twice_rate, once, atol=1e-15)
    np.testing.assert_allclose(rate, [slope, slope, 4.0, 0.0, 0.0, 0.0], atol=1e-15)


# --- what is refused -------------------------------------------------------------------------------------

RAMP = js.History.ramp(1.0)


@pytest.mark.parametrize(
    ("make", "named"),
    [
        ({"rotation": (0, 0, 0), "history": RAMP}, "axis has zero length"),
        ({"rotation": (0, 1), "history": RAMP}, r"axis must have shape \(3,\)"),
        ({"rotation": (0, 0, 1)}, "prescribed rotation needs a history"),
        ({"rotation": (0, 0, 1), "history": js.History.constant()}, "rotation must be zero at time 0, but it is 1"),
        ({"rotation": (0, 0, 1), "angle": [1.0, 2.0], "history": RAMP}, "angle must be one number"),
        ({"rotation": (0, 0, 1), "about": (0, 0), "history": RAMP}, r"about must have shape \(3,\)"),
        ({"rotation": (0, 0, 1), "dofs": ("rx", "rz"), "history": RAMP}, "moves rx, ry, rz, but .* dofs lack ry"),
        (
            {"rotation": (0, 0, 1), "about": (0, 0, 0), "dofs": ("rx", "ry", "rz"), "history": RAMP},
            "about a point moves .* lack ux, uy, uz: leave dofs out",
        ),
        ({"rotation": (0, 0, 1), "displacement": 1.0, "history": RAMP}, "one motion, but .* displacement and rotation"),
        ({"about": (0, 0, 0)}, "about belongs to a rotation"),
        ({"angle": 1.0, "displacement": 1.0, "history": RAMP, "dofs": "ux"}, "angle belongs to a rotation"),
        ({"history": RAMP}, "needs the displacement, rotation or acceleration"),
        ({"dofs": ("ux", "rx"), "acceleration": 1.0, "history": RAMP}, "Only displacements .* names rx"),
        ({"dofs": "ux", "acceleration": [1.0, 2.0, 3.0], "history": RAMP}, r"acceleration must be .* \(3,\)"),
        ({"dofs": "ux", "acceleration": float("nan"), "history": RAMP}, "prescribed acceleration must be finite"),
    ],
)
def test_motions_that_do_not_fit_are_refused(make, named):
    with pytest.raises(ValueError, match=named):
        js.Support([0], **make)


def test_nodes_that_are_driven_twice_are_refused():
    spun = js.Support([0], rotation=(0, 0, 1), history=RAMP)
    for other in (js.Support([0], "rx"), js.Support([0, 1], rotation=(0, 0, 1), history=RAMP), turning(1.0)):
        with pytest.raises(ValueError, match="rx of node 0 is prescribed by two supports"):
            js.Scene(BLADE, SECTION, [spun, other])
    shaken = js.Support([0], "uz", acceleration=1.0, history=RAMP)
    with pytest.raises(ValueError, match="uz of node 0 is prescribed by two supports"):
        js.Scene(BLADE, SECTION, [shaken, js.pinned([0])])
    both = js.Scene(BLADE, SECTION, [spun, shaken])
    assert both.held_dofs.tolist() == [2, 3, 4, 5]
    # Statics, which knows no time, holds what is accelerated.
    turned, held = proportional(both).supports
    assert turned.moves and not held.moves and held.dofs == ("uz",)


def test_steps_of_half_a_turn_are_refused():
    scene = js.Scene(BLADE, SECTION, [turning(1.0, js.History([0.0, 1.0, 2.0], [0.0, 0.5, 40.5]))])
    with pytest.raises(ValueError, match=r"support 0 turns its nodes by 4 rad .* from time 1 to 1.1, .* below 0.0785"):
        js.simulate(scene, js.Newmark(), dt=0.1, t_end=2.0)
    with pytest.raises(ValueError, match="turns its nodes by 4 rad"):
        jax.jit(lambda: check_turns(scene, np.full(20, 0.1)))()  # the trace is of something else
    with pytest.raises(ValueError, match="settle: a support with a prescribed acceleration"):
        shaken = js.Support([0, 1], "uz", acceleration=1.0, history=RAMP)
        js.settle(js.Scene(BLADE, SECTION, [js.Support([0, 1], ("ux", "uy", "rx", "ry", "rz")), shaken]))


# --- files -----------------------------------------------------------------------------------------------


DRIVEN = """
[mesh]
generator = "rectangle"
length = 1.0
width = 0.2
divisions = [3, 1]
[section]
thickness = 0.02
young_modulus = 1e6
poisson_ratio = 0.3
density = 1000.0
[[supports]]
plane = { x = 0.0 }
rotation = [0.0, 0.0, 1.0]
angle = 6.0
about = [-0.1, 0.1, 0.0]
history = { times = [0.0, 1.0], values = [0.0, 1.0] }
[[supports]]
nodes = [5]
hold = "clamped"
rotation = [0.0, 2.0, 0.0]
history = { ramp = 1.0 }
[[supports]]
nodes = [7]
hold = ["uz"]
acceleration = 9.81
history = { times = [0.0, 0.1], values = [1.0, 0.0] }
"""


def test_scene_files_and_result_files_know_driven_supports(tmp_path):
    scene, _ = read(tmp_path, DRIVEN)
    hub, turned, shaken = scene.supports
    assert hub.dofs == js.Support([0]).dofs and float(hub.angle) == 6.0 and hub.about.tolist() == [-0.1, 0.1, 0.0]
    assert turned.about is None and turned.rotation.tolist() == [0.0, 2.0, 0.0] and len(turned.dofs) == 6
    assert float(shaken.acceleration) == 9.81 and shaken.dofs == ("uz",) and not shaken.moves_with_load
    js.Modes(jnp.ones(1), jnp.zeros((1, 8, 6))).save(tmp_path / "modes.h5", scene)
    _, again = js.Modes.load(tmp_path / "modes.h5")
    assert jax.tree.structure(again.supports) == jax.tree.structure(scene.supports)
    pairs = zip(jax.tree.leaves(again.supports), jax.tree.leaves(scene.supports), strict=True)
    assert all(np.array_equal(a, b) for a, b in pairs)
    said = "\n".join(described_scene(scene))
    assert "turned as one body by 6 rad about (0, 0, 1) through (-0.1, 0.1, 0): 2 nodes" in said
    assert "turned in place by 1 rad about (0, 2, 0): 1 node" in said and "uz accelerated by 9.81: 1 node" in said
    with pytest.raises(ValueError, match=r"number 1: .*axis has zero length"):
        read(tmp_path, DRIVEN.replace("[0.0, 0.0, 1.0]", "[0.0, 0.0, 0.0]"))
    with pytest.raises(ValueError, match=r"number 3: lacks|number 3: .*'hold'"):
        read(tmp_path, DRIVEN.replace('hold = ["uz"]\n', ""))


# --- motion ----------------------------------------------------------------------------------------------


ANGLE = 20.0 * np.pi
METHOD, TIGHT = js.EnergyMomentum(), js.Newton(tolerance=1e-12)


def angles(run):
    return np.interp(np.asarray(run.times), SAMPLES, SPUN) * ANGLE


def positions(run):
    return np.asarray(BLADE.nodes) + np.asarray(run.displacements)


def blade(angle=ANGLE, history=None):
    return js.Scene(BLADE, SECTION, [turning(angle, history)])


def run(scene, t_end=10.0, **options):
    return js.simulate(scene, METHOD, dt=0.02, t_end=t_end, newton=TIGHT, reactions=True, **options)


@pytest.fixture(scope="module")
def spun():
    """Ten revolutions about an oblique axis beside the blade, in steps of up to 22 degrees."""
    return run(blade())


def test_a_hub_turns_as_one_rigid_body(spun):
    turns = np.asarray(jax.vmap(exp)(angles(spun)[:, None] * AXIS / np.linalg.norm(AXIS)))
    arms = np.asarray(BLADE.nodes)[HUB] - CENTRE
    np.testing.assert_allclose(positions(spun)[:, HUB], CENTRE + np.einsum("fij,kj->fki", turns, arms), atol=1e-13)
    R = np.asarray(spun.rotations)[:, HUB]
    np.testing.assert_allclose(R, np.broadcast_to(turns[:, None], R.shape), atol=5e-12)  # some ε a step


def test_the_work_of_the_drive_is_the_energy(spun):
    """EnergyMomentum: to round-off, with the moments' work m·θ on the Cayley vectors."""
    assert balance(spun) < 1e-12 and float(spun.energy.kinetic[-1]) > 100.0
    # The same work from the reactions that are recorded.
    carried = np.asarray(js.reactions(spun))[1:]
    theta = (2.0 * np.tan(0.5 * np.diff(angles(spun))))[:, None] * AXIS / np.linalg.norm(AXIS)
    work = np.sum(carried[:, :, :3] * np.diff(positions(spun), axis=0), axis=(1, 2))
    work = np.cumsum(work + np.sum(carried[:, HUB, 3:] * theta[:, None], axis=(1, 2)))
    np.testing.assert_allclose(spun.energy.external_work[1:], work, atol=1e-12 * np.abs(work).max())


def test_reactions_of_a_hub_are_what_the_momenta_gain(spun):
    """In every step: the mean reactions are the impulse, and at the mean positions the angular impulse."""
    carried, x = np.asarray(js.reactions(spun))[1:], positions(spun)
    forces, middle = carried[:, :, :3], 0.5 * (x[1:] + x[:-1])
    gained = np.diff(np.asarray(spun.momentum.linear), axis=0) / 0.02
    np.testing.assert_allclose(forces.sum(axis=1), gained, atol=1e-9 * np.abs(forces).max())
    moments = (np.cross(middle, forces) + carried[:, :, 3:]).sum(axis=1)
    gained = np.diff(np.asarray(spun.momentum.angular), axis=0) / 0.02
    np.testing.assert_allclose(moments, gained, atol=1e-9 * np.abs(moments).max())


def test_driven_nodes_have_their_velocity_from_the_start():
    """A hub that turns at once: its velocities are ω × r in every step, where they would swing between 0 and 2 ω × r."""
    omega = 3.0 * AXIS / np.linalg.norm(AXIS)
    going = run(blade(3.0, js.History(SAMPLES, SAMPLES)), t_end=2.0)
    expected = np.cross(omega, positions(going)[:, HUB] - CENTRE)
    np.testing.assert_allclose(np.asarray(going.velocities)[:, HUB], expected, atol=3e-3)
    assert balance(going) < 1e-12


# --- explicit --------------------------------------------------------------------------------------------


def test_central_differences_turn_a_hub_exactly():
    method = js.CentralDifference()
    scene = blade(0.2, js.History(SAMPLES / 200.0, SPUN))
    made = js.simulate(scene, method, dt=0.9 * method.critical_step(scene), t_end=0.05, save_every=100)
    turned = np.asarray(exp(0.2 * AXIS / np.linalg.norm(AXIS)))
    arms = np.asarray(BLADE.nodes)[HUB] - CENTRE
    np.testing.assert_allclose(positions(made)[-1, HUB], CENTRE + arms @ turned.T, atol=1e-13)
    np.testing.assert_allclose(made.rotations[-1, HUB], np.broadcast_to(turned, (2, 3, 3)), atol=1e-12)
    assert balance(made) < 1e-4
