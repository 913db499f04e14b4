"""Eigenvalue problems on the host, by SciPy: shift-invert Lanczos (ARPACK), and full matrices where they are small."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.linalg import LinAlgError, eig, eigh
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigs, eigsh, splu

from jaxshell.numerics.checks import is_concrete

DENSE = 120
"""Degrees of freedom up to which eigenvalues are those of full matrices; Lanczos' space may not fit into fewer."""


def on_host(function, shape, *values) -> Float[Array, "c *nf"]:
    """Eigenvectors by a function of NumPy arrays, also while JAX traces; constants for its derivatives."""
    values = jax.lax.stop_gradient(values)
    result = jax.ShapeDtypeStruct(shape, jnp.float64)
    if not all(is_concrete(v) for v in values):
        found = jax.pure_callback(
            lambda *v: np.asarray(function(*map(np.asarray, v))), result, *values, vmap_method="sequential"
        )
    else:
        found = jnp.asarray(function(*map(np.asarray, values)))
    return jax.lax.stop_gradient(found)


def power_of_two(number) -> float:
    """The one above `number`; 1 for zero."""
    return float(np.ldexp(1.0, np.frexp(float(number))[1]))


class Inverse(LinearOperator):
    """A⁻¹ by SuperLU."""

    def __init__(self, matrix):
        super().__init__(np.float64, matrix.shape)
        if (matrix.diagonal() == 0).any():  # of multipliers
            self.factors = splu(matrix)
        else:
            self.factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})

    def _matvec(self, x):
        return self.factors.solve(x)


class _Quotient(LinearOperator):
    """A⁻¹ B, with pivots."""

    def __init__(self, A, B):
        super().__init__(np.float64, A.shape)
        self.factors, self.B = splu(A), B

    def _matvec(self, x):
        return self.factors.solve(self.B @ x)


def shift_invert(K, M, shift: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The `count` eigenpairs of K φ = λ M φ nearest to `shift` from above, ascending, φᵀ M φ = 1."""
    inverse = Inverse((K - shift * M).tocsc())
    if M.shape[0] <= DENSE:
        values, vectors = _dense_shift_invert(K.toarray(), M.toarray(), shift, count)
    else:
        values, vectors = lanczos(K, k=count, M=M, sigma=shift, OPinv=inverse, which="LM")
    # One more step cleans the vectors of what the singular mass matrix cannot see.
    vectors = inverse.factors.solve(M @ vectors)
    vectors = vectors / np.sqrt(np.sum(vectors * (M @ vectors), axis=0))
    order = np.argsort(values)
    return values[order], vectors[:, order]


def _dense_shift_invert(K, M, shift: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The eigenpairs of K φ = λ M φ nearest to `shift`, from M φ = θ (K - shift M) φ with λ = shift + 1/θ."""
    shifted = K - shift * M
    try:
        theta, vectors = eigh(M, shifted)
    except LinAlgError:  # not positive definite, about an unstable state
        theta, vectors = (np.real(part) for part in eig(M, shifted))
    nearest = np.argsort(-np.abs(theta))[:count]
    with np.errstate(divide="ignore"):  # beyond the rank of M
        return shift + 1.0 / theta[nearest], vectors[:, nearest]


def indefinite(K, K_sigma, count: int) -> np.ndarray:
    """The vectors (count, n) of the largest μ of -K_σ φ = μ K φ, where multipliers make saddles of the matrices.

    On what joints leave free K is definite, and μ are real.
    """
    size = K.shape[0]
    if size <= DENSE:
        found: Any = eig(np.linalg.solve(K.toarray(), -K_sigma.toarray()))
    else:
        start = np.random.default_rng(0).standard_normal(size)
        found = eigs(_Quotient(K, -K_sigma), k=count, which="LR", v0=start)
    values, vectors = found
    return np.real(vectors[:, np.argsort(-np.real(values))[:count]]).T


def lanczos(matrix, **options):
    # A start that repeats: with ARPACK's own, equal eigenvalues come with other vectors every time.
    start = np.random.default_rng(0).standard_normal(matrix.shape[0])
    try:
        return eigsh(matrix, v0=start, **options)
    except ArpackNoConvergence as error:
        found = len(error.eigenvalues)
        raise RuntimeError(f"Only {found} of {options['k']} eigenvalues converged; ask for fewer.") from error
