"""Ply angles of a snapping laminate: the highest load before it snaps, without failure on the way.

A shallow carbon arch, [θ1/-θ1/θ2/-θ2]s, is pressed down at its crown until it has snapped through. With F_k the force
at the k-th position of the crown and I the Tsai-Wu indices of all plies, elements and positions,

    maximise over θ1, θ2   KS(F)    subject to    KS(I) ≤ 0.7,

KS the smooth maximum of Kreisselmeier and Steinhauser (`jaxshell.ks`). Gradients of both come from the path of
equilibria itself; SciPy's SLSQP takes the steps.
"""

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from scipy.optimize import minimize  # noqa: E402

import jaxshell as js  # noqa: E402

length, width, rise, cells = 0.2, 0.03, 0.01, 12
x, y = (a.ravel() for a in np.meshgrid(np.linspace(-0.5, 0.5, cells + 1), [-0.5, 0.0, 0.5], indexing="ij"))
nodes = np.stack([length * x, width * y, rise * (1 - 4 * x**2)], axis=1)
mesh = js.Mesh(nodes, js.structured_triangles(cells, 2))
carbon = js.Orthotropic(140e9, 9e9, 0.3, 5e9, 1600.0)  # Pa, kg/m³
strengths = js.Strengths(X_t=1500e6, X_c=1200e6, Y_t=50e6, Y_c=200e6, S=70e6)
ends = js.pinned(mesh.nodes_where(lambda x: abs(abs(x[0]) - 0.5 * length) < 1e-9))
crown = js.Support(mesh.nodes_where(lambda x: abs(x[0]) < 1e-9), ["uz"], [-1.6 * rise], js.History.ramp(1.0))
limit = 0.7  # of Tsai-Wu's index, which is 1 at failure
steps = jnp.linspace(0.1, 1.0, 10)


def arch(angles):
    """The force at the crown [N], and Tsai-Wu's index, both as smooth maxima, for angles (2,) [degrees]."""
    plies = [js.Ply(carbon, 0.2e-3, sign * angle) for angle in angles for sign in (1, -1)]
    scene = js.Scene(mesh, js.Laminate(plies, symmetric=True), [ends, crown])
    path = js.solve_static(scene, steps, throw=False)
    work = path.energy.external_work
    force = (work[1:] - work[:-1]) / (0.16 * rise)
    index = js.failure_index(path, "tsai-wu", strengths, frame=list(range(1, 11)))
    return jnp.stack([js.ks(force / 100.0, 50.0), js.ks(index, 50.0)])


both = jax.jit(lambda angles: (arch(angles), jax.jacrev(arch)(angles)))
seen = {}


def values(angles):
    key = tuple(angles)
    if key not in seen:
        seen[key] = jax.tree.map(np.asarray, both(jnp.asarray(angles)))
        print(f"angles {angles[0]:6.2f} {angles[1]:6.2f}: {100 * seen[key][0][0]:6.2f} N, index {seen[key][0][1]:.4f}")
    return seen[key]


start = np.array([20.0, 60.0])
best = minimize(
    lambda a: -10 * values(a)[0][0],
    start,
    jac=lambda a: -10 * values(a)[1][0],
    method="SLSQP",
    bounds=[(0.0, 90.0)] * 2,
    constraints={"type": "ineq", "fun": lambda a: limit - values(a)[0][1], "jac": lambda a: -values(a)[1][1]},
    options={"maxiter": 25, "ftol": 1e-7},
)
(first, _), (last, index) = values(start)[0], values(best.x)[0]
print(f"{100 * first:.2f} N -> {100 * last:.2f} N, index {index:.4f}, angles {np.round(best.x, 2)}")
assert last > 1.3 * first and index < limit + 1e-6 and best.x[0] < 1.0 and 55.0 < best.x[1] < 70.0
