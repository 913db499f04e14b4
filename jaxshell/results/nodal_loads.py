"""What the loads of a scene add up to on its nodes, before the shell moves."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.contribution import Contribution, Place, Surface
from jaxshell.model.history import History
from jaxshell.model.loads import DeadLoad, Load
from jaxshell.model.scene import Scene
from jaxshell.numerics.compiled import compiled_for_frames
from jaxshell.numerics.triangles import local_frame


def nodal_loads(scene: Scene) -> list[tuple[Load, Float[Array, "n 6"]]]:
    """Each load that is a force, with its forces and moments on all nodes at its full value, whatever its history.

    Initial strains are none.
    """
    acting = [load for load in scene.loads if isinstance(load, DeadLoad | Contribution)]
    return list(zip(acting, _nodal(scene), strict=True))


def resultant(places, nodal) -> tuple[np.ndarray, np.ndarray]:
    """Force (3,), and moment (3,) about the origin, of forces and moments (n, 6) on nodes at `places` (n, 3)."""
    places, nodal = np.asarray(places), np.asarray(nodal)
    return nodal[:, :3].sum(axis=0), (np.cross(places, nodal[:, :3]) + nodal[:, 3:]).sum(axis=0)


@compiled_for_frames
def _nodal(scene: Scene) -> list[Float[Array, "n 6"]]:
    x0, triangles = scene.mesh.nodes, scene.mesh.triangles
    frames, plane = jax.vmap(local_frame)(x0[triangles])
    area = 0.5 * plane[:, 0] * plane[:, 2]
    found = scene.section.resultants(scene.mesh)
    layers, static = lambda: scene.section.layers(scene.mesh), scene.mesh.triangles
    of_sections = found.A, layers, static, found.rotary_inertia, found.first_moment
    surface = Surface(x0, triangles, found.mass_per_area, area, frames[:, 2], jnp.ones(()), *of_sections)
    found = []
    for load in scene.loads:
        if isinstance(load, DeadLoad):
            found.append(load.nodal(x0, triangles, surface.mass_per_area))
        elif isinstance(load, Contribution):
            load = eqx.tree_at(lambda held: held.history, load.for_statics(), History.constant())
            found.append(_of_contribution(load, surface))
    return found


def _of_contribution(load: Contribution, surface: Surface) -> Float[Array, "n 6"]:
    groups = load.groups(surface.triangles).array
    R = jnp.broadcast_to(jnp.eye(3), (*groups.shape, 3, 3))

    def force(data, x, R):
        return load.force(data, Place(x, R, jnp.zeros(())))

    forces = jax.vmap(force)(load.data(surface), surface.x0[groups], R)
    return jnp.zeros((len(surface.x0), 6)).at[groups.ravel()].add(forces.reshape(-1, 6))
