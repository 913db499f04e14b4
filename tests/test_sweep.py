"""Sweeps that run: values of single runs, failures that are results, resumption, the command line."""

import jax
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)

import tomllib  # noqa: E402

from strip import STRIP  # noqa: E402

import jaxshell as js  # noqa: E402
from jaxshell.command.cli import main  # noqa: E402
from jaxshell.files.scene_file import scene_of  # noqa: E402
from jaxshell.results.hdf5 import read_scene  # noqa: E402

EXPLICIT = js.CentralDifference()
RUN = {"method": EXPLICIT, "dt": 2e-4, "t_end": 0.02}
BASE = scene_of(tomllib.loads(STRIP), "strip.toml")[0]
THICKNESS, FORCE = [0.02, 0.021, 0.01, 0.022], [1.0, 1e7]
"""Of 0.01 the critical step is below dt: refused. Under 1e7 the strip flies apart: unstable."""


def make(thickness=0.02, force=1.0):
    section = js.Section(thickness, 1e6, 0.3, 1000.0)
    load = js.EdgeForce(BASE.loads[0].edges, [0.0, 0.0, force])
    watch = {"tip": (2, "uz"), "tip velocity": (2, "vz")}
    return js.Scene(BASE.mesh, section, BASE.supports, [load], watch=watch, name=f"strip {thickness} {force}")


VARY = {"thickness": THICKNESS, "force": FORCE}


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("sweep") / "a.h5"


@pytest.fixture(scope="module")
def lines():
    return []


@pytest.fixture(scope="module")
def swept(path, lines):
    """Eight members in batches of two: two refused, three that fail, three that end."""
    return js.sweep(make, VARY, **RUN, batch=2, output=path, say=lines.append)


@pytest.fixture(scope="module")
def single():
    return js.simulate(make(0.021), **RUN)


def test_a_member_has_the_values_of_its_single_run(swept, single):
    assert swept.parameters["thickness"][2] == 0.021 and swept.parameters["force"][2] == 1.0
    for label, values in single.watched.items():
        scale = np.abs(values).max()
        np.testing.assert_allclose(swept.watched[label][2], values, atol=1e-12 * scale)
        np.testing.assert_allclose(swept.end[label][2], values[-1], rtol=1e-12)
        np.testing.assert_allclose(swept.maximum[label][2], np.max(values), rtol=1e-12)
        np.testing.assert_allclose(swept.time_of_maximum[label][2], single.times[np.argmax(values)], rtol=1e-12)
        np.testing.assert_allclose(swept.minimum[label][2], np.min(values), atol=1e-12 * scale)
    np.testing.assert_allclose(swept.times, single.times, rtol=1e-12)
    np.testing.assert_allclose(swept.energy["kinetic"][2], single.energy.kinetic[-1], rtol=1e-10)
    assert swept.steps[2] == 100 and 0 < swept.energy_balance[2] < 0.1


def test_members_that_fail_are_results(swept):
    heavy = swept.parameters["force"] > 1
    thin = swept.parameters["thickness"] == 0.01
    np.testing.assert_array_equal(swept.result == "refused", thin)
    np.testing.assert_array_equal(swept.result == "unstable", heavy & ~thin)
    np.testing.assert_array_equal(swept.successful, ~heavy & ~thin)
    assert swept.failures() == {"unstable": 3, "refused": 2}
    assert "critical step of CentralDifference" in swept.messages[4]
    assert "became unstable. Use a time step below" in swept.messages[1] and swept.messages[1].startswith("Step ")
    assert sorted(swept.messages) == [1, 3, 4, 5, 7]
    for number in (1, 3, 7):
        done = swept.steps[number]
        history = swept.watched["tip"][number]
        assert done < 100 and np.isfinite(history[: done + 1]).all() and np.isnan(history[done + 1 :]).all()
        assert swept.end["tip"][number] == history[done]
    assert np.isnan(swept.watched["tip"][4]).all() and swept.steps[4] == 0


def test_lines_say_how_far_it_is(swept, lines):
    assert lines[-1].strip().startswith("8 of 8 members done, 5 failed")


def test_the_file_holds_what_was_returned(swept, path):
    found = js.Sweep.load(path)
    for name in ("watched", "maximum", "energy", "parameters"):
        for key, values in getattr(swept, name).items():
            np.testing.assert_array_equal(getattr(found, name)[key], values)
    np.testing.assert_array_equal(found.result, swept.result)
    assert found.messages == swept.messages


@pytest.mark.parametrize("read", [js.Solution.load, js.Modes.load, read_scene])
def test_what_reads_a_run_names_a_sweep(swept, path, read):
    with pytest.raises(ValueError, match=r"holds a sweep, not one run: jaxshell\.Sweep\.load reads it"):
        read(path)


def test_a_finished_sweep_runs_nothing_again(swept, path):
    told, before = [], path.read_bytes()
    again = js.sweep(make, VARY, **RUN, batch=2, output=path, say=told.append)
    assert told == []
    np.testing.assert_array_equal(again.watched["tip"], swept.watched["tip"])
    assert path.read_bytes() == before


def test_a_stopped_sweep_goes_on_with_the_members_that_lack(swept, tmp_path):
    path, told = tmp_path / "b.h5", []

    def stop(text):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        js.sweep(make, VARY, **RUN, batch=2, output=path, say=stop)
    half = js.Sweep.load(path)
    assert 0 < half.done.sum() < 8 and np.array_equal(half.result[half.done], swept.result[half.done])
    whole = js.sweep(make, VARY, **RUN, batch=2, output=path, say=told.append)
    np.testing.assert_array_equal(whole.result, swept.result)
    np.testing.assert_allclose(whole.watched["tip"], swept.watched["tip"], rtol=1e-12)
    np.testing.assert_array_equal(whole.watched["tip"][half.done], half.watched["tip"][half.done])
    assert whole.messages == swept.messages


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"vary": {**VARY, "force": [1.0, 2e7]}}, r"another sweep: another vary"),
        ({"dt": 1.9e-4}, "another dt"),
        ({"method": js.CentralDifference(safety=0.8)}, "another method"),
        ({"make": lambda thickness, force: make(thickness, 2 * force)}, "another scene"),
        ({"quantities": {"work": lambda solution: solution.energy.external_work[-1]}}, "another quantities"),
    ],
)
def test_another_sweep_is_refused_by_name(changed, said, swept, path):
    before = path.read_bytes()
    arguments = {"vary": VARY, "make": make, **RUN, **changed}
    with pytest.raises(ValueError, match=f"{said}.*--overwrite"):
        js.sweep(arguments.pop("make"), arguments.pop("vary"), **arguments, batch=2, output=path)
    assert path.read_bytes() == before


def test_floats_of_a_scene_vary_by_where_they_are(swept):
    """The same program as that of a function; the last batch is filled up, and histories are kept at eleven times."""
    vary = {
        "thickness": (lambda s: s.section.thickness, [0.02, 0.021, 0.022]),
        "force": (lambda s: s.loads[0].force, np.array([[0, 0, 1.0]] * 3)),
    }
    found = js.sweep(make(), vary, **RUN, batch=2, sample="zip", times=11)
    assert found.successful.all()
    np.testing.assert_allclose(found.watched["tip"], swept.watched["tip"][[0, 2, 6], ::10], atol=1e-12 * 3e-5)
    np.testing.assert_allclose(found.maximum["tip"], swept.maximum["tip"][[0, 2, 6]], rtol=1e-12)
    with pytest.raises(ValueError, match="force has several per member"):
        found.sensitivities()


def test_calls_that_make_no_sweep_are_refused_by_name():
    for scene, vary, run, said in [
        (make, {"thicknes": [1.0]}, RUN, "No function takes 'thicknes'"),
        (make(), {"thickness": [0.02]}, RUN, r"\(where, values\)"),
        (make, {}, RUN, "Nothing varies"),
        (make, {"thickness": [0.005, 0.006]}, RUN, "No member of the sweep is a valid run.*critical step"),
        (make, {"thickness": [0.02]}, {**RUN, "batch": 0}, "batch must be a whole number"),
        (make, {"thickness": [0.02]}, {**RUN, "times": [0.0, 0.0]}, "times must rise"),
        (make, {"thickness": [0.02]}, {**RUN, "dt": lambda thickness: 2e-4, "save_every": 2}, "leave save_every out"),
    ]:
        with pytest.raises(ValueError, match=said):
            js.sweep(scene, vary, **run)


def test_the_command_line_runs_goes_on_and_draws(swept, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "strip.toml").write_text(STRIP)
    command = [
        "sweep",
        "strip.toml",
        "--vary",
        "section.thickness=0.02,0.021,0.01,0.022",
        "--vary",
        "loads.1.force.3=1,2",
    ]
    assert main([*command, "--batch", "2"]) == 0
    said, errors = capsys.readouterr()
    assert "strip: 8 members, grid" in said and "8 of 8 members done" in said and "2 failed: refused" in said
    assert "sensitivities (main effects S, 6 members)" in said and "tip max: 5 % below" in said
    assert "member 4 failed." in errors and "critical step" in errors
    assert {path.name for path in tmp_path.iterdir()} == {
        "strip.toml", "strip_sweep.h5", "strip_sweep_quantiles.png", "strip_sweep_sensitivities.png", "strip_sweep_scatter.png",
    }  # fmt: skip
    found = js.Sweep.load("strip_sweep.h5")
    assert list(found.parameters) == ["section.thickness", "loads.1.force.3"]
    np.testing.assert_allclose(found.watched["tip"][2], swept.watched["tip"][2], rtol=1e-12)
    assert main([*command, "--no-plots"]) == 0
    assert "members done," not in capsys.readouterr().out
    for more, reason in [
        (["--vary", "run.dt=1e-4,2e-4", "--dt", "2e-4"], "run.dt varies, but --dt holds it fast"),
        (["--quantity", "tip middle"], "no quantity 'tip middle'"),
        (["--seed", "1"], "another sweep: another seed"),
        (["--vary", "section.thickness=1,2"], "section.thickness twice"),
        (["--vary", "section.thickness"], "KEY=VALUES"),
        (["--method", "EMC", "exact"], "one method"),
        (["--reactions"], "keeps no reactions"),
    ]:
        assert main([*command, *more]) == 2
        assert reason in capsys.readouterr().err
