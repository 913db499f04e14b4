"""Sets of mesh files: those of gmsh, Abaqus, VTK and OBJ, in meshes of triangles and of what is cut into them.

The files gmsh* in tests/data are gmsh 4.15's: two plates of 2 by 1 side by side, the left one of triangles, the right
one of triangles and quads, with physical groups of the plates, of the curves at x = 0 and x = 2, and of a point.
"""

from pathlib import Path
from typing import Any

import jax
import meshlane
import numpy as np
import pytest
from mesh_texts import GMSH22, INP, OBJ, PARTS, POLYDATA, lists, written

jax.config.update("jax_enable_x64", True)

import jaxshell as js  # noqa: E402
from jaxshell.files.scene_file import read_scene_file  # noqa: E402
from jaxshell.model.cells import Cells  # noqa: E402
from jaxshell.model.mesh import mesh_of_cells  # noqa: E402
from jaxshell.model.mesh_files import abaqus  # noqa: E402
from jaxshell.model.mesh_files.cards import read_cards  # noqa: E402
from jaxshell.model.sections.regions import Regions  # noqa: E402

DATA = Path(__file__).parent / "data"


def sides_at(mesh, x: float) -> list:
    nodes = np.asarray(mesh.nodes)
    edges = np.unique(np.sort(mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    return edges[(abs(nodes[edges, 0] - x) < 1e-9).all(axis=1)].tolist()


# --- gmsh ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["gmsh22.msh", "gmsh41_binary.msh", "gmsh41_save_all.msh", "gmsh.inp"])
@pytest.mark.filterwarnings("ignore:.*gmsh41_save_all.*5 vertex, 16 line cells are left out")
def test_the_groups_of_a_file_of_gmsh_are_where_they_were_drawn(name):
    """The two plates overlap "both"; "gmsh41_save_all.msh" has curves without a group, which meshlane does not read."""
    mesh = js.Mesh.read(DATA / name)
    space = "_" if name.endswith("inp") else " "
    assert (mesh.n_nodes, mesh.n_elements) == (28, 36)
    left = np.asarray(mesh.nodes)[mesh.triangles].mean(axis=1)[:, 0] < 2
    for set_name, there in ((f"left{space}plate", left), (f"right{space}plate", ~left), ("both", left | ~left)):
        np.testing.assert_array_equal(mesh.element_sets[set_name], np.flatnonzero(there))
    for set_name, x in (("clamp", 0.0), ("seam", 2.0)):
        np.testing.assert_array_equal(mesh.node_sets[set_name], mesh.nodes_where(lambda at, x=x: abs(at[0] - x) < 1e-9))
        assert len(sides_at(mesh, x)) == 2 and mesh.side_sets[set_name].tolist() == sides_at(mesh, x)
    if name.endswith("msh"):
        assert mesh.node_sets["tip"].tolist() == [mesh.nearest_node([4.0, 0.0, 0.0])]
        assert {*mesh.element_sets} == {"left plate", "right plate", "both"} and {*mesh.side_sets} == {"clamp", "seam"}


def test_groups_of_one_name_or_number_are_kept_apart_by_dimension(tmp_path):
    """Group 2 has no name: of a point, a curve and a surface."""
    mesh = js.Mesh.read(written(tmp_path, "groups.msh", GMSH22))
    assert lists(mesh.element_sets) == {"a": [0], "2": [1]}
    assert lists(mesh.side_sets) == {"a": [[0, 3]], "2": [[1, 2]]}
    assert lists(mesh.node_sets) == {"a": [0, 1, 3], "point 2": [2], "2": [1, 2]}


def test_groups_without_elements_are_named(tmp_path):
    more = GMSH22.replace('3\n0 1 "a"', '4\n2 8 "lost"\n0 1 "a"')
    with pytest.warns(
        UserWarning, match=r"groups\.msh: Left out, since no triangle or quad has any of it: element set"
    ):
        js.Mesh.read(written(tmp_path, "groups.msh", more))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("2.2 0 8", "4 0 8", "is of MSH version 4; versions 2.2 and 4.1 are read"),
        ("$EndElements", "", r"has no section \$Elements, or ends within it"),
        ("1 3 7\n", "1 3 8\n", "a triangle names a node that it does not have"),
        ("1 3 7\n", "1 3\n", "the element '4 2 2 2 1 1 3' should have 3 nodes"),
        ('0 1 "a"', '0 1 a"', ""),
    ],
)
def test_a_file_of_gmsh_that_is_wrong_is_refused(old, new, message, tmp_path):
    file = written(tmp_path, "wrong.msh", GMSH22.replace(old, new))
    if not message:
        assert "a" in js.Mesh.read(file).element_sets
        return
    with pytest.raises(ValueError, match=rf"wrong\.msh .*{message}"):
        js.Mesh.read(file)


SCENE = """
[mesh]
file = "plates.msh"
[[section]]
elements = "left plate"
thickness = 0.1
young_modulus = 1.2e6
poisson_ratio = 0.3
density = 1.0
[[section]]
elements = "right plate"
thickness = 0.05
young_modulus = 1.2e6
poisson_ratio = 0.3
density = 1.0
[[supports]]
nodes = "clamp"
hold = "clamped"
[[loads]]
kind = "edge force"
edges = "seam"
force = [0.0, 0.0, 1.0]
[[loads]]
kind = "force"
nodes = "tip"
force = [0.0, 0.0, 2.0]
[[loads]]
kind = "pressure"
elements = "both"
pressure = 3.0
[watch]
tip = { node = "tip", component = "uz" }
"""


def test_a_scene_file_goes_by_the_groups_of_its_mesh(tmp_path):
    """And is the scene that numbers state, found by places."""
    (tmp_path / "plates.msh").write_bytes((DATA / "gmsh41_binary.msh").read_bytes())
    scene, _ = read_scene_file(written(tmp_path, "scene.toml", SCENE))
    mesh = scene.mesh
    assert [support.nodes.array.tolist() for support in scene.supports] == [
        mesh.nodes_where(lambda x: x[0] < 1e-9).tolist()
    ]
    edge, force, pressure = scene.loads
    assert isinstance(edge, js.EdgeForce) and edge.edges.array.tolist() == sides_at(mesh, 2.0)
    tip = mesh.nearest_node([4.0, 0.0, 0.0])
    assert isinstance(force, js.NodalForce) and force.nodes.array.tolist() == [tip]
    assert isinstance(pressure, js.Pressure) and pressure.elements is not None
    assert pressure.elements.array.tolist() == list(range(36)) and scene.watch == (("tip", tip, "uz"),)
    left = np.asarray(mesh.nodes)[mesh.triangles].mean(axis=1)[:, 0] < 2
    assert isinstance(scene.section, Regions)
    assert [found.array.tolist() for found in scene.section.elements] == [
        np.flatnonzero(left).tolist(), np.flatnonzero(~left).tolist(),
    ]  # fmt: skip


# --- Abaqus ----------------------------------------------------------------------------------------------


def test_sets_of_an_input_file(tmp_path):
    """The quad is cut in two; node 99 belongs to nothing."""
    with pytest.warns(UserWarning, match=r"node set 'left' \(1 of 3 nodes\)"):
        mesh = js.Mesh.read(written(tmp_path, "hand.inp", INP))
    np.testing.assert_array_equal(mesh.triangles, [[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]])
    np.testing.assert_array_equal(mesh.nodes[4:], [[2, 0, 0], [2, 1, 0]])
    assert lists(mesh.element_sets) == {
        "Tri": [0, 1],
        "Quad": [2, 3],
        "all": [0, 1, 2, 3],
        "odd": [0, 2, 3],
        "top": [0, 1],
    }
    assert lists(mesh.node_sets) == {
        "Every": [0, 1, 2, 3, 4, 5], "left": [0, 3], "ofquad": [1, 2, 4, 5], "points": [0, 3],
    }  # fmt: skip
    assert lists(mesh.side_sets) == {"rim": [[0, 3], [4, 5]]}


def test_instances_of_a_part_are_placed_and_their_sets_called_by_them(tmp_path):
    """The second one is moved by (1, 1, 5) and turned by a right angle about the axis through (1, 1)."""
    mesh = js.Mesh.read(written(tmp_path, "parts.inp", PARTS))
    np.testing.assert_allclose(mesh.nodes[3:], [[1, 1, 5], [1, 2, 5], [0, 2, 5]], atol=1e-12)
    assert lists(mesh.node_sets) == {
        "FIRST.Set-1": [0, 1], "SECOND.Set-1": [3, 4], "Set-1": [5], "Both": [0, 1, 5],
    }  # fmt: skip
    assert lists(mesh.element_sets) == {"FIRST.Skin": [0], "SECOND.Skin": [1], "_Loaded_SPOS": [1], "Loaded": [1]}


def test_faces_of_plane_elements_and_of_calculix_are_edges(tmp_path):
    text = INP.replace("TYPE=S3R", "TYPE=CPS3").replace("2, E3", "2, S3").replace("Quad, E2", "Quad, S4")
    with pytest.warns(UserWarning, match="'left'"):
        assert lists(js.Mesh.read(written(tmp_path, "plane.inp", text)).side_sets) == {"rim": [[0, 3], [4, 5]]}


def test_numbers_of_an_input_file_lead_to_those_of_the_mesh(tmp_path):
    found = abaqus.inp_of_cards(read_cards(written(tmp_path, "hand.inp", INP)))
    with pytest.warns(UserWarning, match="'left'"):
        mesh, numbering = mesh_of_cells(found.cells, "hand.inp")
    assert [int(numbering.nodes[found.points["", label]]) for label in (10, 50, 99)] == [0, 4, -1]
    assert numbering.triangles([found.elements["", 7], found.elements["", 1]]).tolist() == [2, 3, 0]
    assert found.faces["rim"] == [(2, "E2"), (1, "E3")] and mesh.n_elements == 4


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (" 30, 1., 1.", " 30, 1., x", r"wrong\.inp, line 6: field 3, 'x', should be a number"),
        ("2, 10, 30, 40", "2, 10, 30, 41", r"line 14: element 2 names node 41, which is not defined"),
        ("2, 10, 30, 40", "2, 10, 30", r"line 14: element 2 has 2 nodes, not 3"),
        ("2, 10, 30, 40", "1, 10, 30, 40", r"line 14: element 1 is defined twice"),
        (" 40, 0., 1.", " 30, 0., 1.", r"line 8: node 30 is defined twice"),
        ("TYPE=S3R", "TYPE=C3D4", "element 1 names|holds 2 C3D4 cells, which are no shell elements"),
        (" tri, QUAD", " tri, web", r"line 19: element set 'all' names web, which is no number and no set"),
        ("*NSET, NSET=left", "*NGEN, NSET=left", r"\*NGEN is not read; write all nodes and elements in full"),
        ("NSET=Every", "SYSTEM=C", r"only rectangular coordinates"),
        ("*HEADING\n", "*INCLUDE, INPUT=none.inp\n", "there is no file none.inp to include"),
    ],
)  # fmt: skip
def test_an_input_file_that_is_wrong_is_refused_with_its_line(old, new, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        js.Mesh.read(written(tmp_path, "wrong.inp", INP.replace(old, new, 1)))


def test_numbers_of_sets_that_are_not_there_are_named(tmp_path):
    text = INP.replace("\n 99\n*NSET, NSET=ofquad", "\n 98\n*NSET, NSET=ofquad")
    with pytest.warns(UserWarning, match="Node set 'LEFT' names 1 that the file does not have"):
        assert js.Mesh.read(written(tmp_path, "less.inp", text)).node_sets["left"].tolist() == [0, 3]


def test_an_included_file_is_read_in_its_place(tmp_path):
    nodes, elements = INP.split("*ELEMENT", 1)
    written(tmp_path, "nodes.inp", nodes)
    file = written(tmp_path, "all.inp", f"*INCLUDE, INPUT=nodes.inp\n*ELEMENT{elements}")
    with pytest.warns(UserWarning, match="'left'"):
        assert js.Mesh.read(file).n_elements == 4


# --- VTK and OBJ -----------------------------------------------------------------------------------------

POINTS = [[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0], [7, 7, 7]]
TRIANGLES, QUADS, LINES = [[0, 1, 2], [0, 2, 3]], [[1, 4, 5, 2]], [[0, 3], [4, 5]]


def test_polygons_and_whole_numbers_of_cells_are_read_from_vtk(tmp_path):
    mesh = js.Mesh.read(written(tmp_path, "polygons.vtk", POLYDATA))
    assert lists(mesh.element_sets) == {"part 1": [0, 1], "part 2": [2, 3]} and not mesh.node_sets


@pytest.mark.parametrize("suffix", [".vtk", ".vtu", ".xdmf"])
def test_whole_numbers_of_cells_are_sets_and_others_are_not(suffix, tmp_path):
    cells: Any = [("line", np.array(LINES)), ("triangle", np.array(TRIANGLES)), ("quad", np.array(QUADS))]
    data = {"part": [np.array([3, 3]), np.array([1, 2]), np.array([2])], "load": [np.ones(2), np.ones(2), np.ones(1)]}
    meshlane.write(tmp_path / f"parts{suffix}", meshlane.Mesh(np.array(POINTS), cells, cell_data=data))
    mesh = js.Mesh.read(tmp_path / f"parts{suffix}")
    assert lists(mesh.element_sets) == {"part 1": [0], "part 2": [1, 2, 3]}
    assert lists(mesh.side_sets) == {"part 3": [[0, 3], [4, 5]]} and lists(mesh.node_sets) == {"part 3": [0, 3, 4, 5]}


def test_groups_and_objects_of_obj_files_are_sets(tmp_path):
    mesh = js.Mesh.read(written(tmp_path, "wing.obj", OBJ))
    assert lists(mesh.element_sets) == {"Wing": [0, 1, 2, 3], "skin": [0, 1], "upper": [0, 1], "rib": [2, 3]}
    np.testing.assert_array_equal(mesh.triangles, [[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]])


@pytest.mark.parametrize("head", ["OFF\n# a comment\n6 3 0\n", "OFF 6 3 0\n"])
def test_off_files_of_triangles_and_quads(head, tmp_path):
    faces = "3 0 1 2\n3 0 2 3 255 0 0\n4 1 4 5 2\n"
    points = "".join(f"{x} {y} {z}\n" for x, y, z in POINTS[:6])
    mesh = js.Mesh.read(written(tmp_path, "some.off", head + points + faces))
    np.testing.assert_array_equal(mesh.triangles, [[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]])


@pytest.mark.parametrize(("suffix", "binary"), [(".stl", True), (".stl", False), (".ply", True), (".ply", False)])
def test_surfaces_without_sets(suffix, binary, tmp_path):
    cells: Any = [("triangle", np.array(TRIANGLES))] + ([("quad", np.array(QUADS))] if suffix == ".ply" else [])
    meshlane.write(tmp_path / f"a{suffix}", meshlane.Mesh(np.array(POINTS[:6]), cells), binary=binary)
    mesh = js.Mesh.read(tmp_path / f"a{suffix}")
    assert mesh.n_elements == (4 if suffix == ".ply" else 2)
    assert not mesh.node_sets and not mesh.element_sets and not mesh.side_sets


def test_groups_of_med_files(tmp_path):
    """Salome's: named groups of cells and of nodes."""
    cells: Any = [("triangle", np.array(TRIANGLES)), ("quad", np.array(QUADS))]
    meshlane.write(
        tmp_path / "a.med",
        meshlane.Mesh(
            np.array(POINTS[:6]),
            cells,
            point_sets={"left": np.array([0, 3])},
            cell_sets={"rib": [np.array([], int), np.array([0])], "half": [np.array([0]), np.array([0])]},
        ),
    )
    mesh = js.Mesh.read(tmp_path / "a.med")
    assert lists(mesh.element_sets) == {"rib": [2, 3], "half": [0, 2, 3]} and lists(mesh.node_sets) == {"left": [0, 3]}


# --- cells and sets --------------------------------------------------------------------------------------

SECOND = [[0.0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [1, 0, 0], [2, 1, 0], [1, 2, 0], [0, 1, 0], [1, 1, 0]]


@pytest.mark.parametrize(
    ("kind", "corners", "count"),
    [
        ("triangle6", [[0, 1, 2, 4, 5, 8], [0, 2, 3, 8, 6, 7]], 8),
        ("quad8", [[0, 1, 2, 3, 4, 5, 6, 7]], 6),
        ("quad9", [[0, 1, 2, 3, 4, 5, 6, 7, 8]], 8),
    ],
)
def test_cells_of_second_order_are_cut_through_the_nodes_on_their_sides(kind, corners, count):
    """Lines of the same order, and of the first, which leaves the node on the side out, mark the same edges."""
    blocks = [("line3", np.array([[0, 3, 7]])), ("line", np.array([[1, 2]])), (kind, np.array(corners))]
    cells = Cells(
        np.array(SECOND),
        blocks,
        element_sets={name: np.array([i]) for i, name in enumerate(("left", "right", "first"))},
    )
    with pytest.raises(ValueError, match=rf'file holds \d {kind} cells.* second_order="split" cuts'):
        mesh_of_cells(cells, "file")
    mesh, numbering = mesh_of_cells(cells, "file", second_order="split")
    assert mesh.n_elements == count
    np.testing.assert_array_equal(mesh.element_sets["first"], np.arange(count // len(corners)))
    assert mesh.boundary_edges().tolist() == [[0, 4], [0, 7], [1, 4], [1, 5], [2, 5], [2, 6], [3, 6], [3, 7]]
    assert lists(mesh.side_sets) == {"left": [[0, 7], [3, 7]], "right": [[1, 5], [2, 5]]}
    assert lists(mesh.node_sets) == {"left": [0, 3, 7], "right": [1, 2, 5]}
    a, b, c = np.moveaxis(np.asarray(mesh.nodes)[mesh.triangles], 1, 0)
    area = np.cross(b - a, c - a)[:, 2] / 2
    assert area.sum() == pytest.approx(4.0) and (area > 0).all()
    assert numbering.first.tolist()[:3] == [0, 0, 0]


def faces_that_touch():
    """Two squares with their own nodes along x = 1, and a node of neither; the second one's normals are turned."""
    points = [[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [5, 5, 5], [1, 0, 0], [2, 0, 0], [2, 1, 0], [1, 1, 0]]
    return Cells(
        np.array(points),
        [("quad", np.array([[0, 1, 2, 3], [5, 8, 7, 6]]))],
        {"seam": np.array([1, 2, 5, 8]), "end": np.array([6, 7, 4])},
        {"one": np.array([0]), "two": np.array([1])},
        {"seam": np.array([[1, 2], [8, 5]]), "end": np.array([[6, 7], [4, 6]]), "diagonal": np.array([[5, 7]])},
    )


def test_sets_follow_nodes_that_are_merged_and_triangles_that_are_turned():
    with pytest.warns(UserWarning) as said:
        mesh, numbering = mesh_of_cells(faces_that_touch(), "faces", merge=1e-9, orient=True)
    assert str(said[0].message) == (
        "faces: Left out of sets, since no triangle or quad has it: node set 'end' (1 of 3 nodes), side set 'end' "
        "(1 of 2 edges)."
    )
    assert numbering.nodes.tolist() == [0, 1, 2, 3, -1, 1, 4, 5, 2] and numbering.turned.tolist() == 2 * [False] + 2 * [
        True
    ]
    assert lists(mesh.node_sets) == {"seam": [1, 2], "end": [4, 5]}
    assert lists(mesh.element_sets) == {"one": [0, 1], "two": [2, 3]}
    assert lists(mesh.side_sets) == {"seam": [[1, 2]], "end": [[4, 5]], "diagonal": [[1, 5]]}


def test_cures_of_a_mesh_keep_its_sets():
    with pytest.warns(UserWarning, match="Left out of sets"):
        apart, _ = mesh_of_cells(faces_that_touch(), "faces", coincident="allow")
    merged = apart.merged(1e-9, orient=True)
    with pytest.warns(UserWarning, match="Left out of sets"):
        at_once, _ = mesh_of_cells(faces_that_touch(), "faces", merge=1e-9, orient=True)
    for sets in ("node_sets", "element_sets", "side_sets"):
        assert lists(getattr(merged, sets)) == lists(getattr(at_once, sets))
        assert lists(getattr(apart.oriented(coincident="allow"), sets)) == lists(getattr(apart, sets))


def test_a_set_of_which_nothing_is_left_is_named():
    cells = Cells(
        np.array(POINTS), [("triangle", np.array(TRIANGLES))], {"far": np.array([6])}, {}, {"no": np.array([[0, 4]])}
    )
    with pytest.warns(UserWarning, match=r"Left out, since no .* has any of it: node set 'far', side set 'no'\.$"):
        mesh, _ = mesh_of_cells(cells, "file")
    assert not mesh.node_sets and not mesh.side_sets
