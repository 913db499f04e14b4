"""Whether the joints of a scene can hold what they hold: conditions that repeat others, and starts that break them."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg

from jaxshell.assembly.structure import structure_of
from jaxshell.elements.corotational import local_frame
from jaxshell.model.contribution import Constraint, Place, Surface, gradient_between
from jaxshell.model.scene import Scene
from jaxshell.numerics.checks import is_concrete

_DEPENDENT = 1e-8
"""A condition less than this part of which is its own repeats others."""
_BROKEN = 1e-9
"""A start that breaks a condition by more than this part of the shell's size, or of its motion, is refused."""


class _Row(NamedTuple):
    """Conditions of one group."""

    name: str
    slopes: np.ndarray
    """(p, c, 6)"""
    nodes: np.ndarray
    values: np.ndarray
    """(p,)"""


def check_conditions(scene: Scene) -> None:
    """Raise ValueError for joints whose conditions repeat each other or what supports hold, and for a start in which
    joints are open or opening. Scenes that are being traced are let through."""
    if not any(isinstance(part, Constraint) for part in scene.contributions):
        return
    if not all(is_concrete(leaf) for leaf in jax.tree.leaves(scene)):
        return
    x, R, rates, size = _start(scene)
    rows = _rows(scene, x, R, size)
    for row in rows:
        if np.abs(row.values).max() > _BROKEN * size:
            raise ValueError(
                f"{row.name} is open by {np.abs(row.values).max():.3g} at the start: the initial displacements and "
                "rotations must agree on both sides."
            )
        opening = np.abs(np.einsum("pci,ci->p", row.slopes, rates[row.nodes])).max()
        if opening > _BROKEN * max(np.abs(rates[:, :3]).max(), size * np.abs(rates[:, 3:]).max()):
            raise ValueError(
                f"The initial velocities open {row.name} at the rate {opening:.3g}: give both its sides one motion."
            )
    _check_independent(scene, rows, x, R)


def _start(scene: Scene):
    """Places, rotations, rates (n, 6) of the nodes at the start, and the scene's size."""
    n, initial = scene.mesh.n_nodes, scene.initial
    x, R, rates = np.asarray(scene.mesh.nodes), np.broadcast_to(np.eye(3), (n, 3, 3)).copy(), np.zeros((n, 6))
    size = float(np.linalg.norm(np.ptp(x, axis=0))) or 1.0
    if initial is not None:
        x = x if initial.displacements is None else x + np.asarray(initial.displacements)
        R = R if initial.rotations is None else np.asarray(initial.rotations).copy()
        for columns, given in ((slice(3), initial.velocities), (slice(3, 6), initial.angular_velocities)):
            if given is not None:
                rates[:, columns] = np.asarray(given)
    rates.reshape(-1)[scene.held_dofs] = 0.0
    masters = np.arange(n) if scene.masters is None else scene.masters.array
    arms = np.einsum("nij,nj->ni", R[masters], np.asarray(scene.mesh.nodes) - np.asarray(scene.mesh.nodes)[masters])
    spin = rates[masters, 3:]
    rates = np.concatenate([rates[masters, :3] + np.cross(spin, arms), spin], axis=1)
    return x[masters] + arms, R[masters], rates, size


def _rows(scene: Scene, x, R, size: float) -> list[_Row]:
    """The conditions of every group, with their slopes at the start."""
    surface, found = _surface(scene, size), []
    for number, item in enumerate(scene.connectors):
        what = f"connector {number} ({item.kind})" if item.name is None else f"{item.kind} {item.name!r}"
        for part in item.parts():
            if not isinstance(part, Constraint):
                continue
            nodes = part.groups(scene.mesh.triangles).array
            place = Place(jnp.asarray(x)[nodes], jnp.asarray(R)[nodes], jnp.zeros(len(nodes)))
            data = part.data(surface)
            slopes = jax.vmap(lambda d, p, part=part: gradient_between(lambda q: part.conditions(d, q), p))(data, place)
            values = jax.vmap(part.conditions)(data, place)
            found += [_Row(what, *row) for row in zip(np.asarray(slopes), nodes, np.asarray(values), strict=True)]
    return found


def _surface(scene: Scene, size: float) -> Surface:
    x0, triangles = scene.mesh.nodes, scene.mesh.triangles
    frames, plane = jax.vmap(local_frame)(x0[triangles])
    area = 0.5 * plane[:, 0] * plane[:, 2]
    return Surface(x0, triangles, jnp.zeros_like(area), area, frames[:, 2], jnp.asarray(size))


def _check_independent(scene: Scene, rows: list[_Row], x, R) -> None:
    """Raise ValueError where a condition repeats what others, supports and rigid bodies hold."""
    n, number = scene.mesh.n_nodes, structure_of(scene).numbers()[: 6 * scene.mesh.n_nodes].reshape(-1, 6)
    masters = np.arange(n) if scene.masters is None else scene.masters.array
    arms = x - x[masters]
    matrix, names = [], []
    for row in rows:
        slopes = row.slopes.copy()
        slopes[:, :, 3:] += np.cross(arms[row.nodes][None], slopes[:, :, :3])
        for one in slopes:
            line = np.zeros(int(number.max()) + 2)
            np.add.at(line, number[row.nodes].ravel(), one.ravel())
            line[-1] = 0.0
            matrix.append(line / max(np.linalg.norm(one), 1e-300))
            names.append(row.name)
    G = np.stack(matrix)
    G = G[:, np.abs(G).max(axis=0) > 0]
    factored: Any = scipy.linalg.qr(G.T, mode="economic", pivoting=True)
    _, upper, order = factored
    own = np.zeros(len(names))
    own[: min(upper.shape)] = np.abs(np.diag(upper))
    repeats = sorted(order[own < _DEPENDENT].tolist())
    if repeats:
        several = ", ".join(dict.fromkeys(names[k] for k in repeats))
        raise ValueError(
            f"{len(repeats)} of the {len(names)} conditions of the joints repeat what other joints, supports and rigid "
            f"bodies hold already, among them of {several}: the forces there would have no one answer. Leave one out, "
            "or take a joint that holds less (two hinges of one door: a hinge and a spherical joint; rigid on both "
            "sides: a slider in place of the second)."
        )
