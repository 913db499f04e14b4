"""Whether the joints of a scene can hold what they hold: conditions that repeat others, and starts that break them."""

from typing import Any, NamedTuple

import jax
import numpy as np
import scipy.linalg

from jaxshell.assembly.structure import structure_of
from jaxshell.model.connectors.joint import AtGroup, conditions_at
from jaxshell.model.contribution import Constraint
from jaxshell.model.scene import Scene
from jaxshell.numerics.checks import is_concrete

_DEPENDENT = 1e-8
"""A condition less than this part of which is its own repeats others."""
_BROKEN = 1e-9
"""A start that breaks a condition by more than this part of the shell's size, or of its motion, is refused."""


class _Row(NamedTuple):
    """Conditions of one group, and what has them."""

    name: str
    group: AtGroup


def check_conditions(scene: Scene) -> None:
    """Raise ValueError for joints whose conditions repeat each other or what supports hold, and for a start in which
    joints are open or opening. Scenes that are being traced are let through."""
    if not any(isinstance(part, Constraint) for part in scene.contributions):
        return
    if not all(is_concrete(leaf) for leaf in jax.tree.leaves(scene)):
        return
    x, R, rates, size = _start(scene)
    rows = _rows(scene, x, R)
    for row in rows:
        apart = np.abs(row.group.values).max()
        if apart > _BROKEN * size:
            raise ValueError(
                f"{row.name} is open by {apart:.3g} at the start: the initial displacements and rotations must agree "
                "on both sides."
            )
        opening = np.abs(np.einsum("pci,ci->p", row.group.slopes, rates[row.group.nodes])).max()
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


def _rows(scene: Scene, x, R) -> list[_Row]:
    """The conditions of every group at the start."""
    found = []
    for number, item in enumerate(scene.connectors):
        what = f"connector {number} ({item.kind})" if item.name is None else f"{item.kind} {item.name!r}"
        found += [_Row(what, group) for group in conditions_at(item, scene.mesh, x, R)]
    return found


def _check_independent(scene: Scene, rows: list[_Row], x, R) -> None:
    """Raise ValueError where a condition repeats what others, supports and rigid bodies hold."""
    n, number = scene.mesh.n_nodes, structure_of(scene).numbers()[: 6 * scene.mesh.n_nodes].reshape(-1, 6)
    masters = np.arange(n) if scene.masters is None else scene.masters.array
    arms = x - x[masters]
    matrix, names = [], []
    for row in rows:
        slopes = row.group.slopes.copy()
        slopes[:, :, 3:] += np.cross(arms[row.group.nodes][None], slopes[:, :, :3])
        for one in slopes:
            line = np.zeros(int(number.max()) + 2)
            np.add.at(line, number[row.group.nodes].ravel(), one.ravel())
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
