"""Models of Nastran: each card against the same scene stated by hand, and errors with file and line."""

import warnings

import jax
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)

from stated import assert_alike, same  # noqa: E402

import jaxshell as js  # noqa: E402
from jaxshell.command.cli import main  # noqa: E402
from jaxshell.files.scene_file import read_scene_file  # noqa: E402

CONTROL = """SOL {solution}
CEND
TITLE = A plate of six nodes
SPC = 11
SUBCASE 1
{case}
BEGIN BULK
"""
GRIDS = """$ free fields, small ones and large ones
GRID,1,,0.,0.,0.
GRID    2               1.      0.0     0.
GRID*   3                               2.+0            0.0
*       0.0
GRID    4               0.      1.      0.
GRID    5               1.      1.      0.
GRID    6               2.      1.      0.
"""
ELEMENTS = """CTRIA3  1       10      1       2       5
CTRIA3  2       10      1       5       4
CQUAD4  10      20      2       3       6       5       {quad}
"""
PLAIN = "PSHELL  10      1       .01     1\nPSHELL  20      1       .02     1\n"
MATERIAL = "MAT1    1       7.1+10          .33     2700.\n"
HELD = "SPC1    11      123456  1       4\n"
NODES = [[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0]]
MESH = js.Mesh(NODES, [[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]])
ROOT = js.clamped([0, 3])
RAMP = js.History.ramp(1.0)
CARBON = "MAT8*   2               1.4E+11         1.0E+10         .3\n*       5.0E+9                                          1600.\n"
CARBON_PLY = js.Orthotropic(1.4e11, 1e10, 0.3, 5e9, 1600.0)


def aluminium(thickness: float, density: float = 2700.0) -> js.Section:
    return js.Section(thickness, 7.1e10, 0.33, density)


TWO = [([0, 1], aluminium(0.01)), ([2, 3], aluminium(0.02))]


def write(tmp_path, bulk: str, solution: str = "106", case: str = "", quad: str = "", mesh: str = GRIDS):
    text = CONTROL.format(solution=solution, case=case) + mesh + ELEMENTS.format(quad=quad) + bulk + "ENDDATA\n"
    (tmp_path / "model.bdf").write_text(text, encoding="utf-8")
    return tmp_path / "model.bdf"


def read(tmp_path, *arguments, **named) -> js.Scene:
    """The scene of a file, without a word of warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return js.read_model(write(tmp_path, *arguments, **named))


def through_toml(tmp_path) -> js.Scene:
    """The scene of the file that `jaxshell import` writes of model.bdf."""
    assert main(["import", str(tmp_path / "model.bdf"), str(tmp_path / "scene.toml"), "--overwrite"]) == 0
    return read_scene_file(tmp_path / "scene.toml")[0]


# --- answers ---------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_frequencies_of_a_bulk_data_file_are_those_of_the_scene_by_hand(tmp_path):
    """A laminate whose plies count from a turned side of the quad, off the grid points, and mass that is no structure."""
    bulk = (
        HELD
        + MATERIAL
        + CARBON
        + "PARAM,WTMASS,0.5\nPSHELL  10      1       .01     1                               2.\n"
    )
    bulk += "PCOMP   20      -.012                                           SYM\n"
    bulk += "        2       .002    0.0     YES     2       .003    90.\nEIGRL   9                       3\n"
    scene = read(tmp_path, bulk, solution="103", case="METHOD = 9", quad="30.     .001")
    carbon = js.Orthotropic(1.4e11, 1e10, 0.3, 5e9, 800.0)
    direction = [np.cos(np.pi / 6), np.sin(np.pi / 6), 0.0]
    laminate = js.Laminate([js.Ply(carbon, 0.002), js.Ply(carbon, 0.003, 90.0)], direction, -0.006, symmetric=True)
    by_hand = js.Scene(MESH, [([0, 1], aluminium(0.01, 0.5 * (2700.0 + 2.0 / 0.01))), ([2, 3], laminate)], [ROOT])
    assert_alike(scene, by_hand)
    from_file = through_toml(tmp_path)
    assert same(scene, from_file)
    assert read_scene_file(tmp_path / "scene.toml")[1].said() == {"analysis": "modes", "count": 3}
    one, other = (np.asarray(js.natural_frequencies(s, count=3).frequencies) for s in (from_file, by_hand))
    np.testing.assert_allclose(one, other, rtol=1e-12)


def test_supports_and_loads_of_a_static_subcase(tmp_path):
    """SPC, SPC1 and PS; FORCE in another system, MOMENT, PLOAD2, PLOAD4, GRAV, in a LOAD."""
    bulk = (
        PLAIN
        + MATERIAL
        + "SPCADD  11      12      13\nSPC1    12      123456  1       THRU    1\nSPC     13      4       123\n"
    )
    bulk += "SPC     13      4       456             6       2       .01\n"
    bulk += "LOAD    30      2.      1.      31      0.5     32\n"
    bulk += "CORD2R  7               0.      0.      0.      1.      0.      0.\n        0.      1.      0.\n"
    bulk += "FORCE   31      3       7       10.     0.      0.      1.\nMOMENT  31      3               3.      0.      1.\n"
    bulk += "PLOAD4  32      1       100.\nPLOAD4  32      2       100.\nPLOAD2  32      7.      10\n"
    bulk += "GRAV    32              9.81            \n".replace("            \n", "    0.      0.      -1.\n")
    bulk += "FORCE   99      3               1.      1.      0.      0.\n"
    grids = GRIDS.replace(
        "GRID    5               1.      1.      0.", "GRID    5               1.      1.      0.              6"
    )
    scene = read(tmp_path, bulk, case="LOAD = 30", mesh=grids)
    by_hand = js.Scene(
        MESH,
        TWO,
        [ROOT, js.Support([4], "rz"), js.Support([5], "uy", 0.01, RAMP)],
        [
            js.NodalForce([2], [20.0, 0, 0], RAMP),
            js.NodalMoment([2], [0, 6.0, 0], RAMP),
            js.Pressure([100.0, 100.0], RAMP, elements=[0, 1]),
            js.Pressure(7.0, RAMP, elements=[2, 3]),
            js.Gravity([0, 0, -9.81], RAMP),
        ],
    )
    assert_alike(scene, by_hand)
    assert same(scene, through_toml(tmp_path))
    assert '\nelements = "PSHELL 10"\n' in (tmp_path / "scene.toml").read_text()


def test_systems_of_grid_points_and_what_holds_for_all_grid_points(tmp_path):
    """CORD1R defines two systems in a line; GRDSET holds uz everywhere but where a grid point says 0."""
    grids = "CORD1R  7       1       2       4       8       1       4       2\nGRDSET                                                  3\n"
    grids += GRIDS.replace(
        "GRID    6               2.      1.      0.", "GRID    6               2.      1.      0.              0"
    )
    bulk = (
        PLAIN
        + MATERIAL
        + HELD
        + "FORCE   30      3       7       5.      1.\nFORCE   30      6       8       7.      0.      1.\n"
    )
    scene = read(tmp_path, bulk, case="LOAD = 30", mesh=grids)
    forces = js.NodalForce([2, 5], [[0, 5.0, 0], [0, 0, -7.0]], RAMP)
    assert_alike(scene, js.Scene(MESH, TWO, [ROOT, js.Support([1, 2, 4], "uz")], [forces]))
    assert same(scene, through_toml(tmp_path))


def test_a_transient_with_a_table(tmp_path):
    """Nastran goes on along a table's last line."""
    bulk = PLAIN + MATERIAL + HELD + "TSTEP   5       40      .001    4\nDLOAD   8       1.      3.      81\n"
    bulk += "TLOAD1  81      82                      83\nDAREA   82      3       3       2.\n"
    bulk += "TABLED1 83\n        0.0     0.0     .005    1.0     .01     .5      ENDT\n"
    scene = read(tmp_path, bulk, solution="129", case="DLOAD = 8\nTSTEP = 5")
    history = js.History([0.0, 0.005, 0.01, 0.04], [0.0, 1.0, 0.5, -2.5])
    assert_alike(scene, js.Scene(MESH, TWO, [ROOT], [js.NodalForce([2], [0, 0, 6.0], history)]))
    assert (scene.defaults.dt, scene.defaults.t_end, scene.defaults.save_every) == (0.001, 0.04, 4)
    assert same(scene, through_toml(tmp_path))


def test_buckling_has_the_loads_of_its_first_subcase(tmp_path):
    bulk = (
        PLAIN
        + MATERIAL
        + HELD
        + "FORCE   30      3               10.     -1.     0.      0.\nEIGRL   9                       2\n"
    )
    scene = read(tmp_path, bulk, solution="105", case="LOAD = 30\nSUBCASE 2\nMETHOD = 9")
    assert_alike(scene, js.Scene(MESH, TWO, [ROOT], [js.NodalForce([2], [-10.0, 0, 0], RAMP)]))
    through_toml(tmp_path)
    assert read_scene_file(tmp_path / "scene.toml")[1].said() == {"analysis": "buckling", "count": 2}


def test_grid_points_in_a_cylinder_and_plies_along_a_system(tmp_path):
    grids = """CORD2C  7               0.      0.      0.      0.      0.      1.
        1.      0.      0.
CORD2R  8               0.      0.      0.      1.      0.      0.
        0.      0.      1.
GRID    1       7       2.      0.      0.
GRID    2       7       2.      30.     0.
GRID    3       7       2.      60.     0.
GRID    4       7       2.      0.      1.
GRID    5       7       2.      30.     1.
GRID    6       7       2.      60.     1.
"""
    bulk = (
        HELD + CARBON + "PSHELL  10      2       .01     2\nPCOMPG  20\n        9       2       .01     45.     YES\n"
    )
    bulk = bulk.replace("PSHELL  10      2       .01     2\n", "PCOMP   10\n        2       .01     0.\n")
    scene = read(tmp_path, bulk, mesh=grids, quad="8")
    angle = np.deg2rad([0.0, 30, 60, 0, 30, 60])
    nodes = np.stack([2 * np.cos(angle), 2 * np.sin(angle), [0.0, 0, 0, 1, 1, 1]], axis=1)
    np.testing.assert_allclose(scene.mesh.nodes, nodes, atol=1e-14)
    side = [nodes[1] - nodes[0], nodes[4] - nodes[0]]
    by_hand = js.Scene(
        scene.mesh,
        [
            ([0, 1], js.Laminate([js.Ply(CARBON_PLY, 0.01)], side)),
            ([2, 3], js.Laminate([js.Ply(CARBON_PLY, 0.01, 45.0)], [0.0, 0.0, 1.0])),
        ],
        [ROOT],
    )
    assert_alike(scene, by_hand)
    assert same(scene, through_toml(tmp_path))


# --- what is not carried over ----------------------------------------------------------------------------


def test_a_pressure_on_sides_is_refused(tmp_path):
    write(
        tmp_path,
        PLAIN + MATERIAL + HELD + "PLOAD4  32      1       100.\n                                        LINE    X\n",
        case="LOAD = 32",
    )
    with pytest.raises(ValueError, match=r"  PLOAD4 of type LINE, X \(model\.bdf, line 23\)\n"):
        js.read_model(tmp_path / "model.bdf")


def test_what_has_no_counterpart_is_listed_or_refused(tmp_path, capsys):
    bulk = PLAIN + MATERIAL + HELD + "PARAM,POST,-1\nPLOTEL,90,1,2\n"
    write(tmp_path, bulk, solution="101", case="SUBCASE 2")
    with pytest.warns(UserWarning) as caught:
        js.read_model(tmp_path / "model.bdf")
    said = [str(w.message).split("model.bdf: ", 1)[1] for w in caught]
    assert said == [
        "not carried over: subcase 2: only the first one is carried over",
        "not carried over: 1 PLOTEL (the first: model.bdf, line 24)",
        "not carried over: PARAM POST",
        "note: SOL 101 is linear, and jaxshell turns and moves by finite amounts",
    ]
    write(tmp_path, bulk + "CONM2,91,3,,5.,1.\nRBE2,92,1,123456,2\n", solution="106")
    with pytest.raises(ValueError) as error:
        js.read_model(tmp_path / "model.bdf")
    lines = ["CONM2 91 (model.bdf, line 25): beside its grid point", "1 RBE2 (the first: model.bdf, line 26)"]
    assert all(line in str(error.value) for line in lines)
    assert main(["import", str(tmp_path / "model.bdf"), str(tmp_path / "scene.toml"), "--partial"]) == 0
    assert "  not carried over: CONM2 91 (model.bdf, line 25): beside its" in capsys.readouterr().out
    assert_alike(read_scene_file(tmp_path / "scene.toml")[0], js.Scene(MESH, TWO, [ROOT]))


def test_concentrated_masses_are_point_masses(tmp_path):
    """Off-diagonal moments of CONM2 are those of ∫ρ x y dV, which the tensor has with the other sign."""
    mass = "CONM2,91,3,,5.\n,3.,.1,2.,.2,.3,4.\nPARAM,WTMASS,0.5\n"
    write(tmp_path, PLAIN + MATERIAL + HELD + mass, solution="106")
    assert main(["import", str(tmp_path / "model.bdf"), str(tmp_path / "scene.toml")]) == 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # such as that the mesh leaves vertex cells out
        imported, _ = read_scene_file(tmp_path / "scene.toml")
    for scene in (js.read_model(tmp_path / "model.bdf"), imported):
        (found,) = scene.masses
        assert found.nodes.array.tolist() == [2] and float(found.mass) == 2.5
        np.testing.assert_allclose(found.inertia, [[1.5, -0.05, -0.1], [-0.05, 1.0, -0.15], [-0.1, -0.15, 2.0]])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.replace("PSHELL  10      1  ", "PSHELL  10      7  "), "PSHELL 10 names material 7, which there is not"),
        (lambda t: t.replace("PSHELL  10", "PSHELL  11"), "element 1 names property 10, which is no PSHELL"),
        (lambda t: t.replace(".01     1", ".01"), "PSHELL 10 has no MID2, and so no bending"),
        (lambda t: t.replace("7.1+10", "7.1x10"), "line 21: field 2 of MAT1, '7.1x10', should be a number"),
        (lambda t: t.replace("MAT1 ", "MAT2 "), "MAT2 is not read; MAT1 and MAT8 are"),
        (lambda t: t.replace("2700.", ""), "MAT1 1 has no density"),
        (lambda t: t.replace("SPC = 11", "SPC = 12"), "SPC = 12, which no SPC, SPC1 or SPCADD has"),
        (lambda t: t.replace("SOL 103", "SOL 200"), "SOL 200 has no counterpart"),
        (lambda t: t.replace("123456  1", "123457  1"), "holds '123457', and degrees of freedom are 1 to 6"),
        (lambda t: t.replace("CTRIA3  1 ", "CTRIA3  2 "), "element 2 is defined twice"),
        (lambda t: t.replace("SPC1    11      123456", "SPC1    11      3     ").replace("0.      1.      0.\n", "0.      1.      0.      8\n", 1)
         + "CORD2R,8,,0.,0.,0.,1.,0.,0.,\n,0.,1.,0.\n", r"holds 3 of GRID 4 in a system of its own \(CD\)"),
        (lambda t: t.replace("GRID,1,,0.", "INCLUDE 'model.bdf'\nGRID,1,,0."), "model.bdf includes itself"),
    ],
)  # fmt: skip
def test_errors_name_the_card(change, message, tmp_path):
    file = write(tmp_path, PLAIN + MATERIAL + HELD, solution="103")
    text = change(file.read_text())
    file.write_text(text.replace("ENDDATA\n", "") + "ENDDATA\n")
    with pytest.raises(ValueError, match=message):
        js.read_model(file)
