"""Time and memory of gradients and batches.

`python benchmarks/gradients.py [gradient [xla] [llvm]] [outputs] [memory] [batch]`

gradient: value and gradient with respect to 960 thicknesses of the opened cap over 100 and 500 steps, against the
          plain run, by kernels of XLA's and of LLVM's.
outputs:  the derivatives of 1, 4 and 16 of its displacements by all thicknesses, over 100 steps.
memory:   the strategies of `simulate(gradients=...)` at two sizes.
batch:    32 loads on the cap over 100 steps: a loop, `jax.vmap`, and `jax.shard_map` over two CPU devices.

Wall time and processor time, each the smallest of a few repetitions, compilation left out. The figures of
docs/gradients.md. Needs a quiet machine with two cores; some ten minutes.
"""

import functools
import os
import subprocess
import sys
import time

if "devices" in sys.argv:
    os.environ["XLA_FLAGS"] = "--xla_force_host_platform_device_count=2"

import jax

jax.config.update("jax_enable_x64", True)

import equinox as eqx  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import jaxshell as js  # noqa: E402
from jaxshell.gradients import Checkpointed, Stored  # noqa: E402

METHODS = {"EMC": js.GeneralizedEnergyMomentum(), "EnergyMomentum": js.EnergyMomentum()}


def best(*functions, repeat=3):
    """(result, wall time, processor time) of each, called in turn, so that noise falls on all; first calls left out."""
    results = [jax.block_until_ready(function()) for function in functions]
    times = np.empty((repeat, len(functions), 2))
    for k in range(repeat):
        for i, function in enumerate(functions):
            wall, cpu = time.perf_counter(), time.process_time()
            jax.block_until_ready(function())
            times[k, i] = time.perf_counter() - wall, time.process_time() - cpu
    return [(result, *least) for result, least in zip(results, times.min(axis=0), strict=True)]


def run_with(thickness, scene, method, dt, steps, gradients=None):
    """The run of a scene with these thicknesses of its elements."""
    varied = eqx.tree_at(lambda s: s.section.thickness, scene, thickness)
    return js.simulate(varied, method, dt=dt, t_end=dt * steps, save_every=steps, gradients=gradients, throw=False)


def deflection(scene, method, dt, steps, gradients=None):
    """The function from thicknesses to the first watched displacement at the end."""
    label = scene.watch[0][0]
    return lambda thickness: run_with(thickness, scene, method, dt, steps, gradients).watched[label][-1]


def gradient():
    for kernels in [name for name in ("xla", "llvm") if name in sys.argv[1:]] or ["xla", "llvm"]:
        for steps in (100, 500):
            with js.kernels(kernels):
                gradient_of(steps, kernels)


def gradient_of(steps: int, kernels: str):
    cap = js.scenes.opened_cap()
    thickness = jnp.full(cap.mesh.n_elements, 0.4)
    print(f"{cap.mesh.n_elements} thicknesses of the opened cap, {steps} steps, kernels by {kernels}")
    for name, method in METHODS.items():
        both = jax.jit(jax.value_and_grad(deflection(cap, method, 0.01, steps)), compiler_options=js.COMPILER_OPTIONS)

        def plain(reuse, method=method):
            newton = js.Newton(reuse=reuse)
            return js.simulate(cap, method, dt=0.01, t_end=0.01 * steps, save_every=steps, newton=newton)

        begun = time.perf_counter()
        jax.block_until_ready(both(thickness))
        print(f"{name:16s} first call {time.perf_counter() - begun:5.1f} s")
        (((value, found), wall, cpu), *runs) = best(
            functools.partial(both, thickness), functools.partial(plain, True), functools.partial(plain, False)
        )
        assert abs(value / runs[0][0].watched["A"][-1] - 1) < 1e-5 and np.all(np.isfinite(found))
        print(f"{name:16s} value and gradient {wall:6.2f} s ({cpu:.2f})", flush=True)
        for label, (run, plain_wall, plain_cpu) in zip(("factorizations kept", "full Newton"), runs, strict=True):
            print(
                f"   against a plain run, {label}: {plain_wall:6.2f} s ({plain_cpu:.2f}), "
                f"{float(run.iterations[1:].mean()):4.2f} iterations and "
                f"{run.stats['factorizations'] / steps:4.2f} factorizations a step: "
                f"ratio {wall / plain_wall:.2f} ({cpu / plain_cpu:.2f})",
                flush=True,
            )


def outputs(steps=100):
    cap = js.scenes.opened_cap()
    thickness = jnp.full(cap.mesh.n_elements, 0.4)
    print(f"jax.jacrev by {cap.mesh.n_elements} thicknesses of the opened cap, {steps} steps, EMC")
    for count in (1, 4, 16):

        def of(thickness, count=count):
            return run_with(thickness, cap, METHODS["EMC"], 0.01, steps).displacements[-1, -count:, 2]

        [(_, wall, cpu)] = best(
            functools.partial(jax.jit(jax.jacrev(of), compiler_options=js.COMPILER_OPTIONS), thickness)
        )
        print(f"  {count:2d} outputs {wall:6.2f} s ({cpu:.2f})", flush=True)


def memory(steps=400):
    strategies = {
        "Stored()": Stored(),
        "Checkpointed()": Checkpointed(),
        "Checkpointed(2)": Checkpointed(levels=2),
        "Checkpointed(1, False)": Checkpointed(keep_increments=False),
    }
    for divisions in ((24, 5), (48, 10)):
        cap = js.scenes.opened_cap(divisions)
        thickness = jnp.full(cap.mesh.n_elements, 0.4)
        print(f"opened cap of {cap.mesh.n_elements} elements, {steps} steps, EMC")
        for name, strategy in strategies.items():
            value = deflection(cap, METHODS["EMC"], 0.01, steps, strategy)
            both = jax.jit(jax.value_and_grad(value), compiler_options=js.COMPILER_OPTIONS)
            both = both.lower(thickness).compile()
            [(_, wall, cpu)] = best(functools.partial(both, thickness), repeat=2)
            megabytes = both.memory_analysis().temp_size_in_bytes / 1e6
            print(f"  {name:24s} {wall:6.2f} s ({cpu:.2f})   {megabytes:7.1f} MB", flush=True)


def batch(steps=100, count=32):
    cap = js.scenes.spherical_cap()
    loads = jnp.linspace(0.5, 1.5, count)

    def apex(load):
        varied = eqx.tree_at(lambda s: s.loads[0].force, cap, cap.loads[0].force * load)
        run = js.simulate(varied, METHODS["EMC"], dt=2e-6, t_end=2e-6 * steps, save_every=steps, throw=False)
        return run.watched["apex"]

    if jax.device_count() > 1:
        spec = jax.sharding.PartitionSpec("runs")
        mesh = jax.sharding.Mesh(np.array(jax.devices()), ("runs",))
        spread = jax.shard_map(jax.vmap(apex), mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False)
        [(_, wall, cpu)] = best(functools.partial(jax.jit(spread), loads))
        print(f"  jax.shard_map over {jax.device_count()} devices {wall:6.2f} s ({cpu:.2f})", flush=True)
        return
    print(f"{count} loads on the cap of {cap.mesh.n_elements} elements, {steps} steps")
    one, together = jax.jit(apex), jax.jit(jax.vmap(apex))
    (loop, wall, cpu), (found, wall_together, cpu_together) = best(
        lambda: jnp.stack([one(load) for load in loads]), functools.partial(together, loads)
    )
    print(f"  loop of compiled runs      {wall:6.2f} s ({cpu:.2f})", flush=True)
    # They iterate differently, to an error of 1e-8 of the shell's size in a step.
    np.testing.assert_allclose(found, loop, rtol=0, atol=1e-8 * np.linalg.norm(np.ptp(cap.mesh.nodes, axis=0)))
    print(f"  jax.vmap                   {wall_together:6.2f} s ({cpu_together:.2f})", flush=True)
    subprocess.run([sys.executable, __file__, "batch", "devices"], check=True)


if __name__ == "__main__":
    parts = {"gradient": gradient, "outputs": outputs, "memory": memory, "batch": batch}
    for name in [name for name in parts if name in sys.argv[1:]] or parts:
        parts[name]()
