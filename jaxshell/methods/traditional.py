"""The traditional rotary inertia that the paper compares with (below eq. (40)): nodal, without centrifugal term.

Rotations are taken at the nodes, the material angular acceleration is linear between them, ~Ω I_ρ Ω is dropped.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.assembly.discretised import Model
from jaxshell.elements import inertia
from jaxshell.elements.element import Element
from jaxshell.elements.inertia import LINEAR_MASS, Spins, StepFactors
from jaxshell.numerics import rotations
from jaxshell.numerics.products import dot, product


def initial_spins(R: Float[Array, "n 3 3"], omega: Float[Array, "n 3"]) -> Spins:
    """Nodal spins (n, ...) from rotations and angular velocities in space; angular accelerations zero."""
    material = jnp.einsum("nij,ni->nj", R, omega)
    return Spins(R, material, jnp.zeros_like(material))


def _accelerations(theta, spins: Spins, element: Element, factors: StepFactors, alpha) -> Float[Array, "3 3"]:
    """∫ N_a I_ρ (Ω̇ + α Ω) dA for the three nodes, at the generalised mid-point; α None is none."""

    def one(theta, spins):
        acceleration = factors.mid_acceleration(theta @ spins.R, spins.Omega, spins.Omega_dot, alpha)
        return inertia.apply_inertia(element.frame[2], element.rotary_inertia, acceleration)

    return element.area * product(jnp.asarray(LINEAR_MASS), jax.vmap(one)(theta, spins))


def moments(motion, R_start, spins: Spins, element: Element, factors: StepFactors, alpha=None) -> Float[Array, "3 3"]:
    """Inertial moments of one element on its nodes; `R_start` (3, 3, 3) are the rotations at the step's start."""
    R = factors.mid(motion.R, R_start, factors.alpha_f)
    return dot(R, _accelerations(motion.theta, spins, element, factors, alpha)[:, None, :])


def stiffness(
    motion, R_start, spins: Spins, element: Element, factors: StepFactors, alpha=None
) -> Float[Array, "3 3 3 3"]:
    """Derivative of `moments` by the rotation vectors: axes (node, component, node, component)."""
    tensor = element.rotary_inertia * (jnp.eye(3) - element.frame[2][:, None] * element.frame[2][None])
    mass = element.area * jnp.asarray(LINEAR_MASS)
    R = factors.mid(motion.R, R_start, factors.alpha_f)
    linear = factors.mid_acceleration_slope(alpha) * jnp.einsum("ab,aij,jk,blk->aibl", mass, R, tensor, R_start)
    turned = dot(motion.R, _accelerations(motion.theta, spins, element, factors, alpha)[:, None, :])
    turning = (1.0 - factors.alpha_f) * jnp.einsum("aij,ajk->aik", jax.vmap(rotations.skew)(turned), motion.spin)
    return linear - jnp.einsum("aij,ab->aibj", turning, jnp.eye(3))


def turning(model: Model, theta: Float[Array, "n 3"], spins: Spins) -> Float[Array, " m"]:
    """Σ θ·I_ρ θ of a step's rotations in each element, as `energy_and_momentum` weights angular velocities."""
    elements, material = model.elements, model.gather(jnp.einsum("nij,ni->nj", spins.R, theta))
    turned = inertia.apply_inertia(elements.frame[:, None, 2], 1.0, jnp.asarray(LINEAR_MASS) @ material)
    return elements.area * elements.rotary_inertia * jnp.sum(material * turned, axis=(1, 2))


def energy_and_momentum(model: Model, spins: Spins):
    """Rotational kinetic energy and angular momentum ∫ R I_ρ Ω dA of nodal spins (n, ...)."""
    elements = model.elements
    spins = model.gather(spins)
    momentum = inertia.apply_inertia(elements.frame[:, None, 2], 1.0, jnp.asarray(LINEAR_MASS) @ spins.Omega)
    momentum = (elements.area * elements.rotary_inertia)[:, None, None] * momentum
    return 0.5 * jnp.sum(spins.Omega * momentum), jnp.einsum("maij,maj->i", spins.R, momentum)
