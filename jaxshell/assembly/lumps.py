"""The point masses of a scene as arrays."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxshell.model.scene import Scene


class Lumps(eqx.Module):
    """Mass and inertia tensor of every node that has some."""

    mass: Float[Array, " k"]
    inertia: Float[Array, "k 3 3"]
    """About the nodes, in the axes of the stress-free shape; zero where a node has a mass only."""
    nodes: Int[Array, "k 1"]
    entries: Int[Array, " e"] | None
    """Of (6, 6) matrices, entry by entry: places in the sparse matrix; None where there is none."""
    on_elements: bool = eqx.field(static=True, default=False)
    """As a contribution's groups are placed in the matrix: never the elements'."""

    @property
    def at(self) -> Int[Array, " k"]:
        return self.nodes[:, 0]

    def matrices(self, R: Float[Array, "n 3 3"]) -> Float[Array, "k 6 6"]:
        """Mass matrices by velocities and angular velocities in space, with the nodes' rotations R."""
        turned = R[self.at]
        spatial = turned @ self.inertia @ jnp.swapaxes(turned, 1, 2)
        translational = self.mass[:, None, None] * jnp.eye(3)
        return jnp.zeros((len(self.mass), 6, 6)).at[:, :3, :3].set(translational).at[:, 3:, 3:].set(spatial)


def lumped_nodes(scene: Scene) -> np.ndarray:
    """(k,) nodes with a mass or an inertia tensor, ascending."""
    masses = scene.point_masses
    return np.zeros(0, int) if masses is None else np.unique(masses.nodes.array)


def lumps_of(scene: Scene, nodes, entries) -> Lumps | None:
    """The point masses of a scene; `nodes` (k, 1) are its `lumped_nodes`. None where there are none."""
    masses = scene.point_masses
    if masses is None:
        return None
    known = lumped_nodes(scene)
    mass = jnp.zeros(len(known)).at[np.searchsorted(known, masses.nodes.array)].add(masses.mass)
    place = np.searchsorted(known, masses.turning.array)
    return Lumps(mass, jnp.zeros((len(known), 3, 3)).at[place].add(masses.inertia), nodes, entries)
