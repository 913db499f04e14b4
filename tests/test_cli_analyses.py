"""Statics, arc length, frequencies and buckling from scene files: the answers of the functions, files, refusals."""

import h5py
import jax
import jax.numpy as jnp
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)

import jaxshell as js  # noqa: E402
from jaxshell.command.cli import main  # noqa: E402
from jaxshell.files.run_keys import RunSettings  # noqa: E402
from jaxshell.files.scene_file import read_scene_file  # noqa: E402
from jaxshell.results.hdf5 import read_scene, read_settings  # noqa: E402

COLUMN = """
units = "SI"
[mesh]
generator = "rectangle"
length = 1.0
width = 0.2
divisions = [8, 1]
node_sets = { root = { plane = { x = 0.0 } } }
[section]
thickness = 0.01
young_modulus = 1e9
poisson_ratio = 0.0
density = 1000.0
[[supports]]
nodes = "root"
hold = "clamped"
[[loads]]
kind = "edge force"
plane = { x = 1.0 }
force = [-100.0, 0.0, 1.0]
[watch]
tip = { nearest = [1.0, 0.0, 0.0], component = "uz" }
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("analyses")
    (folder / "column.toml").write_text(COLUMN)
    return folder


@pytest.fixture(scope="module")
def scene(folder):
    return read_scene_file(folder / "column.toml")[0]


def run(folder, *options, status=0):
    assert main(["run", str(folder / "column.toml"), "--output", str(folder), *options]) == status


@pytest.fixture(scope="module")
def static(folder, scene):
    """The solution that the function gives for the load factors that the tests run."""
    return js.solve_static(scene, [0.5, 1.0])


def test_statics_are_those_of_the_function(folder, static, capsys):
    (folder / "loaded.toml").write_text(COLUMN + '[run]\nanalysis = "static"\nload_factors = [0.5, 1.0]\n')
    assert main(["run", str(folder / "loaded.toml"), "--output", str(folder)]) == 0
    said = capsys.readouterr().out
    found = js.Solution.load(folder / "loaded.h5")
    assert np.array_equal(found.times, [0.0, 0.5, 1.0]) and found.analysis == "static"
    assert np.array_equal(found.displacements, static.displacements)
    assert "statics: 2 steps to load factor 1 in" in said and "every equilibrium is stable" in said
    # The edge carries 0.2 · (-100, 0, 1), which the support balances.
    assert "reactions at load factor 1: force (20, 0, -0.2), moment about the origin (" in said
    assert {path.name for path in folder.glob("loaded*.png")} == {"loaded_shapes.png", "loaded_path.png"}


def test_a_static_file_asks_for_the_same_again(folder, static):
    """And what is written for ParaView as it goes is the run."""
    run(folder, "--analysis", "static", "--load-steps", "2", "--vtkhdf", "--quiet", "--no-plots")
    path = folder / "column_static.h5"
    with h5py.File(folder / "column_static.vtkhdf") as file:
        assert np.array_equal(file["VTKHDF/Steps/Values"], static.times)
        shapes = np.reshape(file["VTKHDF/PointData/displacement"], np.shape(static.displacements))
    assert np.array_equal(shapes, static.displacements)
    settings = RunSettings.from_result_file(read_settings(path)).said()
    assert settings["analysis"] == "static" and settings["load_factors"] == (0.5, 1.0)
    assert (settings["branch"], settings["newton_tolerance"], settings["newton_reuse"]) == ("straight", 1e-12, False)
    assert main(["run", str(path), "--output", str(folder), "--quiet", "--no-plots"]) == 0
    again = js.Solution.load(folder / "column_static_rerun.h5")
    assert np.array_equal(again.displacements, static.displacements)


def test_a_column_that_buckles_says_so(folder, capsys):
    """Euler's load of the fixed column is π²EI/4L² = 41.1 on its width of 0.2: factor 2.06 of the scene's 20."""
    run(folder, "--analysis", "buckling", "--count", "1", "--no-plots")
    said = capsys.readouterr().out
    modes, scene = js.BucklingModes.load(folder / "column_buckling.h5")
    assert "buckling: 1 load factors in" in said and scene.mesh.n_elements == 16
    euler = np.pi**2 * 1e9 * 0.2 * 0.01**3 / 12 / 4 / 20
    assert float(modes.load_factors[0]) == pytest.approx(euler, rel=0.01)
    assert modes.load_factors[0] == js.linear_buckling(read_scene(folder / "column_buckling.h5"), 1).load_factors[0]


def test_frequencies_are_those_of_the_function_and_their_file_is_drawn_and_run_again(folder, scene, capsys):
    run(folder, "--analysis", "modes", "--count", "3", "--no-plots")
    said = capsys.readouterr().out
    modes, of = js.Modes.load(folder / "column_modes.h5")
    expected = js.natural_frequencies(scene, 3)
    assert np.array_equal(modes.frequencies, expected.frequencies) and np.array_equal(modes.shapes, expected.shapes)
    assert of.name == "column" and "frequency [Hz]" in said
    assert f"     1  {float(modes.frequencies[0]):>14.6g}" in said
    assert main(["plot", str(folder / "column_modes.h5"), "--output", str(folder / "drawn")]) == 0
    assert [path.name for path in (folder / "drawn").iterdir()] == ["column_modes_modes.png"]
    assert main(["run", str(folder / "column_modes.h5"), "--output", str(folder), "--quiet", "--no-plots"]) == 0
    assert np.array_equal(js.Modes.load(folder / "column_modes_rerun.h5")[0].frequencies, expected.frequencies)


@pytest.mark.slow
def test_frequencies_under_load_are_those_about_the_loaded_state(folder, scene):
    run(folder, "--analysis", "modes", "--count", "1", "--preload", "1", "--no-plots", "--quiet", "--overwrite")
    loaded = float(js.Modes.load(folder / "column_modes.h5")[0].frequencies[0])
    about = js.solve_static(scene, np.arange(1, 11) / 10)
    assert loaded == float(js.natural_frequencies(scene, 1, about).frequencies[0])
    # A beam under the fraction p of its buckling load vibrates at √(1 - p) of its frequency.
    free = float(js.natural_frequencies(scene, 1).frequencies[0])
    assert loaded / free == pytest.approx(np.sqrt(1 - 1 / 2.056), rel=0.02)


@pytest.mark.slow
def test_arc_length_is_that_of_the_function(folder, scene, capsys):
    options = ["--analysis", "arc-length", "--arc-length", "0.005", "--max-steps", "3", "--max-load-factor", "0.5"]
    options += ["--vtkhdf"]
    run(folder, *options)
    found = js.Solution.load(folder / "column_arc_length.h5")
    expected = js.solve_arc_length(scene, 0.005, steps=3, max_load_factor=0.5)
    assert np.array_equal(found.times, expected.times) and np.array_equal(found.displacements, expected.displacements)
    said = capsys.readouterr().out
    assert f"arc length: {len(found.times) - 1} steps to load factor" in said and "column_arc_length.vtkhdf\n" in said
    with h5py.File(folder / "column_arc_length.vtkhdf") as file:
        assert np.array_equal(np.ravel(file["VTKHDF/FieldData/load factor"]), found.times)
    settings = RunSettings.from_result_file(read_settings(folder / "column_arc_length.h5"))
    assert (settings.arc_length, settings.max_steps, settings.max_load_factor) == (0.005, 3, 0.5)


def test_files_of_another_kind_are_named(folder, scene, static):
    static.save(folder / "still.h5")
    js.Modes(jnp.ones(1), jnp.zeros((1, scene.mesh.n_nodes, 6))).save(folder / "one.h5", scene)
    static.to_vtkhdf(folder / "still.vtkhdf", "displacement")
    for read, name, message in (
        (
            js.Solution.load,
            "still.vtkhdf",
            r"still\.vtkhdf is a VTKHDF file, for ParaView: name the result file that it",
        ),
        (js.Solution.load, "one.h5", "holds natural frequencies, not a run: jaxshell.Modes.load reads it"),
        (js.BucklingModes.load, "one.h5", "holds natural frequencies, not buckling factors"),
        (js.Modes.load, "still.h5", "holds a run, not natural frequencies: jaxshell.Solution.load reads it"),
    ):
        with pytest.raises(ValueError, match=message):
            read(folder / name)


def test_nothing_is_computed_where_nothing_can_be_written(folder, capsys, monkeypatch):
    (folder / "taken_modes.h5").write_text("mine")
    (folder / "taken.toml").write_text(COLUMN)
    monkeypatch.setattr("jaxshell.analyses.modal.natural_frequencies", lambda *_, **__: pytest.fail("computed"))
    assert main(["run", str(folder / "taken.toml"), "--analysis", "modes", "--output", str(folder), "--quiet"]) == 2
    assert "exists and holds no results of jaxshell" in capsys.readouterr().err
    assert (folder / "taken_modes.h5").read_text() == "mine"


@pytest.mark.parametrize(
    ("run_table", "options", "message"),
    [
        ('analysis = "modes"\ndt = 0.1', [], '[run] dt is for analysis = "time", but the analysis is "modes"'),
        ("load_steps = 3", [], '[run] load_steps is for analysis = "static", but the analysis is "time"'),
        ('analysis = "static"\nload_steps = 3\nload_factors = [1.0]', [], "[run] load_factors and load_steps say the"),
        ('analysis = "modal"', [], "[run] analysis must be one of time, static, arc-length, modes, buckling, but it is "
         "'modal'. Did you mean 'modes'?"),
        ('analysis = "static"', ["--dt", "0.1"], 'dt is for analysis = "time", but the analysis is "static"'),
        ('analysis = "static"', ["--continue"], '--continue goes on with a run in time, but the analysis is "static"'),
        ("", ["--analysis", "buckling", "--method", "EMC"], 'method is for analysis = "time", but the analysis is "buck'),
        ("", ["--analysis", "modes", "--vtkhdf"], '--vtkhdf is for runs in time, "static" and "arc-length", but'),
        ("", ["--count", "3"], 'count is for analysis = "modes" or "buckling", but the analysis is "time"'),
        ("", ["--analysis", "modes", "--preload", "0"], "preload must not be zero"),
        ("", ["--analysis", "modes", "--count", "900"], "count must be a whole number from 1 to 94"),
    ],
)  # fmt: skip
def test_what_does_not_fit_the_analysis_is_refused(run_table, options, message, tmp_path, capsys):
    (tmp_path / "wrong.toml").write_text(f"{COLUMN}[run]\n{run_table}\n")
    arguments = ["run", str(tmp_path / "wrong.toml"), "--output", str(tmp_path), "--quiet", "--no-plots", *options]
    assert main(arguments) == 2
    assert message in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["wrong.toml"]


def test_a_shell_that_nothing_holds_has_no_statics(tmp_path, capsys):
    free = COLUMN.replace('hold = "clamped"', 'hold = ["uz"]')
    (tmp_path / "free.toml").write_text(free)
    assert main(["run", str(tmp_path / "free.toml"), "--analysis", "static", "--output", str(tmp_path), "--quiet"]) == 2
    assert "The supports leave the shell free to move as a rigid body" in capsys.readouterr().err
