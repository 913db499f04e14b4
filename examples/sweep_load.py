"""A sweep: at which force does the clamped cap snap through?

Twenty-five forces, run as batches of one compiled program, kept in one file that a second call goes on from:

    M q̈ + f_int(q) = F e_apex,      F from 60 to 120 N at once,      P(F) = max_t |w_apex(t)|.

From the shell, the same: jaxshell sweep cap --divisions 3 --vary loads.0.force.2=-60:-120:25 ...
"""

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402

import jaxshell as js  # noqa: E402

forces = np.linspace(60.0, 120.0, 25)
options = {"method": js.EnergyMomentum(), "dt": 2e-6, "t_end": 1.6e-4}


def cap(force):
    return js.scenes.spherical_cap(divisions=3, force=force)


found = js.sweep(cap, {"force": forces}, output="sweep_load.h5", overwrite=True, **options)
peak = -1e3 * found.minimum["apex"]  # mm
jump = int(np.argmax(np.diff(peak)))
print(f"{int(found.successful.sum())} of {found.size} members ended successfully")
for k in (jump, jump + 1):
    print(f"largest deflection {peak[k]:.3f} mm at {forces[k]:.1f} N")
alone = js.simulate(cap(forces[12]), options["method"], dt=2e-6, t_end=1.6e-4).watched["apex"]
print(f"member 12 and its single run differ by {abs(found.watched['apex'][12] - np.asarray(alone)).max():.1e} m")
assert found.successful.all() and abs(found.watched["apex"][12] - np.asarray(alone)).max() < 1e-8
assert np.all(np.diff(peak) > 0) and np.diff(peak)[jump] > 3 * np.median(np.diff(peak))
