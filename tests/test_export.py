"""Exports: what VTK reads back is the solution, at the right times; tables and labelled arrays; files that must stay."""

import csv
import dataclasses
import shutil
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from synthetic import synthetic_solution

import jaxshell as js
from jaxshell.command.cli import main
from jaxshell.model import generators
from jaxshell.results.export import fields, vtkhdf
from jaxshell.results.frames import StoredFrames
from jaxshell.results.solution import RESULTS

vtk = pytest.importorskip("vtk")

STRENGTHS = {"X_t": 1.5, "X_c": 1.2, "Y_t": 0.05, "Y_c": 0.2, "S": 0.07}
CARBON = js.Orthotropic(140.0, 10.0, 0.3, 5.0, 1.6, 1e-3, 3e-3)
FIELDS = ["default", "s11 ply 0 top"]


@pytest.fixture(scope="module", autouse=True)
def _in_several_parts():
    """Eleven frames are computed four at a time."""
    before, fields._MOST = fields._MOST, 4
    yield
    fields._MOST = before


class Read:
    """What VTK makes of a file: the times, and the arrays of a frame as NumPy's."""

    def __init__(self, path):
        from vtkmodules.util.numpy_support import vtk_to_numpy

        self.array = vtk_to_numpy
        self.reader = vtk.vtkHDFReader()
        self.reader.SetFileName(str(path))
        self.reader.UpdateInformation()
        found = self.reader.GetOutputInformation(0).Get(vtk.vtkStreamingDemandDrivenPipeline.TIME_STEPS())
        self.times = np.array(found)

    def frame(self, k: int) -> dict[str, np.ndarray]:
        self.reader.UpdateTimeStep(self.times[k])
        grid = self.reader.GetOutput()
        found = {}
        for data in (grid.GetPointData(), grid.GetCellData(), grid.GetFieldData()):
            found |= {data.GetArrayName(i): self.array(data.GetArray(i)) for i in range(data.GetNumberOfArrays())}
        found["points"] = self.array(grid.GetPoints().GetData())
        found["triangles"] = self.array(grid.GetCells().GetConnectivityArray()).reshape(-1, 3)
        return {name: np.array(value) for name, value in found.items()}


def close(found, wanted, tolerance=1e-12):
    wanted = np.asarray(wanted)
    assert np.shape(found) == wanted.shape
    assert np.abs(found - wanted).max() <= tolerance * max(np.abs(wanted).max(), 1e-300)


def six(tensors):
    return np.stack([np.asarray(tensors)[..., i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))], -1)


@pytest.fixture(scope="module")
def scene() -> js.Scene:
    """Four triangles of a laminate that is heated, with sets."""
    flat = generators.rectangle(2.0, 1.0, (2, 1))
    mesh = js.Mesh(
        flat.nodes,
        flat.triangles,
        node_sets={"root": [0, 3]},
        element_sets={"skin": [0, 1], "a/b.c": [3]},
        side_sets={"tip": [[2, 5]]},
    )
    plies = [js.Ply(CARBON, 0.02, angle) for angle in (0.0, 45.0, 90.0)]
    return js.Scene(
        mesh,
        js.Laminate(plies),
        [js.clamped([0, 3])],
        [js.Thermal(20.0, history=js.History.ramp(0.6))],
        name="heated strip",
        watch={"tip/1": (2, "uz"), "root": (0, "Mxx")},
        defaults=js.scenes.PAPER["cap"]().defaults._replace(t_end=1.0, axes=()),
    )


@pytest.fixture(scope="module")
def solution(scene) -> js.Solution:
    return synthetic_solution(scene, steps=30)


@pytest.fixture(scope="module")
def exported(solution, tmp_path_factory) -> Read:
    path = tmp_path_factory.mktemp("export") / "strip.vtkhdf"
    solution.to_vtkhdf(path, FIELDS)
    return Read(path)


def test_vtk_reads_the_times_and_the_mesh(exported, solution):
    assert np.array_equal(exported.times, solution.frame_times) and len(exported.times) == 11
    for k in (0, 10):
        frame = exported.frame(k)
        assert np.array_equal(frame["points"], solution.scene.mesh.nodes)
        assert np.array_equal(frame["triangles"], solution.scene.mesh.triangles)


@pytest.mark.parametrize("k", [0, 4, 10])
def test_vtk_reads_every_field_as_it_is_computed(exported, solution, k):
    frame = exported.frame(k)
    close(frame["displacement"], solution.displacements[k])
    close(frame["velocity"], solution.velocities[k])
    close(Rotation.from_rotvec(frame["rotation"]).as_matrix(), solution.rotations[k])
    forces = js.section_forces(solution, k, axes="global", at="mean")
    scale = {"N": jnp.abs(forces.N).max(), "M": jnp.abs(forces.M).max()}
    assert k == 0 or min(scale.values()) > 0
    close(frame["N"], six(forces.N))
    close(frame["M"], six(forces.M))
    for face in ("top", "bottom"):
        stress = np.asarray(js.stresses(solution, k, face, axes="global", mean=True))
        close(frame[f"stress {face}"], six(stress))
        trace, square = np.trace(stress, axis1=1, axis2=2), np.einsum("mij,mij->m", stress, stress)
        close(frame[f"von mises {face}"], np.sqrt(1.5 * square - 0.5 * trace**2))
    close(frame["s11 ply 0 top"], js.stresses(solution, k, (0, "top"), axes="ply", mean=True)[:, 0])


@pytest.mark.slow
def test_vtk_reads_the_fields_that_are_asked_for_seldom(solution, tmp_path):
    solution.to_vtkhdf(tmp_path / "a.vtkhdf", ["all", "smax bottom"], failure={"tsai-wu": STRENGTHS})
    frame = Read(tmp_path / "a.vtkhdf").frame(4)
    close(frame["smax bottom"], js.principal(js.stresses(solution, 4, "bottom", mean=True)).values[:, 0])
    strains = js.section_strains(solution, 4, axes="global", at="mean")
    close(frame["strain"], six(strains.strain))
    close(frame["curvature"], six(strains.curvature))
    close(frame["element strain energy"], js.strain_energies(solution, 4))
    close(frame["failure index tsai-wu"], js.failure_index(solution, "tsai-wu", STRENGTHS, 4))
    corners = (np.asarray(solution.scene.mesh.nodes) + solution.displacements[4])[solution.scene.mesh.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    close(frame["normal"], normal / np.linalg.norm(normal, axis=1, keepdims=True))


def test_several_frames_each_have_the_heat_of_their_time(solution):
    """It rises up to 0.6; as N of all frames at once, each with the factor of its own time."""
    rows = [0, 3, 10]
    assert np.asarray(solution.frame_times)[rows].tolist() == pytest.approx([0.0, 0.3, 1.0])
    together = js.section_forces(solution, rows).N
    close(together, [js.section_forces(solution, row).N for row in rows])
    stresses = js.stresses(solution, rows, "top")
    close(stresses, [js.stresses(solution, row, "top") for row in rows])


@pytest.mark.slow
def test_vtk_draws_the_deformed_shell(solution, tmp_path):
    """Off-screen, warped by the displacement and coloured by von Mises' stress: neither blank nor of one colour."""
    pyvista = pytest.importorskip("pyvista")
    solution.to_vtkhdf(tmp_path / "a.vtkhdf", ["displacement", "von mises top"])
    read = Read(tmp_path / "a.vtkhdf")
    read.frame(10)
    shell = pyvista.wrap(read.reader.GetOutput())
    plotter = pyvista.Plotter(off_screen=True, window_size=(400, 300))
    plotter.add_mesh(shell.warp_by_vector("displacement"), scalars="von mises top", show_scalar_bar=False)
    image = np.asarray(plotter.screenshot(tmp_path / "a.png"))
    plotter.close()
    background = (image == image[0, 0]).all(axis=2)
    assert 0.05 < 1 - background.mean() < 0.95
    assert len(np.unique(image[~background], axis=0)) > 3


def test_sets_and_thickness_are_there_at_every_frame(exported):
    for k in (0, 7, 10):
        frame = exported.frame(k)
        assert frame["set root"].tolist() == [1, 0, 0, 1, 0, 0]
        assert frame["sides tip"].tolist() == [0, 0, 1, 0, 0, 1]
        assert frame["set skin"].tolist() == [1, 1, 0, 0]
        assert frame["set a%2Fb%2Ec"].tolist() == [0, 0, 0, 1]
        close(frame["thickness"], np.full(4, 0.06), 1e-15)


def test_energies_are_those_of_the_frames_step(exported, solution):
    for k in (0, 3, 10):
        frame = exported.frame(k)
        assert frame["kinetic energy"] == [float(solution.energy.kinetic[3 * k])]
        assert np.array_equal(frame["angular momentum"], [np.asarray(solution.momentum.angular[3 * k])])
        assert frame["watched tip%2F1"] == [float(solution.watched["tip/1"][3 * k])]


def test_components_in_the_elements_planes(solution, tmp_path):
    solution.to_vtkhdf(tmp_path / "a.vtkhdf", ["M", "Mxy material"], axes="material")
    frame = Read(tmp_path / "a.vtkhdf").frame(5)
    close(frame["M"], js.section_forces(solution, 5, axes="material", at="mean").M)
    close(frame["Mxy material"], frame["M"][:, 2])
    assert "N" not in frame and "velocity" not in frame


def test_frames_are_read_a_few_at_a_time(solution, tmp_path, monkeypatch):
    """Of a file: as many together as are computed together, however long the run."""
    solution.save(tmp_path / "a.h5")
    stored = js.Solution.load(tmp_path / "a.h5")
    read, at = [], StoredFrames.at
    monkeypatch.setattr(StoredFrames, "at", lambda self, which: (read.append(which), at(self, which))[1])
    monkeypatch.setattr(StoredFrames, "displacements", property(lambda self: pytest.fail("all frames were read")))
    waiting = []
    monkeypatch.setattr(vtkhdf.VTKHDFWriter, "_commit", _watched_commit(waiting, vtkhdf.VTKHDFWriter._commit))
    stored.to_vtkhdf(tmp_path / "a.vtkhdf", FIELDS)
    assert read == [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9, 10]]
    assert waiting == [0] * len(waiting) and len(waiting) >= 3
    whole = Read(tmp_path / "a.vtkhdf")
    close(whole.frame(9)["displacement"], solution.displacements[9])


def _watched_commit(waiting, commit):
    """Counts the frames that wait after every commit."""

    def watched(self):
        commit(self)
        waiting.append(len(self._waiting))

    return watched


def test_a_file_that_was_not_finished_opens_with_what_was_written(solution, tmp_path, monkeypatch):
    """A copy of the file taken while the writer still has it open is what a killed process leaves behind."""
    monkeypatch.setattr(vtkhdf, "_EVERY", 0.0)
    writer = js.VTKHDFWriter(tmp_path / "a.vtkhdf", ["displacement", "velocity"])
    writer.begin(solution.scene, {})
    for count, part in enumerate(vtkhdf.in_parts(solution, 3), 1):
        writer.append(part)
        shutil.copy(tmp_path / "a.vtkhdf", tmp_path / "killed.vtkhdf")
        killed = Read(tmp_path / "killed.vtkhdf")
        last = min(3 * count, 11) - 1
        assert np.array_equal(killed.times, solution.frame_times[: last + 1])
        close(killed.frame(last)["displacement"], solution.displacements[last])
    monkeypatch.setattr(vtkhdf, "_EVERY", 1e9)  # what waits when a run is stopped is written then
    writer.close()
    stopped = js.VTKHDFWriter(tmp_path / "b.vtkhdf", "displacement")
    stopped.begin(solution.scene, {})
    for part in vtkhdf.in_parts(solution, 3):
        stopped.append(part)
    assert len(stopped._waiting) > 0
    stopped.close()
    assert len(Read(tmp_path / "b.vtkhdf").times) == 11


# --- runs -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def strip() -> js.Scene:
    mesh = generators.rectangle(2.0, 1.0, (2, 1))
    section = js.Section(0.1, 1e4, 0.3, 1.0)
    return js.Scene(mesh, section, [js.clamped([0, 3])], [js.NodalForce([2], [0, 0, 1e3])], watch={"tip": (2, "uz")})


RUN: dict = {"method": js.CentralDifference(), "dt": 2e-4, "t_end": 4e-3, "save_every": 3, "reactions": True}


@pytest.fixture(scope="module")
def folder(strip, tmp_path_factory):
    """A run that was written as it went, its solution in strip.h5, and a run that failed."""
    folder = tmp_path_factory.mktemp("runs")
    output = [folder / "strip.h5", folder / "strip.vtkhdf"]
    js.simulate(strip, **RUN, output=output)
    return folder


def test_a_run_writes_the_file_that_its_solution_gives(folder):
    solution = js.Solution.load(folder / "strip.h5")
    solution.to_vtkhdf(folder / "after.vtkhdf")
    running, after = Read(folder / "strip.vtkhdf"), Read(folder / "after.vtkhdf")
    assert np.array_equal(running.times, solution.frame_times) and np.array_equal(after.times, running.times)
    for k in (0, 4, 7):
        a, b = running.frame(k), after.frame(k)
        assert list(a) == list(b)
        for name in a:
            close(a[name], b[name])
    close(running.frame(7)["watched tip"], solution.watched["tip"][-1:])


def test_a_failed_run_is_written_up_to_its_failure(strip, folder, monkeypatch):
    monkeypatch.setattr(js.CentralDifference, "check", lambda *_: None)
    dt = 2.0 * js.CentralDifference().critical_step(strip)
    steps = RUN | {"dt": dt, "t_end": 1000 * dt}
    failed = js.simulate(strip, **steps, throw=False, output=folder / "failed.vtkhdf")
    assert bool(failed.result == RESULTS.unstable) and 2 < len(failed.times) < 1000
    found = Read(folder / "failed.vtkhdf")
    assert np.array_equal(found.times, failed.frame_times)
    last = found.frame(len(found.times) - 1)
    close(last["displacement"], failed.displacements[-1])
    close(last["kinetic energy"], failed.energy.kinetic[-1:])


def test_statics_that_unload_are_counted_and_say_their_load_factors(strip, tmp_path):
    up = synthetic_solution(strip, steps=4, save_every=1)
    down = dataclasses.replace(
        up, times=jnp.array([0.0, 1.0, 2.0, 1.0, 0.5]), frame_times=jnp.array([0.0, 2.0, 0.5]), analysis="static"
    )
    down = dataclasses.replace(down, frames=up.frame([0, 2, 4]))
    down.to_vtkhdf(tmp_path / "a.vtkhdf", ["displacement"])
    found = Read(tmp_path / "a.vtkhdf")
    assert found.times.tolist() == [0.0, 1.0, 2.0]
    assert [found.frame(k)["load factor"].tolist() for k in range(3)] == [[0.0], [2.0], [0.5]]
    assert found.frame(1)["kinetic energy"] == [float(up.energy.kinetic[2])]
    rising = dataclasses.replace(up, analysis="static")
    rising.to_vtkhdf(tmp_path / "a.vtkhdf", "displacement")
    assert np.array_equal(Read(tmp_path / "a.vtkhdf").times, up.times)


@pytest.mark.slow
def test_statics_streams(strip, tmp_path):
    solution = js.solve_static(strip, [5e-4, 1e-3, 2e-4], output=tmp_path / "a.vtkhdf")
    found = Read(tmp_path / "a.vtkhdf")
    assert found.times.tolist() == [0.0, 1.0, 2.0, 3.0]
    close(found.frame(3)["displacement"], solution.displacements[3])
    assert found.frame(3)["load factor"] == [2e-4]
    solution.to_csv(tmp_path / "a.csv")
    with (tmp_path / "a.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["load factor"]) for row in rows] == [0.0, 5e-4, 1e-3, 2e-4]
    assert [row["stable"] for row in rows] == ["1", "1", "1", "1"]


# --- tables and labelled arrays -------------------------------------------------------------------------------


def test_the_table_has_every_step_with_all_digits(solution, folder):
    solution.to_csv(folder / "heated.csv")
    with (folder / "heated.csv").open() as file:
        head, *rows = csv.reader(file)
    assert head[:4] == ["time [s]", "watched tip/1 [m]", "watched root [N]", "kinetic energy [J]"]
    assert "angular momentum z [kg m^2/s]" in head and len(rows) == 31
    column = {name: np.array([float(row[k]) for row in rows]) for k, name in enumerate(head)}
    assert np.array_equal(column["time [s]"], solution.times)
    assert np.array_equal(column["watched tip/1 [m]"], solution.watched["tip/1"])
    assert np.array_equal(column["linear momentum y [kg m/s]"], solution.momentum.linear[:, 1])


def test_the_table_has_the_supports_resultant(folder):
    run = js.Solution.load(folder / "strip.h5")
    run.to_csv(folder / "strip.csv")
    with (folder / "strip.csv").open() as file:
        rows = list(csv.DictReader(file))
    total = np.asarray(js.reactions(run))[:, :, :3].sum(axis=1)
    found = [[float(row[f"reaction {axis}"]) for axis in "xyz"] for row in rows]  # no units: the scene states none
    close(np.array(found)[1:], total[1:])
    assert np.isnan(found[0]).all()  # as in the solution: no step has been taken


def test_labelled_arrays_are_the_solution(solution, tmp_path):
    xarray = pytest.importorskip("xarray")
    data = solution.to_xarray(FIELDS)
    assert data.sizes["node"] == 6 and data.sizes["element"] == 4 and data.sizes["frame_time"] == 11
    assert np.array_equal(data.displacement.sel(frame_time=0.4, xyz="z", method=None), solution.displacements[4, :, 2])
    assert data.displacement.attrs["units"] == "m" and data.time.attrs["units"] == "s"
    assert data.watched.sel(watch="root").watched_units == "N"
    stress = js.stresses(solution, 4, axes="global", mean=True)
    close(data.stress_top.isel(frame_time=4).sel(component_6="xy").values, stress[:, 0, 1])
    assert data.element_set_skin.values.tolist() == [True, True, False, False]
    kept = data.drop_vars(["element_set_a/b.c"])  # a name that netCDF does not allow
    kept.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    with xarray.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as again:
        xarray.testing.assert_identical(again.load(), kept)


def test_labelled_arrays_of_scenes_without_units_state_none(folder):
    pytest.importorskip("xarray")
    data = js.Solution.load(folder / "strip.h5").to_xarray("displacement")
    assert "units" not in data.displacement.attrs and "watched_units" not in data.coords
    assert data.reaction.dims == ("time", "held") and data.held_dof.values[:3].tolist() == ["ux", "uy", "uz"]


# --- what is refused ------------------------------------------------------------------------------------------


def test_a_batch_is_refused_by_name(solution, tmp_path):
    batch = jax.tree.map(lambda a: jnp.stack([a, a]), solution)
    for write in (
        lambda: batch.to_vtkhdf(tmp_path / "a.vtkhdf"),
        lambda: batch.to_csv(tmp_path / "a.csv"),
        lambda: batch.to_xarray(),
    ):
        with pytest.raises(ValueError, match=r"one run.*\(2, 31\).*Index the batch"):
            write()


def test_fields_that_the_scene_does_not_have_are_named(solution, strip, tmp_path):
    path = tmp_path / "a.vtkhdf"
    for asked, message in (
        ("stres top", "no field 'stres top'.*displacement.*Mxx"),
        (["displacement", 3], "no field 3"),
        ("s11 ply 7", "no ply 7"),
        ("failure index tsai-wu", "failure="),
    ):
        with pytest.raises(ValueError, match=message):
            solution.to_vtkhdf(path, asked)
    with pytest.raises(ValueError, match="lacks S"):
        solution.to_vtkhdf(path, failure={"tsai-wu": {name: 1.0 for name in STRENGTHS if name != "S"}})
    stiffnesses = js.GeneralSection(A=np.eye(3), B=None, D=np.eye(3), mass_per_area=1.0, rotary_inertia=0.01)
    bare = synthetic_solution(dataclasses.replace(strip, section=stiffnesses))
    with pytest.raises(ValueError, match="'thickness' needs a section of layers"):
        bare.to_vtkhdf(path, "thickness")
    assert not list(tmp_path.iterdir())
    assert fields.choose(bare.scene).names == ("displacement", "rotation", "velocity", "N", "M")


def test_a_file_of_others_stays(solution, tmp_path):
    path = tmp_path / "a.vtkhdf"
    path.write_text("mine")
    with pytest.raises(ValueError, match=r"no results of jaxshell.*--overwrite"):
        solution.to_vtkhdf(path, "displacement")
    assert path.read_text() == "mine" and list(tmp_path.iterdir()) == [path]
    solution.to_vtkhdf(path, "displacement", overwrite=True)
    solution.to_vtkhdf(path, "velocity")  # one of ours is replaced
    assert "displacement" not in Read(path).frame(0)


def test_without_xarray_its_command_is_said(solution, monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(ImportError, match="pip install xarray"):
        solution.to_xarray()


# --- the command line -----------------------------------------------------------------------------------------


def test_command_writes_beside_the_file_or_where_it_is_told(folder, capsys):
    h5 = str(folder / "strip.h5")
    assert main(["export", h5, "--to", "csv", "--output", str(folder / "made")]) == 0
    assert (folder / "made" / "strip.csv").read_text().startswith("time,watched tip,")
    command = ["export", h5, "--to", "vtkhdf", "--output", str(folder / "other.vtkhdf")]
    assert main([*command, "--fields", "displacement", "velocity"]) == 0
    assert {"displacement", "velocity"} <= set(Read(folder / "other.vtkhdf").frame(0))
    assert str(folder / "other.vtkhdf") in capsys.readouterr().out


def test_command_writes_as_it_runs(folder):
    """The run of a result file again: with the same numbers."""
    command = ["run", str(folder / "strip.h5"), "--vtkhdf", "--no-plots", "--quiet", "--output", str(folder / "again")]
    assert main(command) == 0
    again, first = Read(folder / "again" / "strip_rerun.vtkhdf"), Read(folder / "strip.vtkhdf")
    assert np.array_equal(again.times, first.times)
    for name, value in first.frame(7).items():
        close(again.frame(7)[name], value)


def test_command_says_what_is_wrong(folder, capsys):
    h5 = str(folder / "strip.h5")
    for words, message in (
        ([h5, "--to", "csv", "--fields", "N"], "--fields is not for csv"),
        ([h5, h5, "--to", "csv", "--output", str(folder / "one.csv")], "name a folder"),
        ([h5, "--to", "vtkhdf", "--failure", "tsai-wu", "X_t"], "'X_t' is not NAME=NUMBER"),
        ([h5, "--to", "vtkhdf", "--failure", "von-mises", "yeld=3"], "unknown name 'yeld'"),
        ([h5, "--to", "vtkhdf", "--fields", "nonsense"], "no field 'nonsense'"),
        ([str(folder / "none.h5"), "--to", "csv"], "There is no file"),
    ):
        assert main(["export", *words]) == 2
        assert message in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["export", h5, "--to", "xlsx"])
    assert "vtkhdf" in capsys.readouterr().err
