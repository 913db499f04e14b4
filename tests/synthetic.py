"""Solutions made up from formulas, with the shapes and kinds of data of a run, made without a solver."""

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from jaxshell.model.scene import Scene
from jaxshell.results.solution import RESULTS, Energy, Momentum, Solution, Stats


def synthetic_solution(scene: Scene, steps: int = 12, save_every: int = 3, method: str = "EMC") -> Solution:
    """`steps` steps over the scene's default duration: the shell drifts, sinks and turns."""
    times = np.linspace(0, 1.0 if scene.defaults is None else scene.defaults.t_end, steps + 1)
    phase = times / times[-1]
    frame_phase = phase[::save_every]
    x0 = np.asarray(scene.mesh.nodes)
    size = np.ptp(x0, axis=0).max()
    spin = frame_phase[:, None, None] * (0.3 + 0.1 * np.sin(7 * x0 / size))
    shape = np.stack([0.2 * x0[:, 1], 0 * x0[:, 0], -0.1 * size - x0[:, 0] ** 2 / size], 1) / size
    displacements = size * frame_phase[:, None, None] * shape
    moved = np.interp(times, times[::save_every], displacements[:, 0, 2])
    watched = {
        label: jnp.asarray(moved * (1 + i) if component.startswith("u") else np.gradient(moved, times))
        for i, (label, _, component) in enumerate(scene.watch)
    }
    momenta = np.stack([np.sin(phase), np.cos(phase), phase**2], 1)
    decay = 0.0 if method == "EMC" else 0.1
    return Solution(
        scene=scene,
        times=jnp.asarray(times),
        watched=watched,
        energy=Energy(
            kinetic=jnp.asarray(np.sin(3 * phase) ** 2 * (1 - decay * phase)),
            strain=jnp.asarray(np.cos(3 * phase) ** 2 * (1 - decay * phase)),
            external_work=jnp.asarray(0 * phase),
            dissipated=jnp.asarray(0 * phase),
        ),
        momentum=Momentum(linear=jnp.asarray(momenta), angular=jnp.asarray(2 * momenta[:, ::-1])),
        iterations=jnp.asarray(np.arange(steps + 1) % 5),
        frame_times=jnp.asarray(times[::save_every]),
        displacements=jnp.asarray(displacements),
        rotations=jnp.asarray(Rotation.from_rotvec(spin.reshape(-1, 3)).as_matrix().reshape(*spin.shape, 3)),
        velocities=jnp.asarray(np.gradient(displacements, times[::save_every], axis=0)),
        result=RESULTS.successful,
        message="",
        stats=Stats(method=method, steps=steps),
    )
