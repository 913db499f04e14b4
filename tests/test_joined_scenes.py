"""The blade that its hub spins up, and the panel that unfolds: against theory, and with their balances."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import hankel
from test_spinning import DENSITY, LENGTH, UNIT, YOUNG, theory

import jaxshell as js
from jaxshell.scenes import spun_blade, unfolding_panel
from jaxshell.scenes.joined import HUB_RADIUS

DIVISIONS, SPEED, SPIN_UP, DT = (16, 2), 60.0, 0.3, 5e-4


# --- the blade ---------------------------------------------------------------------------------------------


def test_what_the_scenes_state():
    blade = spun_blade((2, 2))
    nodes = np.asarray(blade.mesh.nodes)
    assert nodes[blade.watch[0][1]] == pytest.approx([HUB_RADIUS + LENGTH, 0.0, 0.0])
    assert blade.connectors[0].nodes.array.tolist() == [0, 1, 2] and nodes[:3, 0] == pytest.approx(HUB_RADIUS)
    (hub,) = blade.supports
    turned = hub.angle * hub.history(jnp.array([0.0, SPIN_UP, 2 * SPIN_UP]))
    np.testing.assert_allclose(turned, [0.0, 0.5 * SPEED * SPIN_UP, 1.5 * SPEED * SPIN_UP], rtol=1e-12)
    assert isinstance(spun_blade((2, 2), turning_axes=True).loads[0], js.Centrifugal)
    with pytest.raises(ValueError, match="must be even, so that there is a node amid the tip, but it is 3"):
        spun_blade((2, 3))
    panel = unfolding_panel((2, 1))
    n = (panel.mesh.n_nodes - 3) // 3
    places = np.asarray(panel.mesh.nodes)[: 3 * n] + np.asarray(panel.initial.displacements)[: 3 * n]
    # Folded, the lines lie at two heights, and hinges join nodes in one place.
    assert np.ptp(places, axis=0) == pytest.approx(
        [3 * 0.8 * np.cos(np.radians(85)), 0.6, 0.8 * np.sin(np.radians(85))]
    )
    hinges = panel.connectors[1]
    a, b = (np.r_[places, np.asarray(panel.mesh.nodes)[3 * n :]][end.array] for end in (hinges.a, hinges.b))
    np.testing.assert_allclose(a, b, atol=1e-12)
    (support,) = unfolding_panel((2, 1), held=True).supports
    assert support.nodes.array.tolist() == panel.mesh.node_set("satellite").tolist() == [3 * n + 2]


@pytest.fixture(scope="module")
def linearised():
    """{speed: its first three angular frequencies about the spinning state}."""
    found = {}
    for speed in (30.0, SPEED, 90.0, 120.0):
        scene = spun_blade(DIVISIONS, speed, turning_axes=True)
        modes = js.natural_frequencies(scene, 3, about=js.solve_static(scene, [1.0]))
        found[speed] = 2 * np.pi * np.asarray(modes.frequencies)
    return found


@pytest.mark.slow
def test_the_first_three_frequencies_are_those_of_a_beam_that_spins(linearised):
    """Flapping, lead and lag, and flapping once more, on a hub, at four speeds."""
    for speed, found in linearised.items():
        (first, second, _), (lag, _, _) = (theory(speed / UNIT, HUB_RADIUS, aspect) for aspect in (None, 5.0))
        expected = UNIT * np.array([first, lag, second])
        print(f"{speed} rad/s: {found.round(2)}, theory {expected.round(2)}")
        np.testing.assert_allclose(found, expected, rtol=1e-2)


@pytest.fixture(scope="module")
def spun():
    """The blade with a kick and without one; one program."""
    options = {"dt": DT, "t_end": 0.45, "newton": js.Newton(tolerance=1e-12), "reactions": True}
    kicks = (0.0, 100.0)
    return [js.simulate(spun_blade(DIVISIONS, SPEED, SPIN_UP, kick), js.EnergyMomentum(), **options) for kick in kicks]


def in_turning_axes(run) -> np.ndarray:
    """(f, 2) the middle of the tip along the hub's arm and across it, in its plane."""
    scene, times = run.scene, np.asarray(run.times)
    at = np.asarray(scene.mesh.nodes)[scene.watch[0][1], :2] + np.stack([run.watched["tip x"], run.watched["tip y"]], 1)
    (hub,) = scene.supports
    angle = np.asarray(hub.angle * hub.history(times))
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * at[:, 0] + s * at[:, 1], c * at[:, 1] - s * at[:, 0]], axis=1)


def oscillations(signal: np.ndarray, count: int) -> np.ndarray:
    """The `count` lowest angular frequencies of what is a hundredth of a signal or more, by the matrix pencil."""
    samples = hankel(signal[: len(signal) // 2], signal[len(signal) // 2 - 1 :])
    vectors, sizes, _ = np.linalg.svd(samples)
    kept = vectors[:, sizes > 1e-2 * sizes[0]]
    poles = np.linalg.eigvals(np.linalg.pinv(kept[:-1]) @ kept[1:])
    assert np.abs(np.abs(poles) - 1.0).max() < 1e-4  # nothing damps it
    found = np.sort(np.angle(poles)) / DT
    return found[found > 10.0][:count]


@pytest.mark.slow
def test_the_spun_blade_stretches_as_theory_says(spun):
    """ρΩ²/E (½(R² L - (R³ - r³)/3)) for a bar from r to R = r + L, in the steady state."""
    stretch = in_turning_axes(spun[0])[spun[0].times > SPIN_UP, 0] - HUB_RADIUS - LENGTH
    outer = HUB_RADIUS + LENGTH
    exact = 0.5 * DENSITY * SPEED**2 / YOUNG * (outer**2 * LENGTH - (outer**3 - HUB_RADIUS**3) / 3)
    print(f"stretch {stretch.mean():.4e}, theory {exact:.4e}")
    assert stretch.mean() == pytest.approx(exact, rel=1e-2)


@pytest.mark.slow
def test_the_spun_blade_vibrates_with_the_linearised_frequencies(spun, linearised):
    """After the kick it flaps, and from the spin-up it leads and lags: against the same mesh in turning axes."""
    free = np.asarray(spun[0].times) > SPIN_UP + 6e-3
    flaps = oscillations(np.asarray(spun[1].watched["flap"])[free], 2)
    across = in_turning_axes(spun[0])[free, 1]
    lags = oscillations(across - across.mean(), 1)
    print(f"flap {flaps.round(2)}, lag {lags.round(2)}; linearised {linearised[SPEED].round(2)}")
    np.testing.assert_allclose([flaps[0], lags[0], flaps[1]], linearised[SPEED], rtol=1e-2)


@pytest.mark.slow
def test_the_torque_of_the_drive_is_what_the_blade_gains(spun):
    """To the energy's round-off, which 70 GPa make large beside what a blade of 1.35 kg has of it."""
    for run in spun:
        torque = np.asarray(js.reactions(run))[1:, run.scene.connectors[0].master, 5]
        momentum = np.asarray(run.momentum.angular)[:, 2]
        gained = momentum[1:] - momentum[0]
        np.testing.assert_allclose(DT * np.cumsum(torque), gained, atol=1e-9 * gained.max())
        energy = run.energy
        left = energy.total - energy.external_work
        assert np.abs(left).max() < 1e-10 * np.asarray(energy.total).max()


# --- the panel ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def unfolded():
    scene = unfolding_panel((2, 1))
    newton = js.Newton(tolerance=1e-12)
    return js.simulate(scene, js.EnergyMomentum(), dt=5e-3, t_end=4.0, save_every=5, newton=newton)


@pytest.mark.slow
def test_the_panel_unfolds_and_keeps_its_balances(unfolded):
    energy, scene = unfolded.energy, unfolded.scene
    left = energy.total + energy.dissipated - energy.external_work
    changed = np.abs(left - left[0]).max() / float(energy.total.max())
    # At rest at the start: momenta are measured by what the panel alone has of them.
    moving = 2.0 * float(energy.kinetic.max()) * 3 * 0.8 * 0.6 * 3.0
    linear = np.abs(unfolded.momentum.linear).max() / np.sqrt(moving)
    angular = np.abs(unfolded.momentum.angular).max() / (2.4 * np.sqrt(moving))
    print(f"energy {changed:.1e}, momenta {linear:.1e}, {angular:.1e}")
    assert max(changed, linear, angular) < 1e-12
    hinges = scene.connectors[1]
    x = np.asarray(scene.mesh.nodes) + np.asarray(unfolded.displacements)
    assert np.abs(x[:, hinges.a.array] - x[:, hinges.b.array]).max() < 1e-12
    # Deployed: in one row, as stiff as the stops are, and the springs have done their work.
    R, n = np.asarray(unfolded.rotations[-1]), (scene.mesh.n_nodes - 3) // 3
    along = R[[0, n, 2 * n]] @ np.array([1.0, 0.0, 0.0])
    assert np.degrees(np.arccos(np.clip(along[1:] @ R[-1, :, 0], -1.0, 1.0))).max() < 1.0
    assert float(energy.kinetic[-1]) < 1e-3 * float(energy.kinetic.max())


@pytest.mark.slow
@pytest.mark.evidence
def test_gradients_by_the_hinges():
    def tip(stiffness, damping):
        made = unfolding_panel((1, 1), stiffness, damping)
        run = js.simulate(made, js.EnergyMomentum(), dt=5e-3, t_end=0.1, newton=js.Newton(tolerance=1e-12))
        return jnp.sum(run.watched["tip x"]) + jnp.sum(run.watched["tip z"] ** 2)

    at = (jnp.array(4.0), jnp.array(3.0))
    backward = jax.grad(tip, argnums=(0, 1))(*at)
    push = jax.jit(lambda along: jax.jvp(tip, at, along)[1])
    for k in range(2):
        forward = push(tuple(jnp.array(float(k == i)) for i in range(2)))
        np.testing.assert_allclose(backward[k], forward, rtol=1e-10)
