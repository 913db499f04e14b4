"""Rotation matrices as unit quaternions and back, for files: four numbers in place of nine."""

import numpy as np


def matrices_to_quaternions(matrices: np.ndarray) -> np.ndarray:
    """Unit quaternions (..., 4), (w, x, y, z), of rotation matrices (..., 3, 3).

    4 q qᵀ is linear in R; its column with the largest diagonal entry is q up to length (Shepperd 1978), which
    is well conditioned for every angle.
    """
    R = np.asarray(matrices, dtype=np.float64)
    trace = np.trace(R, axis1=-2, axis2=-1)
    outer = np.empty((*R.shape[:-2], 4, 4))
    outer[..., 0, 0] = 1 + trace
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        outer[..., a + 1, a + 1] = 1 - trace + 2 * R[..., a, a]
        outer[..., 0, a + 1] = outer[..., a + 1, 0] = R[..., c, b] - R[..., b, c]
        outer[..., b + 1, a + 1] = outer[..., a + 1, b + 1] = R[..., b, a] + R[..., a, b]
    largest = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    column = np.take_along_axis(outer, largest[..., None, None], axis=-1)[..., 0]
    return column / np.linalg.norm(column, axis=-1, keepdims=True)


def quaternions_to_matrices(quaternions: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) of unit quaternions (..., 4)."""
    w, x, y, z = np.moveaxis(np.asarray(quaternions), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)
