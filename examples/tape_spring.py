"""A tape spring: bent until it snaps into a fold, followed by arc length, and let go.

A tape is straight and stiff because its section is curved. Bent with its edges in tension it carries a moment that
grows until the section flattens somewhere; from there the angle has to fall for equilibrium, and the path ends in a
fold, which grows at a constant moment. That is M* = (1 + ν) D α and the fold is a cylinder of the tape's own radius R
(Seffen & Pellegrino 1999), as of all cylinders of radius r the bending energy per angle,

    U/θ = ½ D R α r (1/r² + 1/R² + 2ν/(rR)),

is least at r = R. It knows nothing of the free edges, whose transverse moment is zero. They bend back over a length of
√(Rh), and relieve the fold. Wuest (1954) has the section w(y) of a strip that is bent to the curvature κ,

    D w'''' + E h κ² w = 0,    w'' = -1/R - νκ and w''' = 0 at the edges,

and the least U/θ of that is the moment of the plateau with free edges.
"""

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402
from scipy.optimize import minimize_scalar  # noqa: E402

import jaxshell as js  # noqa: E402

tape = js.scenes.tape_spring()
section = tape.section
h, E, nu = (float(value) for value in (section.thickness, section.young_modulus, section.poisson_ratio))
R, alpha = 0.015, np.radians(80.0)
D = E * h**3 / (12 * (1 - nu**2))


def energy_per_angle(curvature):
    """Of a fold of a strip with free edges, U/κ of a unit of length."""
    y = np.linspace(-0.5, 0.5, 4001) * R * alpha
    rate = (E * h * curvature**2 / (4 * D)) ** 0.25
    s, b = rate * y, 0.5 * rate * R * alpha
    # w = a cosh s cos s + b sinh s sin s, and its second and third derivatives over 2 λ² and 2 λ³ at the edge.
    second = [-np.sinh(b) * np.sin(b), np.cosh(b) * np.cos(b)]
    third = [-np.cosh(b) * np.sin(b) - np.sinh(b) * np.cos(b), np.sinh(b) * np.cos(b) - np.cosh(b) * np.sin(b)]
    factors = np.linalg.solve([second, third], [(-1 / R - nu * curvature) / (2 * rate**2), 0.0])
    w = factors @ np.stack([np.cosh(s) * np.cos(s), np.sinh(s) * np.sin(s)])
    bent = 2 * rate**2 * (factors @ np.stack([-np.sinh(s) * np.sin(s), np.cosh(s) * np.cos(s)])) + 1 / R
    bending = 0.5 * D * (curvature**2 + bent**2 + 2 * nu * curvature * bent)
    return np.trapezoid(bending + 0.5 * E * h * (curvature * w) ** 2, y) / curvature


classic = (1 + nu) * D * alpha
fold = minimize_scalar(energy_per_angle, bounds=(0.5 / R, 2 / R), method="bounded")
print(f"plateau of theory: {classic:.4f} N m, with free edges {fold.fun:.4f} N m at a radius of {1 / fold.x / R:.2f} R")

path = js.solve_arc_length(tape, 1e-3, steps=150)
angle = 120.0 * np.asarray(path.times)
left = tape.mesh.node_sets["left"][0]
moment = np.asarray(js.reactions(path))[:, left, 4]
stable = np.asarray(path.stable)
plateau = moment[angle > 72.0]
snap = 120.0 * path.stats["stability_lost"][0]
print(f"peak {moment.max():.3f} N m at {angle[moment.argmax()]:.1f}°, not stable from {snap:.1f}° on")
print(f"plateau {plateau.mean():.4f} N m ± {np.ptp(plateau) / 2:.4f} from 72° to {angle[-1]:.0f}°")
nodes = np.asarray(tape.mesh.nodes)
crown = (np.abs(nodes[:, 1]) < 1e-9) & (nodes[:, 2] > 0)
x, _, z = (nodes + np.asarray(path.displacements)[-1])[crown].T
turns = np.diff(np.arctan2(np.diff(z), np.diff(x)))
middle = slice(len(turns) // 2 - 2, len(turns) // 2 + 3)  # the turns at five nodes
radius = np.hypot(np.diff(x), np.diff(z))[middle].mean() / turns[middle].mean()
print(f"radius of the fold at its crown {radius / R:.2f} R")
assert not path.message and not stable.all() and stable[-1]
assert moment.max() > 5 * classic and np.ptp(plateau) < 0.05 * classic
assert abs(plateau.mean() / classic - 1) < 0.05 and 0 < plateau.mean() / fold.fun - 1 < 0.12
assert abs(radius * fold.x - 1) < 0.15

# Let go: the left hub is held, the right one flies.
folded = js.Initial(displacements=path.displacements[-1], rotations=path.rotations[-1])
released = js.scenes.tape_spring(folded=folded)
run = js.simulate(released, js.EnergyMomentum(), dt=5e-5, t_end=0.015, save_every=20, newton=js.Newton(tolerance=1e-12))
energy = run.energy
kept = np.asarray(energy.total + energy.dissipated)
change = np.ptp(kept) / kept[0]
print(f"let go with {1e3 * kept[0]:.1f} mJ: in {len(kept) - 1} steps K + S + D changes by {change:.1e} of it")
assert change < 1e-10
