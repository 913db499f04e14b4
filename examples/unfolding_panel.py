"""A solar panel unfolds by spring hinges, and the satellite that carries it turns the other way.

Three plates, folded at the start. Hinges hold two nodes in one place with one axis in common,

    x_a = x_b,      (R_a n) · (R_b p) = (R_a n) · (R_b q) = 0,

by multipliers λ whose forces -λ ∂g do no work over a step and no moment on the whole. Springs, friction and end stops
act on the angle between the plates. Nothing acts from outside, so that with `EnergyMomentum`

    kinetic + strain energy (of plates, springs and stops) + what friction took = constant,

and the momenta, zero at the start, are zero at the end: where the panel came to rest so has the satellite, turned.
"""

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402

import jaxshell as js  # noqa: E402

panel = js.scenes.unfolding_panel(divisions=(6, 4))
run = js.simulate(panel, js.EnergyMomentum(), dt=5e-3, t_end=4.0, save_every=10, newton=js.Newton(tolerance=1e-13))

energy, momentum = run.energy, run.momentum
balance = np.asarray(energy.total + energy.dissipated)
drift = np.abs(balance / balance[0] - 1).max()
mass = js.mass_properties(panel).mass - panel.connectors[0].mass  # of the plates
push = np.sqrt(2 * float(energy.kinetic.max()) * mass)  # the size of their momentum
print(f"springs {balance[0]:.1f} J; the balance of energy closes to {drift:.1e}")
print(f"momenta, of what the plates have: {np.abs(momentum.linear).max() / push:.1e}, "
      f"{np.abs(momentum.angular).max() / (2.4 * push):.1e}")  # fmt: skip
assert drift < 1e-12 and np.abs(momentum.linear).max() < 1e-12 * push
assert np.abs(momentum.angular).max() < 1e-12 * 2.4 * push

# Angles about y of the satellite and of the middles of the plates.
plate = (panel.mesh.n_nodes - 3) // 3
places = [panel.connectors[0].master, *(k * plate + plate // 2 for k in range(3))]
R = np.asarray(run.rotations)[:, places]
angles = np.degrees(np.arctan2(R[..., 0, 2], R[..., 0, 0]))
opened = angles[:, 1:] - angles[:, :-1]
print(
    f"at the end the satellite has turned by {angles[-1, 0]:.2f} degrees; the lines are open by {opened[-1].round(2)}"
)
assert np.abs(opened[-1]).max() < 1.0 and np.abs(opened[0]).max() > 169.0 and angles[-1, 0] < -5.0
