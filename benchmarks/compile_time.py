"""What compiling costs, with XLA's default options and with jaxshell's: `python benchmarks/compile_time.py`.

Times are of tracing and lowering, of XLA, and of 50 steps of the clamped cap once compiled (the best of 5).
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
from jaxshell.numerics.compiled import ONCE, OPTIONS  # noqa: E402


def measure(method, options) -> tuple[float, float, float]:
    """Seconds to trace and lower, to compile, and to run 50 steps."""
    scene = js.scenes.spherical_cap()
    setup = set_up(scene, method, js.Newton(), save_every=50)
    model, carry, *_ = setup.prepare()
    dt = scene.defaults.dt
    steps = jnp.full((1, 50), dt), dt * jnp.arange(1.0, 51.0)[None]
    arguments = (model, setup.plan, carry, steps)
    begun = time.perf_counter()
    lowered = eqx.filter_jit(program.run.__wrapped__, compiler_options=options).lower(*arguments)
    traced = time.perf_counter()
    run = lowered.compile()
    built = time.perf_counter()
    times = []
    for _ in range(5):
        start = time.perf_counter()
        jax.block_until_ready(run(*arguments)[0].state.x)
        times.append(time.perf_counter() - start)
    return traced - begun, built - traced, min(times)


def main() -> None:
    print("| method | options | trace and lower, s | compile, s | 50 steps, s |\n|---|---|---|---|---|")
    for method in (js.GeneralizedEnergyMomentum(), js.EnergyMomentum()):
        for label, options in (("XLA's", {}), ("jaxshell's", OPTIONS), ("for what runs once", ONCE)):
            figures = " | ".join(f"{seconds:.2f}" for seconds in measure(method, options))
            print(f"| {type(method).__name__} | {label} | {figures} |", flush=True)


if __name__ == "__main__":
    main()
