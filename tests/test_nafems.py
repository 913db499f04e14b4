"""NAFEMS' benchmarks of stresses: the cylindrical shell patch test LE2."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxshell as js

RADIUS, LENGTH, THICKNESS, ROWS, COLUMNS = 1.0, 0.5, 0.01, 16, 8


@pytest.fixture(scope="module")
def sector():
    """30 degrees of a cylinder, its rows of nodes round it: clamped at 0, symmetric at both ends of its length."""
    angle, z = (
        a.ravel()
        for a in np.meshgrid(np.linspace(0, np.pi / 6, ROWS + 1), np.linspace(0, LENGTH, COLUMNS + 1), indexing="ij")
    )
    nodes = np.stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), z], axis=1)
    mesh = js.Mesh(nodes, js.structured_triangles(ROWS, COLUMNS))  # normals outwards
    first, last = np.flatnonzero(angle == 0), np.flatnonzero(angle == angle.max())
    sides = np.setdiff1d(np.flatnonzero((z == 0) | (z == LENGTH)), first)
    supports = [js.clamped(first), js.symmetry(sides, "z")]
    return mesh, supports, last


def hoop_stress(sector, loads) -> np.ndarray:
    """Mean tangential stress at the outside of every element: (row, column, which of the cell's two)."""
    mesh, supports, _ = sector
    scene = js.Scene(mesh, js.Section(THICKNESS, 210e9, 0.3, 7800.0), supports, loads)
    found = js.solve_static(scene, [1.0])
    around = js.Cylindrical([0, 0, 1], along="circumference")
    stress = js.stresses(found, at="top", axes=around)
    return np.asarray(jnp.mean(stress, axis=1)[:, 0]).reshape(ROWS, COLUMNS, 2)


@pytest.mark.slow
def test_edge_moment(sector):
    """Load case 1: 1 kN·m/m on the free edge, 6M/h² = 60 MPa everywhere."""
    *_, last = sector
    share = LENGTH / COLUMNS * np.where((last == last.min()) | (last == last.max()), 0.5, 1.0)
    moment = js.NodalMoment(last, np.outer(share, [0.0, 0.0, 1000.0]))
    np.testing.assert_allclose(hoop_stress(sector, [moment]), 60e6, rtol=1e-6)  # a constant state: exact


def test_pressure_and_edge_force(sector):
    """Load case 2: 0.6 MPa outwards, and its hoop force pR on the free edge; pR/h = 60 MPa.

    Flat elements carry it by membrane forces that jump from facet to facet, by 3 % in the corners of this mesh.
    """
    *_, last = sector
    edges = np.stack([last[:-1], last[1:]], axis=1)
    pulled = 0.6e6 * RADIUS * np.array([-np.sin(np.pi / 6), np.cos(np.pi / 6), 0.0])
    loads = [js.Pressure(0.6e6), js.EdgeForce(edges, pulled)]
    found = hoop_stress(sector, loads)
    np.testing.assert_allclose(found[-1, 2:-2], 60e6, rtol=0.01)  # the middle of the free end
    np.testing.assert_allclose(found, 60e6, rtol=0.03)
    assert found.mean() == pytest.approx(60e6, rel=2e-3)
