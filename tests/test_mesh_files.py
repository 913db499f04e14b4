"""Meshes as other programs write them: quads, faces that only touch, normals that disagree, slivers, broken files."""

import dataclasses

import jax
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)

import meshlane  # noqa: E402

import jaxshell as js  # noqa: E402
from jaxshell.analyses.statics import solve_static  # noqa: E402
from jaxshell.command.report import describe_scene  # noqa: E402
from jaxshell.files.scene_file import read_scene_file  # noqa: E402
from jaxshell.model.generators import rectangle  # noqa: E402
from jaxshell.model.grids import grid  # noqa: E402
from jaxshell.model.repair import split_quads  # noqa: E402

STRIP = rectangle(4.0, 1.0, [8, 2])
NODES = np.asarray(STRIP.nodes)
SECTION = js.Section(0.1, 1.2e6, 0.3, 1.0)


def quads(rows: int, columns: int) -> np.ndarray:
    """Of a grid whose node (i, j) has the number i·(columns + 1) + j."""
    i, j = grid(np.arange(rows), np.arange(columns))
    at = i * (columns + 1) + j
    return np.stack([at, at + columns + 1, at + columns + 2, at + 1], 1)


def write(path, cells: dict, nodes=NODES):
    meshlane.write(path, meshlane.Mesh(nodes, [(kind, np.asarray(data)) for kind, data in cells.items()]))
    return path


def tip(mesh) -> float:
    """Deflection of a cantilever's corner at (4, 1, 0), clamped at x = 0, under 2 along z at (4, 0, 0)."""
    clamped = js.clamped(mesh.nodes_where(lambda x: x[0] < 1e-9))
    load = js.NodalForce([mesh.nearest_node([4.0, 0.0, 0.0])], [0.0, 0.0, 2.0])
    scene = js.Scene(mesh, SECTION, [clamped], [load], watch={"tip": (mesh.nearest_node([4.0, 1.0, 0.0]), "uz")})
    return float(solve_static(scene, [0.5, 1.0]).watched["tip"][-1])


@pytest.fixture(scope="module")
def right() -> float:
    return tip(STRIP)


# --- quads and other cells -------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".vtk", ".msh", ".inp", ".vtu"])
def test_a_cantilever_of_triangles_and_quads_bends_as_one_of_triangles(suffix, tmp_path, right):
    """Its quads once went missing: it bent by a sixteenth. Squares are cut along the diagonal that STRIP has."""
    cells = {"triangle": STRIP.triangles[:12], "quad": quads(8, 2)[6:]}
    mesh = js.Mesh.read(write(tmp_path / f"mixed{suffix}", cells))
    np.testing.assert_array_equal(mesh.triangles, STRIP.triangles)
    if suffix == ".vtk":
        assert tip(mesh) == pytest.approx(right, rel=1e-9)


def test_quads_can_be_refused(tmp_path):
    file = write(tmp_path / "mixed.vtk", {"triangle": STRIP.triangles[:12], "quad": quads(8, 2)[6:]})
    with pytest.raises(ValueError, match=r'mixed\.vtk holds 10 quad cells.* quads="split" cuts'):
        js.Mesh.read(file, quads="error")
    with pytest.raises(ValueError, match="quads must be one of split, error, but it is 'keep'"):
        js.Mesh.read(file, quads="keep")


def test_quads_are_cut_along_their_shorter_diagonal():
    x = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [3, 3, 0], [0.2, 0.2, 0], [-1, 0.4, 0]])

    def cut(*quad):
        triangles, of = split_quads(x, np.array([quad]))
        assert of.tolist() == [0] * len(triangles)
        return triangles.tolist()

    assert cut(0, 1, 2, 3) == [[0, 1, 2], [0, 2, 3]]  # of two like ones the first
    assert cut(0, 1, 4, 3) == [[0, 1, 3], [1, 4, 3]]
    # A dart: the shorter diagonal, from node 1 to node 3, runs outside.
    assert cut(0, 1, 5, 3) == [[0, 1, 5], [0, 5, 3]]
    assert cut(0, 1, 2, 2) == [[0, 1, 2]]  # a triangle, as some programs write it


@pytest.mark.parametrize(
    ("cells", "message"),
    [
        ({"triangle6": [[0, 3, 4, 1, 2, 5]]}, "holds 1 triangle6 cells, which are no shell elements here"),
        ({"triangle": [[0, 3, 4]], "quad8": [[0, 1, 2, 3, 4, 5, 6, 7]]}, "holds 1 quad8 cells"),
        ({"triangle": [[0, 3, 4]], "tetra": [[0, 1, 3, 6]]}, "holds 1 tetra cells"),
        ({"line": [[0, 1]]}, r"holds no triangles \(it has: 1 line\)"),
    ],
)
def test_other_cells_are_refused_by_name(cells, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        js.Mesh.read(write(tmp_path / "other.vtk", cells))


def test_points_and_lines_are_left_out_by_name(tmp_path):
    cells = {"vertex": [[0]], "line": [[0, 1], [1, 2]], "triangle": STRIP.triangles}
    with pytest.warns(UserWarning, match=r"marked\.vtk: 1 vertex, 2 line cells are left out"):
        mesh = js.Mesh.read(write(tmp_path / "marked.vtk", cells))
    np.testing.assert_array_equal(mesh.triangles, STRIP.triangles)


# --- files that are none ---------------------------------------------------------------------------------

BROKEN = {
    "empty.msh": b"",
    "empty.ply": b"",  # meshlane's reader goes on for ever
    "cut.ply": b"ply\nformat ascii 1.0\nelement vertex 4\n",
    "text.stl": b"solid\n",
    "cut.vtk": b"# vtk DataFile Version 5.1\nwritten\nBINARY\nDATASET UNSTRUCTURED_GRID\nPOINTS 99999999999 double\n",
    "text.inp": b"*NODE\n1, 0.0, a, 0.0\n",
    "broken.vtu": b"<VTKFile",
    "broken.med": b"\x89HDF",
    "words.obj": b"v 1 2\nv 1 2 3\nf 1 2 9\n",
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_file_is_one_error_that_names_it(name, tmp_path, capsys):
    (tmp_path / name).write_bytes(BROKEN[name])
    with pytest.raises(
        ValueError, match=rf"{name}( cannot be read as a mesh file| holds no triangles|, line 2: field 3)"
    ):
        js.Mesh.read(tmp_path / name)
    assert capsys.readouterr() == ("", "")


def test_what_is_no_mesh_file_at_all(tmp_path):
    (tmp_path / "sheet.xyz").write_text("1 2 3")
    with pytest.raises(ValueError, match=r"sheet\.xyz is of no kind that is read, which the name"):
        js.Mesh.read(tmp_path / "sheet.xyz")
    for path in (tmp_path, tmp_path / "none.vtk", "\0.vtk", "x" * 300 + ".vtk"):
        with pytest.raises(FileNotFoundError, match="There is no mesh file"):
            js.Mesh.read(path)


# --- faces that touch ------------------------------------------------------------------------------------


def halves(gap: float = 0.0):
    """STRIP as two faces of their own nodes, which touch along x = 2."""
    left, right = rectangle(2.0, 1.0, [4, 2]), rectangle(2.0, 1.0, [4, 2])
    nodes = np.concatenate([np.asarray(left.nodes), np.asarray(right.nodes) + [2.0 + gap, 0.0, 0.0]])
    return nodes, np.concatenate([left.triangles, right.triangles + left.n_nodes])


@pytest.mark.parametrize("gap", [0.0, 1e-7])
def test_faces_that_only_touch_are_refused_with_the_cure(gap):
    with pytest.raises(ValueError, match=r"nodes coincide .*node 15 with node 12.*Mesh\.merged\("):
        js.Mesh(*halves(gap))


def test_merged_faces_are_the_shell_in_one_piece(tmp_path, right):
    nodes, triangles = halves(1e-7)
    mesh = js.Mesh.merged(nodes, triangles, 1e-5)
    np.testing.assert_array_equal(mesh.triangles, STRIP.triangles)
    np.testing.assert_allclose(mesh.nodes, NODES, atol=2e-7)
    assert tip(mesh) == pytest.approx(right, rel=1e-5)
    apart = js.Mesh(nodes, triangles, coincident="allow")
    np.testing.assert_array_equal(apart.merged(1e-5).triangles, STRIP.triangles)
    file = write(tmp_path / "faces.vtk", {"triangle": triangles}, nodes)
    np.testing.assert_array_equal(js.Mesh.read(file, merge=1e-5).triangles, STRIP.triangles)
    with pytest.raises(ValueError, match=r"faces\.vtk: .*nodes coincide"):
        js.Mesh.read(file)


def test_every_number_of_nodes_in_one_place_is_merged():
    """A fan of triangles that share nothing, as STL files have it."""
    rim = np.arange(12)
    corners = np.stack([np.cos(np.pi * rim / 6), np.sin(np.pi * rim / 6), 0 * rim], 1)
    nodes = np.stack([0 * corners, corners, np.roll(corners, -1, axis=0)], 1).reshape(-1, 3)
    mesh = js.Mesh.merged(
        nodes + 1e-9 * np.random.default_rng(0).normal(size=nodes.shape), rim[:, None] * 3 + [0, 1, 2], 1e-6
    )
    assert (mesh.n_nodes, mesh.n_elements, len(mesh.boundary_edges())) == (13, 12, 12)


def test_merging_does_not_collapse_triangles():
    with pytest.raises(
        ValueError, match=r"Merging within 0\.6 would collapse triangles: the shortest edge at node 0 is 0\.5"
    ):
        js.Mesh.merged(NODES, STRIP.triangles, 0.6)


def test_loose_parts_may_run_and_are_named():
    nodes, triangles = halves(1.0)
    lines = describe_scene(js.Scene(js.Mesh(nodes, triangles), SECTION)).splitlines()
    assert (
        lines[1]
        == "  2 loose parts, which no triangle connects: one of 15 nodes with node 0, one of 15 nodes with node 15"
    )
    assert len(describe_scene(js.Scene(STRIP, SECTION)).splitlines()) == 1


def test_a_slit_is_meant():
    mesh = js.scenes.slit_annular_plate((2, 8)).mesh
    with pytest.raises(ValueError, match=r'3 nodes coincide.* coincident="allow" keeps them apart'):
        js.Mesh(mesh.nodes, mesh.triangles)
    assert js.Mesh(mesh.nodes, mesh.triangles, coincident="allow").n_nodes == mesh.n_nodes


# --- normals ---------------------------------------------------------------------------------------------


def test_oriented_mesh_is_the_one_oriented_by_hand():
    turned = STRIP.triangles.copy()
    some = np.random.default_rng(1).permutation(np.arange(1, len(turned)))[:11]
    turned[some] = turned[some][:, [0, 2, 1]]
    with pytest.raises(ValueError, match=r"have opposite normals.* Mesh\.oriented\(nodes, triangles\)"):
        js.Mesh(NODES, turned)
    np.testing.assert_array_equal(js.Mesh.oriented(NODES, turned).triangles, STRIP.triangles)
    # Each part goes by its own first triangle.
    nodes, triangles = halves(1.0)
    triangles[16] = triangles[16][[0, 2, 1]]
    found = js.Mesh.oriented(nodes, triangles).triangles
    np.testing.assert_array_equal(found[:16], triangles[:16])
    np.testing.assert_array_equal(found[17:], triangles[17:][:, [0, 2, 1]])


def test_a_moebius_strip_has_no_orientation():
    count = 12
    turn = 2 * np.pi * np.arange(count) / count
    across = np.array([-0.3, 0.3])[None, :]
    radius = 1 + across * np.cos(turn / 2)[:, None]
    nodes = np.stack(
        [radius * np.cos(turn)[:, None], radius * np.sin(turn)[:, None], across * np.sin(turn / 2)[:, None]], 2
    )
    here, there = np.arange(count), np.roll(np.arange(count), -1)
    flip = (there == 0).astype(int)
    a, b, c, d = 2 * here, 2 * there + flip, 2 * there + 1 - flip, 2 * here + 1
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    with pytest.raises(ValueError, match="opposite normals"):
        js.Mesh(nodes.reshape(-1, 3), triangles)
    with pytest.raises(ValueError, match="The mesh has no orientation: as on a Möbius strip"):
        js.Mesh.oriented(nodes.reshape(-1, 3), triangles)


# --- slivers ---------------------------------------------------------------------------------------------


def with_a_narrow_column(width: float):
    x = np.linspace(0, 4, 9)
    x[4] = x[3] + width
    x, y = grid(x, np.linspace(0, 1, 3))
    return np.stack([x, y, 0 * x], 1), STRIP.triangles


def test_slivers_are_refused_where_statics_begins_to_fail(right):
    """Four slivers of aspect 2e4 still bend as the strip does."""
    assert tip(js.Mesh(*with_a_narrow_column(2.5e-5))) == pytest.approx(right, rel=1e-2)
    with pytest.raises(ValueError, match=r"Triangle \d+ .* is a sliver: its longest edge is 5e\+04 times its height"):
        js.Mesh(*with_a_narrow_column(1e-5))


# --- the same in scene files -----------------------------------------------------------------------------

SCENE = """
[mesh]
file = "faces.vtk"
{more}
[section]
thickness = 0.1
young_modulus = 1.2e6
poisson_ratio = 0.3
density = 1.0
"""


@pytest.mark.wrong_types
def test_cures_in_scene_files(tmp_path):
    nodes, triangles = halves(1e-7)
    triangles[20:] = triangles[20:][:, [0, 2, 1]]
    write(tmp_path / "faces.vtk", {"triangle": triangles}, nodes)

    def read(more):
        (tmp_path / "scene.toml").write_text(SCENE.format(more=more))
        return read_scene_file(tmp_path / "scene.toml")[0].mesh

    np.testing.assert_array_equal(read("merge = 1e-5\norient = true").triangles, STRIP.triangles)
    assert read('coincident = "allow"\norient = true').n_nodes == len(nodes)
    for more, message in (
        ("merge = 1e-5", "have opposite normals"),
        ("orient = true", "nodes coincide"),
        ('merge = "a"', "merge must be one number, but it is 'a'"),
        ("quads = 4", "quads must be one of split, error, but it is 4"),
        ("fuse = 1.0", "unknown key 'fuse'. Known keys: file, quads, second_order, merge, orient, coincident"),
    ):
        with pytest.raises(ValueError, match=rf"scene\.toml: \[mesh\] .*{message}"):
            read(more)


def test_a_scene_of_a_slit_can_be_replaced_and_traced():
    scene = js.scenes.slit_annular_plate((2, 8))
    assert dataclasses.replace(scene, name="other").mesh is scene.mesh
    doubled = jax.jit(lambda scale: js.Mesh(scale * scene.mesh.nodes, scene.mesh.triangles))(2.0)
    np.testing.assert_allclose(doubled.nodes, 2 * np.asarray(scene.mesh.nodes))
