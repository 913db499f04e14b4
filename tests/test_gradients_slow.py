"""Gradients of runs, long evidence: every method, statics, frequencies, buckling, checkpoints, batches of gradients."""

import functools
import os
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sensitivity import DT, STEPS, check_derivatives, difference_error, measure, parameters, shell

import jaxshell as js
from jaxshell.gradients import Checkpointed, Stored

pytestmark = pytest.mark.slow
NEWTON = js.Newton(tolerance=1e-13)

METHODS = {
    "EDMC": js.GeneralizedEnergyMomentum(spectral_radius=0.8, dissipation=0.05),
    "traditional inertia": js.GeneralizedEnergyMomentum(inertia="traditional"),
    "EnergyMomentum": js.EnergyMomentum(),
    "EnergyMomentum dissipative": js.EnergyMomentum(dissipation=0.05),
    "Newmark": js.Newmark(),
    "GeneralizedAlpha": js.GeneralizedAlpha(),
    "Bathe": js.Bathe(),
}


def check(value, p):
    """Compile the adjoint and the forward derivative of `value` and compare them, and with differences."""
    push = jax.jit(lambda p, d: jax.jvp(value, (p,), (d,))[1])
    check_derivatives(jax.jit(jax.value_and_grad(value)), push, p)


@pytest.mark.parametrize(
    "name",
    [name if name == "EnergyMomentum" else pytest.param(name, marks=pytest.mark.evidence) for name in METHODS],
)
def test_methods(name):
    def value(p):
        steps = DT * (1 + p["dt"])
        return measure(js.simulate(shell(p), METHODS[name], dt=steps, newton=NEWTON, save_every=STEPS, throw=False))

    check(value, parameters())


def test_central_difference():
    p = parameters()
    del p["dt"]

    def value(p):
        return measure(js.simulate(shell(p), js.CentralDifference(), dt=5e-9, t_end=1e-7, save_every=20, throw=False))

    check(value, p)


def test_statics():
    p = {
        k: v for k, v in parameters().items() if k not in ("dt", "velocities", "history", "support_history", "density")
    }

    def value(p):
        # The shell snaps through at 0.087 of its loads (`solve_static` says where it could not go on).
        solution = js.solve_static(shell(p, load=0.075), [0.3, 0.7, 1.0], throw=False)
        reactions = js.reactions(solution)[-1]
        return 1e3 * jnp.sum(solution.displacements[-1]) + jnp.sum(reactions) + jnp.sum(solution.energy.strain)

    check(value, p)


def test_frequencies():
    p = {
        k: v
        for k, v in parameters().items()
        if k in ("thickness", "young_modulus", "poisson_ratio", "density", "nodes")
    }

    def value(p):
        return jnp.sum(js.natural_frequencies(shell(p), count=3).frequencies * jnp.array([1.0, 0.5, 0.25])) / 1e4

    check(value, p)


@functools.cache
def opened_cap():
    with jax.ensure_compile_time_eval():
        return js.scenes.opened_cap((12, 4))


@pytest.mark.parametrize(
    "method", [js.GeneralizedEnergyMomentum(), pytest.param(js.EnergyMomentum(), marks=pytest.mark.evidence)]
)
def test_through_buckling(method):
    """A coarse opened cap that buckles at t = 1.8 to 2 and ends inside out, by all thicknesses."""
    scene = opened_cap()

    def depth(change):
        section = eqx.tree_at(lambda s: s.thickness, scene.section, 0.4 * (1 + change))
        varied = eqx.tree_at(lambda s: s.section, scene, section)
        run = js.simulate(varied, method, dt=0.02, t_end=2.8, save_every=140, newton=NEWTON, throw=False)
        return run.watched["A"][-1]

    # At t = 2 motions grow that would be small vibrations of a stable shell, two of them about as fast as the unloaded
    # shell's slowest vibration.
    buckling = js.simulate(scene, method, dt=0.02, t_end=2.0, save_every=100)
    slowest = js.natural_frequencies(scene, 1, rigid_modes=False).frequencies[0]
    growing = js.natural_frequencies(scene, 2, about=buckling, rigid_modes=False).frequencies
    assert np.all(growing < -0.5 * slowest)
    at = jnp.zeros(scene.mesh.n_elements)
    adjoint = jax.jit(jax.value_and_grad(depth))
    end, gradient = adjoint(at)
    # A hangs beyond its mirror image in the plane of the bottom ring.
    assert float(end) < -2 * np.ptp(np.asarray(scene.mesh.nodes)[:, 2])
    along = jnp.asarray(np.random.default_rng(0).standard_normal(at.shape))
    back = float(gradient @ along)
    pushed = jax.jit(lambda d: jax.jvp(depth, (at,), (d,))[1])(along)
    assert back == pytest.approx(float(pushed), rel=1e-10)
    steps = (3e-4, 1e-4, 3e-5, 1e-5)
    assert difference_error(lambda c: adjoint(c)[0], at, along, back, steps) < 1e-6


@pytest.mark.parametrize(
    "method",
    [
        js.GeneralizedEnergyMomentum(),
        *(pytest.param(m, marks=pytest.mark.evidence) for m in (js.EnergyMomentum(), js.EnergyMomentum(0.05))),
    ],
)
def test_a_free_plate_at_rest(method):
    """Nothing deforms and nothing turns: |Δπ|² = 0 in every element, zero rotations, nodes without load."""
    with jax.ensure_compile_time_eval():
        plate = js.scenes.free_plate((2, 1), loads=())

    def value(thickness, nodes, velocities):
        scene = js.Scene(
            js.Mesh(nodes, plate.mesh.triangles),
            eqx.tree_at(lambda s: s.thickness, plate.section, thickness),
            initial=js.Initial(velocities=velocities),
        )
        run = js.simulate(scene, method, dt=5e-5, t_end=2e-4, save_every=4, throw=False)
        return jnp.sum(run.displacements[-1] ** 2 + run.displacements[-1]) + jnp.sum(run.energy.total)

    rest = jnp.zeros((plate.mesh.n_nodes, 3))
    gradients = jax.jit(jax.grad(value, (0, 1, 2)))(jnp.array(0.002), plate.mesh.nodes, rest)
    assert all(np.all(np.isfinite(g)) for g in gradients)
    # A free body's displacements sum to the time times those of its initial velocities.
    np.testing.assert_allclose(np.sum(gradients[2]), 2e-4 * rest.size, rtol=1e-9)


@functools.cache
def adjoint(gradients):
    def value(p):
        steps = jnp.repeat(DT * (1 + p["dt"]), 3)
        options = {"save_every": 6, "newton": NEWTON, "gradients": gradients, "throw": False}
        return measure(js.simulate(shell(p), js.GeneralizedEnergyMomentum(), dt=steps, **options))

    return jax.jit(jax.grad(value)).lower(parameters()).compile()


@pytest.mark.parametrize(
    "kept",
    [
        Checkpointed(),
        pytest.param(Checkpointed(levels=2), marks=pytest.mark.evidence),
        Checkpointed(keep_increments=False),
    ],
)
def test_checkpoints_change_nothing(kept):
    p, checkpointed = parameters(), adjoint(kept)
    for name, gradient in adjoint(Stored())(p).items():
        np.testing.assert_allclose(checkpointed(p)[name], gradient, rtol=1e-9, atol=1e-12, err_msg=name)
    # Newton's solve runs again on the way back only where the increments were not kept.
    solves = checkpointed.as_text().count('custom_call_target="pardiso_mkl_jax_factor_solve"')
    assert solves == (2 if kept.keep_increments else 3)


@pytest.mark.parametrize("reuse", [pytest.param(False, marks=pytest.mark.evidence), True])
def test_a_batch_converges_like_single_runs(reuse):
    zero, newton = parameters(), js.Newton(tolerance=1e-13, reuse=reuse)

    def one(change, load):
        p = {**zero, "thickness": zero["thickness"] + change}
        method = js.GeneralizedEnergyMomentum()
        run = js.simulate(shell(p, load), method, dt=DT, t_end=STEPS * DT, newton=newton, throw=False)
        return measure(run), run.iterations

    changes, loads = jnp.array([-0.2, 0.0, 0.3]), jnp.array([0.5, 1.0, 5.0])
    values, iterations = jax.jit(jax.vmap(one))(changes, loads)
    single = jax.jit(one)
    for k in range(3):
        value, count = single(changes[k], loads[k])
        assert float(values[k]) == pytest.approx(float(value), rel=1e-12)
        # A batch factors anew in every step.
        assert iterations[k].tolist() == count.tolist() or reuse


def test_gradients_of_batches():
    cap = opened_cap()

    def depth(load):
        varied = eqx.tree_at(lambda s: s.loads[0].force, cap, cap.loads[0].force * load)
        method = js.GeneralizedEnergyMomentum()
        return js.simulate(varied, method, dt=0.02, t_end=0.2, save_every=10, newton=NEWTON, throw=False).watched["A"][
            -1
        ]

    loads = jnp.array([0.5, 1.0, 2.0])
    single = jnp.stack([jax.jit(jax.grad(depth))(load) for load in loads])
    inside = jax.jit(jax.vmap(jax.grad(depth)))(loads)
    outside = jax.jit(jax.grad(lambda loads: jnp.sum(jax.vmap(depth)(loads))))(loads)
    pushed = jax.jit(lambda loads: jax.jvp(jax.vmap(depth), (loads,), (jnp.ones(3),))[1])(loads)
    for found in (inside, outside, pushed):
        np.testing.assert_allclose(found, single, rtol=1e-11)


def test_a_traced_failure_raises_with_values_and_with_gradients():
    cap = opened_cap()

    def depth(load):
        varied = eqx.tree_at(lambda s: s.loads[0].force, cap, cap.loads[0].force * load)
        newton = js.Newton(max_iterations=2)
        return js.simulate(varied, js.GeneralizedEnergyMomentum(), dt=0.5, t_end=2.0, newton=newton).watched["A"][-1]

    for function in (jax.jit(depth), jax.jit(jax.grad(depth))):
        with pytest.raises(Exception, match="did not reach the tolerance within max_iterations"):
            jax.block_until_ready(function(30.0))


def test_a_batch_over_devices():
    """Two CPU devices at once, each with factorizations of its own; in a process of its own, since JAX is set up once."""
    program = """
import jax, jax.numpy as jnp, numpy as np, equinox as eqx
jax.config.update("jax_enable_x64", True)
import jaxshell as js
from jax.sharding import Mesh, PartitionSpec as P
cap = js.scenes.spherical_cap(3)
def depth(load):
    varied = eqx.tree_at(lambda s: s.loads[0].force, cap, cap.loads[0].force * load)
    # Who is before a member in its batch shows in what Newton's tolerance leaves: next to nothing.
    choices = {"newton": js.Newton(tolerance=1e-13), "save_every": 20, "throw": False}
    return js.simulate(varied, js.GeneralizedEnergyMomentum(), dt=2e-6, t_end=4e-5, **choices).watched["apex"]
loads = jnp.linspace(0.5, 1.5, 8)
batch = jax.vmap(depth)
mesh = Mesh(np.array(jax.devices()), ("runs",))
assert mesh.size == 2
spread = jax.jit(jax.shard_map(batch, mesh=mesh, in_specs=P("runs"), out_specs=P("runs"), check_vma=False))
expected = jax.jit(batch)(loads)
for _ in range(5):
    np.testing.assert_allclose(spread(loads), expected, rtol=1e-12)
"""
    flags = f"{os.environ['XLA_FLAGS']} --xla_force_host_platform_device_count=2"
    environment = {**os.environ, "XLA_FLAGS": flags}
    subprocess.run([sys.executable, "-c", program], env=environment, check=True)
