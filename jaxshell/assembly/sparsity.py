"""The sparsity pattern of a square matrix in compressed rows (CSR), as static data."""

import dataclasses

import numpy as np

from jaxshell.numerics.frozen import Frozen


@dataclasses.dataclass(frozen=True)
class SparsityPattern:
    """Where a square sparse matrix may be non-zero: compressed rows, hashable, static.

    size: number of rows n. indptr: (n + 1,) integers. indices: (m,) integers, the columns of each row in
    ascending order. Raises ValueError unless the diagonal is present and every (i, j) has its (j, i).
    """

    size: int
    indptr: Frozen
    indices: Frozen

    def __init__(self, size: int, indptr, indices):
        object.__setattr__(self, "size", int(size))
        object.__setattr__(self, "indptr", indptr if isinstance(indptr, Frozen) else Frozen(indptr))
        object.__setattr__(self, "indices", indices if isinstance(indices, Frozen) else Frozen(indices))
        self._check()

    @property
    def rows(self) -> np.ndarray:
        """(m,) the row of each entry."""
        return np.repeat(np.arange(self.size), np.diff(self.indptr.array))

    def _check(self) -> None:
        n, indptr, indices = self.size, self.indptr.array, self.indices.array
        if n < 1 or indptr.shape != (n + 1,) or indices.ndim != 1:
            raise ValueError(
                f"a pattern of size {n} needs size >= 1, indptr of shape ({n + 1},) and indices of one"
                f" dimension, not shapes {indptr.shape} and {indices.shape}"
            )
        if indptr[0] != 0 or indptr[-1] != len(indices) or np.any(np.diff(indptr) < 0):
            raise ValueError(f"indptr must rise from 0 to the number of indices, {len(indices)}")
        if len(indices) and (indices.min() < 0 or indices.max() >= n):
            raise ValueError(f"columns must lie in 0..{n - 1}, not {indices.min()}..{indices.max()}")
        rows = self.rows
        if np.any(np.diff(rows * n + indices) <= 0):
            raise ValueError("the columns of each row must be in ascending order and occur once")
        has_diagonal = np.bincount(rows[rows == indices], minlength=n)
        if not has_diagonal.all():
            raise ValueError(f"the diagonal must be present; row {has_diagonal.argmin()} lacks its entry")
        transposed = np.argsort(indices, kind="stable")  # the entries by columns, each column by rows
        if not (np.array_equal(indices[transposed], rows) and np.array_equal(rows[transposed], indices)):
            lonely = np.setdiff1d(indices * n + rows, rows * n + indices)
            i, j = divmod(int(lonely[0]), n)
            raise ValueError(f"the pattern must be structurally symmetric; ({j}, {i}) has no ({i}, {j})")
