"""The model: a scene turned into arrays (elements, loads, supports, tables), built inside the compiled program."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell import rotations
from jaxshell.assembly import Structure, Tables
from jaxshell.elements import corotational
from jaxshell.elements.corotational import Element
from jaxshell.fusion import formed
from jaxshell.loads import History, Pressure
from jaxshell.scene import Scene
from jaxshell.supports import Support


class Model(eqx.Module):
    """A scene as arrays: what the methods compute with. Differentiable in every float of the scene."""

    x0: Float[Array, "n 3"]
    elements: Element
    """Each field with a leading axis over the m elements."""
    dead_loads: tuple[tuple[Float[Array, "n 6"], History], ...]
    pressures: tuple[tuple[Float[Array, " m"], History], ...]
    moving: tuple[Support, ...]
    """The supports with a prescribed motion."""
    size: Float[Array, ""]
    """The shell's size, the diagonal of its bounding box [length]: the scale of convergence."""
    tables: Tables

    @classmethod
    def build(cls, scene: Scene, tables: Tables) -> "Model":
        x0, section = scene.mesh.nodes, scene.section.per_element(scene.mesh.n_elements)
        elements = jax.vmap(Element.build)(
            x0[tables.triangles], section.thickness, section.young_modulus, section.poisson_ratio, section.density
        )
        dead, pressures = [], []
        for load in scene.loads:
            if isinstance(load, Pressure):
                pressures.append((jnp.broadcast_to(load.pressure, section.thickness.shape), load.history))
            else:
                dead.append((load.nodal(x0, tables.triangles, elements.mass_per_area), load.history))
        moving = tuple(support for support in scene.supports if support.displacement is not None)
        size = jnp.linalg.norm(jnp.max(x0, axis=0) - jnp.min(x0, axis=0))
        return cls(x0, elements, tuple(dead), tuple(pressures), moving, size, tables)

    def gather(self, nodal):
        """(n, ...) nodal values → (m, 3, ...) at the elements' corners; for every leaf of a pytree."""
        return jax.tree.map(lambda values: values[self.tables.triangles], nodal)

    def assemble_vector(self, corner: Float[Array, "m 18"]) -> Float[Array, "n 6"]:
        """Sum of element vectors over the nodes."""
        return self.tables.nodal(corner.reshape(-1, 6))

    def assemble_matrix(self, matrices: Float[Array, "m 18 18"]) -> Float[Array, " nnz"]:
        """Values of the sparse matrix over the free freedoms."""
        return self.tables.matrix(formed(matrices).reshape(-1))

    def free(self, nodal: Float[Array, "n 6"]) -> Float[Array, " nf"]:
        """The entries of a nodal vector at the free freedoms."""
        return nodal.reshape(-1)[self.tables.free]

    def expand(self, free: Float[Array, " nf"], held: Float[Array, " nh"]) -> Float[Array, "n 6"]:
        """The nodal vector with the given entries at free and held freedoms."""
        return jnp.concatenate([free, held])[self.tables.place].reshape(-1, 6)

    def held_displacement(self, time) -> Float[Array, " nh"]:
        """Displacements of the held freedoms at `time`; zero where nothing is prescribed."""
        values = jnp.zeros(self.x0.shape[0] * 6)
        for support in self.moving:
            values = values.at[support.dof_numbers].set(support.values(time))
        return values[self.tables.held]

    def dead_load(self, time) -> Float[Array, "n 6"]:
        """Nodal forces and moments of all loads with a fixed direction at `time`."""
        total = jnp.zeros((self.x0.shape[0], 6))
        for pattern, history in self.dead_loads:
            total = total + history(time) * pattern
        return total

    def pressure(self, time) -> Float[Array, " m"]:
        """Follower pressure on each element at `time`; only for scenes that have one."""
        total = jnp.zeros(self.tables.triangles.shape[0])
        for value, history in self.pressures:
            total = total + history(time) * value
        return total

    def pressure_load(self, x: Float[Array, "n 3"], time) -> Float[Array, "n 6"]:
        """Nodal forces of the follower pressure on the shape x; zeros for scenes without one."""
        if not self.pressures:
            return jnp.zeros((self.x0.shape[0], 6))
        return self.assemble_vector(jax.vmap(pressure_force)(self.gather(x), self.pressure(time)))

    def strain_energy(self, x: Float[Array, "n 3"], R: Float[Array, "n 3 3"]) -> Float[Array, ""]:
        """Strain energy of the shell, eq. (61) summed over the elements."""

        def one(x, R, element):
            return corotational.strain_energy(corotational.kinematics(x, R, element).deformations, element)

        return jnp.sum(jax.vmap(one)(self.gather(x), self.gather(R), self.elements))

    def internal_force(self, x: Float[Array, "n 3"], R: Float[Array, "n 3 3"]) -> Float[Array, "n 6"]:
        """Nodal internal forces and moments, eq. (70) assembled."""
        return self.assemble_vector(
            jax.vmap(corotational.internal_force)(self.gather(x), self.gather(R), self.elements)
        )


def structure_of(scene: Scene) -> Structure:
    """The static part of a scene that the sparsity depends on."""
    return Structure(scene.mesh.connectivity, scene.mesh.n_nodes, scene.held)


def pressure_force(x: Float[Array, "3 3"], pressure) -> Float[Array, "18"]:
    """Nodal forces p A n/3 of a follower pressure on one deformed element."""
    normal = jnp.cross(x[1] - x[0], x[2] - x[0]) / 6.0
    return jnp.tile(jnp.concatenate([pressure * normal, jnp.zeros(3)]), 3)


def pressure_stiffness(x: Float[Array, "3 3"], pressure) -> Float[Array, "18 18"]:
    """Derivative of `pressure_force` by the nodal displacements (rotations do not enter)."""
    edges = jnp.stack([x[2] - x[1], x[0] - x[2], x[1] - x[0]])
    block = pressure / 6.0 * jax.vmap(rotations.skew)(edges)
    # n = (x2-x1)×(x3-x1)/6 changes by ~(opposite edge) δx_b, at every node alike.
    K = jnp.zeros((3, 2, 3, 3, 2, 3)).at[:, 0, :, :, 0, :].set(jnp.transpose(block, (1, 0, 2))[None])
    return K.reshape(18, 18)
