"""The suite runs with the package's shape annotations checked (pyproject.toml: --jaxtyping-packages)."""

import dataclasses
import importlib
import sys

import isotropic
import jax
import jax.numpy as jnp
import pytest
from jaxtyping import TypeCheckError, install_import_hook

import jaxshell.numerics
from jaxshell.elements import corotational

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


@pytest.fixture(scope="module")
def checked():
    """The two files of small products and rotations, which the suite does not check, with their shapes checked."""
    names = ("jaxshell.numerics.products", "jaxshell.numerics.rotations")
    kept = {name: sys.modules.pop(name) for name in names}
    try:
        with install_import_hook(list(names), "beartype.beartype"):
            yield tuple(importlib.import_module(name) for name in names)
    finally:
        sys.modules.update(kept)
        for name, module in kept.items():
            setattr(jaxshell.numerics, name.rpartition(".")[2], module)


def test_axes_that_only_broadcast_are_allowed(checked):
    """`*#r`: an axis of length one is repeated, other lengths must agree, and so must the result."""
    products, _ = checked
    assert products.dot(jnp.ones((4, 1, 3)), jnp.ones((1, 5, 3))).shape == (4, 5)
    assert products.cross(jnp.ones((4, 1, 3)), jnp.ones((1, 5, 3))).shape == (4, 5, 3)
    with pytest.raises(TypeCheckError):
        products.dot(jnp.ones((4, 3)), jnp.ones((5, 3)))


def test_products_have_the_shapes_that_they_state(checked):
    products, _ = checked
    assert products.product(jnp.ones((4, 5, 3)), jnp.ones((3, 2))).shape == (4, 5, 2)
    assert products.transposed_product(jnp.ones((3, 4)), jnp.ones((3, 5))).shape == (4, 5)
    assert products.columns_times(jnp.ones((4, 6, 3)), jnp.ones((6, 3, 3))).shape == (4, 6, 3)
    assert products.scaled(jnp.ones(()), jnp.ones((2, 3))).shape == (2, 3)
    with pytest.raises(TypeCheckError):
        products.columns_times(jnp.ones((4, 6, 3)), jnp.ones((5, 3, 3)))


def test_rotations_have_the_shapes_that_they_state(checked):
    _, rotations = checked
    theta = jnp.array([0.3, -0.2, 0.5])
    for matrix in (rotations.skew, rotations.exp, rotations.cayley, rotations.H, rotations.H_inverse):
        assert matrix(theta).shape == (3, 3)
        with pytest.raises(TypeCheckError):
            matrix(theta[:2])
    assert rotations.log(rotations.exp(theta)).shape == (3,)
    for ratio in (rotations.sine_ratio, rotations.cosine_ratio, rotations.sine_remainder_ratio, rotations.eta):
        assert ratio(theta @ theta).shape == () and rotations.mu(theta @ theta).shape == ()
        with pytest.raises(TypeCheckError):
            ratio(theta)
