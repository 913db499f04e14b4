"""How deep the shell is in the obstacles of its scene: what the penalty of the contact has let in."""

import warnings
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.obstacles import Obstacle
from jaxshell.model.scene import Scene
from jaxshell.numerics.compiled import compiled_for_frames
from jaxshell.results.solution import Solution

_FRAMES = 64
"""So many frames are looked at together."""


class Penetration(NamedTuple):
    """Of one obstacle, over the frames of a run."""

    obstacle: str
    """Its name."""
    depth: Float[np.ndarray, " f"]
    """The largest of any node [length], zero where none touches."""
    node: np.ndarray
    """(f,) which."""
    thickness: Float[np.ndarray, " f"]
    """Of the shell there [length], of a point twice its radius; NaN of a section that has none."""

    @property
    def worst(self) -> int:
        """The frame of the largest depth."""
        return int(np.argmax(self.depth))

    @property
    def is_deep(self) -> bool:
        """Whether that is more than the thickness: the penalty does not hold what presses on it."""
        return bool(self.depth[self.worst] > self.thickness[self.worst])


def penetration(solution: Solution) -> tuple[Penetration, ...]:
    """How deep the shell's skin is in each obstacle, at every frame, in the order of the scene's obstacles.

    A penalty holds nodes by letting them in a little. That should be a small part of the thickness: else the obstacle
    needs a larger `stiffness`.
    """
    return tuple(
        _of(solution, obstacle, obstacle.called(position)) for position, obstacle in enumerate(solution.scene.obstacles)
    )


def warn_of_depth(solution: Solution) -> None:
    """A warning that names each obstacle in which the shell was deeper than it is thick, at some frame."""
    for found in penetration(solution) if len(solution.frame_times) else ():
        if found.is_deep:
            warnings.warn(
                f"The shell penetrates {found.obstacle} by {found.depth[found.worst]:.3g} at time "
                f"{float(solution.frame_times[found.worst]):.6g} (node {found.node[found.worst]}), more than its "
                f"thickness {found.thickness[found.worst]:.3g}: give the obstacle a larger stiffness.",
                stacklevel=2,
            )


def moved(solution: Solution, obstacle: Obstacle, times: np.ndarray) -> Float[np.ndarray, "f 3"]:
    """How far an obstacle has moved at some times of a solution, in statics by the load factor."""
    if obstacle.motion is None or obstacle.history is None:
        return np.zeros((len(times), 3))
    factors = times if solution.analysis == "static" else np.asarray(obstacle.history(times))
    return factors[:, None] * np.asarray(obstacle.motion)


def _of(solution: Solution, obstacle: Obstacle, name: str) -> Penetration:
    scene, times = solution.scene, np.asarray(solution.frame_times)
    nodes = obstacle.touching(scene.mesh.triangles)
    skin, thickness = obstacle.skin(scene.section, scene.mesh), _thickness(scene)[nodes]
    thickness = np.where(np.isin(nodes, scene.mesh.triangles), thickness, 2.0 * np.asarray(skin))
    shifts = moved(solution, obstacle, times)
    depth, node = [], []
    for first in range(0, len(times), _FRAMES):
        frames = np.arange(first, min(first + _FRAMES, len(times)))
        x = scene.mesh.nodes + solution.frames.at(frames.tolist()).displacements
        found = np.asarray(_depths(obstacle, x[:, nodes], shifts[frames], skin))
        depth.append(np.maximum(found.max(axis=1), 0.0))
        node.append(found.argmax(axis=1))
    which = np.concatenate(node)
    return Penetration(name, np.concatenate(depth), nodes[which], thickness[which])


@compiled_for_frames
def _depths(obstacle: Obstacle, x: Float[Array, "f k 3"], shifts: Float[Array, "f 3"], skin: Float[Array, " k"]):
    return skin - jax.vmap(jax.vmap(obstacle.gap))(x - shifts[:, None])


def _thickness(scene: Scene) -> np.ndarray:
    """(n,) the least of the elements around each node."""
    layers = scene.section.layers(scene.mesh)
    least = np.full(scene.mesh.n_nodes, np.inf)
    if layers is not None:
        each = np.asarray(layers.z[:, -1, 1] - layers.z[:, 0, 0])
        np.minimum.at(least, scene.mesh.triangles, each[:, None])
    return np.where(np.isfinite(least), least, np.nan)
