"""Campbell diagram: the frequencies of a rotor blade against the speed of its hub, beside a beam's.

In axes that turn with the hub at the rate Ω the blade is at rest under its centrifugal forces, and small motions φ
about that rest are pairs ±iω of

    (λ² M + λ G + K) φ = 0

with the stresses of the spin in K and gyroscopic forces in G. For a slender beam of length L on a hub of radius r they
flap, across the plane of rotation, and lead and lag, in it:

    EI w'''' - ρA Ω² ((½(L² - x²) + r (L - x)) w')' = ρA ω² w,      and with ω² + Ω² in place of ω² in the plane.

Ritz with polynomials solves that. So ω² grows with Ω² (Southwell): in the first modes flapping by about
1.193 + 1.571 r/L times Ω², and lag by one time less. A blade must not stay at speeds at which a frequency is a multiple
of Ω.
"""

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402
from numpy.polynomial import Polynomial  # noqa: E402
from scipy.linalg import eigh  # noqa: E402

import jaxshell as js  # noqa: E402

length, width, h, young, density = 1.0, 0.05, 0.01, 70e9, 2700.0  # of the blade of the library
radius = js.scenes.joined.HUB_RADIUS


def blade(speed):
    """The first three angular frequencies [rad/s] of the shell at a speed of the hub [rad/s]."""
    scene = js.scenes.spun_blade((16, 2), speed, turning_axes=True)
    rest = js.solve_static(scene, [1.0])
    return 2 * np.pi * np.asarray(js.natural_frequencies(scene, 3, about=rest).frequencies)


def beam(speed, thickness, in_plane):
    """The same of the beam that bends across its `thickness`."""
    x, weights = np.polynomial.legendre.leggauss(40)
    x, weights = 0.5 * length * (x + 1), 0.5 * length * weights
    shapes = [Polynomial([0, 0, 1]) * Polynomial([-1, 2 / length]) ** k for k in range(10)]
    w, slope, curvature = (np.array([s.deriv(n)(x) if n else s(x) for s in shapes]) for n in (0, 1, 2))
    pull = 0.5 * (length**2 - x**2) + radius * (length - x)
    M = (w * weights) @ w.T
    K = young * thickness**2 / 12 / density * (curvature * weights) @ curvature.T
    K = K + speed**2 * (slope * weights * pull) @ slope.T - in_plane * speed**2 * M
    return np.sqrt(eigh(K, M, eigvals_only=True)[:2])


def beams(speed):
    """Flapping, lead and lag, flapping."""
    (first, second), (lag, _) = beam(speed, h, False), beam(speed, width, True)
    return np.array([first, lag, second])


speeds = np.linspace(0.0, 120.0, 7)
found, theory = (np.array([of(speed) for speed in speeds]) for of in (blade, beams))
error = np.abs(found / theory - 1)
for speed, row, worst in zip(speeds, found, error.max(axis=1), strict=True):
    print(f"{speed:5.0f} rad/s: {row.round(1)} rad/s, at most {100 * worst:.2f} % from the beam's")
assert error.max() < 0.01

southwell = (found[1, 0] ** 2 - found[0, 0] ** 2) / speeds[1] ** 2
print(f"Southwell's coefficient of the first flapping {southwell:.3f}, of a beam's shape at rest 1.350")
np.testing.assert_allclose(southwell, 1.193 + 1.571 * radius / length, rtol=0.02)

# Where the first flapping frequency is twice the speed: squares are linear in squares.
resonance = np.sqrt(np.interp(0.0, 4 * speeds**2 - found[:, 0] ** 2, speeds**2))
print(f"2/rev excites the first flapping at {resonance:.1f} rad/s")
assert abs(beams(resonance)[0] / resonance - 2) < 0.01
