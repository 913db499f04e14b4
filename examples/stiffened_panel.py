"""Modes of a stiffened panel whose mesh and sets come from gmsh.

`stiffened_panel.msh` (made by `gmsh -2 stiffened_panel.geo`) has the physical groups skin, web, root and tip. Sections
and supports name them. Skin and web share the nodes of the junction. Clamped at one end, the panel is a beam of T
section, and one of its modes must be the beam's first:

    f = (1.8751)²/(2π L²) √(EI/m),      I about the centroid of the T, m its mass per length.

Its others twist the open section or bend it sideways, and no beam of that stiffness has them.
"""

import jax

jax.config.update("jax_enable_x64", True)

from pathlib import Path  # noqa: E402

import numpy as np  # noqa: E402

import jaxshell as js  # noqa: E402

mesh = js.Mesh.read(Path(__file__).with_suffix(".msh"))
print({name: len(elements) for name, elements in mesh.element_sets.items()})
E_modulus, nu, rho, h, t = 70e9, 0.3, 2700.0, 2e-3, 3e-3
section = {"skin": js.Section(h, E_modulus, nu, rho), "web": js.Section(t, E_modulus, nu, rho)}
panel = js.Scene(mesh, section, [js.clamped("root")], name="stiffened panel")
modes = js.natural_frequencies(panel, 4)

L, b, d = 0.6, 0.1, 0.04
A = b * h + d * t
centre = d * t * 0.5 * d / A  # below the skin
inertia = b * h**3 / 12 + b * h * centre**2 + t * d**3 / 12 + d * t * (0.5 * d - centre) ** 2
beam = 1.8751**2 / (2 * np.pi * L**2) * np.sqrt(E_modulus * inertia / (rho * A))

# The beam's mode: the one whose tip goes down most as a whole.
tip = mesh.node_sets["tip"]
down = np.abs(np.asarray(modes.shapes)[:, tip, 2].mean(axis=1))
bending = int(np.argmax(down))
mass = float(js.mass_properties(panel).mass)
print("modes, Hz:", np.round(np.asarray(modes.frequencies), 2))
print(f"bending mode {float(modes.frequencies[bending]):.2f} Hz, beam {beam:.2f} Hz; mass {mass:.4f} kg")
assert abs(float(modes.frequencies[bending]) / beam - 1) < 0.02
assert abs(mass / (rho * A * L) - 1) < 1e-12
