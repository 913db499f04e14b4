"""Rigid-body motions that the supports leave free: statics has no answer while there is one."""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from jaxshell.model.scene import Scene
from jaxshell.numerics.checks import is_concrete

_RANK = 1e-8
"""A singular value of the supports' matrix below this fraction of the largest counts as zero."""


def check_supported(scene: Scene) -> None:
    """Raise ValueError that names the rigid-body motions left free, of every connected part of the mesh.

    Nodes that are being traced cannot be looked at and are let through.
    """
    if not is_concrete(scene.mesh.nodes):
        return
    nodes = np.asarray(scene.mesh.nodes)
    count, part = connected_parts(scene.mesh.triangles, len(nodes))
    for k in range(count):
        members = np.flatnonzero(part == k)
        motions = free_motions(nodes, members, scene.held_dofs)
        if motions:
            which = "the shell" if count == 1 else f"the part of the shell with node {members[0]} ({count} parts)"
            raise ValueError(
                f"The supports leave {which} free to move as a rigid body: {'; '.join(motions)}. "
                "Hold these motions; a shell without supports moves and vibrates, but has no static answer."
            )


def connected_parts(triangles: np.ndarray, n_nodes: int) -> tuple[int, np.ndarray]:
    """How many parts of a mesh no element connects, and the part (n,) of each node."""
    ends = triangles.ravel(), np.roll(triangles, 1, axis=1).ravel()
    return connected_components(coo_matrix((np.ones(triangles.size), ends), (n_nodes, n_nodes)), directed=False)


def free_motions(nodes: np.ndarray, members: np.ndarray, held_dofs: np.ndarray) -> list[str]:
    """The rigid-body motions of the nodes `members` that the held degrees of freedom (6·node + dof) allow, in words."""
    centre = nodes[members].mean(axis=0)
    size = np.linalg.norm(np.ptp(nodes[members], axis=0))
    node, dof = np.divmod(held_dofs[np.isin(held_dofs // 6, members)], 6)
    # Row of a held degree of freedom: its motion under (v, ω·size), v the velocity of the centre.
    rows = np.zeros((node.size, 6))
    arm = (nodes[node] - centre) / size
    moving, axis = dof < 3, dof % 3
    rows[np.arange(node.size), dof] = 1.0
    spins = np.cross(np.eye(3)[None, :, :], arm[:, None, :])  # [row, j]: ∂(ω × arm)/∂ω_j
    rows[moving, 3:] = spins[np.flatnonzero(moving), :, axis[moving]]
    _, singular, basis = np.linalg.svd(np.concatenate([rows, np.zeros((6, 6))]))
    null = basis[singular <= _RANK * max(1.0, singular[0])]
    if not len(null):
        return []
    # Spins first: after elimination, rows without a spin are translations.
    reduced = _echelon(null[:, [3, 4, 5, 0, 1, 2]])
    found = []
    for omega, v in zip(reduced[:, :3] / size, reduced[:, 3:], strict=True):
        spin = np.linalg.norm(omega)
        if spin < 1e-6 / size:
            found.append(f"translation along {_vector(v / np.abs(v).max())}")
            continue
        point = centre + np.cross(omega, v) / spin**2
        sliding = " with a translation along it" if abs(omega @ v) > 1e-6 * spin else ""
        axis = _vector(omega / np.abs(omega).max())
        found.append(f"rotation about the axis {axis} through {_vector(point)}{sliding}")
    return found


def _echelon(rows: np.ndarray) -> np.ndarray:
    """Reduced row echelon form, so that motions come along the axes where they can."""
    rows, at = rows.copy(), 0
    for column in range(rows.shape[1]):
        pivot = at + int(np.argmax(np.abs(rows[at:, column])))
        if abs(rows[pivot, column]) < 1e-6:
            continue
        rows[[at, pivot]] = rows[[pivot, at]]
        rows[at] /= rows[at, column]
        others = np.arange(len(rows)) != at
        rows[others] -= np.outer(rows[others, column], rows[at])
        at += 1
        if at == len(rows):
            break
    return rows


def _vector(values: np.ndarray) -> str:
    return "(" + ", ".join(f"{value:.3g}" for value in np.round(values, 9) + 0.0) + ")"
