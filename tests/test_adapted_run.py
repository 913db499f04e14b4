"""`jaxshell run --adapt`: the last mesh is run and written as any scene is; what it refuses, and how it ends."""

import numpy as np
import pytest
from strip import STRIP

import jaxshell as js
from jaxshell.analyses import adapting
from jaxshell.analyses.adapting import Adapted, Round
from jaxshell.command.cli import main
from jaxshell.files.scene_file import read_scene_file
from jaxshell.results.hdf5 import read_settings

ROUNDS = (Round(2, 12, 1.0, 0.5, 0.5), Round(4, 24, 1.1, 0.2, 0.1))
QUICK = STRIP.replace("2e-4", "1e-4").replace("t_end = 0.02", "t_end = 0.001")


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "strip.toml").write_text(QUICK)
    (tmp_path / "asked.toml").write_text(QUICK + 'adapt = 0.2\ngoal = "tip"\n')
    return tmp_path


@pytest.fixture
def pretended(monkeypatch):
    """`adapt` that bisects the first triangle in place of analyses; with what it was called."""
    calls = []

    def adapt(scene, tolerance, *, analysis, goal, report):
        calls.append((tolerance, goal, analysis))
        for mesh in ROUNDS:
            report(mesh)
        met = tolerance >= ROUNDS[-1].estimate
        return Adapted(js.refine(scene, elements=[0]), None, ROUNDS, met, "" if met else "2 meshes were not enough.")

    monkeypatch.setattr(adapting, "adapt", adapt)
    return calls


def run(folder, name, *options):
    return main(["run", str(folder / name), "--no-plots", "--output", str(folder), *options])


def test_the_last_mesh_is_run_as_any_scene(folder, pretended, capsys):
    """Its file has all that the file of an ordinary run of that scene has, and no `adapt`: run again it is as it is."""
    assert run(folder, "asked.toml", "--vtkhdf") == 0
    lines = capsys.readouterr().out.splitlines()
    at = lines.index("  adapting to 20 % of tip")
    assert lines[at - 1] == "strip: 2 triangles, 4 nodes, 12 unknowns"
    assert lines[at + 1 : at + 5] == [f"  {adapting.HEADING}", *(f"  {r}" for r in ROUNDS), "  within the tolerance"]
    assert lines[at + 5].startswith("strip: 4 triangles")
    (tolerance, goal, analysis), found = pretended[0], js.Solution.load(folder / "asked.h5")
    assert (tolerance, goal) == (0.2, "tip")
    assert (folder / "asked.vtkhdf").exists() and found.scene.mesh.n_elements == 4

    js.simulate(found.scene, js.CentralDifference(), dt=1e-4, t_end=0.001, output=folder / "ordinary.h5")
    ordinary = js.Solution.load(folder / "ordinary.h5")
    assert read_settings(folder / "asked.h5") == read_settings(folder / "ordinary.h5")
    assert found.watched.keys() == ordinary.watched.keys() == {"tip", "tip velocity"}
    np.testing.assert_array_equal(found.watched["tip"], ordinary.watched["tip"])
    assert found.state.keys() == ordinary.state.keys() and set(found.stats) == set(ordinary.stats)
    # The analysis that `adapt` is given is that run.
    np.testing.assert_array_equal(analysis(found.scene).watched["tip"], ordinary.watched["tip"])


def test_the_file_is_run_again_and_gone_on_with_on_its_mesh(folder, pretended):
    assert run(folder, "strip.toml", "--adapt", "0.2", "--quiet") == 0
    assert not (folder / "strip.h5").exists()  # as other changes of the mesh, it has a file of its own
    assert run(folder, "strip_adapted.h5", "--quiet") == 0
    assert run(folder, "strip_adapted.h5", "--continue", "--t-end", "0.001", "--quiet") == 0
    assert len(pretended) == 1
    whole, rerun, rest = (js.Solution.load(folder / f"strip_adapted{end}.h5") for end in ("", "_rerun", "_continued"))
    assert rerun.scene.mesh.n_elements == rest.scene.mesh.n_elements == 4
    np.testing.assert_array_equal(rerun.watched["tip"], whole.watched["tip"])
    assert float(rest.times[0]) == float(whole.times[-1]) and float(rest.times[-1]) == pytest.approx(0.002)


def test_a_tolerance_that_is_not_met_is_a_failure_with_results(folder, pretended, capsys):
    assert run(folder, "asked.toml", "--adapt", "0.01", "--quiet") == 1
    told = capsys.readouterr()
    assert told.err == "jaxshell: the mesh is not within the tolerance. 2 meshes were not enough.\n" and not told.out
    assert js.Solution.load(folder / "asked_adapted.h5").scene.mesh.n_elements == 4


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--goal", "tip"], "goal says what adapt is to get right: give adapt"),
        (["--adapt", "2"], "adapt must lie in"),
        (["--adapt", "0.1", "--goal", "tipp"], "goal must be one of"),
        (
            ["--adapt", "0.1", "--method", "EMC", "exact"],
            "adapt makes the mesh of one method, but EMC, exact are asked",
        ),
        (
            ["--adapt", "0.1", "--method", "EMC", "--goal", "tip", "--step-tolerance", "1e-3"],
            "leave step_tolerance out",
        ),
        (["--adapt", "0.1", "--analysis", "modes"], 'adapt is for analysis = "time" or "static"'),
        (["--adapt", "0.1", "--analysis", "buckling"], 'adapt is for analysis = "time" or "static"'),
        (["--adapt", "0.1", "--analysis", "arc-length"], 'adapt is for analysis = "time" or "static"'),
    ],
)
def test_what_does_not_go_together_is_refused_by_name(options, message, folder, pretended, capsys):
    assert run(folder, "strip.toml", *options) == 2
    assert message in capsys.readouterr().err and not pretended


def test_a_run_that_goes_on_keeps_its_mesh(folder, pretended, capsys):
    assert run(folder, "strip.toml", "--quiet") == 0
    for option in (["--adapt", "0.1"], ["--goal", "tip"]):
        assert run(folder, "strip.h5", "--continue", *option) == 2
        assert "leave --adapt and --goal out" in capsys.readouterr().err
    assert not pretended


def test_a_sweep_is_not_adapted(folder, capsys):
    vary = ["--vary", "section.thickness=0.02,0.03", "--output", str(folder / "sweep.h5")]
    assert main(["sweep", str(folder / "asked.toml"), *vary]) == 2
    assert "leave adapt and goal out" in capsys.readouterr().err


def test_a_check_says_what_the_run_would(folder, capsys):
    assert main(["check", str(folder / "asked.toml"), "--no-plots", "--frequencies", "0"]) == 0
    assert "adapted        the mesh, to 20 % of tip" in capsys.readouterr().out
    (folder / "asked.toml").write_text(QUICK + 'goal = "tip"\n')
    assert main(["check", str(folder / "asked.toml"), "--no-plots", "--frequencies", "0"]) == 2
    assert "give adapt" in capsys.readouterr().err


def test_files_that_must_stay_are_seen_before_anything_is_adapted(folder, pretended, capsys):
    (folder / "asked.h5").write_text("mine")
    assert run(folder, "asked.toml") == 2
    assert "holds no results of jaxshell" in capsys.readouterr().err and not pretended
    assert run(folder, "asked.toml", "--overwrite", "--quiet") == 0
    assert not list(folder.glob(".*.part"))


def test_stopped_while_it_is_adapted_nothing_is_written(folder, monkeypatch, capsys):
    def stopped(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(adapting, "adapt", stopped)
    assert run(folder, "asked.toml") == 130
    assert "nothing was written" in capsys.readouterr().err and not list(folder.glob("*.h5"))


def test_a_goal_without_derivatives_is_a_failure(folder, monkeypatch, capsys):
    """A load step that the analysis has to cut cannot be differentiated as it is given."""
    monkeypatch.setattr(adapting.jax, "grad", lambda function: lambda factors: np.nan * np.asarray(factors))
    assert run(folder, "asked.toml", "--quiet") == 1
    assert "The derivatives of the goal are not finite" in capsys.readouterr().err
    assert not list(folder.glob("*.h5"))


def test_a_mesh_that_cannot_be_run_is_named(folder, monkeypatch, capsys):
    """Central differences have a critical step, which finer meshes lower."""
    monkeypatch.setattr(adapting, "adapt", lambda scene, *_, analysis, **__: analysis(js.refine(scene, 5)))
    assert run(folder, "asked.toml", "--dt", "2e-4") == 2
    said = capsys.readouterr().err
    assert said.startswith("jaxshell: On the mesh of 2048 elements: dt is 0.0002, but the critical step")
    assert not list(folder.glob("*.h5"))


@pytest.mark.slow
def test_statics_are_adapted_by_the_command_as_by_the_function(folder, capsys):
    assert run(folder, "strip.toml", "--analysis", "static", "--load-factors", "1e-3", "--adapt", "0.3") == 0
    found = js.Solution.load(folder / "strip_static_adapted.h5")
    wanted = js.adapt(
        read_scene_file(folder / "strip.toml")[0], 0.3, analysis=lambda scene: js.solve_static(scene, [1e-3])
    )
    assert wanted.met and found.analysis == "static"
    assert found.scene.mesh.n_elements == wanted.scene.mesh.n_elements > 2
    np.testing.assert_allclose(found.watched["tip"], wanted.solution.watched["tip"], rtol=1e-9)
    assert str(wanted.rounds[-1]) in capsys.readouterr().out
