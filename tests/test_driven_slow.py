"""Driven motion, long evidence: physics of a spun blade and a shaken base, orders, derivatives, statics."""

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
import pytest  # noqa: E402
from sensitivity import check_derivatives  # noqa: E402
from test_driven import AXIS, BLADE, CENTRE, HUB, SECTION, TIGHT, balance, blade, positions, run  # noqa: E402

import jaxshell as js  # noqa: E402
from jaxshell.model.generators import rectangle  # noqa: E402
from jaxshell.numerics.rotations import exp  # noqa: E402

pytestmark = pytest.mark.slow


# --- physics ---------------------------------------------------------------------------------------------


def test_a_spun_bar_stretches_and_pulls_as_it_should():
    """σ = ρ Ω² (R² - r²)/2 in a bar from r₀ to R: its tip moves by ρ Ω²/(2E) (R² (R - r₀) - (R³ - r₀³)/3), and the hub
    carries the centripetal force of all of it."""
    mesh, inner, speed = rectangle(1.0, 0.1, [8, 1]), 0.2, 10.0
    hub, end = (mesh.nodes_where(lambda x, at=at: abs(x[0] - at) < 1e-9) for at in (0.0, 1.0))
    centre = np.array([-inner, 0.05, 0.0])
    t = np.linspace(0.0, 0.8, 321)
    s = np.minimum(t / 0.5, 1.0)
    turned = speed * (0.5 * (s**3 - 0.5 * s**4) + np.maximum(t - 0.5, 0.0))  # ω = Ω (3 s² - 2 s³), then Ω
    support = js.Support(hub, rotation=(0, 0, 1), about=centre, history=js.History(t, turned))
    scene = js.Scene(mesh, js.Section(0.02, 1e8, 0.0, 1000.0), [support])
    spun = js.simulate(
        scene, js.EnergyMomentum(), dt=0.0025, t_end=0.8, newton=js.Newton(tolerance=1e-13), reactions=True
    )
    steady = np.asarray(spun.times) > 0.5
    x = np.asarray(mesh.nodes) + np.asarray(spun.displacements)[steady] - centre
    stretch = (
        np.linalg.norm(x[:, end], axis=2).mean() - np.linalg.norm(np.asarray(mesh.nodes)[end] - centre, axis=1).mean()
    )
    outer = inner + 1.0
    exact = 1000.0 * speed**2 / 2e8 * (outer**2 * 1.0 - (outer**3 - inner**3) / 3.0)
    assert stretch == pytest.approx(exact, rel=1e-2)
    forces = np.asarray(js.reactions(spun))[steady][:, :, :3].sum(axis=1)
    pull = 1000.0 * 0.02 * 0.1 * speed**2 * (outer**2 - inner**2) / 2.0
    radial = x[:, end].mean(axis=1)
    radial = radial / np.linalg.norm(radial, axis=1, keepdims=True)
    assert -np.sum(forces * radial, axis=1).mean() == pytest.approx(pull, rel=1e-2)


RECORD = js.History([0.0, 0.3, 0.5, 0.9, 1.2], [0.0, 4.0, -6.0, 3.0, 0.0])


def cantilever(supports, loads=()):
    mesh = rectangle(1.0, 0.2, [3, 1])
    return js.Scene(mesh, SECTION, supports, loads, watch={"tip": (mesh.nearest_node([1, 0, 0]), "uz")})


def test_a_shaken_base_is_the_inertial_load_in_its_own_frame():
    """Displacements relative to the base are those under gravity -a(t): apart by Δt², and the base where the double
    integral is; the energy is the work of the drive."""
    rest = js.Support(HUB, ("ux", "uy", "rx", "ry", "rz"))
    driven = cantilever([rest, js.Support(HUB, "uz", acceleration=2.0, history=RECORD)])
    loaded = cantilever([js.clamped(HUB)], [js.Gravity([0.0, 0.0, -2.0], RECORD)])
    apart = []
    for dt in (0.01, 0.005):
        moved, pressed = (
            js.simulate(scene, js.EnergyMomentum(), dt=dt, t_end=1.2, newton=TIGHT) for scene in (driven, loaded)
        )
        base = np.asarray(moved.displacements)[:, HUB[0], 2]
        np.testing.assert_allclose(base, 2.0 * RECORD.double_integral(moved.times), atol=1e-13)
        relative = np.asarray(moved.watched["tip"]) - base
        apart.append(np.abs(relative - np.asarray(pressed.watched["tip"])).max() / np.abs(relative).max())
        assert balance(moved) < 1e-12
    assert apart[1] < 2e-3 and apart[0] / apart[1] == pytest.approx(4.0, rel=0.15)


# --- every method ----------------------------------------------------------------------------------------

METHODS = {"EMC": js.GeneralizedEnergyMomentum(), "Newmark": js.Newmark(), "HHT": js.HHT(-0.1), "Bathe": js.Bathe()}
FINE = js.History(np.linspace(0.0, 1.0, 4001), np.linspace(0.0, 1.0, 4001) ** 3 + 0.5 * np.linspace(0.0, 1.0, 4001))


def moving_at_once():
    """Spun by a hub that turns at once, and a blade that turns with it from the start."""
    support = js.Support(HUB, rotation=AXIS, angle=1.5, about=CENTRE, history=FINE)
    spin = 0.75 * AXIS / np.linalg.norm(AXIS)
    initial = js.Initial.rigid(BLADE, angular_velocity=spin, velocity=np.cross(spin, BLADE.nodes.mean(axis=0) - CENTRE))
    return js.Scene(BLADE, SECTION, [support], initial=initial)


@pytest.mark.parametrize(
    "name", ["EMC", *(pytest.param(name, marks=pytest.mark.evidence) for name in ("Newmark", "HHT", "Bathe"))]
)
def test_work_of_the_drive_is_the_energy_to_the_methods_order(name):
    method, errors = METHODS[name], []
    for dt in (0.02, 0.01):
        made = js.simulate(moving_at_once(), method, dt=dt, t_end=1.0, newton=js.Newton(tolerance=1e-10))
        errors.append(balance(made))
        turned = np.asarray(exp(2.25 * AXIS / np.linalg.norm(AXIS)))
        arms = np.asarray(BLADE.nodes)[HUB] - CENTRE
        np.testing.assert_allclose(positions(made)[-1, HUB], CENTRE + arms @ turned.T, atol=1e-13)
        # Velocities of the hub neither swing nor start from rest.
        omega = 1.5 * (3 * np.asarray(made.times) ** 2 + 0.5)[:, None] * AXIS / np.linalg.norm(AXIS)
        exact = np.cross(omega[:, None], positions(made)[:, HUB] - CENTRE)
        assert np.abs(np.asarray(made.velocities)[:, HUB] - exact).max() < 40 * dt**2
    assert errors[1] < 1e-2 and np.log2(errors[0] / errors[1]) > 1.8


def test_steps_are_cut_below_half_a_turn():
    """Under step control, where the nodes that turn in their places are no part of the estimate."""
    tip = js.Support([BLADE.n_nodes - 1], rotation=(1, 0, 0), history=js.History([0.0, 0.5, 1.0], [0.0, 0.0, 4.0]))
    scene = js.Scene(BLADE, SECTION, [js.clamped(HUB), js.Support([BLADE.n_nodes - 1], ("ux", "uy", "uz")), tip])
    control = js.StepControl(1e6, 0.25, horizon=float("inf"))
    made = js.simulate(scene, js.EnergyMomentum(), dt=control, t_end=1.0, newton=js.Newton(max_iterations=100))
    angle = np.interp(np.asarray(made.times), [0.5, 1.0], [0.0, 4.0])
    assert np.diff(angle).max() < np.pi and balance(made) < 1e-8
    np.testing.assert_allclose(made.rotations[-1, -1], exp(jnp.array([4.0, 0.0, 0.0])), atol=1e-12)


# --- statics ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("way", ["load steps", pytest.param("arc length", marks=pytest.mark.evidence)])
def test_statics_turn_a_shell_on_its_hub_without_strain(way):
    """Load steps of a whole turn are cut; the shell is where the hub takes it. So along the arc length."""
    scene = blade(3.0 * np.pi)
    made = js.solve_static(scene, [0.2, 1.0]) if way == "load steps" else js.solve_arc_length(scene, 0.5)
    for k, factor in enumerate(np.asarray(made.frame_times)):
        R = np.asarray(exp(factor * 3.0 * np.pi * AXIS / np.linalg.norm(AXIS)))
        expected = CENTRE + (np.asarray(BLADE.nodes) - CENTRE) @ R.T
        np.testing.assert_allclose(positions(made)[k], expected, atol=1e-8)
    assert float(made.times[-1]) >= 1.0


def test_a_twisted_strip_has_the_moment_of_theory():
    """T = G b h³/3 φ/L, the torsion of a thin plate, and a little more where its ends cannot warp; half of T φ is the
    strain energy."""
    mesh = rectangle(1.0, 0.05, [8, 1])
    ends = [mesh.nodes_where(lambda x, at=at: abs(x[0] - at) < 1e-9) for at in (0.0, 1.0)]
    turn = js.Support(ends[1], rotation=(1, 0, 0), angle=1e-3, about=(0, 0.025, 0), history=js.History.ramp(1.0))
    section = js.Section(0.005, 1e9, 0.25, 1000.0)
    twisted = js.solve_static(js.Scene(mesh, section, [js.clamped(ends[0]), turn]), [1.0])
    x, carried = np.asarray(mesh.nodes) + np.asarray(twisted.displacements)[-1], np.asarray(js.reactions(twisted))[-1]
    torque = (np.cross(x[ends[1]], carried[ends[1], :3]) + carried[ends[1], 3:]).sum(axis=0)
    torque = torque - np.cross([0, 0.025, 0], carried[ends[1], :3].sum(axis=0))
    shear = 1e9 / 2.5
    assert torque[0] == pytest.approx(shear * 0.05 * 0.005**3 / 3.0 * 1e-3, rel=0.05)
    assert 0.5e-3 * torque[0] == pytest.approx(float(twisted.energy.strain[-1]), rel=1e-4)
    assert float(twisted.energy.external_work[-1]) == pytest.approx(float(twisted.energy.strain[-1]), rel=1e-4)


@pytest.mark.evidence
def test_buckling_by_a_turn_about_a_far_point_is_that_by_a_push():
    mesh = rectangle(1.0, 0.2, [8, 2])
    ends = [mesh.nodes_where(lambda x, at=at: abs(x[0] - at) < 1e-9) for at in (0.0, 1.0)]
    ramp = js.History.ramp(1.0)
    pushed = [js.Support(ends[1], "ux", -1e-4, ramp), js.Support(ends[1], ("uy", "uz", "rx", "ry", "rz"))]
    turned = js.Support(ends[1], rotation=(0, 0, 2), angle=1e-7, about=(1.0, -1000.0, 0), history=ramp)
    factors = [
        np.asarray(js.linear_buckling(js.Scene(mesh, SECTION, [js.clamped(ends[0]), *moved]), 2).load_factors)
        for moved in (pushed, [turned])
    ]
    np.testing.assert_allclose(factors[1], factors[0], rtol=1e-3)
    held = js.Scene(mesh, SECTION, [js.clamped(ends[0]), js.clamped(ends[1])])
    moved = js.Scene(mesh, SECTION, [js.clamped(ends[0]), turned])
    frequencies = [np.asarray(js.natural_frequencies(scene, 3).frequencies) for scene in (held, moved)]
    np.testing.assert_allclose(frequencies[1], frequencies[0], rtol=1e-12)


# --- derivatives -----------------------------------------------------------------------------------------

PARAMETERS = {
    "angle": jnp.array(0.0),
    "axis": jnp.zeros(3),
    "about": jnp.zeros(3),
    "samples": jnp.zeros(2),
    "record": jnp.zeros(3),
    "thickness": jnp.array(0.0),
}


FLAT = rectangle(0.6, 0.3, [2, 1])
ROOT, FAR = FLAT.nodes_where(lambda x: x[0] < 1e-9), FLAT.nearest_node([0.6, 0.3, 0.0])


def driven_strip(p):
    """A hub that turns from the start, and a far node that is shaken."""
    history = js.History([0.0, 0.02, 0.05], jnp.concatenate([jnp.zeros(1), jnp.array([0.3, 1.0]) + p["samples"]]))
    turn = js.Support(
        ROOT,
        rotation=jnp.array([0.2, 0.1, 0.9]) + p["axis"],
        angle=0.3 * (1 + p["angle"]),
        about=jnp.array([-0.1, 0.1, 0.05]) + p["about"],
        history=history,
    )
    record = js.History([0.0, 0.02, 0.04], jnp.array([100.0, -150.0, 50.0]) * (1 + p["record"]))
    section = js.Section(0.02 * (1 + p["thickness"]), 1e6, 0.3, 1000.0)
    return js.Scene(FLAT, section, [turn, js.Support([FAR], "uz", acceleration=1.0, history=record)])


def measure(made):
    rng = np.random.default_rng(1)
    shape = made.displacements.shape[1:]
    terms = [
        jnp.sum(jnp.asarray(rng.standard_normal(shape)) * made.displacements[-1]),
        jnp.sum(jnp.asarray(rng.standard_normal((*shape, 3))) * made.rotations[-1]),
        0.1 * jnp.sum(jnp.asarray(rng.standard_normal(shape)) * made.velocities[-1]),
        jnp.mean(made.energy.kinetic + 2 * made.energy.strain + 3 * made.energy.external_work),
    ]
    return sum(terms)


@pytest.mark.parametrize(
    "method", [js.EnergyMomentum(), pytest.param(js.Newmark(), marks=pytest.mark.evidence)], ids=["exact", "Newmark"]
)
def test_derivatives_by_the_drive(method):
    """Adjoint against forward mode, and against differences; and a batch of angles in one program."""
    tight = js.Newton(tolerance=1e-13)

    def value(p):
        return measure(js.simulate(driven_strip(p), method, dt=np.full(5, 0.01), newton=tight, throw=False))

    check_derivatives(
        jax.jit(jax.value_and_grad(value)), jax.jit(lambda p, d: jax.jvp(value, (p,), (d,))[1]), PARAMETERS
    )
    angles = jnp.array([-0.2, 0.0, 0.3])
    batch = jax.jit(jax.vmap(lambda angle: value(PARAMETERS | {"angle": angle})))(angles)
    single = [
        measure(js.simulate(driven_strip(PARAMETERS | {"angle": a}), method, dt=np.full(5, 0.01), newton=tight))
        for a in angles
    ]
    np.testing.assert_allclose(batch, single, rtol=1e-9)


def test_derivatives_of_statics_by_the_drive():
    def value(p):
        static = js.solve_static(driven_strip(p), jnp.array([0.5, 1.0]), throw=False)
        return jnp.sum(jnp.asarray(np.random.default_rng(2).standard_normal((6, 3))) * static.displacements[-1]) + (
            0.1 * static.energy.external_work[-1]
        )

    p = {name: value for name, value in PARAMETERS.items() if name not in ("record", "samples")}
    p = p | {"thickness": jnp.array(0.0)}

    def filled(p):
        # The thickness changes the value by 1e-6 of it: by ten times as much of it, or differences are round-off.
        return value(PARAMETERS | p | {"thickness": 10.0 * p["thickness"]})

    check_derivatives(jax.jit(jax.value_and_grad(filled)), jax.jit(lambda p, d: jax.jvp(filled, (p,), (d,))[1]), p)


@pytest.mark.evidence
def test_a_driven_run_goes_on():
    whole, before = run(blade(), t_end=1.0), run(blade(), t_end=0.8)
    rest = run(blade(), t_end=0.2, restart=before)
    np.testing.assert_array_equal(rest.displacements, np.asarray(whole.displacements)[40:])
    np.testing.assert_array_equal(rest.energy.external_work, np.asarray(whole.energy.external_work)[40:])
