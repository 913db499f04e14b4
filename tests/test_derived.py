"""Values found by other means keep their derivatives, of every order, wherever they stand in a program."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)

from jaxshell.numerics.derived import derived  # noqa: E402


def residual(u, p, s):
    return u**3 + u - p * s**2


def root(p, s):
    """u with u³ + u = p s², found where nothing is differentiated."""
    still = jax.lax.stop_gradient((p, s))
    found = jax.lax.fori_loop(0, 60, lambda _, u: u - residual(u, *still) / (3 * u**2 + 1), jnp.ones(()))

    def change(u, parameters, along):
        return -along(lambda parameters: residual(u, *parameters[:2])) / (3 * u**2 + 1)

    return derived(change, found, (p, s, jnp.arange(3), "static"))


def run(p, kept: bool):
    """Three steps of a scan, replayed in reverse mode or not."""

    def step(s, _):
        return s + 0.3 * root(p, s), None

    body = jax.checkpoint(step, prevent_cse=False) if kept else step
    return jax.lax.scan(body, 1.1 * jnp.ones(()), None, length=3)[0]


@pytest.mark.parametrize("kept", [False, True], ids=["stored", "replayed"])
@pytest.mark.parametrize(("outer", "inner"), list(itertools.product((jax.jacfwd, jax.jacrev), repeat=2)))
@pytest.mark.parametrize("jitted", [False, True], ids=["eager", "jit"])
def test_second_derivative_in_a_scan(kept, outer, inner, jitted):
    def value(p):
        return run(p, kept)

    value = jax.jit(value) if jitted else value
    h = 1e-3
    coarse, fine = ((value(1.3 + e) - 2 * value(1.3) + value(1.3 - e)) / e**2 for e in (2 * h, h))
    assert outer(inner(value))(1.3) == pytest.approx(float((4 * fine - coarse) / 3), rel=1e-6)


@pytest.mark.parametrize("axes", [(0, 0), (0, None), (None, 0)])
def test_batches(axes):
    """Derivatives of a batch are those of its members, in either order of the two transformations."""
    p = jnp.array([0.7, 1.3]) if axes[0] == 0 else jnp.array(0.9)
    s = jnp.array([1.1, 0.6]) if axes[1] == 0 else jnp.array(1.2)
    found = jax.vmap(jax.hessian(root, argnums=(0, 1)), in_axes=axes)(p, s)
    members = [jax.hessian(root, argnums=(0, 1))(*(a[k] if a.ndim else a for a in (p, s))) for k in range(2)]
    for got, want in zip(
        jax.tree.leaves(found), jax.tree.leaves(jax.tree.map(lambda *a: jnp.stack(a), *members)), strict=True
    ):
        np.testing.assert_allclose(got, want, rtol=1e-13)
    total = jax.grad(lambda p: jax.vmap(root, in_axes=axes)(p, s).sum())(p)
    each = jax.vmap(jax.grad(root), in_axes=axes)(p, s)
    np.testing.assert_allclose(total, each if axes[0] == 0 else each.sum(), rtol=1e-13)
