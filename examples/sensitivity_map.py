"""Sensitivity map: where on the clamped cap does thickness govern the peak deflection?

The cap under a step force at its apex, M q̈ + f_int(q; h) = f_ext, is followed through its first swing. With
w(t; h) the apex's deflection and the peak P(h) = max_t w, one reverse pass through the run gives

    ∂P/∂h_e    for every element e,

drawn here per relative change of thickness and per area, (h_e/A_e) ∂P/∂h_e, so that the picture does not depend
on the mesh. Where it is blue, material there lowers the peak. Forward mode checks the sum: thickening the whole
shell by a common factor must change the peak by Σ_e h_e ∂P/∂h_e.

Writes sensitivity_map.png.
"""

import jax

jax.config.update("jax_enable_x64", True)

import equinox as eqx  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import matplotlib  # noqa: E402
import numpy as np  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

import jaxshell as js  # noqa: E402
from jaxshell.plotting.style import STYLE  # noqa: E402

cap = js.scenes.spherical_cap(divisions=8)
thickness = jnp.full(cap.mesh.n_elements, 4e-4)


def peak(thickness):
    """Largest deflection of the apex [m] in the first 150 µs."""
    scene = eqx.tree_at(lambda scene: scene.section.thickness, cap, thickness)
    method = js.GeneralizedEnergyMomentum()
    run = js.simulate(scene, method, dt=3e-6, t_end=1.5e-4, save_every=50, throw=False)
    return jnp.max(-run.watched["apex"])


value, gradient = jax.jit(jax.value_and_grad(peak))(thickness)
together = jax.jit(lambda h: jax.jvp(peak, (h,), (h,))[1])(thickness)

nodes, triangles = np.asarray(cap.mesh.nodes), cap.mesh.triangles
edges = nodes[triangles[:, 1:]] - nodes[triangles[:, :1]]
area = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
per_area = 1e3 * np.asarray(thickness * gradient) / (1e4 * area)

with matplotlib.rc_context(STYLE):
    figure = Figure(figsize=(4.2, 3.4), layout="constrained")
    axes = figure.subplots()
    largest = np.abs(per_area).max()
    for sx in (1, -1):  # the other quarters by symmetry
        for sy in (1, -1):
            x, y = 1e3 * sx * nodes[:, 0], 1e3 * sy * nodes[:, 1]
            drawn = axes.tripcolor(
                x, y, triangles, facecolors=per_area, cmap="RdBu_r", vmin=-largest, vmax=largest,
                edgecolors="face", linewidth=0.2,
            )  # fmt: skip
    axes.set_aspect("equal")
    axes.grid(False)
    axes.set_title("Clamped cap, 444.8 N at its apex, EMC, Δt = 3 µs")
    axes.set_xlabel("x in mm")
    axes.set_ylabel("y in mm")
    figure.colorbar(drawn, label="change of the peak in mm per relative\nchange of thickness and per cm²")
    figure.savefig("sensitivity_map.png")

print(f"peak {1e3 * value:.4f} mm; change per relative change of all thicknesses {1e3 * together:.4f} mm")
print(f"sum over the elements {1e3 * jnp.sum(thickness * gradient):.4f} mm")
np.testing.assert_allclose(jnp.sum(thickness * gradient), together, rtol=1e-9)
