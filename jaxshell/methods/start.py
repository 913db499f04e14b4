"""The start of a run: initial motion of a scene, and accelerations that are consistent with its loads."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.assembly.discretised import Model
from jaxshell.elements.inertia import LINEAR_MASS
from jaxshell.methods import damping
from jaxshell.model.scene import Scene

Nodal = Float[Array, "n 3"]


def initial_motion(model: Model, scene: Scene) -> tuple[Nodal, Float[Array, "n 3 3"], Nodal, Nodal]:
    """Positions, rotations, velocities and angular velocities at the start; held degrees of freedom do not move."""
    n = model.x0.shape[0]
    x, R = model.x0, jnp.broadcast_to(jnp.eye(3), (n, 3, 3))
    v = omega = jnp.zeros((n, 3))
    initial = scene.initial
    if initial is not None:
        x = x if initial.displacements is None else x + initial.displacements
        R = R if initial.rotations is None else jnp.asarray(initial.rotations)
        v = v if initial.velocities is None else jnp.asarray(initial.velocities)
        omega = omega if initial.angular_velocities is None else jnp.asarray(initial.angular_velocities)
    rates = jnp.concatenate([v, omega], axis=1)
    if model.elimination is not None:
        rates = model.elimination.along(rates)
    rates = rates.reshape(-1).at[model.tables.held].set(0.0).reshape(n, 6)
    if model.elimination is None:
        return x, R, rates[:, :3], rates[:, 3:]
    rates = model.elimination.nodal_forces(rates)
    return model.elimination.placed(x, R, rates[:, :3], rates[:, 3:])


def initial_translational_acceleration(
    model: Model, x: Nodal, R: Float[Array, "n 3 3"], time, v: Nodal, omega: Nodal
) -> Nodal:
    """d̈ from M d̈ = f_ext - f_int - f_damp over the free displacements; zero at the held ones.

    The consistent mass matrix of linear triangles is well conditioned, so conjugate gradients preconditioned
    with its diagonal reach round-off in some thirty products.
    """
    n = model.x0.shape[0]
    force = model.external_load(x, R, time) - model.internal_force(x, R, time)
    if model.damping is not None:
        force = force - damping.initial_force(model, x, R, v, omega)
    if model.resisting:
        force = force + model.resistance((x, R, time), (x, R, time), jnp.concatenate([v, omega], axis=1))
    is_free = jnp.zeros(6 * n).at[model.tables.free].set(1.0).reshape(n, 6)[:, :3]
    mass = model.elements.mass_per_area * model.elements.area

    lumped = jnp.zeros((n, 1))
    if model.lumps is not None:
        lumped = lumped.at[model.lumps.at, 0].add(model.lumps.mass)

    def product(a):
        corner = mass[:, None, None] * (jnp.asarray(LINEAR_MASS) @ model.gather(a * is_free))
        found = model.tables.nodal(corner.reshape(-1, 3))
        if model.lumps is not None:
            found = found + lumped * a
        return is_free * found + (1.0 - is_free) * a

    diagonal = model.tables.nodal(jnp.repeat(mass / 6.0, 3))[:, None]
    if model.lumps is not None:
        diagonal = diagonal + lumped
    scale = jnp.where(is_free > 0, 1.0 / diagonal, 1.0)
    found, _ = jax.scipy.sparse.linalg.cg(
        product, is_free * force[:, :3], tol=1e-15, maxiter=200, M=lambda r: scale * r
    )
    return found
