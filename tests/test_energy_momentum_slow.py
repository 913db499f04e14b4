"""EnergyMomentum: long evidence. The free plate at steps up to eight times the paper's, 10 000 steps of tumbling,
order on the cap. Each test prints what it measured (pytest -m slow -s)."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_energy_momentum import drift, euler, rigid, run

import jaxshell as js

pytestmark = [pytest.mark.slow, pytest.mark.optimised]
EXACT = js.Newton(tolerance=1e-14, max_iterations=40)
FREE_FROM = 0.004 * (1 + 1e-9)
"""The plate's loads vanish at 4 ms."""


def plate(method, dt, t_end=0.1, newton=EXACT):
    return js.simulate(js.scenes.free_plate(), method, dt=dt, t_end=t_end, save_every=50, newton=newton)


def printed(name, **figures):
    print(f"\n{name}: " + ", ".join(f"{key} {value:.2g}" for key, value in figures.items()))


@pytest.mark.parametrize("dt", [1e-4, 4e-4])
def test_free_plate_conserves(dt):
    """Energy, |L| and |J| to 1e-12 once the loads are gone; energy is their work to 1e-10 (here: 1e-12) before."""
    solution = plate(js.EnergyMomentum(), dt)
    free = int(np.flatnonzero(np.asarray(solution.times) > FREE_FROM)[0])
    energy = np.asarray(solution.energy.total)
    figures = {
        "energy": drift(energy, free),
        "linear": drift(np.linalg.norm(solution.momentum.linear, axis=1), free),
        "angular": drift(np.linalg.norm(solution.momentum.angular, axis=1), free),
        "balance": np.abs(energy - np.asarray(solution.energy.external_work)).max() / energy.max(),
        "iterations per step": solution.stats["iterations"] / solution.stats["steps"],
    }
    printed(f"plate, dt = {dt:g}", **figures)
    assert len(energy) == round(0.1 / dt) + 1
    assert max(figures[key] for key in ("energy", "linear", "angular", "balance")) < 1e-12


@pytest.mark.parametrize("steps", [12, 36, 76, 131])
def test_free_plate_with_few_steps(steps):
    """20 ms in few steps: some start from an iterate whose mixed tangent is all but singular."""
    solution = plate(js.EnergyMomentum(), 0.02 / steps, t_end=0.02, newton=js.Newton())
    energy = np.asarray(solution.energy.total)
    assert solution.result == js.RESULTS.successful
    assert np.abs(energy - np.asarray(solution.energy.external_work)).max() < 1e-7 * energy.max()


@pytest.mark.parametrize("dissipation", [0.02, 0.5])
def test_free_plate_loses_what_is_dissipated(dissipation):
    """The paper's ξ and the largest: the energy falls at every step; with what was removed it is the loads' work."""
    solution = plate(js.EnergyMomentum(dissipation), 5e-5, t_end=0.05)
    free = int(np.flatnonzero(np.asarray(solution.times) > FREE_FROM)[0])
    energy, lost = np.asarray(solution.energy.total), np.asarray(solution.energy.dissipated)
    figures = {
        "balance": np.abs(energy + lost - np.asarray(solution.energy.external_work)).max() / energy.max(),
        "angular": drift(solution.momentum.angular, free),
        "largest rise": np.diff(energy[free:]).max() / energy.max(),
        "lost": lost[-1] / energy.max(),
    }
    printed(f"plate, ξ = {dissipation}", **figures)
    assert max(figures["balance"], figures["angular"]) < 1e-12
    assert figures["largest rise"] < 0
    assert figures["lost"] > 0.01


def test_tumbling_plate_for_ten_thousand_steps():
    """80 turns: energy and J to 1e-12; the orientation follows Euler's equations within the phase error of the step."""
    spin, duration, count = np.array([4.0, 3.0, 12.0]), 40.0, 10_000
    solution = run(rigid(spin), count=count, duration=duration, newton=js.Newton(tolerance=1e-16, max_iterations=8))
    figures = {
        "energy": drift(solution.energy.total),
        "angular": drift(solution.momentum.angular),
        "linear": float(np.abs(solution.momentum.linear).max()),
    }
    printed("tumbling", **figures)
    assert max(figures["energy"], figures["angular"]) < 1e-12
    tenth = euler(spin, duration / 10)
    found = np.asarray(solution.rotations)[np.searchsorted(np.asarray(solution.frame_times), duration / 10 - 1e-9)]
    assert Rotation.from_matrix(found[0] @ tenth.T).magnitude() < 2e-2


def history(scene, method, end, count, samples):
    """A watched displacement at `samples` times that all step sizes share."""
    newton = js.Newton(tolerance=1e-11)
    solution = js.simulate(scene, method, dt=end / count, t_end=end, save_every=50, newton=newton)
    return np.asarray(solution.watched[scene.watch[0][0]])[:: count // samples]


@pytest.mark.parametrize("scene", ["cap", "plate"])
def test_second_order_with_the_limit_of_the_papers_scheme(scene):
    """The cap's apex over its first swing, the plate's corner under its loads: slope 2 ± 0.1, and one limit."""
    made = js.scenes.spherical_cap(divisions=6) if scene == "cap" else js.scenes.free_plate()
    end, counts = (1e-4, (200, 400, 800)) if scene == "cap" else (0.004, (400, 800, 1600))
    exact = [history(made, js.EnergyMomentum(), end, n, counts[0]) for n in counts]
    papers = [history(made, js.GeneralizedEnergyMomentum(), end, n, counts[0]) for n in counts[1:]]
    size = np.linalg.norm(exact[-1])
    first, second = (np.linalg.norm(a - b) / size for a, b in itertools.pairwise(exact))
    limits = [fine + (fine - coarse) / 3.0 for coarse, fine in (exact[1:], papers)]
    apart = np.linalg.norm(limits[0] - limits[1]) / size
    printed(scene, slope=np.log2(first / second), error=second / 3.0, apart=apart)
    assert np.log2(first / second) == pytest.approx(2.0, abs=0.1)
    assert apart < 2e-5
