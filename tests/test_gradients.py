"""Gradients of runs: adjoint, forward mode and differences agree; rest, failures and batches.

`test_gradients_slow.py` repeats the first test for every method and through buckling.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sensitivity import DT, STEPS, difference_error, directions, measure, parameters, products, shell

import jaxshell as js
from jaxshell.gradients import Checkpointed, _near_divisor

# Tight, so that differences see round-off only.
NEWTON = js.Newton(tolerance=1e-13)


def run(p, load=1.0, motion=1.0):
    steps = DT * (1 + p["dt"])
    return js.simulate(
        shell(p, load, motion), js.GeneralizedEnergyMomentum(), dt=steps, newton=NEWTON, save_every=STEPS, throw=False
    )


@functools.cache
def adjoint():
    def value(p, load, motion):
        solution = run(p, load, motion)
        return measure(solution), solution.result._value

    return jax.jit(jax.value_and_grad(value, has_aux=True))


@functools.cache
def forward():
    return jax.jit(lambda p, d: jax.jvp(lambda p: measure(run(p)), (p,), (d,))[1])


def test_adjoint_forward_and_differences_agree():
    p = parameters()
    along = directions(p)
    _, gradient = adjoint()(p, 1.0, 1.0)
    back = products(gradient, along)
    for i, name in enumerate(p):
        one = {k: v[i] for k, v in along.items()}
        assert back[name] == pytest.approx(float(forward()(p, one)), rel=1e-10), name
        value = lambda p: adjoint()(p, 1.0, 1.0)[0][0]  # noqa: E731
        assert difference_error(value, p, one, back[name]) < 1e-6, name


def test_gradients_are_finite_at_rest():
    (_, code), gradient = adjoint()(parameters(), 0.0, 0.0)
    assert int(code) == 0
    assert all(np.all(np.isfinite(g)) for g in gradient.values())
    # A load is felt to first order at rest, the section is not.
    assert np.all(gradient["thickness"] == 0) and np.all(gradient["nodes"] == 0)


def test_a_failed_run_has_no_gradient():
    (value, code), gradient = adjoint()(parameters(), 1e5, 1.0)
    assert int(code) != 0
    assert np.isnan(value)
    assert all(np.all(np.isnan(g)) for g in gradient.values())


def test_a_batch_converges_like_single_runs():
    thickness = jnp.array([-0.2, 0.0, 0.3])
    zero = parameters()

    def one(change, load):
        solution = run({**zero, "thickness": zero["thickness"] + change}, load)
        return measure(solution), solution.iterations

    loads = jnp.array([0.5, 1.0, 5.0])
    values, iterations = jax.jit(jax.vmap(one))(thickness, loads)
    for k in range(3):
        (value, _), _ = adjoint()({**zero, "thickness": zero["thickness"] + thickness[k]}, loads[k], 1.0)
        assert float(values[k]) == pytest.approx(float(value), rel=1e-12)
    # Each at its own pace: a heavier load takes more iterations.
    assert int(iterations[0].sum()) < int(iterations[2].sum())


def test_checkpointed_checks_its_input_and_splits_evenly():
    with pytest.raises(ValueError, match="levels must be a whole number of at least 1, but it is 0"):
        Checkpointed(levels=0)
    assert Checkpointed().segments(500) == (22,)
    assert Checkpointed(levels=2).segments(1000) == (10, 100)
    assert _near_divisor(500, 22) == 20
    assert _near_divisor(97, 10) == 10
