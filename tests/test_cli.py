"""The command `jaxshell`: runs, reruns, plots, lists; failures and bad input end without a traceback."""

import os
import signal
import subprocess
import sys
import time
from typing import Any

import equinox as eqx
import jax
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)

from jaxshell.analyses.statics import solve_static  # noqa: E402
from jaxshell.command.cli import main  # noqa: E402
from jaxshell.command.method_names import choose_methods, method_label, parse_method  # noqa: E402
from jaxshell.command.pictures import PicturesAhead  # noqa: E402
from jaxshell.command.run_settings import _about_as_many_elements  # noqa: E402
from jaxshell.methods import GeneralizedEnergyMomentum, Newmark  # noqa: E402
from jaxshell.model.generators import rectangle  # noqa: E402
from jaxshell.model.loads import Gravity, History, NodalForce  # noqa: E402
from jaxshell.model.scene import Scene  # noqa: E402
from jaxshell.model.sections import Section  # noqa: E402
from jaxshell.model.supports import clamped  # noqa: E402
from jaxshell.plotting.ahead import draw_one  # noqa: E402
from jaxshell.results.diagnostics import loads_end  # noqa: E402
from jaxshell.results.solution import RESULTS, Solution  # noqa: E402
from jaxshell.scenes import BY_NAME, PAPER  # noqa: E402

STRIP = """
[mesh]
generator = "rectangle"
length = 2.0
width = 1.0
divisions = [2, 1]
[section]
thickness = 0.1
young_modulus = 1.0e4
poisson_ratio = 0.3
density = 1.0
[[loads]]
kind = "force"
nodes = [5]
force = [0, 0, 1]
history = { times = [0, 0.05], values = [1, 0] }
[watch]
corner = { node = 5, component = "uz" }
[run]
dt = 0.01
t_end = 0.2
save_every = 2
"""
PICTURES = {"strip_shapes.png", "strip_displacement.png", "strip_energy.png", "strip_momentum.png"}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A folder with a run of the strip, by three methods, and one by one; and what was printed."""
    folder = tmp_path_factory.mktemp("cli")
    (folder / "strip.toml").write_text(STRIP)
    assert main(["run", str(folder / "strip.toml"), "--output", str(folder / "one"), "--quiet"]) == 0
    assert main(["run", str(folder / "strip.toml"), "--output", str(folder / "all"), "--method", "all"]) == 0
    return folder


def test_run_writes_results_and_pictures(finished):
    assert {path.name for path in (finished / "one").iterdir()} == {"strip.h5"} | PICTURES
    solution = Solution.load(finished / "one" / "strip.h5")
    assert len(solution.times) == 21 and len(solution.frame_times) == 11
    assert np.isclose(solution.times[-1], 0.2) and float(solution.watched["corner"][-1]) > 0


def test_all_methods_in_one_picture(finished):
    results = {"strip_EMC.h5", "strip_EDMC1.h5", "strip_EDMC2.h5"}
    assert {path.name for path in (finished / "all").iterdir()} == results | PICTURES


def test_summary(finished, capsys):
    run = ["run", str(finished / "strip.toml"), "--output", str(finished / "summary"), "--no-plots"]
    assert main([*run, "--t-end", "0.1", "--dt", "0.02", "--method", "emc"]) == 0
    text = capsys.readouterr().out
    assert "strip: 4 triangles, 6 nodes, 36 unknowns" in text
    assert "EMC: 5 steps to t = 0.1" in text and "Newton iterations a step" in text
    assert "momentum after the loads (t = 0.05) changes by linear" in text
    assert [path.name for path in (finished / "summary").iterdir()] == ["strip.h5"]


def test_rerun_of_a_result_file_gives_the_same(finished):
    first = finished / "all" / "strip_EDMC1.h5"
    assert main(["run", str(first), "--output", str(finished / "again"), "--no-plots", "--quiet"]) == 0
    one, two = Solution.load(first), Solution.load(finished / "again" / "strip_EDMC1_rerun.h5")
    assert np.array_equal(one.times, two.times) and np.array_equal(one.displacements, two.displacements)
    assert one.stats["method"] == two.stats["method"]


@pytest.mark.slow
@pytest.mark.optimised
@pytest.mark.parametrize(
    "method",
    [
        "EDMC1",
        "exact",
        *(pytest.param(m, marks=pytest.mark.evidence) for m in ("newmark", "bathe", "centraldifference")),
    ],
)
def test_a_run_goes_on_from_its_file(method, finished, tmp_path):
    """In two halves the run that one makes in one go, by every kind of state."""
    dt = ["--dt", "1e-4", "--t-end"] if method == "centraldifference" else ["--t-end"]
    run = ["run", str(finished / "strip.toml"), "--method", method, "--no-plots", "--quiet"]
    assert main([*run, *dt, "0.2", "--output", str(tmp_path / "whole")]) == 0
    assert main([*run, *dt, "0.1", "--output", str(tmp_path)]) == 0
    go_on = ["run", str(tmp_path / "strip.h5"), "--continue", "--no-plots", "--quiet", "--output", str(tmp_path)]
    assert main([*go_on, "--t-end", "0.1"]) == 0
    whole, rest = (Solution.load(tmp_path / name) for name in ("whole/strip.h5", "strip_continued.h5"))
    half = len(whole.times) // 2
    for name in ("times", "watched", "energy", "momentum"):  # to the last bit, with what Newton keeps
        one, other = (jax.tree.map(np.asarray, getattr(run, name)) for run in (rest, whole))
        assert eqx.tree_equal(one, jax.tree.map(lambda a: a[half:], other)), name
    assert np.array_equal(rest.frame(-1).displacements, whole.frame(-1).displacements)
    assert rest.stats["method"] == whole.stats["method"] and rest.stats["newton"] == whole.stats["newton"]


@pytest.mark.slow
def test_a_run_that_was_stopped_goes_on_to_its_end(finished, tmp_path, capsys, monkeypatch):
    """The end that it was to have; a file whose run has ended asks for how long, and a scene for a file."""
    from jaxshell.results.hdf5 import ResultWriter

    append = ResultWriter.append

    def stopped(self, part):
        append(self, part)
        if part.times[-1] > 0.45:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(ResultWriter, "append", stopped)
        patch.setattr("jaxshell.analyses.simulation._CHUNK_STEPS", 10)
        run = ["run", str(finished / "strip.toml"), "--t-end", "0.9", "--output", str(tmp_path)]
        assert main([*run, "--no-plots", "--quiet"]) == 130
    path = tmp_path / "strip.h5"
    assert f"`jaxshell run {path} --continue` goes on with it." in capsys.readouterr().err
    assert 0.45 < Solution.load(path).times[-1] < 0.6
    assert main(["run", str(path), "--continue", "--output", str(tmp_path), "--quiet"]) == 0
    times = np.asarray(Solution.load(tmp_path / "strip_continued.h5").times)
    assert 0.45 < times[0] < 0.6 and np.isclose(times[-1], 0.9)
    for arguments, message in (
        ([str(tmp_path / "strip_continued.h5")], "The run has reached its end, t = 0.9: say with --t-end for how"),
        (["cap"], "--continue goes on from a result file (.h5), but the scene is 'cap'."),
        ([str(path), "--method", "exact"], "--continue goes on with the method of the file: leave --method out."),
    ):
        assert main(["run", *arguments, "--continue"]) == 2
        assert message in capsys.readouterr().err


@pytest.mark.slow
def test_a_run_that_is_told_to_end_does_so_as_by_the_keyboard(finished, tmp_path):
    """SIGTERM, at some moment of a run without end: 128 + 15, a file that is whole, and it goes on."""
    command = [sys.executable, "-m", "jaxshell", "run", str(finished / "strip.toml"), "--t-end", "1e4", "--quiet"]
    command += ["--save-every", "1000000000", "--output", str(tmp_path)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env={**os.environ, "JAX_PLATFORMS": "cpu"})
    path, begun = tmp_path / "strip.h5", time.monotonic()
    while time.monotonic() - begun < 120 and not (path.exists() and len(Solution.load(path).times) > 100):
        assert process.poll() is None, process.stderr
        time.sleep(0.2)
    told = time.monotonic()
    process.send_signal(signal.SIGTERM)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 128 + signal.SIGTERM
    assert "--continue` goes on with it" in said
    assert time.monotonic() - told < 20
    found = Solution.load(path)
    assert found.result == RESULTS.interrupted and len(found.frame_times) == 1
    assert main(["run", str(finished / "strip.toml"), "--output", str(tmp_path), "--quiet"]) == 2  # it did not end
    go_on = ["run", str(path), "--continue", "--t-end", "0.1", "--output", str(tmp_path), "--quiet", "--no-plots"]
    assert main(go_on) == 0
    assert Solution.load(tmp_path / "strip_continued.h5").times[0] == found.times[-1]


@pytest.mark.slow
def test_rerun_keeps_newton_step_control_and_parameters(finished, tmp_path):
    run = ["run", str(finished / "strip.toml"), "--output", str(tmp_path), "--no-plots", "--quiet"]
    assert main([*run, "--method", "exact", "--step-tolerance", "1e-3", "--newton-tolerance", "1e-5"]) == 0
    again = ["run", str(tmp_path / "strip.h5"), "--output", str(tmp_path), "--no-plots", "--quiet"]
    assert main(again) == 0
    one, two = (Solution.load(tmp_path / name) for name in ("strip.h5", "strip_rerun.h5"))
    assert np.array_equal(one.times, two.times) and np.array_equal(one.displacements, two.displacements)
    assert one.stats["newton"] == two.stats["newton"] and "tolerance=1e-05" in two.stats["newton"]
    # What the command line says comes first, and the rest of the file's method stays.
    assert main([*again, "--dissipation", "0.1", "--dt", "0.02", "--newton-tolerance", "1e-9"]) == 0
    three = Solution.load(tmp_path / "strip_rerun.h5")
    assert three.stats["method"].startswith("EnergyMomentum(dissipation=0.1") and len(three.times) == 11
    assert "tolerance=1e-09" in three.stats["newton"]


@pytest.mark.slow
def test_a_static_result_is_run_in_time_as_its_scene(tmp_path, capsys):
    """Of how a static solution was found nothing fits a run in time: steps are asked for, and given."""
    mesh = rectangle(2.0, 1.0, (2, 1))
    section, load = Section(0.1, 1e4, 0.3, 1.0), NodalForce([2], [0.0, 0.0, 0.1])
    scene = Scene(mesh, section, [clamped([0, 3])], [load], watch={"tip": (2, "uz")})
    solve_static(scene, [1.0], output=tmp_path / "still.h5")
    run = ["run", str(tmp_path / "still.h5"), "--analysis", "time", "--no-plots", "--quiet", "--output", str(tmp_path)]
    assert main(run) == 2 and "The scene gives no dt: add --dt" in capsys.readouterr().err
    assert main([*run, "--dt", "0.1", "--t-end", "1"]) == 0
    moving = Solution.load(tmp_path / "still_rerun_time.h5")
    assert moving.stats["method"].startswith("GeneralizedEnergyMomentum(") and "reuse=True" in moving.stats["newton"]
    assert main([*run, "--dt", "0.1", "--t-end", "1", "--continue"]) == 2
    assert "still.h5 holds no state to go on from: it is of statics" in capsys.readouterr().err


def test_plot_of_several_files(finished, capsys):
    files = [str(finished / "all" / f"strip_{name}.h5") for name in ("EMC", "EDMC2")]
    assert main(["plot", *files, "--output", str(finished / "plots")]) == 0
    names = {path.name for path in (finished / "plots").iterdir()}
    assert names == {name.replace("strip", "strip_compared") for name in PICTURES}
    assert capsys.readouterr().out.count("strip_compared") == 4


def test_failed_run_keeps_its_steps_and_says_so(finished, capsys):
    (finished / "wild.toml").write_text(STRIP.replace("[0, 0, 1]", "[0, 0, 1e9]").replace("dt = 0.01", "dt = 0.1"))
    assert main(["run", str(finished / "wild.toml"), "--output", str(finished / "wild")]) == 1
    error = capsys.readouterr().err
    assert error.startswith("jaxshell: EMC failed. Step ") and "Reduce the time step" in error
    solution = Solution.load(finished / "wild" / "wild.h5")
    assert not bool(solution.result == RESULTS.successful) and solution.message in error
    assert np.all(np.isfinite(solution.displacements))
    assert (finished / "wild" / "wild_shapes.png").is_file()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "dome"], "There is no scene 'dome'. Choose out of cap, plate, opened_cap"),
        (["run", "none.toml"], "There is no file none.toml"),
        (["run", "none.h5"], "There is no file none.h5"),
        (["plot", "none.h5"], "There is no file none.h5"),
        (["plot", __file__], "cannot be read as an HDF5 file"),
        (
            ["run", "cap", "--method", "rk4"],
            "There is no method 'rk4'. Choose out of EMC, EDMC1, EDMC2, ",
        ),
        (["run", "cap", "--dt", "-1"], "dt must be positive, but it is -1.0"),
        (["run", "cap", "--save-every", "0"], "save_every must be a whole number of at least 1, but it is 0"),
        (["run", "cap", "--spectral-radius", "2"], "spectral_radius must lie in [0, 1], but it is 2.0"),
        (["run", "cap", "--method", "all", "--dissipation", "0.1"], "for one method at a time"),
        (["run", "plate", "--divisions", "4"], "'plate' takes 2 divisions, but 1 are given"),
        (["run", __file__, "--divisions", "4"], "--divisions is for the library's scenes"),
        (["run", "cap", "--step-tolerance", "-1"], "StepControl tolerance must be positive, but it is -1.0"),
    ],
)
def test_bad_input_is_a_short_error(arguments, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("jaxshell: ") and message in captured.err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("scene", "divisions", "elements"),
    [("cap", None, 200), ("cap", [20], 800), ("plate", None, 90), ("opened_cap", None, 960), ("flying_cylinder", None, 256),
     ("strip.toml", None, 4), ("all/strip_EMC.h5", None, 4), ("none.h5", None, 0), ("dome", None, 0), pytest.param("plate", ["x"], 0, marks=pytest.mark.wrong_types)],
)  # fmt: skip
def test_elements_are_estimated_before_jax_starts(scene, divisions, elements, finished):
    """Small meshes get one of XLA's threads. What cannot be estimated counts as large."""
    name = scene if "." not in scene else str(finished / scene)
    assert _about_as_many_elements(name, divisions) == elements


@pytest.mark.slow
def test_one_thread_for_a_small_mesh_only():
    """Seen from outside: which environment JAX starts with; the user's own word comes first."""
    program = (
        "import os, sys; from jaxshell.command.run_settings import one_thread_for_small_meshes as f; "
        "f(*sys.argv[1:]); print(os.environ.get('NPROC'))"
    )
    bare = {key: value for key, value in os.environ.items() if key != "NPROC"}
    for name, environment, expected in (
        ("cap", bare, "1"),
        ("opened_cap", bare, "None"),
        ("cap", bare | {"NPROC": "2"}, "2"),
    ):
        command = [sys.executable, "-c", program, name]
        found = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        assert found.stdout.strip() == expected


def test_scene_without_a_step_asks_for_one(tmp_path, capsys):
    (tmp_path / "strip.toml").write_text(STRIP[: STRIP.index("[run]")])
    assert main(["run", str(tmp_path / "strip.toml"), "--output", str(tmp_path)]) == 2
    assert "The scene gives no dt: add --dt, or dt in the file's [run]." in capsys.readouterr().err


@pytest.mark.slow
def test_step_control_and_another_mesh(tmp_path, capsys):
    command = "run cap --divisions 2 --method exact --step-tolerance 1e-5 --t-end 1e-4 --dt 1e-7 --no-plots --output"
    assert main([*command.split(), str(tmp_path)]) == 0
    assert "8 triangles" in capsys.readouterr().out
    run = Solution.load(tmp_path / "cap.h5")
    sizes = np.asarray(run.step_sizes)
    assert run.stats["accepted"] == len(sizes) and sizes.max() > 1.01 * sizes.min()


def test_scenes_are_listed(capsys):
    assert main(["scenes"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(BY_NAME) and lines[0].startswith("cap                  Clamped spherical cap")
    assert [line.split()[0] for line in lines] == list(BY_NAME)


def test_help_and_version_need_no_float64(capsys):
    for arguments, text in (
        (["--help"], "COMMAND"),
        (["run", "--help"], "--method"),
        (["--version"], "jaxshell "),
    ):
        with pytest.raises(SystemExit) as left:
            main(arguments)
        assert left.value.code == 0 and text in capsys.readouterr().out


def test_module_runs_as_a_command_without_matplotlib(tmp_path):
    code = (
        "import sys, runpy; sys.argv = ['jaxshell', 'scenes']\n"
        "try: runpy.run_module('jaxshell', run_name='__main__')\n"
        "except SystemExit as left: assert not left.code\n"
        "assert 'matplotlib' not in sys.modules and 'h5py' not in sys.modules"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "opened_cap" in done.stdout


# --- names of methods ------------------------------------------------------------------------------------


def test_the_scene_gives_its_methods_their_parameters():
    plate = PAPER["plate"]()
    assert list(choose_methods(plate, [])) == ["EMC"]
    chosen: Any = choose_methods(plate, ["all"])
    parameters = [(float(m.spectral_radius), float(m.dissipation)) for m in chosen.values()]
    assert list(chosen) == ["EMC", "EDMC1", "EDMC2"]
    assert parameters == [(1.0, 0.0), (0.95, 0.0), (1.0, 0.02)]


def test_other_methods_go_by_their_class():
    cap = PAPER["cap"]()
    assert choose_methods(cap, ["Newmark"]) == {"Newmark": Newmark()}
    with pytest.raises(ValueError, match="The method 'Newmark' has no spectral_radius"):
        choose_methods(cap, ["Newmark"], {"spectral_radius": 0.5})


def test_labels_say_what_differs_from_the_named_methods():
    cap = PAPER["cap"]()
    (label,) = choose_methods(cap, ["EMC"], {"spectral_radius": 0.9, "dissipation": 0.01})
    assert label == "EDMC, ρ∞ = 0.9, ξ = 0.01"
    (label,) = choose_methods(cap, ["EMC"], {"spectral_radius": 0.8})
    assert label == "EDMC1"


def test_quoted_methods_are_read_back():
    text = "GeneralizedEnergyMomentum(spectral_radius=0.8, dissipation=0, initial_acceleration=zero)"
    method = parse_method(text)
    assert method == GeneralizedEnergyMomentum(0.8, 0, "zero")
    assert method_label(method, PAPER["cap"]()) == "EDMC1"
    for bad in ("", "open('x')", "GeneralizedEnergyMomentum(0.8)", "Unknown()", "__import__(name=os)"):
        with pytest.raises(ValueError, match=r"is not one of .* as this version"):
            parse_method(bad)


def test_end_of_the_loads():
    plate = PAPER["plate"]((3, 1))
    assert loads_end(plate) == 0.004
    assert loads_end(PAPER["plate"]((3, 1), loads=[])) == 0.0
    late = Gravity([0, 0, 1], History([0.0, 1.0, 2.0, 3.0], [0.0, 1.0, 0.0, 0.0]))
    assert loads_end(PAPER["plate"]((3, 1), loads=[late])) == 2.0
    assert loads_end(PAPER["opened_cap"]((6, 2))) == np.inf


def test_what_pictures_need_is_loaded_once_the_program_is_compiled(monkeypatch):
    drawn_ahead = []
    monkeypatch.setattr("jaxshell.plotting.ahead.draw_one", lambda: drawn_ahead.append(1) or 1 / 0)
    PicturesAhead(wanted=False).wait()
    waiting = PicturesAhead(wanted=True)
    waiting.wait()  # of a run that failed before
    for expected in ([], [1], [1]):  # after the start, then the first steps
        waiting.append(None)
        waiting.wait()
        assert drawn_ahead == expected
    monkeypatch.undo()
    draw_one()
