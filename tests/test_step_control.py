"""Step control: landing, accuracy per step, halving on failure, the estimate itself."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxshell as js
from jaxshell.analyses.step_control import StepControl, local_error


def cap(force=-27.8, times=(0.0, 1e-6, 1.0), values=(0.0, 1.0, 1.0)) -> js.Scene:
    """A coarse cap under a force on its apex: one program for every history of three samples."""
    plain = js.scenes.spherical_cap(divisions=3)
    load = js.NodalForce([0], [0.0, 0.0, force], js.History(times, values))
    return js.Scene(plain.mesh, plain.section, plain.supports, [load], watch={"apex": (0, "uz")})


def test_the_estimate_is_the_mid_point_rules_local_error():
    """r(t) = t² moves a node by t³/3; Δt times the mean of the end velocities misses it by -Δt³ r''/12."""
    ends = np.array([1.7, 1.4, 1.2, 1.1])  # newest first
    means = [(a**3 - b**3) / 3 / (a - b) for a, b in zip(ends[:-1], ends[1:], strict=True)]
    rates = jnp.asarray(means)[:, None, None] * jnp.asarray([1.0, 0.0, 0.0])
    dt, before = 0.3, jnp.asarray([0.2, 0.1])
    found = float(local_error(rates, dt, before))
    trapezoid = dt * (ends[0] ** 2 + ends[1] ** 2) / 2 - (ends[0] ** 3 - ends[1] ** 3) / 3
    assert found == pytest.approx(abs(trapezoid), rel=0.05)


@pytest.mark.parametrize(
    "method", [js.EnergyMomentum(), pytest.param(js.GeneralizedEnergyMomentum(), marks=pytest.mark.slow)]
)
def test_steps_land_on_output_times_and_kinks(method):
    scene = cap(-5.0, [0.0, 1.3e-5, 3.1e-5], [0.0, 1.0, 0.5])
    control = StepControl(1e-4, 1e-6, output_interval=1e-5)
    solution = js.simulate(scene, method, dt=control, t_end=4.5e-5)
    np.testing.assert_allclose(solution.frame_times, [0.0, 1e-5, 2e-5, 3e-5, 4e-5, 4.5e-5], rtol=1e-12)
    times = np.asarray(solution.times)
    for kink in (1.3e-5, 3.1e-5):
        assert np.min(np.abs(times - kink)) < 1e-18
    assert np.all(np.diff(times) > 0)
    assert solution.stats["accepted"] == times.size - 1 == solution.stats["steps"]
    assert solution.stats["rejected"] >= 0


@pytest.mark.slow
def test_a_tighter_tolerance_is_more_accurate_and_takes_more_steps():
    scene = cap(-20.0, [0.0, 1e-4, 1.0])
    exact = js.simulate(scene, js.EnergyMomentum(), dt=2.5e-7, t_end=1.5e-4)
    errors, steps = [], []
    for tolerance in (1e-5, 1e-7):
        control = StepControl(tolerance, 1e-6, output_interval=1.5e-4)
        solution = js.simulate(scene, js.EnergyMomentum(), dt=control, t_end=1.5e-4)
        there = np.interp(solution.times, exact.times, exact.watched["apex"])
        errors.append(np.max(np.abs(there - solution.watched["apex"])) / np.max(np.abs(there)))
        steps.append(solution.stats["steps"])
    assert errors[1] < 0.5 * errors[0]
    assert steps[1] > steps[0]


@pytest.mark.slow
def test_later_steps_may_err_more_unless_the_horizon_is_far():
    """The same runs at first; towards the end, where errors have little time to act, steps of up to 10^(1/3) times."""
    scene, sizes = cap(-20.0, [0.0, 2e-4, 1.0]), {}
    for horizon in (None, float("inf")):
        control = StepControl(1e-6, 1e-6, output_interval=1.5e-4, horizon=horizon)
        run = js.simulate(scene, js.EnergyMomentum(), dt=control, t_end=1.5e-4)
        sizes[horizon] = np.interp([1e-5, 1.4e-4], np.asarray(run.times)[1:], np.asarray(run.step_sizes))
    first, late = sizes[None] / sizes[float("inf")]
    assert first == pytest.approx(1.0, abs=0.1)
    assert 1.3 < late < 10 ** (1 / 3) * 1.4


def test_a_run_that_goes_on_after_the_horizon_has_the_late_tolerance():
    """Ten times the first, as the docstring of `StepControl` says, in all of its steps."""
    scene = cap(-20.0, [0.0, 2e-4, 1.0])
    control = StepControl(1e-6, 1e-6, output_interval=3e-5)
    start = js.simulate(scene, js.EnergyMomentum(), dt=control, t_end=3e-5)
    after, even = (
        js.simulate(
            scene,
            js.EnergyMomentum(),
            dt=StepControl(tolerance, 1e-6, output_interval=3e-5, horizon=horizon),
            t_end=3e-5,
            restart=start,
        )
        for tolerance, horizon in ((1e-6, 1e-5), (1e-5, float("inf")))
    )
    np.testing.assert_allclose(after.step_sizes, even.step_sizes, rtol=1e-9)


def test_a_step_on_which_newton_fails_is_halved():
    """Two corrections are enough for small steps only: a step of 2e-6 fails, and must not be halved at first."""
    scene, newton = cap(times=[-1.0, 0.0, 1.0], values=[1.0, 1.0, 1.0]), js.Newton(max_iterations=2, reuse=False)
    control = StepControl(1e-1, 2e-6, smallest=2e-6, output_interval=2e-5)
    with pytest.raises(js.SimulationError):
        js.simulate(scene, js.EnergyMomentum(), dt=control, t_end=2e-5, newton=newton)
    control = StepControl(1e-1, 2e-6, output_interval=2e-5)
    solution = js.simulate(scene, js.EnergyMomentum(), dt=control, t_end=2e-5, newton=newton)
    assert solution.stats["rejected"] > 0
    assert solution.result == js.RESULTS.successful


def test_the_smallest_step_ends_the_run_and_keeps_what_was_done():
    control = StepControl(1e-12, 1e-6, smallest=9e-7)
    solution = js.simulate(cap(), js.EnergyMomentum(), dt=control, t_end=4e-5, throw=False)
    assert solution.result == js.RESULTS.step_too_small
    assert "smallest" in solution.message and solution.times.size >= 1


@pytest.mark.slow
def test_frozen_steps_repeat_the_run():
    control = StepControl(1e-4, 1e-6, output_interval=1e-5)
    first = js.simulate(cap(), js.EnergyMomentum(), dt=control, t_end=3e-5)
    again = js.simulate(cap(), js.EnergyMomentum(), dt=np.asarray(first.step_sizes))
    np.testing.assert_allclose(again.watched["apex"], first.watched["apex"], rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"tolerance": 0.0, "initial": 1.0}, "tolerance must be positive, but it is 0.0"),
        ({"tolerance": 1e-3, "initial": -1.0}, "initial must be positive, but it is -1.0"),
        ({"tolerance": 1e-3, "initial": 1.0, "smallest": 2.0}, "smallest <= initial"),
        ({"tolerance": 1e-3, "initial": 1.0, "output_interval": 0.0}, "output_interval must be positive"),
        ({"tolerance": 1e-3, "initial": 1.0, "horizon": -2.0}, "horizon must be positive, but it is -2.0"),
    ],
)
def test_bad_numbers_are_named(arguments, match):
    with pytest.raises(ValueError, match=match):
        StepControl(**arguments)


def test_central_differences_say_before_compilation_why_not():
    """Their step is limited by stability, and their state holds no rates of the last steps."""
    with pytest.raises(ValueError, match=r"CentralDifference takes equal steps.*critical_step"):
        js.simulate(cap(), js.CentralDifference(), dt=StepControl(1e-4, 1e-9), t_end=1e-6)
