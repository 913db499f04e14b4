"""Models of Abaqus and CalculiX: each card against the same scene stated by hand, and errors with file and line."""

import dataclasses
from pathlib import Path

import jax
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)

from stated import assert_alike, same  # noqa: E402

import jaxshell as js  # noqa: E402
from jaxshell.analyses.statics import solve_static  # noqa: E402
from jaxshell.command.cli import main  # noqa: E402
from jaxshell.files.scene_file import read_scene_file  # noqa: E402

MESH = """*HEADING
A plate of six nodes
** a comment
*Node, nset=All
1, 0., 0.
2, 1., 0., 0.
3, 2., 0., 0.
4, 0., 1., 0.
5, 1., 1., 0.
6, 2., 1., 0.
*Element, type=S3, elset=Left
1, 1, 2, 5
2, 1, 5, 4
*ELEMENT, TYPE=S4R, ELSET=RIGHT
10, 2, 3, 6, 5
*NSET, NSET=FIX
1, 4
*NSET, NSET=TIP, GENERATE
3, 6, 3
*ELSET, ELSET=WHOLE
LEFT, RIGHT
"""
NODES = [[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0]]
TRIANGLES = [[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]]
STEEL = """*MATERIAL, NAME=Steel
*ELASTIC
2.1D11, 0.3
*DENSITY
7850.
*EXPANSION
1.2e-5
"""
CARBON = """*MATERIAL, NAME=CARBON
*ELASTIC, TYPE=LAMINA
1.4e11, 1.e10, 0.3, 5.e9, 5.e9, 3.5e9
*DENSITY
1600.
"""
PLAIN = "*SHELL SECTION, ELSET=WHOLE, MATERIAL=STEEL\n0.01, 5\n"
HELD = "*BOUNDARY\nFIX, ENCASTRE\n"
STATIC = "*STEP, NLGEOM\n*STATIC\n0.25, 1.\n"
DYNAMIC = "*STEP, NLGEOM\n*DYNAMIC\n1.e-3, 2.e-2\n"
END = "*END STEP\n"

MESH_BY_HAND = js.Mesh(NODES, TRIANGLES)
SECTION = js.Section(0.01, 2.1e11, 0.3, 7850.0, 1.2e-5)
ROOT = js.clamped([0, 3])


def read(tmp_path, text: str, **options) -> js.Scene:
    """The scene of an input file, without a word of warning."""
    import warnings

    file = tmp_path / "model.inp"
    file.write_text(text, encoding="utf-8")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return js.read_model(file, **options)


def through_toml(tmp_path) -> js.Scene:
    """The scene of the file that `jaxshell import` writes of model.inp."""
    assert main(["import", str(tmp_path / "model.inp"), str(tmp_path / "scene.toml"), "--overwrite"]) == 0
    return read_scene_file(tmp_path / "scene.toml")[0]


# --- answers ---------------------------------------------------------------------------------------------


def static_scenes(tmp_path) -> tuple[js.Scene, js.Scene]:
    """One that is read and one by hand: sets of sets, two sections, one of them off the nodes, forces, moments,
    pressure on a surface, a moved support."""
    sections = "*SHELL SECTION, ELSET=LEFT, MATERIAL=STEEL, OFFSET=SPOS\n0.02\n"
    sections += "*SHELL SECTION, ELSET=RIGHT, MATERIAL=STEEL\n1.D-2, 5\n"
    loads = "*CLOAD\nTIP, 3, 40.\n6, 3, 60.\n6, 5, 2.\n*DSLOAD\nTOP, P, 1000.\n*BOUNDARY\n5, 2, 2, 1e-4\n"
    surface = "*SURFACE, NAME=TOP, TYPE=ELEMENT\nRIGHT, SPOS\n"
    scene = read(tmp_path, MESH + surface + STEEL + sections + HELD + STATIC + loads + END)
    ply = js.Ply(js.Isotropic(2.1e11, 0.3, 7850.0, 1.2e-5), 0.02)
    by_hand = js.Scene(
        MESH_BY_HAND,
        [([0, 1], js.Laminate([ply], offset=-0.01)), ([2, 3], SECTION)],
        [ROOT, js.Support([4], "uy", 1e-4, js.History.ramp(1.0))],
        [
            js.NodalForce([2, 5], [[0, 0, 40.0], [0, 0, 100.0]], js.History.ramp(1.0)),
            js.NodalMoment([5], [0, 2.0, 0], js.History.ramp(1.0)),
            js.Pressure(-1000.0, js.History.ramp(1.0), elements=[2, 3]),
        ],
    )
    return scene, by_hand


def test_a_static_step_with_sets_sections_and_loads(tmp_path, capsys):
    scene, by_hand = static_scenes(tmp_path)
    assert_alike(scene, by_hand)
    assert same(scene, through_toml(tmp_path))
    assert read_scene_file(tmp_path / "scene.toml")[1].said() == {"analysis": "static", "load_steps": 4}
    assert "written: " in capsys.readouterr().out


@pytest.mark.slow  # it compiles two programs
def test_statics_of_an_input_file_are_those_of_the_scene_by_hand(tmp_path):
    _, by_hand = static_scenes(tmp_path)
    from_file = through_toml(tmp_path)
    one, other = (np.asarray(solve_static(s, [1.0]).displacements[-1]) for s in (from_file, by_hand))
    np.testing.assert_allclose(one, other, atol=1e-12 * np.abs(other).max(), rtol=0)
    assert np.abs(other).max() > 1e-3


# --- sections --------------------------------------------------------------------------------------------


def test_composites_with_orientations(tmp_path):
    """From the direction of an orientation on, which turns by 30 degrees; a ply with an orientation of its own."""
    orientation = "*ORIENTATION, NAME=ONE\n0., 1., 0., -1., 0., 0.\n3, 30.\n*ORIENTATION, NAME=X\n1,0,0, 0,1,0\n3, 0.\n"
    section = "*SHELL SECTION, ELSET=WHOLE, COMPOSITE, ORIENTATION=ONE, OFFSET=-0.25\n"
    plies = "1e-3, 3, CARBON, 45.\n2e-3, 3, STEEL\n1e-3, 3, CARBON, X\n"
    scene = read(tmp_path, MESH + STEEL + CARBON + orientation + section + plies + HELD + STATIC + END)
    carbon = js.Orthotropic(1.4e11, 1e10, 0.3, 5e9, 1600.0)
    steel = js.Isotropic(2.1e11, 0.3, 7850.0, 1.2e-5)
    turned = [np.cos(np.deg2rad(120)), np.sin(np.deg2rad(120)), 0.0]
    plies = [js.Ply(carbon, 1e-3, 45.0), js.Ply(steel, 2e-3), js.Ply(carbon, 1e-3, -120.0)]
    assert_alike(scene, js.Scene(MESH_BY_HAND, js.Laminate(plies, turned, offset=0.001), [ROOT]))
    assert same(scene, through_toml(tmp_path))


def test_the_axis_near_the_normal_says_which_is_projected(tmp_path):
    """With 1 the second axis is direction 1; a CalculiX file without the line has the first; none has the axis x."""
    carbon = js.Orthotropic(1.4e11, 1e10, 0.3, 5e9, 1600.0)
    axes = "*ORIENTATION, NAME=A\n0., 0., 1., 1., 1., 0.\n"
    section = "*SHELL SECTION, ELSET=WHOLE, MATERIAL=CARBON, ORIENTATION=A\n0.01\n"
    for text, direction in (
        (axes + "1, 0.\n", [1.0, 1.0, 0.0]),
        (axes.replace("0., 0., 1.", "0., 1., 0."), [0, 1.0, 0]),
    ):
        scene = read(tmp_path, MESH + CARBON + text + section + STATIC + END)
        assert_alike(scene, js.Scene(MESH_BY_HAND, js.Laminate([js.Ply(carbon, 0.01)], direction)))
    scene = read(tmp_path, MESH + CARBON + section.replace(", ORIENTATION=A", "") + STATIC + END)
    assert_alike(scene, js.Scene(MESH_BY_HAND, js.Laminate([js.Ply(carbon, 0.01)])))


def test_orientations_of_a_cylinder(tmp_path):
    nodes = "*NODE\n" + "".join(
        f"{i}, {np.cos(a)!r}, {np.sin(a)!r}, {z}\n"
        for i, (a, z) in enumerate([(0.0, 0), (0.4, 0), (0.4, 1), (0.0, 1)], 1)
    ).replace("np.float64(", "").replace(")", "")
    mesh = nodes + "*ELEMENT, TYPE=S4, ELSET=WHOLE\n1, 1, 2, 3, 4\n"
    section = "*SHELL SECTION, ELSET=WHOLE, COMPOSITE, ORIENTATION=C\n0.01, 3, CARBON, 10.\n"
    carbon = js.Orthotropic(1.4e11, 1e10, 0.3, 5e9, 1600.0)
    for near, along, extra in ((1, "circumference", 0.0), (2, "axis", 0.0), (1, "circumference", 25.0)):
        system = f"*ORIENTATION, NAME=C, SYSTEM=CYLINDRICAL\n0,0,0, 0,0,1\n{near}, {extra}\n"
        scene = read(tmp_path, mesh + CARBON + system + section + STATIC + END)
        direction = js.Cylindrical([0, 0, 1.0], along=along)
        if extra:  # turned about the radial axis at each centre
            centres = np.asarray(scene.mesh.nodes)[scene.mesh.triangles].mean(axis=1)
            around = np.cross([0, 0, 1.0], centres) / np.linalg.norm(centres[:, :2], axis=1, keepdims=True)
            direction = np.cos(np.deg2rad(extra)) * around + np.sin(np.deg2rad(extra)) * np.array([0, 0, 1.0])
        assert_alike(scene, js.Scene(scene.mesh, js.Laminate([js.Ply(carbon, 0.01, 10.0)], direction)))
    assert same(scene, through_toml(tmp_path))


def test_stiffnesses_of_a_general_section(tmp_path):
    A, D = np.diag([3e8, 2e8, 1e8]), np.diag([3e3, 2e3, 1e3])
    B = np.diag([1e3, 0.0, 0.0])
    whole = np.block([[A, B], [B, D]])
    numbers = [f"{whole[i, j]:g}" for j in range(6) for i in range(j + 1)]
    lines = "\n".join(", ".join(numbers[at : at + 8]) for at in (0, 8, 16))
    text = f"*SHELL GENERAL SECTION, ELSET=WHOLE, DENSITY=12.\n{lines}\n"
    scene = read(tmp_path, MESH + text + STATIC + END)
    assert_alike(scene, js.Scene(MESH_BY_HAND, js.GeneralSection(A, B, D, 12.0)))


def test_engineering_constants_and_expansion(tmp_path):
    material = (
        "*MATERIAL, NAME=M\n*ELASTIC, TYPE=ENGINEERING CONSTANTS\n1e11, 2e10, 3e10, .25, .3, .35, 4e9, 5e9\n6e9,\n"
    )
    material += "*DENSITY\n1000.\n*EXPANSION, TYPE=ORTHO\n1e-6, 2e-5, 3e-5\n"
    section = "*SHELL SECTION, ELSET=WHOLE, MATERIAL=M\n0.01\n"
    heat = "*TEMPERATURE\nALL, 120., 5.\n"
    start = "*INITIAL CONDITIONS, TYPE=TEMPERATURE\nALL, 20.\n"
    scene = read(tmp_path, MESH + material + section + start + STATIC + heat + END)
    ply = js.Ply(js.Orthotropic(1e11, 2e10, 0.25, 4e9, 1000.0, 1e-6, 2e-5), 0.01)
    assert_alike(scene, js.Scene(MESH_BY_HAND, js.Laminate([ply]), (), [js.Thermal(100.0, 5.0, js.History.ramp(1.0))]))


# --- loads and steps -------------------------------------------------------------------------------------


def test_a_dynamic_step_with_amplitudes(tmp_path):
    """A load without an amplitude acts whole from the start of a dynamic step; gravity, damping, initial velocities."""
    amplitude = "*AMPLITUDE, NAME=PULSE\n0., 0., 0.005, 1., 0.01, 0.5\n"
    damped = STEEL + "*DAMPING, ALPHA=2., BETA=1e-5\n"
    start = "*INITIAL CONDITIONS, TYPE=VELOCITY\nTIP, 3, 0.5\n6, 1, 2.\n2, 1, 1.\n"
    loads = "*DLOAD, AMPLITUDE=PULSE\nWHOLE, P, 10.\n*DLOAD\n, GRAV, 9.81, 0., 0., -2.\n*CLOAD\n5, 1, 3.\n"
    scene = read(tmp_path, MESH + damped + PLAIN + HELD + amplitude + start + DYNAMIC + loads + END)
    velocities = np.zeros((6, 3))
    velocities[[2, 5], 2], velocities[1, 0], velocities[5, 0] = 0.5, 1.0, 2.0
    by_hand = js.Scene(
        MESH_BY_HAND,
        SECTION,
        [ROOT],
        [
            js.Pressure(10.0, js.History([0.0, 0.005, 0.01], [0.0, 1.0, 0.5])),
            js.Gravity([0, 0, -9.81]),
            js.NodalForce([4], [3.0, 0, 0]),
        ],
        initial=js.Initial(velocities),
        damping=js.RayleighDamping(2.0, 1e-5),
    )
    assert_alike(scene, by_hand)
    assert (scene.defaults.dt, scene.defaults.t_end) == (1e-3, 2e-2)
    assert same(scene, through_toml(tmp_path))


def test_loads_that_turn_of_a_liquid_and_on_a_part_of_the_shell(tmp_path):
    """HP is 6 at z = 1 and 0 at z = 3: a weight of 3 per volume; on SPOS it pushes against the normal."""
    surface = "*SURFACE, NAME=TOP, TYPE=ELEMENT\nRIGHT, SPOS\n"
    loads = "*CLOAD, FOLLOWER\nTIP, 1, 5.\nTIP, 3, 2.\n*DLOAD\nLEFT, HP, 6., 3., 1.\nRIGHT, GRAV, 9.81, 0., 0., -2.\n"
    loads += "*DSLOAD\nTOP, HP, 6., 3., 1.\n"
    dead = "*{}, FOLLOWER=NO, CONSTANT RESULTANT=YES\n{}, TRVEC, 10., 3., 0., 4.\n"
    loads += dead.format("DLOAD", "LEFT") + dead.format("DSLOAD", "TOP")
    text = MESH + STEEL + PLAIN + HELD + surface + DYNAMIC + loads
    scene = read(tmp_path, text + END)
    expected = [
        js.FollowerForce([2, 5], [5.0, 0, 2.0]),
        js.HydrostaticPressure(3.0, 3.0, elements=[0, 1]),
        js.Gravity([0, 0, -9.81], elements=[2, 3]),
        js.HydrostaticPressure(-3.0, 3.0, elements=[2, 3]),
        js.Traction([6.0, 0, 8.0], elements=[0, 1]),
        js.Traction([6.0, 0, 8.0], elements=[2, 3]),
    ]
    by_hand = dataclasses.replace(scene, loads=tuple(expected))
    assert same(scene, by_hand) and same(scene, through_toml(tmp_path))
    for stray in ("*CLOAD, FOLLOWER\nTIP, 4, 5.\n", "*DLOAD\nLEFT, TRVEC, 10., 3., 0., 4.\n"):
        with pytest.raises(ValueError, match="FOLLOWER"):
            read(tmp_path, text + stray + END)
    with pytest.raises(ValueError, match="HP needs its pressure at another height"):
        read(tmp_path, text + "*DLOAD\nLEFT, HP, 6., 3., 3.\n" + END)


def test_the_amplitude_of_a_step_may_be_said(tmp_path):
    loads = "*CLOAD\n5, 1, 3.\n"
    for step, history in (
        (STATIC, js.History.ramp(1.0)),
        (DYNAMIC, js.History.constant()),
        (DYNAMIC.replace("NLGEOM", "NLGEOM, AMPLITUDE=RAMP"), js.History.ramp(0.02)),
        (STATIC.replace("NLGEOM", "NLGEOM, AMPLITUDE=STEP"), js.History.constant()),
    ):
        scene = read(tmp_path, MESH + STEEL + PLAIN + HELD + step + loads + END)
        load = js.NodalForce([4], [3.0, 0, 0], history)
        assert_alike(scene, js.Scene(MESH_BY_HAND, SECTION, [ROOT], [load]))


def test_a_step_may_move_what_the_model_holds(tmp_path):
    held = "*BOUNDARY\nFIX, 1, 3\nTIP, ZSYMM\n1, 6\n"
    moved = "*BOUNDARY, AMPLITUDE=UP\nFIX, 3, 3, 0.2\n"
    amplitude = "*AMPLITUDE, NAME=UP, DEFINITION=EQUALLY SPACED, FIXED INTERVAL=0.01\n0., 1., 0.\n"
    scene = read(tmp_path, MESH + STEEL + PLAIN + held + amplitude + DYNAMIC + moved + END)
    up = js.History([0.0, 0.01, 0.02], [0.0, 1.0, 0.0])
    supports = [js.Support([0, 3], ("ux", "uy")), js.symmetry([2, 5], "z"), js.Support([0], "rz")]
    assert_alike(scene, js.Scene(MESH_BY_HAND, SECTION, [*supports, js.Support([0, 3], "uz", 0.2, up)]))


def test_eigenvalue_steps(tmp_path):
    for card, run in (
        ("*FREQUENCY\n7\n", {"analysis": "modes", "count": 7}),
        ("*BUCKLE\n3\n", {"analysis": "buckling", "count": 3}),
        ("*STATIC, RIKS\n0.1, 1.\n", {"analysis": "arc-length"}),
        ("*DYNAMIC, ALPHA=-0.1\n1e-3, 1.\n", {"method": ("HHT",), "alpha": -0.1, "dt": 1e-3, "t_end": 1.0}),
    ):
        (tmp_path / "model.inp").write_text(MESH + STEEL + PLAIN + HELD + "*STEP, NLGEOM\n" + card + END)
        through_toml(tmp_path)
        assert read_scene_file(tmp_path / "scene.toml")[1].said() == run


# --- parts and other files -------------------------------------------------------------------------------


def test_parts_are_placed_with_their_sections_and_orientations(tmp_path):
    """The plate as two instances, the second turned by 90 degrees about the axis y at x = 2 and joined nowhere."""
    part = MESH.replace("*HEADING\nA plate of six nodes\n", "")
    orientation = "*ORIENTATION, NAME=ONE\n1,0,0, 0,1,0\n3, 0.\n"
    section = "*SHELL SECTION, ELSET=WHOLE, MATERIAL=CARBON, ORIENTATION=ONE\n0.01\n"
    assembly = """*ASSEMBLY, NAME=A
*INSTANCE, NAME=FLAT, PART=PLATE
*END INSTANCE
*INSTANCE, NAME=UP, PART=PLATE
3., 0., 0.
3., 0., 0., 3., 1., 0., -90.
*END INSTANCE
*NSET, NSET=HELD, INSTANCE=FLAT
1, 4
*NSET, NSET=HELD, INSTANCE=UP
FIX
*END ASSEMBLY
"""
    text = f"*PART, NAME=PLATE\n{part}{orientation}{section}*END PART\n{assembly}{CARBON}*BOUNDARY\nHELD, PINNED\n"
    scene = read(tmp_path, text + STATIC + "*CLOAD\nUP.TIP, 1, 5.\nFLAT.3, 2, 1.\n*DLOAD\nUP.RIGHT, P, 7.\n" + END)
    nodes = np.array(NODES)
    turned = np.stack([3.0 + 0 * nodes[:, 0], nodes[:, 1], nodes[:, 0]], axis=1)
    mesh = js.Mesh(np.concatenate([nodes, turned]), np.concatenate([TRIANGLES, np.array(TRIANGLES) + 6]))
    np.testing.assert_allclose(scene.mesh.nodes, mesh.nodes, atol=1e-15)
    carbon = js.Orthotropic(1.4e11, 1e10, 0.3, 5e9, 1600.0)
    parts = [(range(4), [1.0, 0, 0]), (range(4, 8), [0, 0, 1.0])]
    by_hand = js.Scene(
        scene.mesh,
        [(list(where), js.Laminate([js.Ply(carbon, 0.01)], along)) for where, along in parts],
        [js.pinned([0, 3, 6, 9])],
        [
            js.NodalForce([8, 11], [5.0, 0, 0], js.History.ramp(1.0)),
            js.NodalForce([2], [0, 1.0, 0], js.History.ramp(1.0)),
            js.Pressure(7.0, js.History.ramp(1.0), elements=[6, 7]),
        ],
    )
    assert_alike(scene, by_hand)
    assert same(scene, through_toml(tmp_path))


def test_included_files(tmp_path):
    (tmp_path / "mesh.inc").write_text(MESH)
    scene = read(tmp_path, "*INCLUDE, INPUT=mesh.inc\n" + STEEL + PLAIN + HELD + STATIC + END)
    assert_alike(scene, js.Scene(MESH_BY_HAND, SECTION, [ROOT]))
    with pytest.raises(ValueError, match=r"mesh\.inc, line 1: mesh\.inc includes itself"):
        (tmp_path / "mesh.inc").write_text("*INCLUDE, INPUT=mesh.inc\n")
        read(tmp_path, "*INCLUDE, INPUT=mesh.inc\n")


# --- what is not carried over ----------------------------------------------------------------------------


def test_what_has_no_counterpart_is_listed_a_line_each(tmp_path, capsys):
    text = MESH + STEEL + PLAIN + HELD + STATIC + "*NODE PRINT, NSET=TIP\nU\n*EL FILE\nS\n*CONTROLS\n" + END
    (tmp_path / "model.inp").write_text(text + "*STEP\n*FREQUENCY\n3\n" + END)
    with pytest.warns(UserWarning) as caught:
        js.read_model(tmp_path / "model.inp")
    said = [str(w.message).split("model.inp: ", 1)[1] for w in caught]
    assert said == [
        "not carried over: step 2 (model.inp, line 42): only the first step is carried over",
        "not carried over: output requests: *NODE PRINT, *EL FILE",
        "not carried over: *CONTROLS (model.inp, line 40): not known here",
    ]
    through_toml(tmp_path)
    out = capsys.readouterr().out
    assert all(f"  {line}\n" in out for line in said) and "  S4R elements of the file: 1\n" in out
    assert all(f"# {line}\n" in (tmp_path / "scene.toml").read_text() for line in said)


def test_what_the_answer_depends_on_is_refused_unless_partial(tmp_path, capsys):
    beam = "*ELEMENT, TYPE=B31, ELSET=BEAM\n20, 3, 6\n*BEAM SECTION, ELSET=BEAM, MATERIAL=STEEL, SECTION=RECT\n.1, .1\n"
    text = MESH + beam + STEEL + PLAIN + "*RIGID BODY, REF NODE=6, ELSET=BEAM\n" + HELD + STATIC + END
    (tmp_path / "model.inp").write_text(text)
    with pytest.raises(ValueError) as caught:
        js.read_model(tmp_path / "model.inp")
    lines = str(caught.value).splitlines()
    assert (
        lines[1:4]
        == [
            "  1 elements of type B31, which are no shells",
            "  *BEAM SECTION (model.inp, line 24)",
            "  *RIGID BODY (model.inp, line 35)",
        ]
        and "--partial" in lines[-1]
    )
    arguments = ["import", str(tmp_path / "model.inp"), str(tmp_path / "scene.toml")]
    assert main(arguments) == 2 and not (tmp_path / "scene.toml").exists()
    assert main([*arguments, "--partial"]) == 0
    assert "not carried over: *RIGID BODY" in capsys.readouterr().out
    scene = read_scene_file(tmp_path / "scene.toml")[0]
    assert_alike(scene, js.Scene(MESH_BY_HAND, SECTION, [ROOT]))
    assert main([*arguments, "--partial"]) == 2
    assert "scene.toml exists" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.replace("MATERIAL=STEEL", "MATERIAL=STELE"), r"line 29: there is no \*MATERIAL STELE.*: Steel"),
        (lambda t: t.replace("ELSET=WHOLE, MAT", "ELSET=HOLE, MAT"), "line 29: there is no element set HOLE"),
        (lambda t: t.replace("ELSET=WHOLE, MAT", "ELSET=LEFT, MAT"), r"Element 10 has no \*SHELL SECTION"),
        (lambda t: t + "*SHELL SECTION, ELSET=LEFT, MATERIAL=STEEL\n1.\n", r"Element 1 has more than one \*SHELL SEC"),
        (lambda t: t.replace("0.01, 5", "0.0l, 5"), "line 30: field 1, '0.0l', should be a number"),
        (lambda t: t.replace("2.1D11, 0.3", "2.1D11"), "line 24: field 2, which is empty, should be a number"),
        (lambda t: t.replace("FIX, ENC", "FX, ENC"), "line 32: there is no node set FX"),
        (lambda t: t.replace("FIX, ENCASTRE", "FIX, 1, 7"), "line 32: degrees of freedom are 1 to 6 here"),
        (lambda t: t + DYNAMIC + "*CLOAD, AMPLITUDE=A\n5, 1, 1.\n", r"there is no \*AMPLITUDE A"),
        (lambda t: t + DYNAMIC + "*BOUNDARY\n5, 1, 1, 1.\n", "displacement of 5 jumps"),
        (lambda t: t + "*AMPLITUDE, NAME=A\n0., 0., 0., 1.\n", r"times of \*AMPLITUDE A must increase"),
        (lambda t: t + "*STEP\n*HEAT TRANSFER\n", r"none of \*STATIC, \*DYNAMIC"),
        (lambda t: t.replace("*DENSITY\n7850.\n", "") + DYNAMIC, r"material Steel has no \*DENSITY"),
        (
            lambda t: (
                t.replace("TYPE=S4R", "type=S4R").replace("type=S3", "type=M3D3").replace("type=S4R", "TYPE=C3D4")
            ),
            "no shell",
        ),
        (lambda t: "*PARAMETER\na=1\n" + t, r"line 1: \*PARAMETER is not read"),
    ],
)
def test_errors_name_the_line(change, message, tmp_path):
    (tmp_path / "model.inp").write_text(change(MESH + STEEL + PLAIN + HELD))
    with pytest.raises(ValueError, match=message):
        js.read_model(tmp_path / "model.inp")


def test_elements_of_second_order(tmp_path):
    nodes = [[0, 0], [2, 0], [2, 2], [0, 2], [1, 0], [2, 1], [1, 2], [0, 1]]
    text = "*NODE\n" + "".join(f"{i}, {x}, {y}, 0.\n" for i, (x, y) in enumerate(nodes, 1))
    text += "*ELEMENT, TYPE=S8R, ELSET=WHOLE\n1, 1,2,3,4,5,6,7,8\n" + STEEL + PLAIN + STATIC + END
    (tmp_path / "model.inp").write_text(text)
    with pytest.raises(ValueError, match=r"1 quad8 cells.*second_order=\"split\""):
        js.read_model(tmp_path / "model.inp")
    assert js.read_model(tmp_path / "model.inp", second_order="split").mesh.n_elements == 6
    arguments = ["import", str(tmp_path / "model.inp"), str(tmp_path / "scene.toml"), "--second-order", "split"]
    assert main(arguments) == 0
    assert read_scene_file(tmp_path / "scene.toml")[0].mesh.n_elements == 6


def test_the_examples_weigh_what_their_sections_say():
    """Strips of 0.05 by 0.3 m: two of doubler, five of skin, one of rib; the wing's two parts are trapezes."""
    examples = Path(__file__).parents[1] / "examples"
    with pytest.warns(UserWarning, match="output requests: "):
        panel = js.read_model(examples / "panel.inp")
    carbon, strip = 1600.0, 0.05 * 0.3
    by_hand = strip * (2 * 1.5e-3 * carbon + 5 * 1e-3 * carbon + 2e-3 * 2770.0)
    assert float(js.mass_properties(panel).mass) == pytest.approx(by_hand, rel=1e-12)
    with pytest.warns(UserWarning, match="transverse shear"):
        wing = js.read_model(examples / "wing.bdf")
    by_hand = 0.75 * 0.3375 * 2.5e-3 * carbon + 0.45 * 0.2375 * 2.5e-3 * 2770.0
    assert float(js.mass_properties(wing).mass) == pytest.approx(by_hand, rel=1e-12)


def test_other_files_are_told_apart(tmp_path):
    with pytest.raises(FileNotFoundError, match="There is no model file"):
        js.read_model(tmp_path / "nothing.inp")
    (tmp_path / "model.txt").write_text("*NODE\n")
    with pytest.raises(ValueError, match=r"no kind that models are read from.*\.inp, \.bdf"):
        js.read_model(tmp_path / "model.txt")


def test_masses_and_rotary_inertias_are_point_masses(tmp_path):
    """I12 of *ROTARY INERTIA is the tensor's component, -∫ρ x y dV; a mass at a node of no shell is refused."""
    lumps = (
        "*ELEMENT, TYPE=MASS, ELSET=TIPS\n90, 3\n91, 6\n*ELEMENT, TYPE=ROTARYI, ELSET=GYRO\n92, 6\n"
        "*MASS, ELSET=TIPS\n0.5\n*ROTARY INERTIA, ELSET=GYRO\n3., 2., 4., -0.1, -0.2, -0.3\n"
    )
    path = tmp_path / "model.inp"
    path.write_text(MESH + lumps + STEEL + PLAIN + HELD + STATIC + "*END STEP\n", encoding="utf-8")
    assert main(["import", str(path), str(tmp_path / "scene.toml")]) == 0
    for scene in (js.read_model(path), read_scene_file(tmp_path / "scene.toml")[0]):
        tips, gyro = scene.masses
        assert tips.nodes.array.tolist() == [2, 5] and float(tips.mass) == 0.5
        assert gyro.nodes.array.tolist() == [5] and float(gyro.mass) == 0.0
        np.testing.assert_allclose(gyro.inertia, [[3.0, -0.1, -0.2], [-0.1, 2.0, -0.3], [-0.2, -0.3, 4.0]])
    far = MESH.replace("*Element, type=S3", "7, 5., 5., 0.\n*Element, type=S3", 1) + lumps.replace("91, 6", "91, 7")
    path.write_text(far + STEEL + PLAIN + HELD + STATIC + "*END STEP\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"\*MASS .*: 1 at nodes that no shell has"):
        js.read_model(path)
