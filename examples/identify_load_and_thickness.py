"""Identification: what pulse hit the cap, and how thick is it? From noisy displacement histories.

    minimise over θ   ½ Σ_k Σ_n |u_k(t_n; θ) - û_k,n|²/σ²,   θ = (p_1 ... p_5, h),

where u_k are displacements at three points, û the measured ones with noise of standard deviation σ, p_j the
samples of the pulse (linear in between) and h the thickness. Gauss-Newton: θ ← θ + (JᵀJ)⁻¹ Jᵀ (û - u)/σ, with the
sensitivities J = ∂u/∂θ by forward mode, which suits few parameters and many outputs: all six directions share each
step's factorization. (JᵀJ)⁻¹ is also the covariance of what is found.
"""

import jax

jax.config.update("jax_enable_x64", True)

import equinox as eqx  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import jaxshell as js  # noqa: E402

divisions = 4
cap = js.scenes.spherical_cap(divisions)
sample_times = [0.0, 2e-5, 4e-5, 6e-5, 8e-5]
pulse = js.NodalForce([0], [0.0, 0.0, -100.0], js.History(sample_times, np.ones(5)))
points = {"apex": (0, "uz"), "ring": (2 * (divisions + 1) + 2, "uz"), "outer ring": (3 * (divisions + 1), "ux")}
cap = js.Scene(cap.mesh, cap.section, cap.supports, (pulse,), watch=points)


@jax.jit
def displacements(theta):
    """(3, 61) displacements [mm] over 120 µs. θ: samples of the pulse [100 N], thickness [0.4 mm]."""
    where = lambda scene: (scene.loads[0].history.values, scene.section.thickness)  # noqa: E731
    scene = eqx.tree_at(where, cap, (theta[:5], 4e-4 * theta[5]))
    run = js.simulate(scene, js.EnergyMomentum(), dt=2e-6, t_end=1.2e-4, save_every=60, throw=False)
    return 1e3 * jnp.stack([run.watched[point] for point in points])


truth = jnp.array([0.3, 0.9, 0.6, 0.8, 0.1, 0.95])
noise = 2e-3  # mm, about 1 % of the largest displacement
exact = displacements(truth)
measured = exact + noise * np.random.default_rng(0).standard_normal(exact.shape)

sensitivities = jax.jit(jax.jacfwd(lambda theta: displacements(theta).ravel()))
theta = jnp.array([0.5, 0.5, 0.5, 0.5, 0.5, 1.1])
for iteration in range(8):
    residual = (measured - displacements(theta)).ravel() / noise
    J = sensitivities(theta) / noise
    step, *_ = jnp.linalg.lstsq(J, residual)
    theta = theta + step
    print(f"{iteration}  misfit {float(jnp.mean(residual**2)):12.4f}  thickness {0.4 * float(theta[5]):.5f} mm")
    if float(jnp.max(jnp.abs(step))) < 1e-6:
        break

deviation = jnp.sqrt(jnp.diag(jnp.linalg.inv(J.T @ J)))
for name, found, true, spread in zip(["p1", "p2", "p3", "p4", "p5", "h"], theta, truth, deviation, strict=True):
    print(f"{name}  found {found:.4f} ± {spread:.4f}  true {true:.4f}")
error = float(jnp.max(jnp.abs(theta - truth) / deviation))
print(f"largest error {error:.2f} standard deviations; thickness off by {abs(float(theta[5] / truth[5]) - 1):.2%}")
assert error < 4 and abs(theta[5] / truth[5] - 1) < 0.01
