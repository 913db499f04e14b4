"""Rigid-body motions that the supports leave free: statics has no answer while there is one."""

import jax
import numpy as np
from scipy.linalg import block_diag
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from jaxshell.model.scene import Scene
from jaxshell.numerics.checks import is_concrete

_ON_OBSTACLES = (
    " Obstacles hold it where it presses on them from the start: settle() lets it come to rest there, and its last "
    "shape can be the scene's initial one."
)
_RANK = 1e-8
"""A singular value of the supports' matrix below this fraction of the largest counts as zero."""


def check_supported(scene: Scene, may_touch: bool = False) -> None:
    """Raise ValueError that names the rigid-body motions left free, of every connected part of the mesh.

    Obstacles hold the nodes that press on them at the start, along their normals; all nodes that may touch them, where
    the shell `may_touch` them on its way. Nodes and connectors that are being traced cannot be looked at and are let
    through.
    """
    if not all(map(is_concrete, jax.tree.leaves((scene.mesh.nodes, scene.connectors)))):
        return
    parts = free_parts(scene, may_touch)
    for members, motions in parts:
        if motions:
            which = "the shell"
            if len(parts) > 1:
                which = f"the part of the shell with node {members[0]} ({len(parts)} parts)"
            raise ValueError(
                f"The supports leave {which} free to move as a rigid body: {'; '.join(motions)}. "
                "Hold these motions; a shell without supports moves and vibrates, but has no static answer."
                f"{_ON_OBSTACLES if scene.obstacles and not may_touch else ''}"
            )


def free_parts(scene: Scene, may_touch: bool = False) -> list[tuple[np.ndarray, list[str]]]:
    """The parts that no element and no rigid body connects: their nodes, and the rigid-body motions that supports,
    connectors and obstacles leave to each, in words.

    Connectors join parts; a part's motion is free where the others may move along with it.
    """
    nodes = np.asarray(scene.mesh.nodes)
    links = [np.stack([body.followers, np.full(len(body.followers), body.master)], axis=1) for body in scene.bodies]
    count, part = connected_parts(scene.mesh.triangles, len(nodes), links)
    places = [_Part(nodes, np.flatnonzero(part == k)) for k in range(count)]
    held = [place.rows_of(scene.held_dofs) for place in places]
    holding = [item.holds(scene.mesh) for item in scene.connectors] + [_pressed(scene, may_touch)]
    joining = [rows for holds in holding for rows in _joining(holds, nodes, part, places)]
    if not joining:
        return [(place.members, place.words(_null(rows))) for place, rows in zip(places, held, strict=True)]
    both = np.concatenate([np.asarray(block_diag(*held)), *joining])
    null = _null(both).reshape(-1, count, 6)
    return [(place.members, place.words(_independent(null[:, k]))) for k, place in enumerate(places)]


def _pressed(scene: Scene, may_touch: bool) -> list[tuple[np.ndarray, np.ndarray]]:
    """What obstacles resist: of each node that they hold a row (1, 6) along the normal."""
    x, found = scene.start[0], []
    for obstacle in scene.obstacles:
        met = obstacle.meeting(scene.section, scene.mesh, x, obstacle.moved(np.zeros(())))
        if all(map(is_concrete, met)):
            holds = np.full(len(met.nodes), True) if may_touch else np.asarray(met.depth) > 0.0
            rows = np.pad(np.asarray(met.normals), ((0, 0), (0, 3)))
            found += [(met.nodes[[k]], rows[[k]]) for k in np.flatnonzero(holds)]
    return found


def connected_parts(triangles: np.ndarray, n_nodes: int, links=()) -> tuple[int, np.ndarray]:
    """How many parts of a mesh no element connects, and none of the `links` (k, 2), and the part (n,) of each node."""
    first = np.concatenate([triangles.ravel(), *(pairs[:, 0] for pairs in links)])
    second = np.concatenate([np.roll(triangles, 1, axis=1).ravel(), *(pairs[:, 1] for pairs in links)])
    return connected_components(coo_matrix((np.ones(first.size), (first, second)), (n_nodes, n_nodes)), directed=False)


class _Part:
    """A part that moves as a rigid body: by (v, ω·size), v the velocity of its centre."""

    def __init__(self, nodes: np.ndarray, members: np.ndarray):
        self.nodes, self.members = nodes, members
        self.centre = nodes[members].mean(axis=0)
        self.size = float(np.linalg.norm(np.ptp(nodes[members], axis=0))) or 1.0  # of a single node any

    def motion_of(self, node) -> np.ndarray:
        """(6, 6) velocity and spin·size of a node, a number, by rows, under the part's motions."""
        arm = (self.nodes[node] - self.centre) / self.size
        found = np.eye(6)
        found[:3, 3:] = np.cross(np.eye(3), arm).T  # column j: ω_j × arm
        return found

    def rows_of(self, dofs: np.ndarray) -> np.ndarray:
        """(k, 6) of the degrees of freedom 6·node + dof that are the part's."""
        own = dofs[np.isin(dofs // 6, self.members)]
        return np.array([self.motion_of(node)[dof] for node, dof in zip(*np.divmod(own, 6), strict=True)]).reshape(
            -1, 6
        )

    def words(self, null: np.ndarray) -> list[str]:
        """Motions (k, 6), in words."""
        return _named(null, self.centre, self.size)


def _joining(holds, nodes: np.ndarray, part: np.ndarray, places: list[_Part]):
    """What connectors resist, by the motions of all parts: rows (r, 6 parts) of each group."""
    for group, rows in holds:
        total = np.zeros((len(rows), 6 * len(places)))
        for position, node in enumerate(group):
            k, own = part[node], rows[:, 6 * position : 6 * position + 6].copy()
            own[:, 3:] /= places[k].size
            total[:, 6 * k : 6 * k + 6] += own @ places[k].motion_of(node)
        sizes = np.linalg.norm(total, axis=1)
        yield total[sizes > 0] / sizes[sizes > 0][:, None]


def _null(rows: np.ndarray) -> np.ndarray:
    """(k, d) motions that leave all rows at rest."""
    _, singular, basis = np.linalg.svd(
        np.concatenate([rows, np.zeros((rows.shape[1], rows.shape[1]))]), full_matrices=False
    )
    return basis[singular <= _RANK * max(1.0, singular[0])]


def _independent(motions: np.ndarray) -> np.ndarray:
    """(k, 6) motions that span those given."""
    if not len(motions):
        return motions
    _, singular, basis = np.linalg.svd(motions)
    return basis[: len(singular)][singular > _RANK]


def _named(null: np.ndarray, centre: np.ndarray, size: float) -> list[str]:
    """Rigid-body motions (v, ω·size), in words."""
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
