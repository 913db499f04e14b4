"""Sweeps that are killed, whose workers are killed, and whose members have different structures."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)

from strip import STRIP  # noqa: E402
from test_sweep import BASE, RUN, make  # noqa: E402

import jaxshell as js  # noqa: E402
from jaxshell.command.cli import main  # noqa: E402
from jaxshell.files.scene_file import read_content, scene_of  # noqa: E402

pytestmark = pytest.mark.slow


@pytest.fixture
def strip(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "strip.toml").write_text(STRIP)
    return tmp_path


def test_a_killed_sweep_leaves_a_file_that_goes_on(strip):
    command = [
        "sweep",
        "strip.toml",
        "--vary",
        "loads.1.force.3=1:2:40",
        "--vary",
        "run.t_end=0.2",
        "--batch",
        "2",
        "--no-plots",
    ]
    environment = {**os.environ, "PYTHONPATH": str(Path(js.__file__).parents[1])}
    process = subprocess.Popen(
        [sys.executable, "-m", "jaxshell", *command], stdout=subprocess.PIPE, text=True, env=environment
    )
    assert process.stdout is not None
    for line in process.stdout:
        if "8 of 40 members done" in line:
            process.send_signal(signal.SIGKILL)
            break
    process.wait(60)
    process.stdout.close()
    half = js.Sweep.load("strip_sweep.h5")
    assert 8 <= half.done.sum() < 40 and half.successful[half.done].all()
    assert main(command) == 0
    whole = js.Sweep.load("strip_sweep.h5")
    assert whole.successful.all()
    np.testing.assert_array_equal(whole.watched["tip"][half.done], half.watched["tip"][half.done])
    assert main([*command, "--output", "fresh.h5"]) == 0
    np.testing.assert_allclose(whole.watched["tip"], js.Sweep.load("fresh.h5").watched["tip"], rtol=1e-12)
    assert not list(strip.glob(".*.part"))


def test_all_members_finish_though_a_worker_is_killed(tmp_path):
    """A cluster of two processes, of which one is killed while it runs a batch."""
    distributed = pytest.importorskip("distributed")
    vary, run = {"force": np.linspace(1.0, 2.0, 24)}, {**RUN, "dt": 5e-5, "t_end": 0.3}
    quantities = {"squared": lambda solution: solution.watched["tip"][-1] ** 2}
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        killed = []

        def kill(line):
            if not killed:
                with distributed.Client(cluster) as client:
                    running = [address for address, tasks in client.processing().items() if tasks]
                    killed.append(client.run(os.getpid, workers=running[:1])[running[0]])
                os.kill(killed[0], signal.SIGKILL)

        found = js.sweep(
            make,
            vary,
            **run,
            quantities=quantities,
            batch=2,
            scheduler=cluster.scheduler_address,
            say=kill,
            output=tmp_path / "a.h5",
        )
    assert killed and found.successful.all() and js.Sweep.load(tmp_path / "a.h5").successful.all()
    here = js.sweep(make, vary, **run, quantities=quantities, batch=2)
    np.testing.assert_allclose(found.watched["tip"], here.watched["tip"], rtol=1e-12)
    np.testing.assert_allclose(found.quantities["squared"], found.end["tip"] ** 2, rtol=1e-12)


def test_a_batch_that_workers_die_of_is_given_up_and_the_others_are_kept(tmp_path):
    distributed, dask = pytest.importorskip("distributed"), pytest.importorskip("dask")

    def deadly(force):
        return make(force=force)

    def dies(solution):
        if solution.times.shape[0] > 101:
            os._exit(1)
        return solution.watched["tip"][-1]

    vary = {"force": [1.0, 2.0], "t_end": [0.02, 0.03]}
    run = {"method": RUN["method"], "dt": RUN["dt"], "t_end": lambda t_end: float(t_end), "quantities": {"tip": dies}}
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster,
        pytest.raises(RuntimeError, match="2 of 4 members were given up"),
    ):
        js.sweep(deadly, vary, **run, scheduler=cluster.scheduler_address, output=tmp_path / "a.h5")
    found = js.Sweep.load(tmp_path / "a.h5")
    np.testing.assert_array_equal(found.successful, found.parameters["t_end"] == 0.02)
    np.testing.assert_array_equal(found.done, found.successful)


def test_two_processes_from_the_command_line(strip):
    assert main(["sweep", "strip.toml", "--vary", "loads.1.force.3=1:2:8", "--workers", "2", "--no-plots"]) == 0
    assert js.Sweep.load("strip_sweep.h5").successful.all()


def test_no_cluster_is_an_error_that_says_so(monkeypatch):
    from jaxshell.analyses.sweep import workers

    monkeypatch.setattr(workers, "_PATIENCE", 2)
    with pytest.raises(OSError, match=r"No cluster with a worker answers at tcp://127.0.0.1:9"):
        js.sweep(make, {"force": [1.0, 2.0]}, **RUN, scheduler="tcp://127.0.0.1:9")


def test_without_distributed_the_error_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ImportError, match="pip install distributed"):
        js.sweep(make, {"force": [1.0, 2.0]}, **RUN, workers=2)


def test_meshes_methods_and_steps_that_differ_make_groups(strip):
    """Three members that differ from the first in one of them each: four programs, with the values of single runs."""
    varied = ["mesh.divisions.1=1,2,1,1", "run.method=Newmark,Newmark,exact,Newmark", "run.dt=1e-3,1e-3,1e-3,2e-3"]
    command = ["sweep", "strip.toml", "--sample", "zip", "--no-plots", "--newton-tolerance", "1e-12"]
    assert main([*command, *(word for key in varied for word in ("--vary", key))]) == 0
    found = js.Sweep.load("strip_sweep.h5")
    assert found.successful.all() and found.times.shape == (201,) and found.times[-1] == 0.02
    methods = {"Newmark": js.Newmark(), "exact": js.EnergyMomentum()}
    for number in (1, 2, 3):
        columns, name, dt = (values[number] for values in found.parameters.values())
        content = read_content("strip.toml")
        content["mesh"]["divisions"] = [int(columns), 1]
        scene = scene_of(content, "strip.toml")[0]
        single = js.simulate(scene, methods[name], dt=float(dt), t_end=0.02, newton=js.Newton(tolerance=1e-12))
        for label, values in single.watched.items():
            expected = np.interp(found.times, single.times, values)
            np.testing.assert_allclose(found.watched[label][number], expected, atol=1e-9 * np.abs(values).max())
        assert found.steps[number] == len(single.times) - 1


def test_step_control_runs_members_one_by_one():
    control = js.StepControl(1e-3, initial=1e-3)
    newton = js.Newton(tolerance=1e-12)
    found = js.sweep(make, {"force": [1.0, 2.0]}, method=js.Newmark(), dt=control, t_end=0.05, newton=newton)
    assert found.successful.all() and found.watched["tip"].shape == (2, 201)
    single = js.simulate(make(force=2.0), js.Newmark(), dt=control, t_end=0.05, newton=newton)
    assert found.steps[1] == len(single.times) - 1
    np.testing.assert_allclose(found.end["tip"][1], single.watched["tip"][-1], rtol=1e-9)


def test_frames_are_kept_where_they_are_asked_for(tmp_path):
    found = js.sweep(make, {"force": [1.0, 2.0]}, **RUN, save_every=25, output=tmp_path / "a.h5")
    single = js.simulate(make(force=2.0), RUN["method"], dt=RUN["dt"], t_end=RUN["t_end"], save_every=25)
    for sweep in (found, js.Sweep.load(tmp_path / "a.h5")):
        assert sweep.frames is not None
        np.testing.assert_allclose(sweep.frames["times"][1], single.frame_times, rtol=1e-12)
        for name in ("displacements", "velocities", "rotations"):
            expected = np.asarray(getattr(single, name))
            np.testing.assert_allclose(sweep.frames[name][1], expected, atol=1e-12 * np.abs(expected).max())


def test_members_that_watch_different_things_are_refused():
    def other(force):
        scene = make(force=force)
        watch = {"tip": (2, "uz")} if force > 1 else {"edge": (3, "uz")}
        return js.Scene(BASE.mesh, scene.section, scene.supports, scene.loads, watch=watch)

    with pytest.raises(ValueError, match="All members must watch the same"):
        js.sweep(other, {"force": [1.0, 2.0]}, **RUN)


def test_a_batch_of_implicit_members_has_the_values_of_single_runs_within_newtons_tolerance():
    newton = js.Newton(tolerance=1e-12)
    run = {"method": js.EnergyMomentum(), "dt": 2e-3, "t_end": 0.04, "newton": newton}
    found = js.sweep(make, {"thickness": [0.02, 0.03], "force": [1.0, 1e3]}, **run, batch=4)
    assert found.successful.all()
    for number in range(4):
        thickness, force = (values[number] for values in found.parameters.values())
        single = js.simulate(make(thickness, force), run["method"], dt=2e-3, t_end=0.04, newton=newton)
        expected = np.asarray(single.watched["tip"])
        np.testing.assert_allclose(found.watched["tip"][number], expected, atol=1e-9 * np.abs(expected).max())
