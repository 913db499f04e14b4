"""Shape gradient: where to move the nodes of a panel to raise its lowest frequency.

For a simple eigenvalue of K φ = ω² M φ and a shape x of the stress-free mesh,

    ∂ω²/∂x = φᵀ (∂K/∂x - ω² ∂M/∂x) φ,      φᵀ M φ = 1,

which `jax.grad` takes through the mesh, its frames and its stiffness. The heights z of the inner nodes of a shallow
panel, clamped all around, follow the gradient within a given height; the edge stays. Stiffness that comes from shape
costs almost no mass.
"""

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import jaxshell as js  # noqa: E402

side, height, highest, cells = 0.4, 0.004, 0.008, 8
x, y = (a.ravel() for a in np.meshgrid(*[np.linspace(-0.5, 0.5, cells + 1)] * 2, indexing="ij"))
triangles = js.structured_triangles(cells, cells)
section = js.Section(1e-3, 70e9, 0.3, 2700.0)
edge = np.flatnonzero(np.maximum(abs(x), abs(y)) > 0.5 - 1e-9)
inner = np.setdiff1d(np.arange(x.size), edge)


def frequency(z):
    """The lowest frequency [Hz] of the panel with heights z [m] of its inner nodes."""
    heights = jnp.zeros(x.size).at[inner].set(z)
    mesh = js.Mesh(jnp.stack([side * x, side * y, heights], axis=1), triangles)
    return js.natural_frequencies(js.Scene(mesh, section, [js.clamped(edge)]), 1).frequencies[0]


value_and_gradient = jax.jit(jax.value_and_grad(frequency))
z = height * (1 - 4 * x[inner] ** 2) * (1 - 4 * y[inner] ** 2)  # a shallow bump
first, slope = value_and_gradient(z)
step = 1e-7 * slope / np.linalg.norm(slope)
difference = (frequency(z + step) - frequency(z - step)) / (2 * np.linalg.norm(step))
print(f"{first:.2f} Hz; slope along the gradient {np.linalg.norm(slope):.6g} Hz/m, by differences {difference:.6g}")
np.testing.assert_allclose(np.linalg.norm(slope), difference, rtol=1e-5)

found, gradient, length = first, slope, 0.2 * height
for _ in range(12):
    trial = np.clip(z + length * gradient / np.abs(gradient).max(), -highest, highest)
    new, new_gradient = value_and_gradient(trial)
    if new > found:
        z, found, gradient = trial, new, new_gradient
    else:
        length /= 2
    print(f"{new:.2f} Hz")
print(f"{first:.2f} Hz -> {found:.2f} Hz, no node higher than {1e3 * highest:.0f} mm")
assert found > 1.1 * first
