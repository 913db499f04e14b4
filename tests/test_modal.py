"""Frequencies and buckling against thin-plate theory; the derivative; a vibrating mode keeps its frequency."""

import equinox as eqx
import isotropic
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxshell as js
from jaxshell.analyses.modal import mass_matrix
from jaxshell.model import generators
from jaxshell.model.supports import ALL
from jaxshell.numerics.rotations import exp

YOUNG_MODULUS, POISSON_RATIO, THICKNESS, DENSITY = 1e7, 0.3, 0.005, 2.0
RIGIDITY = YOUNG_MODULUS * THICKNESS**3 / (12 * (1 - POISSON_RATIO**2))
UNIT = np.sqrt(RIGIDITY / (DENSITY * THICKNESS)) / (2 * np.pi)
"""Hz for λ = ω a² (ρh/D)^½ = 1 and a = 1."""

# λ of the first modes of a square plate. Clamped: A. W. Leissa, "The free vibration of rectangular plates", J. Sound
# Vib. 31 (1973) 257-293. Free, ν = 0.3: S. Hurlebaus, L. Gaul & J. T.-S. Wang, "An exact series solution for
# calculating the eigenfrequencies of orthotropic plates with completely free boundary", J. Sound Vib. 244
# (2001) 747-759; Leissa's upper bound of the first is 13.489.
CLAMPED = [35.992, 73.413, 73.413, 108.27]
FREE = [13.468, 19.596, 24.270, 34.801, 34.801]


def edge_nodes(mesh):
    return mesh.nodes_where(lambda x: np.max(np.abs(x[:2] - 0.5), axis=0) > 0.5 - 1e-9)


def plate(divisions, held=None, **arguments):
    mesh = generators.rectangle(1.0, 1.0, (divisions, divisions))
    supports = () if held is None else (js.Support(edge_nodes(mesh), held),)
    return js.Scene(mesh, js.Section(THICKNESS, YOUNG_MODULUS, POISSON_RATIO, DENSITY), supports, **arguments)


def compressed_plate(divisions):
    """Simply supported, pressed along x with 1 per length: buckles at 4π²D/a²."""
    mesh = generators.rectangle(1.0, 1.0, (divisions, divisions))
    end = mesh.nodes_where(lambda x: x[0] > 1 - 1e-9)
    edges = np.stack([end[:-1], end[1:]], 1)
    supports = (
        js.Support(edge_nodes(mesh), "uz"),
        js.Support(mesh.nodes_where(lambda x: x[0] < 1e-9), "ux"),
        js.Support([0], "uy"),
    )
    section = js.Section(THICKNESS, YOUNG_MODULUS, POISSON_RATIO, DENSITY)
    return js.Scene(mesh, section, supports, (js.EdgeForce(edges, [-1.0, 0.0, 0.0]),))


def test_clamped_plate():
    scene = plate(16, ALL)
    modes = js.natural_frequencies(scene, 3)
    assert float(modes.frequencies[0]) / UNIT == pytest.approx(CLAMPED[0], rel=5e-3)
    # The modes are orthogonal in the mass, and normalised.
    corners = np.asarray(scene.mesh.nodes)[scene.mesh.triangles]
    elements = jax.jit(jax.vmap(lambda x: isotropic.element(x, THICKNESS, 1.0, 0.3, DENSITY)))(corners)
    R = jnp.broadcast_to(jnp.eye(3), (len(corners), 3, 3, 3))
    M = np.asarray(jax.jit(jax.vmap(mass_matrix))(R, elements))
    shapes = np.asarray(modes.shapes)[:, scene.mesh.triangles].reshape(3, -1, 18)
    assert np.einsum("ami,mij,bmj->ab", shapes, M, shapes) == pytest.approx(np.eye(3), abs=1e-8)


def test_free_plate():
    scene = plate(16)
    modes = js.natural_frequencies(scene, 9)
    found = np.asarray(modes.frequencies) / UNIT
    assert found[:6] == pytest.approx(0, abs=1e-3)
    assert found[6:] == pytest.approx(FREE[:3], rel=5e-3)
    skipped = js.natural_frequencies(scene, 3, rigid_modes=False)
    assert np.asarray(skipped.frequencies) / UNIT == pytest.approx(found[6:], rel=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(("held", "exact"), [(ALL, CLAMPED), (None, FREE)])
def test_higher_modes_of_plates(held, exact):
    modes = js.natural_frequencies(plate(40, held), len(exact), rigid_modes=False)
    assert np.asarray(modes.frequencies) / UNIT == pytest.approx(exact, rel=5e-3)


def test_bad_counts_are_refused():
    with pytest.raises(ValueError, match="count must be"):
        js.natural_frequencies(plate(4, ALL), 0)


def test_mass_of_a_rigid_motion():
    """Mass and rotary inertia of one element, turned: kinetic energy of a spin about a tangent and the normal."""
    x = jnp.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    element = jax.jit(isotropic.element)(x, 0.1, 1.0, 0.3, 3.0)
    R = jnp.broadcast_to(exp(jnp.array([0.3, -0.4, 0.2])), (3, 3, 3))
    M = jax.jit(mass_matrix)(R, element)
    still, ones = jnp.zeros((3, 3)), jnp.ones((3, 1))
    push = jnp.concatenate([ones * jnp.array([1.0, 0, 0]), still], axis=1).ravel()
    assert push @ M @ push == pytest.approx(3.0 * 0.1 * 1.0)
    for axis, inertia in (([1.0, 0, 0], 3.0 * 0.1**3 / 12), ([0, 0, 1.0], 0.0)):
        spin = jnp.concatenate([still, ones * (R[0] @ jnp.array(axis))], axis=1).ravel()
        assert spin @ M @ spin == pytest.approx(inertia, abs=1e-18)


@pytest.mark.slow
@pytest.mark.parametrize(
    "method",
    [
        js.Newmark(),
        *(pytest.param(m, marks=pytest.mark.evidence) for m in (js.GeneralizedEnergyMomentum(), js.EnergyMomentum())),
    ],
    ids=lambda m: type(m).__name__,
)
def test_a_mode_vibrates_at_its_frequency(method):
    """Released with a mode's velocity, the plate follows sin ω t; the trapezoidal rule makes tan(ωΔt/2) of ωΔt/2, and
    so do the mid-point rules, which are the same for small motions. The other methods: test_methods.py."""
    scene = plate(4, ALL)
    modes = js.natural_frequencies(scene, 1)
    frequency, shape = float(modes.frequencies[0]), np.asarray(modes.shapes[0])
    velocity = 1e-4 * THICKNESS * 2 * np.pi * frequency / np.abs(shape).max() * shape
    moving = js.Scene(
        scene.mesh,
        scene.section,
        scene.supports,
        initial=js.Initial(velocity[:, :3], velocity[:, 3:]),
        watch={"middle": (12, "uz")},
    )
    dt = 1 / (40 * frequency)
    run = js.simulate(moving, method, dt=dt, t_end=60 * dt)
    omega = 2 / dt * np.arctan(np.pi * frequency * dt)
    ratio = np.asarray(run.watched["middle"]) / (velocity[12, 2] / (2 * np.pi * frequency))
    assert ratio == pytest.approx(np.sin(omega * np.asarray(run.times)), abs=2e-3)


def test_buckling_of_a_compressed_plate():
    """N = 4π²D/a² (Bryan); 3.5 % above it on 4×4 cells, 0.7 % on 12×12."""
    scene = compressed_plate(4)
    buckling = js.linear_buckling(scene, 2)
    assert float(buckling.load_factors[0]) == pytest.approx(4 * np.pi**2 * RIGIDITY, rel=0.04)
    middle = scene.mesh.nearest_node([0.5, 0.5, 0])
    assert np.abs(np.asarray(buckling.shapes[0, :, 2])).argmax() == middle
    assert float(jnp.abs(buckling.shapes[0, middle, 2])) == pytest.approx(1)


@pytest.mark.slow
def test_the_frequency_vanishes_where_the_plate_buckles():
    """Under a part p of the buckling load the square of the frequency falls by the factor 1 - p."""
    scene = compressed_plate(12)
    critical = js.linear_buckling(scene, 1).load_factors
    assert float(critical[0]) == pytest.approx(4 * np.pi**2 * RIGIDITY, rel=0.01)
    unloaded = js.natural_frequencies(scene, 1).frequencies[0]
    pressed = js.solve_static(scene, 0.5 * critical)
    loaded = js.natural_frequencies(scene, 1, about=pressed).frequencies[0]
    assert float((loaded / unloaded) ** 2) == pytest.approx(0.5, abs=2e-3)


def test_buckling_of_a_mechanism_is_refused():
    with pytest.raises(ValueError, match="free to move as a rigid body"):
        js.linear_buckling(plate(4))


def derivative_case():
    scene = plate(4, ALL)

    def frequency(thickness):
        return js.natural_frequencies(eqx.tree_at(lambda s: s.section.thickness, scene, thickness), 1).frequencies[0]

    h, step = jnp.array(THICKNESS), 1e-7
    return frequency, h, (frequency(h + step) - frequency(h - step)) / (2 * step)


@pytest.mark.slow
def test_gradient_of_a_frequency():
    frequency, h, expected = derivative_case()
    assert float(jax.grad(frequency)(h)) == pytest.approx(float(expected), rel=1e-6)


@pytest.mark.slow
def test_forward_derivative_of_a_frequency_inside_jit():
    frequency, h, expected = derivative_case()
    assert float(jax.jit(jax.jacfwd(frequency))(h)) == pytest.approx(float(expected), rel=1e-6)
