"""The scenes that are dropped, bent and shaken: what they state, their balances, and the closed forms beside them."""

import dataclasses
from pathlib import Path

import jax
import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.signal import lsim

import jaxshell as js
from jaxshell import scenes
from jaxshell.command.report import describe_scene
from jaxshell.command.run_settings import chosen_methods, with_defaults
from jaxshell.files.run_keys import RunSettings
from jaxshell.files.scene_file import read_scene_file

TIGHT = js.Newton(tolerance=1e-13)
SHAKEN = Path(__file__).parents[1] / "examples" / "shaken_plate.toml"


def left(run) -> float:
    """The largest change of energy that work and dissipation do not explain, over the largest energy."""
    energy = run.energy
    kept = np.asarray(energy.total - energy.external_work + energy.dissipated)
    return float(np.abs(kept - kept[0]).max() / np.asarray(energy.total).max())


def test_what_they_state():
    tray = scenes.dropped_tray((2, 2))
    nodes = np.asarray(tray.mesh.nodes)
    assert tray.mesh.n_elements == 32 and nodes[:, 2].min() == pytest.approx(2.5e-3)
    # Bottom 0.4 × 0.28, and four sides √(15² + 25²) mm wide that are mitred at the corners.
    area = 0.4 * 0.28 + np.hypot(0.015, 0.025) * (0.4 + 0.28 + 0.03) * 2
    assert float(js.mass_properties(tray).mass) == pytest.approx(2.7 * area, rel=1e-12)
    assert float(tray.initial.velocities[0, 2]) == pytest.approx(-np.sqrt(2 * 9.81))
    tape = scenes.tape_spring((4, 2))
    crown, edge = (np.asarray(tape.mesh.nodes)[number] for _, number, _ in tape.watch[:2])
    assert crown[0] == edge[0] == 0.06 and crown[2] - edge[2] == pytest.approx(0.015 * (1 - np.cos(np.radians(40))))
    assert [tape.mesh.node_sets[name].tolist() for name in ("left", "right")] == [[15], [16]]
    assert float(tape.supports[0].angle) == pytest.approx(np.pi / 3) and tape.name == "tape_spring"
    assert "loose" not in describe_scene(tape)  # references of bodies are no parts that were forgotten
    released = scenes.tape_spring((4, 2), folded=js.Initial(displacements=np.zeros((17, 3))))
    assert not any(support.moves for support in released.supports) and len(released.held_dofs) == 6
    for divisions in ((3, 2), (4, 3)):
        with pytest.raises(ValueError, match="even"):
            scenes.tape_spring(divisions)
    with pytest.raises(ValueError, match="height"):
        scenes.dropped_tray(height=-1.0)
    with pytest.raises(ValueError, match="tip_mass"):
        scenes.shaken_plate(tip_mass=0.0)


def test_a_scene_may_name_its_method():
    tray = scenes.dropped_tray((2, 2))
    assert list(chosen_methods(with_defaults(RunSettings(), tray, "time"), tray)) == ["exact"]
    asked = RunSettings.checked({"method": "EMC"})
    assert list(chosen_methods(with_defaults(asked, tray, "time"), tray)) == ["EMC"]
    with pytest.raises(ValueError, match="method must be a tuple"):
        dataclasses.replace(tray, defaults=tray.defaults._replace(method="exact"))


def test_the_scene_file_states_the_shaken_plate():
    scene, run = read_scene_file(SHAKEN)
    made = scenes.shaken_plate()
    assert jax.tree.structure(scene) == jax.tree.structure(dataclasses.replace(made, defaults=scene.defaults))
    for found, wanted in zip(jax.tree.leaves(scene), jax.tree.leaves(made), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-15)
    assert run.t_end == made.defaults.t_end and run.dt == made.defaults.dt


# --- the tray --------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def drop():
    scene = scenes.dropped_tray((2, 2))
    return js.simulate(scene, js.EnergyMomentum(), dt=2e-4, t_end=0.06, save_every=10, newton=TIGHT)


@pytest.mark.slow
def test_the_tray_keeps_its_energy_through_the_bounces(drop):
    force = np.asarray(drop.watched["fz"])
    assert np.sum(np.diff((force > 0).astype(int)) == 1) >= 5
    depth = np.asarray(drop.watched["depth"]).max()
    print(f"energy {left(drop):.1e}, depth {depth / 1e-3:.1%} of the thickness")
    assert left(drop) < 1e-10
    assert 0 < depth < 0.2e-3  # of a sheet of 1 mm, on cells of 20 cm


@pytest.mark.slow
def test_the_tray_gains_the_impulses_of_the_floor(drop):
    mass = float(js.mass_properties(drop.scene).mass)
    forces = np.stack([np.asarray(drop.watched[f"f{axis}"]) for axis in "xyz"], axis=1)
    impulse = np.cumsum(forces * np.diff(drop.times, prepend=0.0)[:, None], axis=0)
    weight = np.asarray(drop.times)[:, None] * mass * np.array([0.0, 0.0, -9.81])
    linear = np.asarray(drop.momentum.linear)
    np.testing.assert_allclose(linear - linear[0], impulse + weight, atol=1e-10 * np.abs(linear).max())
    assert linear[-1, 2] > 0 > linear[0, 2]


# --- the tape --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_tape_is_bent_through_its_snap_with_the_work_of_its_hubs():
    """A mesh that is too coarse for the moment of the fold: examples/tape_spring.py has that, and the release."""
    bent = js.simulate(scenes.tape_spring((16, 4)), js.EnergyMomentum(), dt=1e-3, t_end=0.2, newton=TIGHT)
    assert left(bent) < 1e-10 and bent.energy.dissipated[-1] > 0
    crown, edge = (np.asarray(bent.watched[name]) for name in ("crown", "edge"))
    assert (crown - edge)[-1] < -0.002  # flat, of a rise of 3.5 mm
    turned = np.asarray(bent.rotations)[-1, -2:, 0, 2]
    assert turned == pytest.approx([np.sin(np.pi / 3), -np.sin(np.pi / 3)])


# --- the plate -------------------------------------------------------------------------------------------

LENGTH, MASS_PER_LENGTH, STIFFNESS = 0.3, 2700.0 * 0.02 * 0.002, 70e9 * 0.02 * 0.002**3 / 12


def relative_motion_of_theory(times, acceleration, tip_mass, beta):
    """Of the tip against the base: the first mode of a beam with a mass at its end, by Duhamel's integral.

    1 + cos b cosh b + μ b (cos b sinh b - sin b cosh b) = 0 with μ = M/(ρA L), ω = (b/L)² √(EI/ρA), ζ = βω/2,
    q̈ + 2ζω q̇ + ω² q = -Γ a, and the participation Γ of the mode that is 1 at the tip.
    """
    mu = tip_mass / (MASS_PER_LENGTH * LENGTH)
    b = brentq(
        lambda b: 1 + np.cos(b) * np.cosh(b) + mu * b * (np.cos(b) * np.sinh(b) - np.sin(b) * np.cosh(b)), 0.3, 1.87
    )
    omega = (b / LENGTH) ** 2 * np.sqrt(STIFFNESS / MASS_PER_LENGTH)
    x = np.linspace(0.0, b, 2001)
    phi = np.cosh(x) - np.cos(x) - (np.cos(b) + np.cosh(b)) / (np.sin(b) + np.sinh(b)) * (np.sinh(x) - np.sin(x))
    phi /= phi[-1]
    gamma = (np.trapezoid(phi, x / b) + mu) / (np.trapezoid(phi**2, x / b) + mu)
    return lsim(([-gamma], [1.0, beta * omega**2, omega**2]), acceleration, times)[1]  # exact between the samples


@pytest.mark.slow
def test_the_shaken_plate_moves_as_the_oscillator_of_theory():
    """Whole histories with ν = 0, as a beam; with ν = 0.3 the clamped edge stiffens the plate by 0.6 % in frequency."""
    scene = scenes.shaken_plate()
    beam = dataclasses.replace(scene, section=js.Section(0.002, 70e9, 0.0, 2700.0))
    for shaken, of_history, of_peak in ((beam, 0.01, 0.01), (scene, None, 0.02)):
        # Corrections with kept factors end where rounding does, which on some processors leaves 1e-10 of the energy.
        newton = js.Newton(tolerance=1e-13, reuse=False)
        run = js.simulate(shaken, js.EnergyMomentum(), dt=1e-3, t_end=0.4, save_every=100, newton=newton)
        found = np.asarray(run.watched["tip"] - run.watched["base"])
        base = 20.0 * np.asarray(scene.supports[0].history(run.times))
        theory = relative_motion_of_theory(np.asarray(run.times), base, 0.02, 5e-4)
        peak = np.abs(theory).max()
        print(f"peak {np.abs(found).max() / peak - 1:+.2%}, history {np.abs(found - theory).max() / peak:.2%}")
        assert np.abs(found).max() == pytest.approx(peak, rel=of_peak)
        assert of_history is None or np.abs(found - theory).max() < of_history * peak
        assert left(run) < 1e-11
