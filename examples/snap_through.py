"""Snap-through and snap-back: the whole equilibrium path of a shallow hinged roof, by arc length.

The equations of equilibrium with the load factor λ as an unknown, and a step of given length ℓ,

    f_int(u) - λ f_ext = 0,      Σ_a |Δx_a|²/n = ℓ²,

pass both the load's and the centre's extremes. Where the tangent stiffness has a negative eigenvalue the equilibrium is
not stable: under a given load the roof leaves it. The limit loads are those of Sze, Liu & Lo 2004 (section 3.8,
thickness 6.35 mm), who list points of the path next to them.
"""

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402

import jaxshell as js  # noqa: E402

roof = js.scenes.hinged_roof(divisions=(6, 6), thickness=6.35)
path = js.solve_arc_length(roof, 0.6, steps=150)
factor, centre = np.asarray(path.times), -np.asarray(path.watched["centre"])
stable = np.asarray(path.stable)

turning = 1 + np.flatnonzero(np.diff(factor)[:-1] * np.diff(factor)[1:] < 0)
upper, lower = factor[turning[:2]]
print(f"upper limit load {3000 * upper:.1f} N at {centre[turning[0]]:.2f} mm (585.9 N in the reference)")
print(f"lower limit load {3000 * lower:.1f} N (-386.4 N in the reference)")
print(f"stable until {centre[np.argmin(stable)]:.2f} mm, and again at the end: {bool(stable[-1])}")
assert abs(upper / 0.1953 - 1) < 0.02 and abs(lower / -0.1288 - 1) < 0.02
assert not stable[turning[0] + 1] and stable[-1] and factor[-1] >= 1.0
assert np.diff(centre).min() < 0  # it snaps back as well
