"""Scene files: the documented example, every table, and errors that say what is wrong and where."""

from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)

from jaxshell.files.scene_file import read_scene_file  # noqa: E402
from jaxshell.model.generators import GENERATORS, rectangle  # noqa: E402
from jaxshell.model.loads import EdgeForce, Gravity, NodalForce, NodalMoment, Pressure  # noqa: E402
from jaxshell.model.mesh import Mesh  # noqa: E402

EXAMPLE = Path(__file__).parents[1] / "examples" / "cantilever.toml"
BASE = """
[mesh]
generator = "rectangle"
length = 4.0
width = 2.0
divisions = [4, 2]
[section]
thickness = 0.1
young_modulus = 1.0e6
poisson_ratio = 0.3
density = 1.0
"""


def read(tmp_path, text: str):
    file = tmp_path / "scene.toml"
    file.write_text(text, encoding="utf-8")
    return read_scene_file(file)


def test_example():
    scene: Any
    scene, run = read_scene_file(EXAMPLE)
    assert (scene.name, scene.mesh.n_elements, run.method, run.dt) == ("cantilever", 80, ("EMC",), 0.02)
    assert np.all(np.asarray(scene.mesh.nodes)[scene.supports[0].nodes.array, 0] == 0)
    force = scene.loads[0].nodal(scene.mesh.nodes, scene.mesh.triangles, 0.0)
    assert np.allclose(force.sum(axis=0), [0, 0, 4, 0, 0, 0])
    assert float(scene.loads[0].history(0.05)) == 0.5
    assert np.allclose(scene.mesh.nodes[scene.watch[0][1]], [10, 0.5, 0])
    assert scene.defaults is not None and scene.defaults.picture_times[1] == 1.0


def test_every_load_and_selection(tmp_path):
    scene: Any
    scene, run = read(
        tmp_path,
        BASE
        + """
[[supports]]
plane = { x = 0.0 }
box = [[0, 0, 0], [4, 1, 0]]
hold = "symmetry x"
[[supports]]
nodes = [14]
hold = ["uz"]
displacement = 0.5
history = { times = [0, 1], values = [0, 1] }
[[loads]]
kind = "force"
nearest = [2.1, 1.1, 0]
force = [0, 0, 1]
[[loads]]
kind = "moment"
boundary = true
plane = { y = 2.0 }
moment = [1, 0, 0]
[[loads]]
kind = "edge force"
plane = { x = 4.0 }
force = [0, 2, 0]
[[loads]]
kind = "gravity"
acceleration = [0, 0, -9.81]
[[loads]]
kind = "pressure"
pressure = 3.0
history = { ramp = 2.0 }
[initial]
velocity = [1, 2, 3]
[watch]
"a point" = { node = 3, component = "vx" }
""",
    )
    held, moved = scene.supports
    assert held.nodes.array.tolist() == [0, 1] and held.dofs == ("ux", "ry", "rz")
    assert moved.nodes.array.tolist() == [14] and float(moved.values(0.5)[0, 0]) == 0.25
    kinds = [NodalForce, NodalMoment, EdgeForce, Gravity, Pressure]
    assert [type(load) for load in scene.loads] == kinds
    assert np.allclose(scene.mesh.nodes[scene.loads[0].nodes.array], [[2, 1, 0]])
    assert scene.loads[1].nodes.array.tolist() == [2, 5, 8, 11, 14]
    assert sorted(scene.loads[2].edges.array.tolist()) == [[12, 13], [13, 14]]
    assert float(scene.loads[4].history(1.0)) == 0.5
    assert scene.initial is not None and np.allclose(np.asarray(scene.initial.velocities), [1, 2, 3])
    assert scene.watch == (("a point", 3, "vx"),)
    assert run.said() == {} and scene.defaults is None and scene.name == "scene"


def test_mesh_file_beside_the_scene(tmp_path):
    mesh = rectangle(2.0, 1.0, [2, 2])
    import meshlane

    meshlane.write(tmp_path / "strip.vtk", meshlane.Mesh(np.asarray(mesh.nodes), [("triangle", mesh.triangles)]))
    section = BASE[BASE.index("[section]") :]
    scene, _ = read(tmp_path, '[mesh]\nfile = "strip.vtk"\n' + section)
    assert np.array_equal(scene.mesh.triangles, mesh.triangles)


SUPPORT = '[[supports]]\nplane = { x = 0.0 }\nhold = "clamped"\n'


@pytest.mark.wrong_types
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = 1", "the file has the unknown key 'x'. Known keys: name, units, mesh"),
        ("[mesh", "is not a valid TOML file"),
        (
            BASE.replace("thickness", "thicknes"),
            r"\[section\] has the unknown key 'thicknes'. Did you mean 'thickness'\? Known keys: thickness,",
        ),
        (BASE.replace("density = 1.0", ""), r"\[section\] lacks 'density'"),
        (BASE.replace("0.1", "-0.1"), r"\[section\] thickness must be positive, but it is -0.1"),
        (BASE.replace("rectangle", "disk"), "generator must be one of rectangle, cylinder.*'disk'"),
        (BASE.replace("width = 2.0", ""), r"\[mesh\] lacks 'width'"),
        (BASE.replace("[4, 2]", "[4]"), r"\[mesh\] divisions of a rectangle must be .* but are \[4\]"),
        (BASE.replace("width", "height"), r"\[mesh\] has the unknown key 'height'"),
        ('[mesh]\nfile = "no.msh"', "There is no file .*no.msh"),
        (BASE + "[run]\nstep = 1", r"\[run\] has the unknown key 'step'.* Known keys: analysis, "),
        (BASE + "[supports]\nhold = 1", r"write \[\[supports\]\] above each"),
        (BASE + SUPPORT.replace("plane", "plain"), r"\[\[supports\]\] number 1: has the unknown key 'plain'"),
        (
            BASE + SUPPORT.replace("x = 0.0", "x = 9.0"),
            "No node fulfils plane; the mesh spans x 0 to 4, y 0 to 2",
        ),
        (BASE + SUPPORT.replace("x = 0.0", "w = 0.0"), "number 1: plane has the unknown key 'w'"),
        (BASE + SUPPORT.replace("clamped", "fixed"), "hold must be one of 'clamped', .* but it is 'fixed'"),
        (BASE + '[[supports]]\nhold = "clamped"', "chooses no nodes; give one of nodes, nearest"),
        (BASE + '[[supports]]\nnodes = [99]\nhold = "clamped"', "nodes must be numbers from 0 to 14"),
        (BASE + '[[supports]]\nnodes = [1]\nhold = ["uw"]', r"number 1: A support holds 'uw'"),
        (BASE + '[[loads]]\nkind = "wind"', "kind must be one of 'force', .* but it is 'wind'"),
        (
            BASE + '[[loads]]\nkind = "force"\nnodes = [1]\nforce = [1, 2]',
            r"number 1: force must have shape \(3,\)",
        ),
        (
            BASE + '[[loads]]\nkind = "force"\nnearest = [1, 2]\nforce = [1, 2, 3]',
            r"nearest must be \[x, y, z\]",
        ),
        (
            BASE + '[[loads]]\nkind = "edge force"\nnodes = [0]\nforce = [1, 2, 3]',
            "No edge of the mesh's boundary",
        ),
        (BASE + '[[loads]]\nkind = "gravity"\nnodes = [1]', "number 1: has the unknown key 'nodes'"),
        (
            BASE + '[[loads]]\nkind = "pressure"\npressure = 1\nhistory = { times = [1, 0], values = [0, 1] }',
            "number 1: history times must increase",
        ),
        (
            BASE + '[watch]\ntip = { component = "uz" }',
            r"\[watch\] tip needs either nearest = \[x, y, z\] or node",
        ),
        (BASE + '[watch]\ntip = { node = 1, component = "rz" }', "watch 'tip' names 'rz'"),
        (BASE + "[initial]\nspeed = 1", r"\[initial\] has the unknown key 'speed'"),
        ('units = "mm"\n' + BASE, "units must be .* but it is 'mm'"),
        ("units = 3\n" + BASE, "the file units must be a text, but it is 3"),
        ("name = []\n" + BASE, r"the file name must be a text, but it is \[\]"),
        ("x = " + 3000 * "[", "is not a valid TOML file: it is nested too deeply"),
        ("x = " + 5000 * "1", "is not a valid TOML file"),
        (BASE.replace("0.1", '"0.1"'), r"\[section\] thickness must be a number .*but it is '0.1'"),
        (BASE.replace("0.1", "true"), r"\[section\] thickness must be a number .*but it is True"),
        (BASE.replace("[4, 2]", "[30000, 30000]"), r"\[mesh\] A grid of 30000 by 30000 is 1800000000 triangles, more"),
        (BASE.replace("4.0", "[4.0]"), r"\[mesh\] length must be one number, but it is \[4.0\]"),
        (BASE.replace('"rectangle"', '["rectangle"]'), r"\[mesh\] generator must be a text, but it is \['rectangle'\]"),
        (BASE + '[[loads]]\nkind = ["x"]', r"number 1: kind must be a text, but it is \['x'\]"),
        (BASE + SUPPORT.replace("x = 0.0", "x = nan"), "number 1: plane x must be finite, but it is nan"),
        (
            BASE + SUPPORT.replace("plane = { x = 0.0 }", "nearest = [nan, 0, 0]"),
            "nearest must be finite, but it is nan",
        ),
        (BASE + SUPPORT.replace("plane = { x = 0.0 }", "nodes = [true]"), "nodes must be numbers from 0 to 14"),
        (BASE + '[watch]\ntip = { node = 1.5, component = "uz" }', "watch 'tip' names node 1.5"),
        (BASE + "[run]\ndt = nan", r"\[run\] dt must be a number, but it is nan"),
        (BASE + "[run]\ndt = 0.1\nt_end = inf", "t_end must be finite, but it is inf"),
        ('[mesh]\nfile = ["a"]', r"\[mesh\] file must be a text"),
    ],
)
def test_errors_say_where_and_what(tmp_path, text, message):
    with pytest.raises(ValueError, match=message) as caught:
        read(tmp_path, text)
    assert "scene.toml" in str(caught.value)


def test_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match="no file"):
        read_scene_file(tmp_path / "none.toml")


def _area_and_normals(mesh: Mesh):
    x = np.asarray(mesh.nodes)[mesh.triangles]
    normals = 0.5 * np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    return np.linalg.norm(normals, axis=1).sum(), normals, x.mean(axis=1)


@pytest.mark.parametrize(
    ("name", "arguments", "area", "boundary"),
    [
        ("rectangle", (2.0, 1.0, [4, 3]), 2.0, 14),
        ("cylinder", (1.0, 2.0, [4, 48]), 4 * np.pi, 96),
        ("cylinder", (1.0, 2.0, [4, 24], 90.0), np.pi, 56),
        ("spherical_cap", (1.0, 60.0, 12), np.pi, 96),
        ("spherical_zone", (1.0, 30.0, 90.0, [48, 12]), np.pi * np.sqrt(3), 96),
    ],
)
def test_generators_have_area_boundary_and_outward_normals(name, arguments, area, boundary):
    """Areas of the smooth surfaces, to which a mesh this fine comes within one per cent."""
    mesh = GENERATORS[name](*arguments)
    found, normals, centres = _area_and_normals(mesh)
    assert 0.99 * area < found <= area * (1 + 1e-12)
    assert len(mesh.boundary_edges()) == boundary
    outwards = np.array([0.0, 0.0, 1.0]) if name == "rectangle" else centres * [name != "cylinder", 1, 1]
    assert np.all(np.sum(normals * outwards, axis=1) > 0)


@pytest.mark.parametrize(
    ("name", "arguments", "message"),
    [
        ("rectangle", (0.0, 1.0, [1, 1]), "length must be positive, but it is 0.0"),
        ("rectangle", (float("nan"), 1.0, [1, 1]), "length must be finite, but it is nan"),
        ("rectangle", ("1", 1.0, [1, 1]), "length must be one number, but it is '1'"),
        ("spherical_cap", (1.0, 30.0, 2000), "A grid of 4000 by 4000 is 32000000 triangles"),
        ("rectangle", (1.0, 1.0, [1, 0.5]), "divisions of a rectangle"),
        ("cylinder", (1.0, 1.0, [1, 2]), "divisions of a cylinder must be whole numbers of at least 1 and 3"),
        ("cylinder", (1.0, 1.0, [1, 4], 400), "angle must be at most 360 degrees, but it is 400"),
        ("spherical_cap", (1.0, 180.0, 4), "half_angle must be below 180 degrees"),
        ("spherical_zone", (1.0, 40.0, 30.0, [4, 4]), "0 < top < bottom < 180"),
    ],
)
def test_generators_refuse(name, arguments, message):
    with pytest.raises(ValueError, match=message):
        GENERATORS[name](*arguments)
