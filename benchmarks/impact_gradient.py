"""What an impact does to a gradient: `python benchmarks/impact_gradient.py`.

A flat plate falls on a floor and is in flight again at the time T. Its height there, as a function of the height d of
the fall, has a closed form: a mass ρh on a spring k, for every unit of surface. Printed is dz(T)/dd over its exact value,
by the adjoint of the whole run, for contacts from well resolved by the step to far shorter than it: the mean, the least
and the largest over a few heights of the fall, which end at different places between two steps; and the quotient of
differences over a change of d as large as that range, which is what an optimiser makes of it.
"""

import jax
import jax.numpy as jnp
import numpy as np

jax.config.update("jax_enable_x64", True)

import jaxshell as js  # noqa: E402
from jaxshell.model import generators  # noqa: E402

H, RHO, G, SPEED, END = 2e-3, 2700.0, 1000.0, 1.0, 6e-3
MESH = generators.rectangle(0.2, 0.1, (2, 1))
SECTION = js.Section(thickness=H, young_modulus=70e9, poisson_ratio=0.3, density=RHO)
FALLS = np.linspace(0.005, 0.006, 9)


def height(fall, stiffness, steps: int):
    """z(T) of the middle of the plate."""
    floor = js.Plane(jnp.stack([0.0, 0.0, -0.5 * H - fall]), [0, 0, 1], stiffness=stiffness)
    start = js.Initial.rigid(MESH, velocity=(0.0, 0.0, -SPEED))
    scene = js.Scene(MESH, SECTION, loads=[js.Gravity([0, 0, -G])], initial=start, obstacles=[floor])
    newton = js.Newton(tolerance=1e-13)
    run = js.simulate(scene, js.EnergyMomentum(), dt=np.full(steps, END / steps), newton=newton, save_every=steps)
    return jnp.mean(run.displacements[-1][:, 2])


def exact(fall, stiffness):
    """The same in closed form: free fall, a half wave on the spring, free flight."""
    omega = jnp.sqrt(stiffness / (RHO * H))
    speed = jnp.sqrt(SPEED**2 + 2.0 * G * fall)
    touching = 2.0 / omega * (jnp.pi - jnp.arctan(speed * omega / G))
    flight = END - (speed - SPEED) / G - touching
    return -fall + speed * flight - 0.5 * G * flight**2


def main() -> None:
    print("| steps | ω Δt | mean | least | largest | differences |")
    print("|---|---|---|---|---|---|")
    for steps in (120, 240):
        run = jax.jit(jax.value_and_grad(lambda fall, k, steps=steps: height(fall, k, steps)))
        for resolved in (0.1, 0.3, 1.0, 3.0, 10.0, 30.0):
            stiffness = RHO * H * (resolved * steps / END) ** 2
            values, slopes = zip(*(run(jnp.array(fall), jnp.array(stiffness)) for fall in FALLS), strict=True)
            wanted = [float(jax.grad(exact)(fall, stiffness)) for fall in FALLS]
            parts = np.array(slopes) / np.array(wanted)
            secant = (values[-1] - values[0]) / (exact(FALLS[-1], stiffness) - exact(FALLS[0], stiffness))
            print(
                f"| {steps} | {resolved:g} | {parts.mean():.3f} | {parts.min():.3f} | {parts.max():.3f} | "
                f"{float(secant):.3f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
