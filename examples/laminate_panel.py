"""A laminate panel from an Abaqus file, in a gust: its motion, its stresses, and how near its plies come to failure.

`panel.inp` has the mesh, sets, layups, an aluminium rib, supports, pressure and force with their amplitudes, and the
step. `read_model` makes the scene of it. With viscous damping the balance of `EnergyMomentum` is

    K + S + D - W = 0,

and the largest Tsai-Wu index of all plies over the frames says how much of the strength is used. From the shell:
jaxshell import panel.inp panel.toml && jaxshell run panel.toml
"""

import jax

jax.config.update("jax_enable_x64", True)

from pathlib import Path  # noqa: E402

import numpy as np  # noqa: E402

import jaxshell as js  # noqa: E402

panel = js.read_model(Path(__file__).with_name("panel.inp"))
print({name: len(elements) for name, elements in panel.mesh.element_sets.items()})
run = js.simulate(panel, js.EnergyMomentum(), dt=5e-4, t_end=0.05, save_every=10)

energy = run.energy
balance = np.asarray(energy.total + energy.dissipated - energy.external_work)
tip = np.asarray(run.displacements)[:, panel.mesh.node_sets["TIP"], 2].mean(axis=1)
frame = int(np.argmax(abs(tip)))
strengths = {"X_t": 1.5e9, "X_c": 1.2e9, "Y_t": 5e7, "Y_c": 2e8, "S": 7e7}
index = np.asarray(js.failure_index(run, "tsai-wu", strengths, frame))
print(f"tip {1e3 * tip[frame]:.2f} mm at {1e3 * float(run.frame_times[frame]):.1f} ms")
print(f"largest Tsai-Wu index {index.max():.3f} in element {int(index.argmax())}; plies fail at 1")
print(f"K + S + D - W: {abs(balance).max() / float(energy.external_work.max()):.1e} of the largest work")
assert abs(balance).max() < 1e-7 * float(energy.external_work.max())
assert 0 < index.max() < 1 and panel.mesh.n_elements == 2 * 48
