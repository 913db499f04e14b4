"""What is made of stresses and sections: nodal values, invariants, aggregates, mass properties."""

import jax
import jax.numpy as jnp
import linear
import numpy as np
import pytest

import jaxshell as js
from jaxshell.analyses.driver import set_up
from jaxshell.model import generators
from jaxshell.model.materials.base import stress_rotation
from jaxshell.model.sections.direction import angles
from jaxshell.numerics.rotations import exp


def close(found, wanted, tolerance):
    found = np.asarray(found)
    assert np.abs(found - wanted).max() <= tolerance * np.abs(wanted).max(), np.abs(found - wanted).max()


# --- folds and regions -----------------------------------------------------------------------------------------


def test_nodal_values_stop_at_folds_and_regions():
    x = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0], [2, 0, 1], [2, 1, 1.0]])
    mesh = js.Mesh(x, [[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2], [4, 6, 7], [4, 7, 5]])
    values = np.array([0.0, 0.0, 1.0, 1.0, 5.0, 5.0])
    smooth = np.asarray(js.nodal(mesh, values, at="mean"))
    assert np.all(smooth[4:] == 5.0) and np.all(smooth[:4] < 1.01)  # the fold at x = 2
    assert smooth[0, 1] == smooth[2, 0] == pytest.approx(2 / 3)  # node 1: areas of one and of two triangles
    sections = [([0, 1], js.Section(0.1, 1.0, 0.3, 1.0)), ([2, 3, 4, 5], js.Section(0.2, 1.0, 0.3, 1.0))]
    kept = np.asarray(js.nodal(js.Scene(mesh, sections), values, at="mean"))
    np.testing.assert_array_equal(kept, np.repeat(values[:, None], 3, axis=1))
    # One tensor, in the axes of every element: turned, averaged, turned back.
    flat = generators.rectangle(1.0, 1.0, (2, 2))
    turn = jax.vmap(stress_rotation)(-angles(jnp.array([1.0, 0.0, 0.0]), flat))
    values = jnp.repeat((turn @ jnp.array([1.0, -2.0, 3.0]))[:, None], 3, axis=1)
    close(js.nodal(flat, values, components="forces"), np.asarray(values), 1e-14)


# --- invariants, aggregates ------------------------------------------------------------------------------------


def test_invariants():
    stress = np.random.default_rng(1).normal(size=(50, 3))
    (large, small), angle = np.moveaxis(js.principal(stress).values, -1, 0), np.asarray(js.principal(stress).angle)
    close(js.von_mises(stress), np.sqrt(large**2 - large * small + small**2), 1e-13)
    tensors = np.stack([stress[:, [0, 2]], stress[:, [2, 1]]], 1)
    close(np.stack([small, large], 1), np.linalg.eigvalsh(tensors), 1e-13)
    along = np.stack([np.cos(angle), np.sin(angle)], 1)
    close(np.einsum("bij,bj->bi", tensors, along), large[:, None] * along, 1e-12)
    for function in (js.von_mises, lambda s: js.principal(s).values[0], lambda s: js.principal(s).angle):
        for at in (jnp.zeros(3), jnp.array([2.0, 2.0, 0.0])):
            assert np.all(np.isfinite(jax.grad(function)(at)))


def test_ks_bounds_the_maximum():
    values = np.random.default_rng(2).normal(size=(4, 25))
    for sharpness in (1.0, 30.0, 1e4):
        found = np.asarray(js.ks(values, sharpness, axis=1))
        excess = found - values.max(axis=1)
        assert np.all(excess >= -1e-14) and np.all(excess <= np.log(25) / sharpness + 1e-14)
    assert np.isfinite(js.ks(1e6 * values, 1e3))
    assert float(jnp.sum(jax.grad(js.ks)(jnp.asarray(values)))) == pytest.approx(1.0)


# --- mass ------------------------------------------------------------------------------------------------------


def test_mass_of_a_tube_and_its_spin():
    """A closed square tube (side √2 R): its inertia by hand, and the energy with which a simulation starts."""
    R, length, h, density = 1.0, 3.0, 0.2, 5.0
    mesh = generators.cylinder(R, length, (2, 4))
    spin = np.array([0.3, -0.5, 0.7])
    scene = js.Scene(mesh, js.Section(h, 1e3, 0.3, density), initial=js.Initial.rigid(mesh, angular_velocity=spin))
    found, side = js.mass_properties(scene), np.sqrt(2) * R
    mass, second = 4 * side * length * density * h, 4 * side * length * density * h**3 / 12
    axial = mass * (side**2 / 12 + side**2 / 4) + second
    across = 0.5 * mass * (side**2 / 12 + side**2 / 4) + mass * length**2 / 12 + 0.5 * second
    assert float(found.mass) == pytest.approx(mass, rel=1e-13)
    close(found.centre, np.array([length / 2, 0, 0]), 1e-13)
    close(found.inertia, np.diag([axial, across, across]), 1e-13)
    _, _, start, _ = set_up(scene, js.EnergyMomentum(), js.Newton()).prepare()
    assert float(start.observed.kinetic) == pytest.approx(float(0.5 * spin @ found.inertia @ spin), rel=1e-12)
    steel = js.Isotropic(200.0, 0.3, 5.0)
    # An offset moves the mass along the normals.
    high = js.mass_properties(
        js.Scene(generators.rectangle(2.0, 1.0, (2, 2)), js.Laminate([js.Ply(steel, 0.05, 0.0)] * 3, offset=0.3))
    )
    close(high.centre, np.array([1.0, 0.5, 0.3]), 1e-12)


# --- convergence ---------------------------------------------------------------------------------------------


def plate_errors(n):
    """L2 errors of moments in a simply supported square plate under sin sin: at mid-edges, middles, nodal."""
    E, nu, h = 1e4, 0.3, 0.01
    mesh, section = generators.rectangle(1.0, 1.0, (n, n)), js.Section(h, E, nu, 1.0)
    x, triangles = np.asarray(mesh.nodes), mesh.triangles
    D, q = E * h**3 / 12 / (1 - nu**2), np.sin(np.pi * x[:, 0]) * np.sin(np.pi * x[:, 1])
    size = 1e-8 * 4 * np.pi**4 * D
    loads = np.zeros((len(x), 6))
    for corner in range(3):
        np.add.at(loads[:, 2], triangles[:, corner], size / n**2 / 24 * (q[triangles].sum(1) + q[triangles[:, corner]]))
    edge = np.unique(mesh.boundary_edges())
    held = np.union1d((6 * edge[:, None] + np.arange(3)).ravel(), 6 * np.arange(len(x))[:, None] + [0, 1, 5])
    u = linear.displacements(mesh, section, held, loads)
    motion = js.Scene(mesh, section), u[:, :3], jax.vmap(exp)(jnp.asarray(u[:, 3:]))

    def exact(at):
        s, c = np.sin(np.pi * at[..., :2]).prod(-1), np.cos(np.pi * at[..., :2]).prod(-1)
        return 1e-8 * np.pi**2 * D * np.stack([(1 + nu) * s, (1 + nu) * s, -(1 - nu) * c], -1)

    def error(found, at):
        return np.linalg.norm(np.asarray(found) - exact(at)) / np.linalg.norm(exact(at))

    corners = x[triangles]
    M = js.section_forces_of(*motion, axes=[1.0, 0, 0]).M
    smooth = js.nodal(mesh, M)
    return (
        error(M, 0.5 * (corners + corners[:, [1, 2, 0]])),
        error(np.mean(M, axis=1), corners.mean(1)),
        error(smooth, corners),
    )


def test_moments_converge_and_nodal_ones_better():
    coarse, fine = np.array(plate_errors(8)), np.array(plate_errors(16))
    orders = np.log2(coarse / fine)
    assert orders == pytest.approx([1.13, 1.37, 1.51], abs=0.1)
    assert fine[2] < 0.4 * fine[0]
