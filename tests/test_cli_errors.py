"""`jaxshell run --errors`: what it prints is what `richardson` and `mesh_errors` find; drawn and exported."""

import h5py
import numpy as np
import pytest
from strip import STRIP

import jaxshell as js
from jaxshell.analyses.richardson import percent
from jaxshell.command.cli import main
from jaxshell.command.errors import describe_errors, with_half_step
from jaxshell.files.scene_file import read_scene_file
from jaxshell.plotting import figures

FINER = STRIP.replace("[1, 1]", "[2, 2]").replace("2e-4", "1e-4")


def run(scene, dt=1e-4):
    return js.simulate(scene, js.CentralDifference(), dt=dt, t_end=0.02)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("errors")
    (folder / "strip.toml").write_text(FINER + "errors = true\n")
    return folder


@pytest.fixture(scope="module")
def printed(folder):
    with pytest.MonkeyPatch.context() as patch:
        lines = []
        patch.setattr("builtins.print", lambda *words, **_: lines.extend(" ".join(map(str, words)).split("\n")))
        assert main(["run", str(folder / "strip.toml"), "--output", str(folder), "--no-plots"]) == 0
    return lines


@pytest.fixture(scope="module")
def solution(folder, printed):
    return js.Solution.load(folder / "strip.h5")


def test_a_run_says_the_errors_of_mesh_and_step_of_what_is_watched(folder, printed, solution):
    scene = read_scene_file(folder / "strip.toml")[0]
    study = js.richardson([js.coarsen(scene), scene], run, half_step=lambda scene: run(scene, 5e-5))
    at = printed.index("  errors: the same on 2 triangles and with half the step ...")
    peak = float(np.asarray(solution.watched["tip"]).max())
    wanted = f"    tip: {peak:.6g}, mesh error {percent(study.error('tip'))}, by two meshes; step error "
    assert printed[at + 1] == wanted + percent(study.step_error("tip"))
    assert 0.01 < study.error("tip") < 0.5 and 0 < study.step_error("tip") < 0.01


def test_a_run_says_the_recovered_error_at_its_largest_strain_energy(printed, solution):
    frame = int(np.argmax(solution.energy.strain))
    errors = js.mesh_errors(solution, frame)
    wanted = f"{percent(float(errors.relative))} off in the norm of energy, by recovery, at t = "
    said = next(line for line in printed if "by recovery" in line)
    assert wanted in said and f"t = {float(solution.frame_times[frame]):.6g};" in said
    assert said.endswith(f"element {int(np.argmax(errors.local))}")


@pytest.mark.slow
def test_the_error_is_exported_and_drawn(folder, solution):
    frame = len(solution.frame_times) - 1
    local = np.asarray(js.mesh_errors(solution).local)
    assert main(["export", str(folder / "strip.h5"), "--to", "vtkhdf", "--fields", "mesh error"]) == 0
    with h5py.File(folder / "strip.vtkhdf") as file:
        stored = np.asarray(file["VTKHDF/CellData/mesh error"])
    np.testing.assert_allclose(stored.reshape(frame + 1, -1)[frame], local, rtol=1e-10)
    drawn = figures(solution, ["mesh error"], renderer="matplotlib")["mesh_error"]
    bar = drawn.axes[-1]
    assert bar.get_ylabel() == "Error of the mesh (energy norm) in %"
    shown = js.mesh_errors(solution, [0, *np.unique(np.linspace(0, frame, 9).astype(int))]).local
    assert bar.get_ylim()[1] == pytest.approx(100 * float(np.max(shown)), rel=0.2)


def test_what_cannot_be_told_is_said(solution):
    """Nothing watched; and a mesh that can only be refined, on which the step is too long."""
    silent = []
    scene = js.Scene(solution.scene.mesh, solution.scene.section, solution.scene.supports, solution.scene.loads)
    lines = describe_errors(scene, run_of(scene, solution), lambda each: run_of(each, solution), None, silent.append)
    assert lines[0].startswith("    not known: The scene watches nothing")
    alone = js.Scene(js.Mesh(np.eye(3), [[0, 1, 2]]), solution.scene.section)

    def refused(scene):
        raise ValueError("dt is 1")

    assert describe_errors(alone, {"a": 1.0}, refused, None, silent.append) == ["    not known: dt is 1"]
    assert silent == ["  errors: the same on 2 triangles ...", "  errors: the same on 4 triangles ..."]


def run_of(scene, solution):
    """That run, as if nothing were watched."""
    named = {name: getattr(solution, name) for name in ("times", "energy", "momentum", "iterations", "frame_times")}
    return js.Solution(scene, watched={}, frames=solution.frames, **named)


def test_a_mesh_too_coarse_to_run_is_left_out():
    scene = js.scenes.hemisphere((4, 4))

    def area(scene):
        if scene.mesh.n_elements == 2:
            raise ValueError("too coarse")
        return {"area": js.mass_properties(scene).mass}

    said = []
    lines = describe_errors(scene, area(scene), area, None, said.append)
    assert said == ["  errors: the same on 2 and 8 triangles ..."]
    assert "mesh error" in lines[0] and lines[0].endswith("by two meshes")


def test_half_a_step_is_half_of_a_controlled_step_too():
    assert with_half_step(0.1) == 0.05
    control = with_half_step(js.StepControl(1e-3, initial=0.1, smallest=0.08, output_interval=1.0))
    assert (float(control.tolerance), float(control.initial)) == pytest.approx((1e-3 / 8, 0.05))
    assert float(control.smallest) == pytest.approx(0.05) and control.output_interval == 1.0


def test_a_run_that_goes_on_has_no_errors_of_its_own(folder, solution, capsys):
    assert main(["run", str(folder / "strip.h5"), "--continue", "--t-end", "0.001", "--errors"]) == 2
    assert "leave --continue out" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("analysis, first", [("static", "tip"), ("modes", "mode 1")])
def test_other_analyses_say_the_meshs_error(analysis, first, folder, capsys):
    options = ["--analysis", analysis, "--no-plots", "--output", str(folder)]
    options += ["--load-steps", "2"] if analysis == "static" else ["--count", "2"]
    (folder / "plain.toml").write_text(FINER.split("[run]")[0])
    assert main(["run", str(folder / "plain.toml"), "--errors", *options]) == 0
    lines = capsys.readouterr().out.splitlines()
    at = lines.index("  errors: the same on 2 triangles ...")
    assert lines[at + 1].startswith(f"    {first}: ") and lines[at + 1].endswith("by two meshes")
    assert any("by recovery, at load factor 1;" in line for line in lines) == (analysis == "static")
