"""`simulate`: steps and frames, restart, result files, failure, and several ways to the same run."""

import equinox as eqx
import jax
import numpy as np
import pytest

import jaxshell as js
from jaxshell.command.cli import main

DT, STEPS = 1e-5, 100
EMC = js.GeneralizedEnergyMomentum()


def cap(force=111.2, late=1.0) -> js.Scene:
    """A coarse clamped cap under `force` at its apex, multiplied by `late` from 1.1e-4 s on."""
    scene = js.scenes.spherical_cap(divisions=3)
    load = js.NodalForce([0], [0.0, 0.0, -force], js.History([0.0, 1e-4, 1.1e-4], [1.0, 1.0, late]))
    watch = {"apex": (0, "uz"), "apex velocity": (0, "vz")}
    return js.Scene(scene.mesh, scene.section, scene.supports, [load], watch=watch, name="coarse")


@pytest.fixture(scope="module")
def scene():
    return cap()


TIGHT = js.Newton(tolerance=1e-12)
"""What depends on the path of the iterates (a factorization kept or not) is then below what runs are compared to."""


@pytest.fixture(scope="module")
def whole(scene):
    """A hundred steps, a frame of every second."""
    return js.simulate(scene, EMC, dt=DT, t_end=STEPS * DT, save_every=2, newton=TIGHT)


def close(found, expected, tolerance=1e-9):
    scale = np.abs(np.asarray(expected)).max()
    np.testing.assert_allclose(found, expected, atol=tolerance * scale, rtol=0)


def test_histories_at_every_step_and_frames_at_every_second(whole, scene):
    np.testing.assert_allclose(whole.times, DT * np.arange(STEPS + 1), rtol=1e-14)
    np.testing.assert_allclose(whole.frame_times, whole.times[::2], rtol=1e-14)
    n = scene.mesh.n_nodes
    assert whole.displacements.shape == whole.velocities.shape == (STEPS // 2 + 1, n, 3)
    assert whole.rotations.shape == (STEPS // 2 + 1, n, 3, 3)
    np.testing.assert_array_equal(whole.displacements[:, 0, 2], whole.watched["apex"][::2])
    np.testing.assert_array_equal(whole.velocities[:, 0, 2], whole.watched["apex velocity"][::2])
    R = np.asarray(whole.rotations)
    np.testing.assert_allclose(R @ np.swapaxes(R, 2, 3), np.broadcast_to(np.eye(3), R.shape), atol=1e-14)
    assert whole.iterations[0] == 0 and np.all(np.asarray(whole.iterations)[1:] >= 1)
    assert whole.result == js.RESULTS.successful and whole.message == ""
    assert whole.stats["steps"] == STEPS and whole.stats["iterations"] == int(whole.iterations.sum())
    assert np.abs(np.asarray(whole.displacements)).max() > 1e-4  # a quarter of the thickness


@pytest.mark.slow
def test_frames_apart_leave_the_histories_as_they_are(whole, scene):
    """Also where the steps are no multiple of those between frames: the last frame is the end."""
    sparse = js.simulate(scene, EMC, dt=DT, t_end=STEPS * DT, save_every=7, newton=TIGHT)
    np.testing.assert_allclose(sparse.frame_times, DT * np.array([*range(0, STEPS, 7), STEPS]), rtol=1e-14)
    close(sparse.watched["apex"], whole.watched["apex"])
    close(sparse.displacements[-1], whole.displacements[-1])


def test_an_array_of_steps(whole, scene):
    """Half of the steps, then as many of half the size: what the run and a restart with smaller steps give."""
    half = STEPS // 2
    both = js.simulate(scene, EMC, dt=np.repeat([DT, 0.5 * DT], half), save_every=2, newton=TIGHT)
    close(both.watched["apex"][: half + 1], whole.watched["apex"][: half + 1], 1e-12)
    first = js.simulate(scene, EMC, dt=[DT] * half, save_every=2, newton=TIGHT)
    second = js.simulate(scene, EMC, dt=0.5 * DT, t_end=0.5 * half * DT, save_every=2, restart=first, newton=TIGHT)
    np.testing.assert_allclose(both.times[half:], second.times, rtol=1e-12)
    close(both.watched["apex"][half:], second.watched["apex"], 1e-10)


def test_a_duration_that_is_no_multiple_of_the_step_ends_with_a_shorter_one(scene):
    solution = js.simulate(scene, EMC, dt=DT, t_end=79.25 * DT, save_every=2)
    np.testing.assert_allclose(np.diff(solution.times), DT * np.array([1.0] * 79 + [0.25]), rtol=1e-9)


def test_restart_goes_on_as_if_nothing_had_happened(whole, scene, caplog):
    half = STEPS // 2
    first = js.simulate(scene, EMC, dt=DT, t_end=half * DT, save_every=2, newton=TIGHT)
    with jax.log_compiles(), caplog.at_level("WARNING", "jax"):
        second = js.simulate(scene, EMC, dt=DT, t_end=half * DT, save_every=2, restart=first, newton=TIGHT)
        jax.jit(lambda known: known + 1.0)(1.0)
    assert "jit(<lambda>)" in caplog.text and "jit(run)" not in caplog.text  # which the first compiled
    np.testing.assert_allclose(second.times, whole.times[half:], rtol=1e-13)
    close(second.watched["apex"], whole.watched["apex"][half:], 1e-10)
    close(second.energy.total, whole.energy.total[half:], 1e-10)
    close(second.energy.external_work, whole.energy.external_work[half:], 1e-10)
    close(second.displacements[-1], whole.displacements[-1], 1e-10)


@pytest.mark.slow
def test_autodiff_and_closed_form_give_the_same_run(scene):
    """At the default tolerance: near round-off the number of corrections is chance."""
    closed_form, autodiff = (
        js.simulate(scene, EMC, dt=DT, t_end=STEPS * DT, save_every=2, tangent=tangent)
        for tangent in ("closed_form", "autodiff")
    )
    np.testing.assert_array_equal(autodiff.iterations, closed_form.iterations)
    close(autodiff.displacements, closed_form.displacements, 1e-10)
    close(autodiff.energy.total, closed_form.energy.total, 1e-10)


@pytest.mark.parametrize("solver", [pytest.param(js.Dense(), marks=pytest.mark.slow), js.KLU()], ids=["dense", "klu"])
def test_linear_solvers_give_the_same_run(solver, whole, scene):
    solution = js.simulate(scene, EMC, dt=DT, t_end=STEPS * DT, save_every=2, linear_solver=solver, newton=TIGHT)
    close(solution.displacements, whole.displacements)


@pytest.mark.slow
def test_the_papers_criterion(whole, scene):
    """‖ΔQ‖ ≤ 1e-6, eq. (100): the same run within what that leaves."""
    paper = js.Newton(tolerance=1e-6, criterion="norm")
    solution = js.simulate(scene, EMC, dt=DT, t_end=STEPS * DT, save_every=2, newton=paper)
    close(solution.watched["apex"], whole.watched["apex"], 1e-5)


def test_kept_factorizations_give_the_same_run_and_are_fewer(whole, scene):
    """At the same tolerance nearer to the converged run than full iterations, for fewer factorizations."""
    kept, full = (
        js.simulate(scene, EMC, dt=DT, t_end=STEPS * DT, save_every=2, newton=js.Newton(reuse=reuse))
        for reuse in (True, False)
    )
    close(kept.displacements, whole.displacements, 1e-7)
    close(full.displacements, whole.displacements, 1e-5)
    assert full.stats["factorizations"] == full.stats["iterations"]
    assert kept.stats["factorizations"] < 0.7 * full.stats["factorizations"]


def test_results_go_to_disk_as_they_come(whole, scene, tmp_path):
    path = tmp_path / "cap.h5"
    returned = js.simulate(scene, EMC, dt=DT, t_end=STEPS * DT, save_every=2, output=path, newton=TIGHT)
    loaded = js.Solution.load(path)
    for name in ("times", "iterations", "frame_times", "displacements", "velocities"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(returned, name), err_msg=name)
    np.testing.assert_allclose(loaded.rotations, returned.rotations, atol=1e-14)  # kept as quaternions
    np.testing.assert_array_equal(loaded.watched["apex"], whole.watched["apex"])
    np.testing.assert_array_equal(loaded.energy.total, whole.energy.total)
    assert loaded.result == js.RESULTS.successful and loaded.scene.name == scene.name
    # The file keeps the method's state; another method cannot go on with it.
    ahead, behind = (js.simulate(scene, EMC, dt=DT, t_end=4 * DT, newton=TIGHT, restart=r) for r in (returned, loaded))
    np.testing.assert_array_equal(ahead.displacements, behind.displacements)
    loaded.save(tmp_path / "again.h5")
    again = js.Solution.load(tmp_path / "again.h5").state
    assert all(np.array_equal(again[name], array) for name, array in loaded.state.items())
    with pytest.raises(ValueError, match=r"restart must be a solution .* with its final state"):
        js.simulate(scene, js.EnergyMomentum(), dt=DT, t_end=STEPS * DT, restart=loaded)


@pytest.mark.slow
@pytest.mark.optimised
def test_chunks_of_any_length_make_the_same_run(scene, monkeypatch):
    """To the last bit. A chunk lasts about a second, however far apart the frames are: here one step at a time."""
    whole = js.simulate(scene, EMC, dt=DT, t_end=STEPS * DT, save_every=2, newton=TIGHT)
    monkeypatch.setattr("jaxshell.analyses.simulation._CHUNK_TIME", 0.0)
    found = js.simulate(scene, EMC, dt=DT, t_end=STEPS * DT, save_every=10**9, newton=TIGHT)
    for name in ("times", "iterations", "watched", "energy"):
        assert eqx.tree_equal(getattr(found, name), getattr(whole, name)), name
    assert len(found.frame_times) == 2 and found.frame_times[-1] == whole.frame_times[-1]
    np.testing.assert_array_equal(found.displacements[-1], whole.displacements[-1])


def test_frames_in_a_file_are_not_kept_in_memory(scene, tmp_path):
    found = js.simulate(scene, EMC, dt=DT, t_end=4 * DT, newton=TIGHT, output=tmp_path / "cap.h5")
    assert jax.tree.leaves(found.frames) == []
    np.testing.assert_array_equal(found.frame(2).displacements, found.displacements[2])


# --- failure ----------------------------------------------------------------------------------------------


def test_failure_keeps_every_finished_step(whole, tmp_path):
    """A load that becomes absurd after ten steps."""
    path = tmp_path / "wild.h5"
    with pytest.raises(js.SimulationError) as caught:
        js.simulate(cap(late=1e7), EMC, dt=DT, t_end=STEPS * DT, save_every=2, output=path)
    solution = caught.value.solution
    assert solution.result != js.RESULTS.successful
    assert len(solution.times) == 11 and float(solution.times[-1]) == pytest.approx(1e-4)
    assert len(solution.frame_times) == 6
    close(solution.watched["apex"], whole.watched["apex"][:11])
    assert np.all(np.isfinite(solution.displacements))
    message = str(caught.value)
    assert message == solution.message
    assert message.startswith("Step 11, from t = 0.0001 with dt = 1e-05: ")
    assert "Reduce the time step" in message
    # The file holds the same, and says the same.
    loaded = js.Solution.load(path)
    assert loaded.message == message and loaded.result == solution.result
    np.testing.assert_array_equal(loaded.times, solution.times)


def test_a_far_too_large_step_fails_at_once_and_the_command_says_so(tmp_path, capsys):
    """A hundred times the paper's step at ten thousand times its load: exit status 1, and a file."""
    scene, dt, t_end = cap(force=1.112e6), 2e-4, 2e-4 * STEPS
    solution = js.simulate(scene, EMC, dt=dt, t_end=t_end, save_every=2, throw=False)
    assert solution.result != js.RESULTS.successful
    assert solution.message.startswith("Step 1, from t = 0 with dt = 0.0002: ")
    assert len(solution.times) == 1 and np.all(np.asarray(solution.displacements) == 0)
    solution.save(tmp_path / "wild.h5")
    command = ["run", str(tmp_path / "wild.h5"), "--output", str(tmp_path), "--method", "EMC", "--no-plots"]
    assert main([*command, "--dt", str(dt), "--t-end", str(t_end), "--save-every", "2"]) == 1
    assert solution.message in capsys.readouterr().err


def test_a_kept_factorization_serves_while_the_shell_turns():
    """A spinning plate's tangent turns with it: through more than half a turn one factorization does for many steps."""
    dt, steps = 2e-4, 300
    assert np.linalg.norm([20.0, 60.0]) * steps * dt > np.pi
    with jax.numpy_rank_promotion("allow"):
        scene = js.scenes.spinning_plate(4)
        solution = js.simulate(scene, js.EnergyMomentum(), dt=dt, t_end=steps * dt, save_every=steps)
    assert solution.stats["factorizations"] < 0.15 * steps
    energy, momentum = np.asarray(solution.energy.total), np.asarray(solution.momentum.angular)
    np.testing.assert_allclose(energy, np.full_like(energy, energy[0]), rtol=1e-11)
    np.testing.assert_allclose(momentum, np.broadcast_to(momentum[0], momentum.shape), atol=1e-10 * abs(momentum).max())
