"""The suite runs with the package's shape annotations checked (pyproject.toml: --jaxtyping-packages)."""

import dataclasses

import isotropic
import jax
import jax.numpy as jnp
import pytest
from jaxtyping import TypeCheckError

from jaxshell.elements import corotational
from jaxshell.numerics.products import cross, dot

X = jnp.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
R = jnp.broadcast_to(jnp.eye(3), (3, 3, 3))


@pytest.fixture(scope="module")
def element():
    return jax.jit(isotropic.element)(X, 0.05, 1000.0, 0.3, 2.0)


@pytest.mark.parametrize("transform", [lambda f: f, jax.jit], ids=["eager", "jit"])
def test_an_element_function_refuses_wrong_shapes(element, transform):
    force = transform(corotational.internal_force)
    assert force(X, R, element).shape == (18,)
    for x, rotations in [(X[:, :2], R), (X[:2], R), (X, R[0]), (X.astype(int), R)]:
        with pytest.raises(TypeCheckError):
            force(x, rotations, element)


def test_a_field_refuses_a_wrong_shape(element):
    """Dataclasses are checked as they are made."""
    with pytest.raises(TypeCheckError):
        dataclasses.replace(element, coordinates=jnp.zeros((2, 2)))


def test_axes_that_only_broadcast_are_allowed():
    """`*#r`: an axis of length one is repeated, other lengths must agree, and so must the result."""
    assert dot(jnp.ones((4, 1, 3)), jnp.ones((1, 5, 3))).shape == (4, 5)
    assert cross(jnp.ones((4, 1, 3)), jnp.ones((1, 5, 3))).shape == (4, 5, 3)
    with pytest.raises(TypeCheckError):
        dot(jnp.ones((4, 3)), jnp.ones((5, 3)))
