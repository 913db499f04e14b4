"""Grids of quads cut in triangles: coordinates, connectivity, and how large they may be."""

import numpy as np

MOST_TRIANGLES = 2_000_000
"""More are refused where meshes are generated: their tangent alone, of six million unknowns, fills gigabytes."""


def grid(first, second) -> tuple[np.ndarray, np.ndarray]:
    """Both coordinates (n·k,) of the nodes of a grid of n by k values, numbered as `structured_triangles` does."""
    check_size(len(first), len(second))
    first, second = np.meshgrid(first, second, indexing="ij")
    return first.ravel(), second.ravel()


def chain(nodes: np.ndarray) -> np.ndarray:
    """Edges (n - 1, 2) between neighbours in a list of nodes (n,)."""
    return np.stack([nodes[:-1], nodes[1:]], 1)


def check_size(rows: int, columns: int) -> None:
    """Raise ValueError where a grid of `rows` by `columns` quads has more than two million triangles."""
    if 2 * rows * columns > MOST_TRIANGLES:
        raise ValueError(
            f"A grid of {rows} by {columns} is {2 * rows * columns} triangles, more than the {MOST_TRIANGLES} that are "
            "generated: choose smaller divisions."
        )


def structured_triangles(rows: int, columns: int, periodic: bool = False) -> np.ndarray:
    """Connectivity of a rows × columns grid of quads, each cut along its (i, j)-(i+1, j+1) diagonal.

    Node (i, j) has index i·(columns+1) + j, or i·columns + j where the second direction closes on itself
    (`periodic`). Returns (2·rows·columns, 3).
    """
    check_size(rows, columns)
    width = columns if periodic else columns + 1
    i, j = grid(np.arange(rows), np.arange(columns))
    after = (j + 1) % width
    a, b, c, d = i * width + j, (i + 1) * width + j, (i + 1) * width + after, i * width + after
    return np.stack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)], 1).reshape(-1, 3)
