"""Uncertainty: how much does the cap's deflection scatter when its thickness and its load do?

Thickness h_e = h₀ (1 + δ_e) with a random field δ of standard deviation 2 % and correlation length 10 mm, and a load
with a standard deviation of 3 %. For the apex deflection w = w(δ, f), linearised about the mean,

    Var w ≈ gᵀ C g,    g = ∂w/∂(δ, f)  from one reverse pass,   C the covariance of (δ, f),

against the spread of a sample of runs, done as one program by `jax.vmap`.
"""

import jax

jax.config.update("jax_enable_x64", True)

import equinox as eqx  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import jaxshell as js  # noqa: E402

cap = js.scenes.spherical_cap(divisions=4)
centres = np.asarray(cap.mesh.nodes)[cap.mesh.triangles].mean(axis=1)
distance = np.linalg.norm(centres[:, None] - centres[None], axis=2)
covariance = np.zeros((33, 33))
covariance[:32, :32] = 0.02**2 * np.exp(-((distance / 0.01) ** 2) / 2)
covariance[32, 32] = 0.03**2


def deflection(changes):
    """Apex deflection [mm] after 60 µs; `changes` (33,) are those of the thicknesses and of the load."""
    scene = eqx.tree_at(
        lambda scene: (scene.section.thickness, scene.loads[0].force),
        cap,
        (4e-4 * (1 + changes[:32]), cap.loads[0].force * (1 + changes[32])),
    )
    run = js.simulate(scene, js.GeneralizedEnergyMomentum(), dt=3e-6, t_end=6e-5, save_every=20, throw=False)
    return -1e3 * run.watched["apex"][-1]


mean, g = jax.jit(jax.value_and_grad(deflection))(jnp.zeros(33))
linear = float(jnp.sqrt(g @ covariance @ g))

sample = np.random.default_rng(0).multivariate_normal(np.zeros(33), covariance, size=400)
sampled = jax.jit(jax.vmap(deflection))(jnp.asarray(sample))
spread = float(jnp.std(sampled, ddof=1))

print(f"mean {float(mean):.4f} mm (linearised) and {float(sampled.mean()):.4f} mm (400 runs)")
print(f"standard deviation {linear:.5f} mm (one gradient) and {spread:.5f} mm (400 runs)")
# The sample's own uncertainty is 1/√800 = 3.5 %.
assert abs(linear / spread - 1) < 0.1
