"""Gradients of runs: adjoint, forward mode and differences agree; rest, failures and batches.

`test_gradients_slow.py` repeats the first test for every method and through buckling.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sensitivity import DT, STEPS, check_derivatives, measure, parameters, shell

import jaxshell as js
from jaxshell.gradients import Checkpointed, Stored, _near_divisor, keep, scan_steps
from jaxshell.numerics.batching import one_by_one

# Tight, so that differences see round-off only.
NEWTON = js.Newton(tolerance=1e-13)


def run(p, load=1.0, motion=1.0):
    steps = DT * (1 + p["dt"])
    return js.simulate(
        shell(p, load, motion),
        js.GeneralizedEnergyMomentum(),
        dt=steps,
        newton=NEWTON,
        save_every=STEPS,
        throw=False,
    )


ONE, NONE = jnp.ones(()), jnp.zeros(())


@functools.cache
def adjoint():
    def value(p, load, motion):
        solution = run(p, load, motion)
        return measure(solution), solution.result._value

    return jax.jit(jax.value_and_grad(value, has_aux=True)).lower(parameters(), ONE, ONE).compile()


def value_and_gradient(p):
    (value, _), gradient = adjoint()(p, ONE, ONE)
    return value, gradient


def test_adjoint_and_differences_agree():
    check_derivatives(value_and_gradient, None, parameters())


@pytest.mark.slow
def test_forward_mode_agrees_too():
    push = jax.jit(lambda p, d: jax.jvp(lambda p: measure(run(p)), (p,), (d,))[1])
    check_derivatives(value_and_gradient, push, parameters())


def test_the_way_back_factors_once_and_runs_no_iteration():
    # One call is Newton's, in its loop; the other is the transposed solve of the way back.
    assert adjoint().as_text().count('custom_call_target="pardiso_mkl_jax_factor_solve"') == 2


def test_several_outputs_share_the_way_back():
    """`jax.jacrev`: one factorization a step for all outputs, with a substitution for each."""

    def outputs(thickness):
        value = measure(run(parameters() | {"thickness": thickness}))
        return jnp.stack([value, value**2, -value])

    jacobian = jax.jit(jax.jacrev(outputs)).lower(parameters()["thickness"]).compile()
    assert jacobian.as_text().count('custom_call_target="pardiso_mkl_jax_factor_solve"') == 2
    value, gradient = value_and_gradient(parameters())
    expected = np.outer([1.0, 2.0 * value, -1.0], gradient["thickness"])
    found = np.asarray(jacobian(parameters()["thickness"])).reshape(expected.shape)
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())


def test_gradients_are_finite_at_rest():
    (_, code), gradient = adjoint()(parameters(), NONE, NONE)
    assert int(code) == 0
    assert all(np.all(np.isfinite(g)) for g in gradient.values())
    # A load is felt to first order at rest, the section is not.
    assert np.max(np.abs(gradient["thickness"])) < 1e-12 and np.max(np.abs(gradient["nodes"])) < 1e-12


def test_a_failed_run_has_no_gradient():
    (value, code), gradient = adjoint()(parameters(), 1e5 * ONE, ONE)
    assert int(code) != 0
    assert np.isnan(value)
    assert all(np.any(np.isnan(g)) for g in gradient.values())
    assert np.all(np.isnan(gradient["thickness"])) and np.isnan(gradient["force"])


def test_a_mapped_iteration_goes_at_its_own_pace():
    def count(before, start, least):
        """Halvings until the value is below `least`, and all halvings so far."""
        value, n = jax.lax.while_loop(lambda c: c[0] > least, lambda c: (c[0] / 2, c[1] + 1), (start, 0))
        return (value, n), before + n

    mapped = jax.vmap(lambda start: one_by_one(count, 5, start, 1.0), out_axes=(0, None))
    starts = jnp.array([1.0, 8.0, 1024.0])
    (value, halvings), total = jax.jit(mapped)(starts)
    assert halvings.tolist() == [0, 3, 10] and value.tolist() == [1.0, 1.0, 1.0]
    assert total == 18  # what one member leaves goes to the next
    # The loop's condition stays that of one member, where jax.vmap alone would ask whether any goes on.
    assert "reduce_or" not in str(jax.make_jaxpr(mapped)(starts))


def test_checkpointed_checks_its_input_and_splits_evenly():
    with pytest.raises(ValueError, match="levels must be a whole number of at least 1, but it is 0"):
        Checkpointed(levels=0)
    assert Checkpointed().segments(500) == (22,)
    assert Checkpointed(levels=2).segments(1000) == (10, 100)
    assert _near_divisor(500, 22) == 20
    assert _near_divisor(97, 10) == 10


@pytest.mark.parametrize("save_every", [1, 7, 50])
@pytest.mark.parametrize("kept", [Checkpointed(), Checkpointed(2), Checkpointed(3), Checkpointed(1, False)])
def test_strategies_and_frames_change_nothing(kept, save_every):
    """On a scalar: steps that do not fill the frames, frames that do not fill the segments, an empty record."""
    steps = jnp.linspace(0.01, 0.02, 53)

    def step(x, dt):
        increment = keep(dt * jnp.sin(x))
        return x + increment, (x, jnp.zeros(0))

    def value(start, strategy):
        end, records, frames = scan_steps(strategy, step, lambda x: x**2, start, steps, save_every)
        assert records[0].shape == (53,) and records[1].shape == (53, 0)
        assert frames.shape == (-(-53 // save_every),)
        return end + jnp.sum(records[0] * jnp.arange(53)) + jnp.sum(frames)

    expected = jax.value_and_grad(value)(1.0, Stored())
    found = jax.value_and_grad(value)(1.0, kept)
    np.testing.assert_allclose(found, expected, rtol=1e-13)
