"""Meshes of Nastran bulk data: formats of fields, coordinate systems, sets of properties, and errors with their line."""

import jax
import numpy as np
import pytest
from mesh_texts import BDF, lists, written

jax.config.update("jax_enable_x64", True)

import jaxshell as js  # noqa: E402
from jaxshell.model.mesh_files import nastran  # noqa: E402
from jaxshell.model.mesh_files.bulk_data import read_file  # noqa: E402


def test_properties_of_bulk_data_are_sets(tmp_path):
    """With angles and offsets after the nodes, an exponent without its e, a cylindrical system, and all formats."""
    mesh = js.Mesh.read(written(tmp_path, "hand.bdf", BDF))
    np.testing.assert_allclose(
        mesh.nodes, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0]], atol=1e-12
    )
    assert lists(mesh.element_sets) == {"skin": [0, 1], "PCOMP 9": [2, 3]}
    assert lists(mesh.side_sets) == {"property 5": [[4, 5]]} and lists(mesh.node_sets) == {"property 5": [4, 5]}
    bulk = nastran.bulk_of_file(read_file(tmp_path / "hand.bdf"))
    assert (bulk.points[5], bulk.elements[8]) == (4, 3)


def test_bulk_data_without_begin_and_end_are_read(tmp_path):
    """As gmsh writes them."""
    text = BDF.split("BEGIN BULK\n")[1].replace("ENDDATA\n", "")
    assert js.Mesh.read(written(tmp_path, "bare.nas", text)).n_elements == 4


CYLINDER = """GRDSET,,7
CORD1C,7,1,2,3
GRID,1,0,0.,0.,0.
GRID,2,0,0.,0.,1.
GRID,3,0,1.,0.,0.
GRID,4,,2.,0.,0.
GRID,5,,2.,90.,0.
GRID,6,,2.,90.,1.
CTRIA3,1,1,4,5,6
"""


def test_coordinate_systems_of_grid_points_and_a_system_for_all(tmp_path):
    """A 0 in place of the system is the basic one, an empty field GRDSET's. What follows ENDDATA is not read."""
    written(tmp_path, "inner.bdf", CYLINDER + "ENDDATA\nGRID,4\n")
    mesh = js.Mesh.read(written(tmp_path, "outer.bdf", "INCLUDE 'inner.bdf' $ and no more\nINCLUDE 'none.bdf'\n"))
    np.testing.assert_allclose(mesh.nodes, [[2, 0, 0], [0, 2, 0], [0, 2, 1]], atol=1e-15)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("GRDSET,,7", "GRDSET,,7\nGRDSET,,0", "line 2: GRDSET is there twice"),
        ("GRID,3,0,", "GRID,3,,", "line 5: GRID 3 is in coordinate system 7, which is defined by itself"),
        ("CORD1C,7,1,2,3", "CORD1C,7,1,2,9", "line 2: CORD1C 7 names grid point 9, which is not there"),
        ("CORD1C,7,1,2,3", "CORD1C,7,1,2,3,7,1,3,2", "line 2: coordinate system 7 is defined twice"),
        ("GRID,4,,2.", "GRID,4,,nan", "line 6: field 3 of GRID, 'nan', should be a number"),
        ("GRID,6,,2.,90.,1.", "GRID,6,,2.,90.,1.,,,,+B\n+C,1", r"line 9: \+C does not continue .* goes on with \+B"),
        ("CTRIA3,1", "BEGIN SUPER=1\nCTRIA3,1", "line 9: superelements are not read, and BEGIN SUPER=1 begins one"),
        ("CTRIA3,1", "CTRIA 3,1", "line 9: 'CTRIA 3,' begins no card of bulk data"),
    ],
)  # fmt: skip
def test_grid_points_that_are_wrong_are_refused_with_their_line(old, new, message, tmp_path):
    with pytest.raises(ValueError, match=r"wrong\.bdf, " + message):
        js.Mesh.read(written(tmp_path, "wrong.bdf", CYLINDER.replace(old, new, 1)))


def test_springs_and_rigid_bodies_are_left_out_by_name(tmp_path):
    text = BDF.replace("ENDDATA", "CELAS2,90,1.0,1,1,2,1\nRBE2,91,1,123,2\nRBE2,92,1,123,3\nENDDATA")
    with pytest.warns(UserWarning, match=r"springs\.bdf: 1 CELAS2 are left out\. 2 RBE2 are left out\.$"):
        assert js.Mesh.read(written(tmp_path, "springs.bdf", text)).n_elements == 4


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("$HMNAME PROP", "INCLUDE\n$HMNAME PROP", r"wrong\.bdf, line 4: INCLUDE needs the name of a file"),
        ("$HMNAME PROP", "INCLUDE 'no.bdf'\n$HMNAME PROP", r"wrong\.bdf, line 4: there is no file no\.bdf to include"),
        ("       7     1.0     90.", "       8     1.0     90.", "line 9: GRID 4 is in coordinate system 8, which is not"),
        ("CTRIA3,2,4,1,3,4", "CTRIA3,2,4,1,3,44", "line 15: CTRIA3 2 names grid point 44, which is not there"),
        ("CTRIA3,2,4,1,3,4", "CTRIA3,2,4,1,3", "names no grid point in field 5"),
        ("CTRIA3,2,4,1,3,4", "CTRIA3,1,4,1,3,4", "line 15: element 1 is defined twice"),
        ("CTRIA3,2,4,1,3,4", "CTETRA,2,4,1,3,4,5", "holds 1 CTETRA cells, which are no shell elements"),
        ("GRID,2,,1.0", "GRID,2,,1.0x", r"wrong\.bdf, line 6: field 3 of GRID, '1.0x', should be a number"),
        ("0.      1.      +\n+       1.  ", "0.      1.      +\n+       0.  ", "coordinate system lie on one line"),
    ],
)  # fmt: skip
def test_bulk_data_that_are_wrong_are_refused_with_their_line(old, new, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        js.Mesh.read(written(tmp_path, "wrong.bdf", BDF.replace(old, new, 1)))
