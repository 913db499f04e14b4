"""Delaying the buckling of the opened cap by moving material along its meridian.

The ring of forces min(t, 1) keeps pushing and the cap snaps through. With thickness h_k on each of the K rings of
elements, and t_b(h) the time at which the top ring, on its way through, has sunk by 5 m,

    maximise over h   t_b(h)    subject to    Σ_k A_k h_k = h₀ Σ_k A_k.

The gradient of t_b comes from the run itself: w(t_b; h) = -5 m gives ∂t_b/∂h = -(∂w/∂h)/ẇ, which linear
interpolation of the history between its two samples around the crossing contains. Plain projected ascent with a step
of fixed length, halved when it overshoots.
"""

import jax

jax.config.update("jax_enable_x64", True)

import equinox as eqx  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import jaxshell as js  # noqa: E402

around, rings = 12, 5
cap = js.scenes.opened_cap((around, rings))
ring = np.repeat(np.arange(rings), 2 * around)  # of each element, from the bottom
nodes, triangles = np.asarray(cap.mesh.nodes), cap.mesh.triangles
edges = nodes[triangles[:, 1:]] - nodes[triangles[:, :1]]
area = np.bincount(ring, 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1))
area = jnp.asarray(area / area.sum())


def buckling_time(h):
    """Time [s] at which A passes -5 m, for thicknesses h (rings,) [0.4 m]; NaN if it does not."""
    scene = eqx.tree_at(lambda scene: scene.section.thickness, cap, 0.4 * h[ring])
    run = js.simulate(scene, js.EnergyMomentum(), dt=0.025, t_end=5.0, save_every=200, throw=False)
    w, t = run.watched["A"], run.times
    after = jnp.argmax(w < -5.0)
    part = (-5.0 - w[after - 1]) / (w[after] - w[after - 1])
    return jnp.where(after > 0, t[after - 1] + part * (t[after] - t[after - 1]), jnp.nan)


ascend = jax.jit(jax.value_and_grad(buckling_time))
h = jnp.ones(rings)
time, gradient = ascend(h)
first, length = time, 0.08
print(f"uniform: buckles at {time:.4f} s; gradient {np.round(gradient, 3)}")
for _ in range(8):
    direction = gradient - area * (gradient @ area) / (area @ area)  # keeps the mass
    trial = h + length * direction / jnp.linalg.norm(direction)
    new_time, new_gradient = ascend(trial)
    if new_time > time:
        h, time, gradient = trial, new_time, new_gradient
    else:
        length /= 2
    print(f"buckles at {new_time:.4f} s with {np.round(trial, 3)}")

print(f"{first:.4f} s -> {time:.4f} s at {float(area @ h):.6f} of the mass")
assert time > first + 0.1 and abs(area @ h - 1) < 1e-9
