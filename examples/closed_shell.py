"""Pressure on a closed shell: a free sphere breathes under a pressure that is put into it at once.

The pressure follows the surface. On a closed shell it has neither resultant nor moment, and its work is that of the
volume:

    W = p (V - V₀),      K + S = W,      w'' + ω² w = p/(ρh),      ω² = 2E / (ρR²(1 - ν)),

so that the radius swings between R and R + 2 w_s about the membrane solution w_s = pR²(1 - ν)/(2Eh). Nothing holds the
sphere. `EnergyMomentum` keeps both balances and the momenta to the tolerance of Newton's iteration.
"""

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402

import jaxshell as js  # noqa: E402

radius, h, E, nu, rho, pressure = 0.5, 1e-3, 70e9, 0.3, 2700.0, 1e5


def sphere(cuts):
    """Nodes and triangles, normals outwards: an octahedron whose faces are cut in four, again and again."""
    nodes = [*np.eye(3), *-np.eye(3)]
    faces = [(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2), (1, 0, 5), (3, 1, 5), (4, 3, 5), (0, 4, 5)]
    for _ in range(cuts):
        middles, finer = {}, []

        def middle(a, b, middles=middles):
            if (key := (min(a, b), max(a, b))) not in middles:
                middles[key] = len(nodes)
                nodes.append((nodes[a] + nodes[b]) / np.linalg.norm(nodes[a] + nodes[b]))
            return middles[key]

        for a, b, c in faces:
            ab, bc, ca = middle(a, b), middle(b, c), middle(c, a)
            finer += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        faces = finer
    return radius * np.array(nodes), np.array(faces)


def volume(x):
    a, b, c = np.moveaxis(x[triangles], 1, 0)
    return np.einsum("mi,mi->", a, np.cross(b, c)) / 6


nodes, triangles = sphere(3)
mesh = js.Mesh(nodes, triangles)
watch = {"pole": (2, "uz"), "equator": (0, "ux")}
ball = js.Scene(mesh, js.Section(h, E, nu, rho), loads=[js.Pressure(pressure)], watch=watch, name="sphere")

omega, w_s = np.sqrt(2 * E / (rho * (1 - nu))) / radius, pressure * radius**2 * (1 - nu) / (2 * E * h)
period = 2 * np.pi / omega
run = js.simulate(ball, js.EnergyMomentum(), dt=period / 40, t_end=2 * period, newton=js.Newton(tolerance=1e-12))

work, total = np.asarray(run.energy.external_work), np.asarray(run.energy.total)
volumes = np.array([volume(nodes + u) for u in np.asarray(run.displacements)])
swing = np.linalg.norm(nodes + np.asarray(run.displacements), axis=2).mean(axis=1) - radius
print(f"largest swing {1e3 * swing.max():.4f} mm, 2 w_s = {2e3 * w_s:.4f} mm")
print(f"W - p ΔV: {abs(work - pressure * (volumes - volumes[0])).max() / work.max():.1e} of the largest W")
print(f"K + S - W: {abs(total - work).max() / work.max():.1e} of the largest W")
speed = np.abs(np.asarray(run.momentum.linear)).max() / js.mass_properties(ball).mass / (omega * w_s)
print(f"mean velocity {speed:.1e} of the largest")
assert abs(swing.max() / (2 * w_s) - 1) < 0.02
assert abs(work - pressure * (volumes - volumes[0])).max() < 1e-9 * work.max()
assert abs(total - work).max() < 1e-9 * work.max() and speed < 1e-9
