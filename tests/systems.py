"""Sparse systems that the tests of the linear solvers share: patterns of shells, values, dense copies."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse

from jaxshell.solvers.linear_solver import KLU, Dense, Pardiso, SparsityPattern, multiply

ROUND_OFF = 1e-12  # of matrices whose condition numbers are below 100
SOLVERS = (Pardiso, KLU, Dense)


def available(kind):
    """A solver of the class; the test is skipped where its package is not installed."""
    try:
        return kind()
    except ImportError as error:
        pytest.skip(str(error))


def shell_pattern(columns, rows):
    """Six unknowns a node on a structured mesh of triangles."""
    node = np.arange((columns + 1) * (rows + 1)).reshape(columns + 1, rows + 1)
    a, b, c, d = (part.ravel() for part in (node[:-1, :-1], node[1:, :-1], node[1:, 1:], node[:-1, 1:]))
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    i, j = np.repeat(triangles, 3, axis=1).ravel(), np.tile(triangles, (1, 3)).ravel()
    nodes = np.zeros((node.size, node.size))
    nodes[i, j] = 1.0
    rows, columns = np.nonzero(np.kron(nodes, np.ones((6, 6))))
    size = 6 * node.size
    return SparsityPattern(size, np.searchsorted(rows, np.arange(size + 1)), columns)


def random_values(pattern, seed=0):
    """Unsymmetric, with a diagonal that keeps the condition number low."""
    values = np.random.default_rng(seed).standard_normal(len(pattern.indices.array))
    return jnp.asarray(values + 40.0 * (pattern.rows == pattern.indices.array))


def to_dense(pattern, values):
    shape = (pattern.size, pattern.size)
    csr = (np.asarray(values), pattern.indices.array, pattern.indptr.array)
    return scipy.sparse.csr_matrix(csr, shape=shape).toarray()


def relative_residual(handle, values, x, rhs):
    """|K x - b|/|b|: round-off for a regular matrix, not so for a singular one."""
    return jnp.linalg.norm(multiply(handle, values, x) - rhs) / jnp.linalg.norm(rhs)


def relative_error(x, reference):
    return np.linalg.norm(x - reference) / np.linalg.norm(reference)


PATTERN = shell_pattern(3, 2)
N = PATTERN.size
RHS = jnp.asarray(np.random.default_rng(1).standard_normal(N))
