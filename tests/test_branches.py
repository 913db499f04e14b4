"""A branch that copies nothing: what it returns, and what XLA makes of it."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxshell as js
from jaxshell.assembly.structure import structure_of
from jaxshell.assembly.tables import analyse
from jaxshell.numerics.branches import when


def doubled(pair):
    count, values = pair
    return count + 1, 2.0 * values


def test_the_branch_is_taken_where_the_condition_holds():
    given = jnp.asarray(0), jnp.arange(3.0)
    for condition, expected in ((True, (1, [0.0, 2.0, 4.0])), (False, (0, [0.0, 1.0, 2.0]))):
        count, values = jax.jit(when, static_argnums=1)(jnp.asarray(condition), doubled, given)
        assert count == expected[0]
        np.testing.assert_array_equal(values, expected[1])


def test_every_member_of_a_batch_takes_its_own():
    conditions = jnp.array([True, False, True])
    counts, values = jax.vmap(lambda c: when(c, doubled, (jnp.asarray(0), jnp.ones(2))))(conditions)
    np.testing.assert_array_equal(counts, [1, 0, 1])
    np.testing.assert_array_equal(values, [[2.0, 2.0], [1.0, 1.0], [2.0, 2.0]])


def test_forward_derivatives_are_those_of_the_branch():
    def value(x, condition):
        return when(condition, lambda y: y**3, x)

    for condition, slope in ((True, 12.0), (False, 1.0)):
        assert jax.jvp(lambda x: value(x, jnp.asarray(condition)), (2.0,), (1.0,))[1] == slope  # noqa: B023


def test_a_run_copies_no_matrix_in_its_loops():
    # Three places copied the factored matrix where runs and iterations branched by `jax.lax.cond`.
    scene = js.scenes.free_plate(divisions=(4, 3))
    entries = analyse(structure_of(scene))[1].indices.array.size

    def run(dt):
        return js.simulate(scene, js.GeneralizedEnergyMomentum(), dt=dt * jnp.ones(10), throw=False).displacements

    text = jax.jit(run).lower(1e-4).compile().as_text()
    loops = text[: text.index("\nENTRY")].splitlines()
    assert any(f"f64[{entries}]" in line for line in loops)
    assert not [line for line in loops if f" = f64[{entries}]" in line and " copy(" in line]
