"""What compiling costs, with XLA's default options and with jaxshell's: `python benchmarks/compile_time.py`.

Times are of tracing and lowering, of XLA, and of 50 steps of the clamped cap once compiled (the best of 5); and of the
value and the gradient of such a run by every element's thickness.
"""

import time

import equinox as eqx
import jax
import jax.numpy as jnp

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_enable_compilation_cache", False)

import jaxshell as js  # noqa: E402
from jaxshell.analyses import program  # noqa: E402
from jaxshell.analyses.driver import set_up  # noqa: E402
from jaxshell.numerics.compiled import COMPILER_OPTIONS, ONCE  # noqa: E402


def measure(method, options) -> tuple[float, float, float]:
    """Seconds to trace and lower, to compile, and to run 50 steps."""
    scene = js.scenes.spherical_cap()
    setup = set_up(scene, method, js.Newton(), save_every=50)
    model, carry, *_ = setup.prepare()
    dt = scene.defaults.dt
    steps = jnp.full((1, 50), dt), dt * jnp.arange(1.0, 51.0)[None]
    arguments = (model, setup.plan, carry, steps)
    jitted = eqx.filter_jit(program.run.__wrapped__, compiler_options=options)
    return timed(jitted, arguments, lambda found: found[0].state.x)


def measure_gradient(method, options) -> tuple[float, float, float]:
    """The same of the apex' deflection and its gradient."""
    scene = js.scenes.spherical_cap()
    dt = scene.defaults.dt

    def deflection(thickness):
        varied = eqx.tree_at(lambda s: s.section.thickness, scene, thickness)
        return js.simulate(varied, method, dt=dt, t_end=50 * dt, save_every=50, throw=False).watched["apex"][-1]

    thickness = jnp.full(scene.mesh.n_elements, scene.section.thickness)
    return timed(jax.jit(jax.value_and_grad(deflection), compiler_options=options), (thickness,), lambda found: found)


def timed(jitted, arguments, looked_at) -> tuple[float, float, float]:
    """Seconds to trace and lower `jitted`, to compile it, and to run it."""
    jax.clear_caches()
    begun = time.perf_counter()
    lowered = jitted.lower(*arguments)
    traced = time.perf_counter()
    run = lowered.compile()
    built = time.perf_counter()
    times = []
    for _ in range(5):
        start = time.perf_counter()
        jax.block_until_ready(looked_at(run(*arguments)))
        times.append(time.perf_counter() - start)
    return traced - begun, built - traced, min(times)


def main() -> None:
    print("| method | options | trace and lower, s | compile, s | 50 steps, s |\n|---|---|---|---|---|")
    kinds = ("XLA's", {}), ("jaxshell's", COMPILER_OPTIONS), ("for what runs once", ONCE)
    for method in (js.GeneralizedEnergyMomentum(), js.EnergyMomentum()):
        name = type(method).__name__
        for label, options in kinds:
            figures = " | ".join(f"{seconds:.2f}" for seconds in measure(method, options))
            print(f"| {name} | {label} | {figures} |", flush=True)
        for label, options in kinds[:2]:
            figures = " | ".join(f"{seconds:.2f}" for seconds in measure_gradient(method, options))
            print(f"| {name}, value and gradient | {label} | {figures} |", flush=True)


if __name__ == "__main__":
    main()
