"""The same shell stated in other units, and the same shape in other sizes: the answers are the same.

Without scaled unknowns Pardiso's pivots depend on the unit of length: below 1e-5 m it fails, and at 1e-7 m it gives
answers that are wrong by 110 %.
"""

import functools

import jax.numpy as jnp
import numpy as np
import pytest
from systems import SOLVERS, available

import jaxshell as js
from jaxshell.model import generators

UNITS = [(length, 1.0) for length in (1e-9, 1e-7, 1e-5, 1e-3, 1e3, 1e6)] + [(1e3, 1e-3)]
"""Of a metre and a kilogram, how many units; the last is mm-tonne-s. Seconds stay."""


def plate(length=1.0, mass=1.0, push=(0.0, 0.01, 0.5)) -> js.Scene:
    """A cantilever of 1 m, bent by a force on its end; lengths, masses and what is made of them in the given units."""
    nodes, triangles = _mesh()
    section = js.Section(0.02 * length, 1e6 * mass / length, 0.3, 1000.0 * mass / length**3)
    loads = (
        js.NodalForce([2, 5], 0.5 * mass * length * jnp.array(push), js.History.ramp(0.1)),
        js.Pressure(0.02 * mass / length),
    )
    return js.Scene(js.Mesh(length * nodes, triangles), section, (js.clamped([0, 3]),), loads, watch={"tip": (5, "uz")})


@functools.cache
def _mesh():
    mesh = generators.rectangle(1.0, 0.5, (2, 1))
    return np.asarray(mesh.nodes), mesh.triangles


def error(found, expected) -> float:
    return float(np.max(np.abs(np.asarray(found) - expected)) / np.max(np.abs(expected)))


@pytest.mark.parametrize(
    "solver",
    [SOLVERS[0], *(pytest.param(kind, marks=pytest.mark.slow) for kind in SOLVERS[1:])],
    ids=lambda kind: kind.__name__,
)
def test_statics(solver):
    def displacements(scene):
        run = js.solve_static(scene, [0.5, 1.0], linear_solver=available(solver))
        return run.frame(-1).displacements

    push = (0.0, 0.01, 1.5)
    expected = np.asarray(displacements(plate(push=push)))
    assert np.abs(expected).max() > 0.1
    for length, mass in UNITS:
        assert error(displacements(plate(length, mass, push)) / length, expected) < 1e-9


@pytest.mark.parametrize(
    "method", [js.GeneralizedEnergyMomentum(), js.EnergyMomentum()], ids=lambda m: type(m).__name__
)
@pytest.mark.parametrize(
    "solver",
    [SOLVERS[0], *(pytest.param(kind, marks=pytest.mark.evidence) for kind in SOLVERS[1:])],
    ids=lambda k: k.__name__,
)
def test_motion(method, solver):
    def motion(scene):
        run = js.simulate(
            scene, method, dt=0.02, t_end=0.2, newton=js.Newton(tolerance=1e-12), linear_solver=available(solver)
        )
        return run.watched["tip"], run.energy.total

    tip, energy = map(np.asarray, motion(plate()))
    for length, mass in UNITS:
        scaled_tip, scaled_energy = motion(plate(length, mass))
        assert error(scaled_tip / length, tip) < 1e-9
        assert error(scaled_energy / (mass * length**2), energy) < 1e-9


def test_frequencies():
    expected = js.natural_frequencies(plate(), 4)
    for length, mass in UNITS:
        found = js.natural_frequencies(plate(length, mass), 4)
        assert error(found.frequencies, np.asarray(expected.frequencies)) < 1e-9
        shapes = np.abs(np.sqrt(mass) * found.shapes[:, :, 2])
        assert error(shapes, np.abs(np.asarray(expected.shapes[:, :, 2]))) < 1e-6


def test_buckling():
    push = (-1.0, 0.0, 0.0)
    expected = js.linear_buckling(plate(push=push), 2).load_factors
    for length, mass in UNITS:
        assert error(js.linear_buckling(plate(length, mass, push), 2).load_factors, np.asarray(expected)) < 1e-9


@pytest.mark.slow
def test_arc_length():
    def path(scene):
        run = js.solve_arc_length(scene, steps=4, max_load_factor=1.0)
        return np.append(run.times, run.watched["tip"] / np.ptp(scene.mesh.nodes[:, 0]))

    expected = path(plate())
    for length, mass in UNITS:
        assert error(path(plate(length, mass)), expected) < 1e-9


@pytest.mark.parametrize("size", [1e-9, 1e-6, 1e3, 1e6])
def test_shells_that_are_small_and_large(size):
    """Of the same material: forces go with the square of the size, frequencies with its reciprocal."""
    like = js.solve_static(plate(), [0.5, 1.0]).frame(-1).displacements
    # E and ρ stay: a mass of size³ at a length of size, and seconds that are `size` as long.
    small = plate(size)
    material = js.Section(0.02 * size, 1e6, 0.3, 1000.0)
    loads = (js.NodalForce([2, 5], 0.5 * size**2 * jnp.array([0.0, 0.01, 0.5])), js.Pressure(0.02))
    scene = js.Scene(small.mesh, material, small.supports, loads)
    found = js.solve_static(scene, [0.5, 1.0]).frame(-1).displacements
    assert error(found / size, np.asarray(like)) < 1e-9
    expected = np.asarray(js.natural_frequencies(plate(), 3).frequencies)
    assert error(size * js.natural_frequencies(scene, 3).frequencies, expected) < 1e-9
