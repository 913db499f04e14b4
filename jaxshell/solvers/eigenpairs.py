"""The derivatives of eigenpairs A φ = μ B φ of symmetric sparse matrices, φᵀ B φ = 1.

    dμ = φᵀ (dA - μ dB) φ
    dφ = v + c φ,   (A - μ B) v = -(dA - μ dB - dμ B) φ,   v_k = 0,   c = -φᵀ B v - ½ φᵀ dB φ

R. B. Nelson, "Simplified calculation of eigenvector derivatives", AIAA J. 14 (1976) 1201-1205. A - μ B is singular;
with row and column k, of the largest entry of φ, replaced by those of the identity it is not, and its pattern stays.
The first derivative of μ needs no solution. Each rule uses the two functions again, so every order is right.

Where μ is not simple its second derivative and the first of φ do not exist. How near the next eigenvalue is, of those
found or not, three inverse iterations that start across φ show.
"""

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxshell.assembly.sparsity import SparsityPattern
from jaxshell.numerics.derived import derived
from jaxshell.solvers.iteration import Linear
from jaxshell.solvers.linear_solver import default_solver, multiply

_GAP = 1e-7
"""Eigenvalues this near to each other, as a fraction of their size, are not told apart."""
_SWEEPS = 3
NOT_SIMPLE = (
    "An eigenvalue is (nearly) equal to another: its second derivative, and the derivative of its mode, do not exist. "
    "Disturb the symmetry of the scene, or differentiate a sum over the equal ones."
)


class Pencil(eqx.Module):
    """Values of A and B on one pattern."""

    A: Float[Array, " m"]
    B: Float[Array, " m"]
    pattern: SparsityPattern = eqx.field(static=True)
    soft: Any = None
    """Of the zeros that multipliers have on the diagonal, as in `Linear`; constant."""


def symmetric(pattern: SparsityPattern, values: Float[Array, " m"]) -> Float[Array, " m"]:
    """Values of the symmetric part of a matrix."""
    with jax.ensure_compile_time_eval():
        transposed = jnp.asarray(np.argsort(pattern.indices.array, kind="stable"))
    return 0.5 * (values + values[transposed])


def eigenvalues(pencil: Pencil, vectors: Float[Array, "c n"], defined: Bool[Array, " c"]) -> Float[Array, " c"]:
    """The eigenvalues of the given vectors, as Rayleigh quotients, with their derivatives.

    A second derivative where an eigenvalue is `defined` and not simple is an error when the program gets there; where
    it is not `defined`, the number is not used.
    """
    return _values(True, vectors, pencil, defined)


def eigenvectors(pencil: Pencil, vectors: Float[Array, "c n"]) -> Float[Array, "c n"]:
    """`vectors`, φᵀ B φ = 1, with their derivatives: NaN where an eigenvalue is not simple."""
    return _vectors(False, vectors, pencil, jnp.ones(vectors.shape[0], bool))


def quadratic(pattern: SparsityPattern, values: Float[Array, " m"], vectors: Float[Array, "c n"]) -> Float[Array, " c"]:
    """φᵀ A φ of each vector."""
    with jax.ensure_compile_time_eval():
        rows, columns = jnp.asarray(pattern.rows), jnp.asarray(pattern.indices.array)
    return jnp.sum(vectors[:, rows] * values * vectors[:, columns], axis=1)


def _values(strict: bool, vectors, pencil: Pencil, defined) -> Float[Array, " c"]:
    def change(mu, given, along):
        pencil, vectors = given
        phi = _vectors(strict, vectors, pencil, defined)
        dA, dB = along(lambda given: given[0].A), along(lambda given: given[0].B)
        moved = quadratic(pencil.pattern, dA, phi) - mu * quadratic(pencil.pattern, dB, phi)
        return moved / quadratic(pencil.pattern, pencil.B, phi)

    still = jax.lax.stop_gradient(pencil)
    mu = quadratic(pencil.pattern, still.A, vectors) / quadratic(pencil.pattern, still.B, vectors)
    return derived(change, mu, (pencil, vectors))


def _vectors(strict: bool, vectors, pencil: Pencil, defined) -> Float[Array, "c n"]:
    solver = default_solver()
    linear = Linear(solver, solver.prepare(pencil.pattern), soft=jax.lax.stop_gradient(pencil.soft))

    def change(phi, pencil, along):
        dA, dB = along(lambda pencil: pencil.A), along(lambda pencil: pencil.B)
        mu = _values(strict, vectors, pencil, defined)
        one = functools.partial(_nelson, linear, strict, pencil.A, pencil.B, dA, dB)
        return jax.vmap(one)(phi, mu, defined)

    return derived(change, vectors, pencil)


def _nelson(linear: Linear, strict: bool, A, B, dA, dB, phi, mu, defined) -> Float[Array, " n"]:
    """The change of one vector φ (n,) with the eigenvalue μ."""
    handle = linear.handle
    k = jnp.argmax(jnp.abs(phi))
    off = (handle.rows == k) | (handle.indices == k)
    singular = A - mu * B
    size = jax.lax.stop_gradient(jnp.max(jnp.abs(singular)))
    regular = jnp.where(off, jnp.where(handle.rows == handle.indices, size, 0.0), singular)

    def solve(transpose, rhs):
        x = _solved(linear, regular, rhs, transpose)
        # Asked here, where the answer is wanted: programs that do not use it do not pay for it.
        lost = defined & jnp.any(rhs != 0) & ~(_gap(linear, A, B, regular, phi, mu) > _GAP)
        return eqx.error_if(x, lost, NOT_SIMPLE) if strict else jnp.where(lost, jnp.nan, x)

    B_phi = multiply(handle, B, phi)
    residual = multiply(handle, dA, phi) - mu * multiply(handle, dB, phi)
    d_mu = phi @ residual / (phi @ B_phi)
    v = jax.lax.custom_linear_solve(
        functools.partial(multiply, handle, regular),
        jnp.where(jnp.arange(phi.size) == k, 0.0, d_mu * B_phi - residual),
        solve=lambda _, rhs: solve(False, rhs),
        transpose_solve=lambda _, rhs: solve(True, rhs),
    )
    return v - (B_phi @ v + 0.5 * phi @ multiply(handle, dB, phi)) * phi


def _solved(linear: Linear, matrix, rhs, transpose: bool) -> Float[Array, " n"]:
    """With a symmetric matrix; refined where multipliers have zeros on its diagonal."""
    if linear.soft is not None:
        return linear.solve_once(matrix, rhs)
    return linear.solver._solve_once(linear.handle, matrix, rhs, transpose)


def _gap(linear: Linear, A, B, regular, phi, mu) -> Float[Array, ""]:
    """Distance from μ to the next eigenvalue, as a fraction of the larger."""
    handle = linear.handle
    B_phi = multiply(handle, B, phi)
    w = jnp.asarray(np.random.default_rng(1).standard_normal(phi.size))
    for _ in range(_SWEEPS):
        w = _solved(linear, regular, multiply(handle, B, w / jnp.max(jnp.abs(w))), False)
        w = w - (B_phi @ w) * phi
    next_mu = (w @ multiply(handle, A, w)) / (w @ multiply(handle, B, w))
    return jnp.abs(next_mu - mu) / jnp.maximum(jnp.abs(mu), jnp.abs(next_mu))
