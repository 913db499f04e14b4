"""The start of a run: initial motion of a scene, and accelerations that are consistent with its loads."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.assembly.discretised import Model
from jaxshell.elements.inertia import LINEAR_MASS, mass_matrix
from jaxshell.methods import damping
from jaxshell.model.scene import Scene

Nodal = Float[Array, "n 3"]
_NO_INERTIA = 1e-3
"""Of the mean rotary inertia of a node: what turns without inertia, as the drilling rotations do, is given this part of
it, so that accelerations can be solved for. Nothing but these rotations sees it."""


def linear_of(solvers) -> Any:
    """The linear solver of a run's solvers; None where there are none."""
    return None if solvers is None else solvers.linear


def initial_accelerations(model: Model, linear, x: Nodal, R, time, v: Nodal, omega: Nodal):
    """(d̈, ω̇) (n, 3) each, at the start.

    Of a shell whose nodes are free of each other the translations alone, by `initial_translational_acceleration`:
    rotations start without acceleration. Where rigid bodies and joints bind places and rotations, both, of
    M a + Gᵀλ = f, G a = -Ġ v, with the consistent mass matrix.
    """
    if model.elimination is None and not model.constraints:
        return initial_translational_acceleration(model, x, R, time, v, omega), jnp.zeros_like(omega)
    force = model.external_load(x, R, time) - model.internal_force(x, R, time)
    rates = jnp.concatenate([v, omega], axis=1)
    if model.damping is not None:
        force = force - damping.initial_force(model, x, R, v, omega)
    if model.resisting:
        force = force + model.resistance((x, R, time), (x, R, time), rates)
    found = _accelerations(model, linear, x, R, time, rates, force)
    return found[:, :3], found[:, 3:]


def initial_motion(model: Model, scene: Scene) -> tuple[Nodal, Float[Array, "n 3 3"], Nodal, Nodal]:
    """Positions, rotations, velocities and angular velocities at the start, time 0.

    Held degrees of freedom do not move, and those with a prescribed motion have its rates: had they none, a method of
    mean velocities would swing between zero and twice the rate ever after.
    """
    n = model.x0.shape[0]
    x, R = model.x0, jnp.broadcast_to(jnp.eye(3), (n, 3, 3))
    v = omega = jnp.zeros((n, 3))
    initial = scene.initial
    if initial is not None:
        x = x if initial.displacements is None else x + model.whole(initial.displacements, v)
        R = R if initial.rotations is None else model.whole(initial.rotations, R)
        v = v if initial.velocities is None else model.whole(initial.velocities, v)
        omega = omega if initial.angular_velocities is None else model.whole(initial.angular_velocities, omega)
    rates = jnp.concatenate([v, omega], axis=1)
    if model.elimination is not None:
        rates = model.elimination.along(rates)
    held = model.held_rates(jnp.zeros(())) if model.moving else 0.0
    rates = rates.reshape(-1).at[model.tables.held].set(held).reshape(n, 6)
    if model.elimination is None:
        return x, R, rates[:, :3], rates[:, 3:]
    rates = model.elimination.nodal_forces(rates)
    return model.elimination.placed(x, R, rates[:, :3], rates[:, 3:])


def _accelerations(model: Model, linear, x, R, time, rates: Float[Array, "n 6"], force) -> Float[Array, "n 6"]:
    """The accelerations (n, 6) of `initial_accelerations`, `force` (n, 6) without those of inertia."""
    n, omega = x.shape[0], rates[:, 3:]
    # What nodes have of acceleration without any of the unknowns: followers turn about their masters, others are moved.
    known = jnp.zeros((n, 6))
    if model.elimination is not None:
        known = known.at[:, :3].set(model.elimination.centripetal(R, omega))
    if model.moving:
        known = known + model.spread(jnp.zeros(model.tables.free.shape), model.held_accelerations(time), R)

    def weighted(R, element):
        """The mass matrix, with a little inertia about directors."""
        M = mass_matrix(R, element)
        axes = R @ element.frame[2]
        little = _NO_INERTIA * element.area * element.rotary_inertia / 3.0 * axes[:, :, None] * axes[:, None, :]
        blocks = M.reshape(3, 2, 3, 3, 2, 3)
        return blocks.at[jnp.arange(3), 1, :, jnp.arange(3), 1, :].add(little).reshape(18, 18)

    matrices = jax.vmap(weighted)(model.gather(R), model.elements)
    moved = jnp.einsum("mij,mj->mi", matrices, model.gather(known).reshape(-1, 18))
    force, others = force - model.assemble_vector(moved), []
    if model.lumps is not None:
        lumps = model.lumps
        own = lumps.matrices(R)
        spin = own[:, 3:, 3:] @ omega[lumps.at, :, None]
        turning = jnp.cross(omega[lumps.at], spin[..., 0])
        gyroscopic = jnp.concatenate([jnp.zeros_like(turning), turning], axis=1)
        force = force.at[lumps.at].add(-jnp.einsum("kij,kj->ki", own, known[lumps.at]) - gyroscopic)
        others.append((lumps, own))
    for acting in model.constraints:
        others.append((acting, acting.constraint_stiffness(x, R, time)))
        force = force + model.sum_over_nodes(acting, acting.bending_of_motion(x, R, time, rates, known))
    values = model.matrix_at(R, matrices, others)
    free = linear.posed(model).solve_once(values, model.free(model.collected(force, R)))
    held = jnp.zeros(model.tables.held.shape)
    return model.spread(free, held, R) + known


def initial_translational_acceleration(
    model: Model, x: Nodal, R: Float[Array, "n 3 3"], time, v: Nodal, omega: Nodal
) -> Nodal:
    """d̈ from M d̈ = f_ext - f_int - f_damp over the free displacements; prescribed at the held ones.

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
    given = None
    if model.moving:
        given = jnp.zeros(6 * n).at[model.tables.held].set(model.held_accelerations(time)).reshape(n, 6)[:, :3]
        force = force.at[:, :3].add(-translational_inertia(model, given))

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
    return found if given is None else found + given


def translational_inertia(model: Model, a: Nodal) -> Nodal:
    """Forces M a of the consistent mass, and of point masses, on nodes with the accelerations a."""
    mass = model.elements.mass_per_area * model.elements.area
    corner = mass[:, None, None] * (jnp.asarray(LINEAR_MASS) @ model.gather(a))
    found = model.tables.nodal(corner.reshape(-1, 3))
    if model.lumps is not None:
        found = found.at[model.lumps.at].add(model.lumps.mass[:, None] * a[model.lumps.at])
    return found
