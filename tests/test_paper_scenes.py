"""The scenes of Yang & Xia 2014, section VI, their first parts; `test_paper_scenes_slow.py` runs them to the end.

`pytest -n 0 -s -m "slow or not slow" tests/test_paper_scenes*.py` prints every figure. Reference values:
issue figures of two independent trial codes of the paper's method, and Kratos Multiphysics 10.4.4 (tests/data).
"""

from pathlib import Path

import numpy as np
import pytest

import jaxshell as js

DATA = Path(__file__).parent / "data"
EMC = js.GeneralizedEnergyMomentum(initial_acceleration="zero")
CAP_HEIGHT = 0.002182  # H, section VI.A


def peak(times, values) -> tuple[float, float]:
    """(time, value) of the largest of the samples, from the parabola through it and its neighbours."""
    i = int(np.argmax(values))
    a, b, c = values[i - 1 : i + 2]
    shift = 0.5 * (a - c) / (a - 2 * b + c)
    return times[i] + shift * (times[1] - times[0]), b - 0.25 * (a - c) * shift


def impulse(scene: js.Scene) -> np.ndarray:
    """Time integral of the resultant of all loads, (3,)."""
    total = np.zeros(3)
    for load in scene.loads:
        pattern = np.asarray(load.nodal(scene.mesh.nodes, scene.mesh.triangles, None))
        total += pattern[:, :3].sum(axis=0) * np.trapezoid(load.history.values, load.history.times)
    return total


def drift(values) -> float:
    """Largest distance from the first value, over the largest size."""
    values = np.asarray(values).reshape(len(values), -1)
    return np.linalg.norm(values - values[0], axis=1).max() / np.linalg.norm(values, axis=1).max()


@pytest.fixture(scope="module")
def cap():
    """The clamped cap to 250 µs with the paper's step, 2 µs."""
    return js.simulate(js.scenes.spherical_cap(), EMC, dt=2e-6, t_end=2.5e-4)


def test_cap_deflection(cap):
    w = -np.asarray(cap.watched["apex"]) / CAP_HEIGHT
    found = w[[25, 50, 75, 100, 125]]
    print("cap, w/H at 50, 100, ..., 250 µs:", np.round(found, 4))
    np.testing.assert_allclose(found, [1.184, 2.252, 1.949, 0.848, 0.584], atol=0.01)


def test_cap_first_swing(cap):
    time, top = peak(np.asarray(cap.times), -np.asarray(cap.watched["apex"]) / CAP_HEIGHT)
    print(f"cap, first swing: w/H = {top:.4f} at {1e6 * time:.1f} µs")
    assert top == pytest.approx(2.460, abs=0.003)
    assert time == pytest.approx(126e-6, abs=2e-6)


def test_cap_beside_kratos(cap):
    """Another β0 and scheme: within 3 % of the peak."""
    times, w, _ = np.loadtxt(DATA / "kratos_cap_newmark.csv", delimiter=",", skiprows=1).T
    apart = np.abs(np.interp(times, cap.times, cap.watched["apex"]) - w).max() / np.abs(w).max()
    print(f"cap, largest distance from Kratos: {apart:.4f} of the peak")
    assert apart < 0.03


def test_cap_energy_is_the_work_of_the_load(cap):
    energy, work = np.asarray(cap.energy.total), np.asarray(cap.energy.external_work)
    error = np.abs(energy - work).max() / energy.max()
    print(f"cap, EMC: K + S - W at most {error:.1e} of K + S")
    assert error < 1e-2


@pytest.mark.slow
def test_opened_cap_before_buckling():
    solution = js.simulate(js.scenes.opened_cap(), EMC, dt=0.01, t_end=1.0, save_every=10)
    found = np.asarray(solution.watched["A"])[[50, 100]]
    print("opened cap, w_A at t = 0.5, 1:", np.round(found, 4))
    np.testing.assert_allclose(found, [-0.4960, -2.489], rtol=3e-3)


def test_plate_flies_with_the_impulse():
    """The first tenth of the flight; the loads end at 4 ms."""
    scene = js.scenes.free_plate()
    solution = js.simulate(scene, EMC, dt=5e-5, t_end=0.01, save_every=50)
    free = slice(80, None)
    total = impulse(scene)
    error = np.abs(np.asarray(solution.momentum.linear)[free] - total).max() / np.linalg.norm(total)
    energy, angular = drift(solution.energy.total[free]), drift(solution.momentum.angular[free])
    print(f"plate, EMC to 0.01 s: impulse {error:.1e}, energy {energy:.1e}, angular momentum {angular:.1e}")
    assert error < 1e-10 and energy < 1e-3 and angular < 1e-4
    assert float(solution.energy.strain[free].max()) > 0.01 * float(solution.energy.total[-1])  # it does bend
