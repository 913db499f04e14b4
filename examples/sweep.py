"""A sweep: how the clamped cap's deflection depends on thickness, modulus and load, from 64 runs in one file.

A latin hypercube over scatter of 2 % in the thickness h, 3 % in Young's modulus E and 3 % in the load f. Standardised
regression coefficients β tell what the scatter of the largest deflection w comes from, and R² how linear it is:

    (w - mean) / deviation = Σ β_i (x_i - mean_i) / deviation_i,    Σ β_i² ≈ R².

Run it again, and it finds all members in its file; stopped halfway, it goes on.
"""

import jax

jax.config.update("jax_enable_x64", True)

import equinox as eqx  # noqa: E402
from scipy import stats  # noqa: E402

import jaxshell as js  # noqa: E402
from jaxshell.plotting.ensembles import plot_sweep  # noqa: E402

cap = js.scenes.spherical_cap(divisions=3)
section = cap.section


def scene(h, E, f):
    """The cap with thickness, modulus and load as fractions of its own."""
    return eqx.tree_at(
        lambda s: (s.section.thickness, s.section.young_modulus, s.loads[0].force),
        cap,
        (h * section.thickness, E * section.young_modulus, f * cap.loads[0].force),
    )


found = js.sweep(
    scene,
    {"h": stats.norm(1, 0.02), "E": stats.norm(1, 0.03), "f": stats.norm(1, 0.03)},
    method=js.GeneralizedEnergyMomentum(),
    dt=4e-6,
    t_end=2e-4,
    sample="latin:64",
    output="cap_sweep.h5",
    say=print,
)
for path in plot_sweep(found, ".", "cap_sweep", ["apex min"]):
    print(path)

sensitivities = found.sensitivities(["apex min"])
assert sensitivities.r_squared is not None
for name, beta in zip(sensitivities.parameters, sensitivities.values["apex min"], strict=True):
    print(f"{name}: β = {beta:+.3f}")
print(f"R² = {sensitivities.r_squared['apex min']:.4f}")
h, E, f = sensitivities.values["apex min"]
# The apex moves down, so that its minimum rises with stiffness and falls with the load.
assert found.successful.all() and sensitivities.r_squared["apex min"] > 0.9
assert h > 0 and E > 0 and f < 0 and abs(h**2 + E**2 + f**2 - sensitivities.r_squared["apex min"]) < 0.05
