"""Seven-point inertia of the shell for methods that keep spins at the Gauss points: forces, tangents, energies.

Eqs. (27), (28), (34), (40), (51) with the points of `jaxshell.elements.inertia`. Translations are linear in area
coordinates, and their mass is exact; rotations, angular velocities and accelerations live at the points.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.elements import inertia
from jaxshell.elements.corotational import Element
from jaxshell.elements.inertia import GAUSS_POINTS, GAUSS_WEIGHTS, LINEAR_MASS, Spins, StepFactors
from jaxshell.model import Model
from jaxshell.rotations import exp, log

# --- one element ------------------------------------------------------------------------------------------


def inertial_forces(increment, theta, v, a, spins: Spins, element: Element, factors: StepFactors):
    """f_iner of eqs. (40), (88), (18,): `increment`, `theta`, `v`, `a` are (3, 3), node by component."""
    acceleration = factors.mid(factors.second(increment, v, a), a, factors.alpha_m)
    mass = element.mass_per_area * element.area
    force = mass * (jnp.asarray(LINEAR_MASS) @ acceleration)
    moments = jax.vmap(inertia.point_inertia, in_axes=(0, 0, None, None, None))(
        jnp.asarray(GAUSS_POINTS) @ theta, spins, element.frame[2], element.rotary_inertia, factors
    )
    moment = element.area * (jnp.asarray(GAUSS_WEIGHTS[:, None] * GAUSS_POINTS).T @ moments)
    return jnp.stack([force, moment], axis=1).reshape(18)


def inertial_tangent(theta, spins: Spins, element: Element, factors: StepFactors) -> Float[Array, "18 18"]:
    """Derivative of `inertial_forces` by displacements and rotation vectors of the step, eqs. (51), (95)."""
    points = jax.vmap(inertia.point_tangent, in_axes=(0, 0, None, None, None))(
        jnp.asarray(GAUSS_POINTS) @ theta, spins, element.frame[2], element.rotary_inertia, factors
    )
    weights = GAUSS_WEIGHTS[:, None, None] * GAUSS_POINTS[:, :, None] * GAUSS_POINTS[:, None, :]
    blocks = jnp.asarray(weights.reshape(7, 9)).T @ points.stiffness.reshape(7, 9)
    rotational = element.area * jnp.transpose(blocks.reshape(3, 3, 3, 3), (0, 2, 1, 3))
    second = (1.0 - factors.alpha_m) / (factors.beta * factors.dt**2)
    mass = second * element.mass_per_area * element.area
    translational = mass * jnp.asarray(LINEAR_MASS)[:, None, :, None] * jnp.eye(3)[None, :, None, :]
    zero = jnp.zeros_like(translational)
    rows = [jnp.stack([translational, zero], axis=3), jnp.stack([zero, rotational], axis=3)]
    return jnp.stack(rows, axis=1).reshape(18, 18)


# --- the shell --------------------------------------------------------------------------------------------


def initial_spins(model: Model, R: Float[Array, "n 3 3"], omega: Float[Array, "n 3"]) -> Spins:
    """Spins (m, 7, ...) from nodal rotations and angular velocities in space; angular accelerations zero.

    Rotations between the nodes follow the rotation vectors that lead from node 1 to the others.
    """

    def points(R, omega):
        relative = jax.vmap(log)(jnp.einsum("aij,kj->aik", R, R[0]))
        turned = jax.vmap(exp)(jnp.asarray(GAUSS_POINTS) @ relative) @ R[0]
        material = jnp.einsum("pij,pi->pj", turned, jnp.asarray(GAUSS_POINTS) @ omega)
        return Spins(turned, material, jnp.zeros_like(material))

    return jax.vmap(points)(model.gather(R), model.gather(omega))


def turned_spins(model: Model, theta: Float[Array, "n 3"], spins: Spins, factors: StepFactors) -> Spins:
    """Spins at the end of the step from the nodal rotation vectors, eqs. (103), (13), (14)."""
    at_points = jnp.asarray(GAUSS_POINTS) @ model.gather(theta)
    return jax.vmap(jax.vmap(inertia.end_of_step, (0, 0, None)), (0, 0, None))(at_points, spins, factors)


def kinetic_and_momenta(model: Model, x: Float[Array, "n 3"], v: Float[Array, "n 3"], spins: Spins):
    """Kinetic energy, linear and angular momentum about the origin, eqs. (34), (27), (28)."""
    elements = model.elements
    mass = elements.mass_per_area * elements.area
    corners, rates = model.gather((x, v))
    momentum = mass[:, None, None] * (jnp.asarray(LINEAR_MASS) @ rates)
    turning = jnp.asarray(GAUSS_WEIGHTS)[:, None] * inertia.apply_inertia(
        elements.frame[:, None, 2], 1.0, spins.Omega
    )
    turning = (elements.area * elements.rotary_inertia)[:, None, None] * turning
    kinetic = 0.5 * (jnp.sum(rates * momentum) + jnp.sum(spins.Omega * turning))
    angular = jnp.sum(jnp.cross(corners, momentum), axis=(0, 1)) + jnp.einsum("mpij,mpj->i", spins.R, turning)
    return kinetic, jnp.sum(momentum, axis=(0, 1)), angular
