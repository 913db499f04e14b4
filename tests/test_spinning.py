"""Shells at rest in axes that spin: their shape, their frequencies, and what couples motions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.polynomial import Polynomial
from scipy.linalg import eigh

import jaxshell as js
from jaxshell.model import generators

LENGTH, WIDTH, H, YOUNG, DENSITY = 1.0, 0.05, 0.01, 70e9, 2700.0
UNIT = np.sqrt(YOUNG * H**2 / 12 / DENSITY) / LENGTH**2
"""√(EI/ρA)/L²: the unit of the speeds and frequencies of theory."""


def blade(spin=(0.0, 0.0, 1.0), **changes) -> js.Scene:
    """A blade along x on an axis along z through its root, clamped there; flat in its plane of rotation."""
    mesh = generators.rectangle(LENGTH, WIDTH, (24, 1))
    mesh = js.Mesh(mesh.nodes - jnp.array([0.0, WIDTH / 2, 0.0]), mesh.triangles)
    section = js.Section(thickness=H, young_modulus=YOUNG, poisson_ratio=0.0, density=DENSITY)
    root = js.clamped(mesh.nodes_where(lambda x: x[0] < 1e-9))
    return js.Scene(mesh, section, [root], [js.Centrifugal(spin)], **changes)


def theory(speed: float, hub: float = 0.0, aspect: float | None = None) -> np.ndarray:
    """The first three flapping frequencies of a clamped beam that spins, all over `UNIT`, by Ritz with polynomials:
    (w'')'' - Ω² ((½(1 - x²) + hub (1 - x)) w')' = ω² w, on a hub of that radius over the beam's length.

    With `aspect`, width over thickness, those of lead and lag, in the plane of rotation: the bending stiffness times
    its square, and ω² + Ω² in place of ω².
    """
    x, weights = np.polynomial.legendre.leggauss(40)
    x, weights = 0.5 * (x + 1), 0.5 * weights
    shapes = [Polynomial([0, 0, 1]) * Polynomial([-1, 2]) ** k for k in range(10)]
    values, slopes, bends = (np.array([s.deriv(n)(x) if n else s(x) for s in shapes]) for n in (0, 1, 2))
    mass, tension = (values * weights) @ values.T, 0.5 * (1 - x**2) + hub * (1 - x)
    K = (aspect or 1.0) ** 2 * (bends * weights) @ bends.T + speed**2 * (slopes * weights * tension) @ slopes.T
    return np.sqrt(eigh(K if aspect is None else K - speed**2 * mass, mass, eigvals_only=True)[:3])


def modes(scene: js.Scene, factor: float, count: int = 6) -> js.Modes:
    """About the state that spins with √factor times the scene's spin."""
    return js.natural_frequencies(scene, count, about=js.solve_static(scene, [factor]))


def test_theory_is_that_of_a_beam_at_rest_and_of_one_that_spins():
    """Spinning: A. D. Wright, C. E. Smith, R. W. Thresher & J. L. C. Wang, "Vibration modes of centrifugally stiffened
    beams", J. Appl. Mech. 49 (1982) 197-202, uniform, without a hub."""
    np.testing.assert_allclose(theory(0.0), [3.516015, 22.03449, 61.69721], rtol=1e-6)
    np.testing.assert_allclose(theory(12.0), [13.1702, 37.6031, 79.6145], rtol=1e-5)


def test_a_blade_flaps_as_a_beam_that_spins():
    scene = blade(spin=(0.0, 0.0, 12.0 * UNIT))
    for speed in (3.0, 6.0, 9.0, 12.0):
        found = modes(scene, (speed / 12.0) ** 2)
        size = jnp.max(jnp.abs(found.shapes), axis=1)
        flapping = np.flatnonzero(np.asarray(size[:, 2] > 10 * size[:, 1]))[:3]
        frequencies = 2 * np.pi * np.asarray(found.frequencies)[flapping] / UNIT
        print(f"speed {speed}: flapping {frequencies.round(4)}, theory {theory(speed).round(4)}")
        np.testing.assert_allclose(frequencies, theory(speed), rtol=1e-2)
        assert found.growth is not None and not jnp.any(found.growth)


def test_a_spinning_bar_stretches():
    """u = ρΩ²/E (L²x/2 - x³/6), the mean across the blade."""
    spin = 12.0 * UNIT
    scene = blade(spin=(0.0, 0.0, spin))
    moved = js.solve_static(scene, [1.0]).displacements[-1]
    x = np.asarray(scene.mesh.nodes)[:, 0]
    expected = DENSITY * spin**2 / YOUNG * (LENGTH**2 * x / 2 - x**3 / 6)
    across = moved[:, 0].reshape(-1, 2).mean(axis=1)
    np.testing.assert_allclose(across, expected[::2], atol=5e-3 * expected.max())


def test_seen_from_turning_axes_a_free_mass_has_two_frequencies():
    """A mass on springs k in its plane of rotation: ω₀ ± Ω, the whirling ones; along the axis ω₀."""
    mesh = js.Mesh.of_points({"mass": (0.0, 0.0, 0.0)})
    m, k, spin = 2.0, 800.0, 5.0
    scene = js.Scene(
        mesh,
        None,
        loads=[js.Centrifugal((0.0, 0.0, spin))],
        masses=[js.PointMass("mass", m)],
        connectors=[js.ElasticSupport("mass", (k, k, k))],
    )
    found = js.natural_frequencies(scene, 3)
    expected = np.sort([np.sqrt(k / m) - spin, np.sqrt(k / m), np.sqrt(k / m) + spin])
    np.testing.assert_allclose(np.sort(2 * np.pi * np.asarray(found.frequencies)), expected, rtol=1e-10)


@pytest.mark.slow
def test_derivatives_of_the_frequencies():
    scene = blade()

    def first(spin, thickness):
        section = js.Section(thickness=thickness, young_modulus=YOUNG, poisson_ratio=0.0, density=DENSITY)
        made = js.Scene(scene.mesh, section, scene.supports, [js.Centrifugal(jnp.array([0.0, 0.3, 1.0]) * spin)])
        return modes(made, 1.0, 2).frequencies[0]

    at = (6.0 * UNIT, H)
    backward = jax.grad(first, argnums=(0, 1))(*at)
    for i in range(2):
        _, forward = jax.jvp(first, at, tuple(float(i == j) for j in range(2)))
        np.testing.assert_allclose(backward[i], forward, rtol=1e-8)
        up, down = (first(*[a * (1 + s * 1e-5 * (i == j)) for j, a in enumerate(at)]) for s in (1, -1))
        np.testing.assert_allclose(forward, (up - down) / (2e-5 * at[i]), rtol=1e-5)


def test_what_spins_has_no_run_in_time():
    with pytest.raises(ValueError, match=r"load 0 \(centrifugal\) has no place in a run in time"):
        js.simulate(blade(), js.EnergyMomentum(), dt=1e-4, t_end=1e-4)
    with pytest.raises(ValueError, match="give one Centrifugal load"):
        scene = blade()
        js.Scene(scene.mesh, scene.section, scene.supports, [*scene.loads, *scene.loads])
