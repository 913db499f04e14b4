"""Mid-point inertia of translations and directors that are linear in the element (Simo & Tarnow 1994).

T = ½∫ρh|v|² + ½∫(ρh³/12)|ṫ|² dA with t_a = R_a n: all masses are constant, and the mid-point rule keeps both momenta
and the energy exactly. What `jaxshell.methods.energy_momentum` asks of a form of inertia: `at_start`, `steady`,
`forces`, `tangent`, `momenta`.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.elements.element import Element
from jaxshell.elements.energy_momentum import mid_matrix
from jaxshell.numerics.products import cross, dot, product, scaled
from jaxshell.numerics.rotations import skew
from jaxshell.numerics.triangles import LINEAR_MASS


class DirectorMotion(NamedTuple):
    """One element's translational and director motion at the start of the step."""

    v: Float[Array, "*m 3 3"]
    director: Float[Array, "*m 3 3"]
    """t_a = R_a n, with n the element's reference normal."""
    rate: Float[Array, "*m 3 3"]
    """ṫ_a = W_a n."""


class Momenta(NamedTuple):
    """Of the whole shell."""

    kinetic: Float[Array, ""]
    linear: Float[Array, "3"]
    angular: Float[Array, "3"]


def at_start(elements: Element, R: Float[Array, "m 3 3 3"], v: Float[Array, "m 3 3"], W) -> DirectorMotion:
    """The motion of all elements from rotations, velocities and Ṙ at their corners."""
    normals = elements.frame[:, None, None, 2]
    return DirectorMotion(v, dot(R, normals), dot(W, normals))


def steady(u: Float[Array, "3 6"], start: DirectorMotion, dt) -> DirectorMotion:
    """A motion that begins with the step's mean rates, and so has no acceleration."""
    return DirectorMotion(u[:, :3] / dt, start.director, _change(u, start)[1] / dt)


def forces(u, start: DirectorMotion, element: Element, dt, alpha=None) -> Float[Array, "18"]:
    """Rate of momentum as force, and moment t_m,a × (rate of the director's momentum), on every node a.

    Mass-proportional damping `alpha`, where it is not None, adds α times the mean momenta to the rates.
    """
    middle, force, spin = _step(u, start, element, dt, alpha)
    return jnp.stack([force, cross(middle, spin)], axis=1).reshape(18)


def tangent(spin: Float[Array, "3 3 3"], u, start: DirectorMotion, element: Element, dt, alpha=None):
    """Derivative of `forces` by u, (18, 18); `spin` are the derivatives of the nodal spins by the rotations in u."""
    factor = 2.0 / dt**2 if alpha is None else 2.0 / dt**2 + alpha / dt
    mass, rotary = (factor * m for m in _masses(element))
    middle, _, rate = _step(u, start, element, dt, alpha)
    end = 2.0 * middle - start.director
    skews = jax.vmap(skew)
    by_theta = -jax.vmap(product)(skews(end), spin)  # δt₁ = δω × t₁
    moved = jax.vmap(lambda t: jax.vmap(lambda B: product(t, B))(by_theta))(skews(middle))  # (a, b, 3, 3)
    turned = -0.5 * jax.vmap(product)(skews(rate), by_theta)
    moved = rotary[:, :, None, None] * moved
    eye = jnp.eye(3)
    moments = jnp.transpose(moved + eye[:, :, None, None] * turned[:, None], (0, 2, 1, 3))
    forces = mass[:, None, :, None] * eye[None, :, None, :]
    coupling = lever = jnp.zeros_like(forces)
    uneven = _uneven_mass(element)
    if uneven is not None:
        uneven = factor * uneven
        coupling = uneven[:, None, :, None] * jnp.transpose(by_theta, (1, 0, 2))[None]
        lever = uneven[:, None, :, None] * skews(middle)[:, :, None, :]
    rows = [jnp.stack([forces, coupling], axis=3), jnp.stack([lever, moments], axis=3)]
    return jnp.stack(rows, axis=1).reshape(18, 18)


def momenta(elements: Element, x: Float[Array, "m 3 3"], R, v, W) -> Momenta:
    """Kinetic energy and momenta, eqs. (27), (28), (34), with the masses with which the scheme keeps them."""
    motion = at_start(elements, R, v, W)
    weight = elements.area[:, None, None]
    momentum = weight * elements.mass_per_area[:, None, None] * (jnp.asarray(LINEAR_MASS) @ v)
    spin = weight * elements.rotary_inertia[:, None, None] * (jnp.asarray(LINEAR_MASS) @ motion.rate)
    if elements.first_moment is not None:  # ∫ρz dz couples the two
        uneven = weight * elements.first_moment[:, None, None] * jnp.asarray(LINEAR_MASS)
        momentum, spin = momentum + uneven @ motion.rate, spin + uneven @ v
    kinetic = 0.5 * (jnp.sum(v * momentum) + jnp.sum(motion.rate * spin))
    angular = jnp.sum(jnp.cross(x, momentum) + jnp.cross(motion.director, spin), axis=(0, 1))
    return Momenta(kinetic, jnp.sum(momentum, axis=(0, 1)), angular)


def rate_of_change(change, rate, dt, alpha):
    """(rate₁ - rate₀)/Δt where Δt ½(rate₁ + rate₀) is the `change`, plus α times the mean rate."""
    mean = change / dt
    found = 2.0 * (mean - rate) / dt
    return found if alpha is None else found + alpha * mean


def _masses(element: Element) -> tuple[Float[Array, "3 3"], Float[Array, "3 3"]]:
    """∫ N_a N_b dA times ρh and ρh³/12: constant, since velocities and directors are linear in the element."""
    linear = jnp.asarray(LINEAR_MASS)
    return scaled(element.mass_per_area * element.area, linear), scaled(element.rotary_inertia * element.area, linear)


def _uneven_mass(element: Element) -> Float[Array, "3 3"] | None:
    """The same times ∫ρz dz, which couples velocities and directors; None where it vanishes."""
    if element.first_moment is None:
        return None
    return scaled(element.first_moment * element.area, jnp.asarray(LINEAR_MASS))


def _change(u, start: DirectorMotion):
    """Mid-point directors t_m (3, 3) and their change t₁ - t₀ (3, 3) in the step."""
    # t_m = ½ (I + cay(θ)) t₀, from t₁ - t₀ = θ × t_m.
    middle = jax.vmap(lambda A, t: product(A, t))(jax.vmap(mid_matrix)(u[:, 3:]), start.director)
    return middle, cross(u[:, 3:], middle)


def _step(u, start: DirectorMotion, element: Element, dt, alpha):
    """Mid-point directors t_m (3, 3), and the rates of the momenta of velocities and directors, (3, 3) each.

    Σ_b M_ab ((v₁ - v₀)/Δt + α v_m)_b and Σ_b J_ab ((ṫ₁ - ṫ₀)/Δt + α ṫ_m)_b, each with the other's changes where ∫ρz dz
    couples them.
    """
    middle, change = _change(u, start)
    mass, rotary = _masses(element)
    faster, turned = rate_of_change(u[:, :3], start.v, dt, alpha), rate_of_change(change, start.rate, dt, alpha)
    force, spin = product(mass, faster), product(rotary, turned)
    uneven = _uneven_mass(element)
    if uneven is not None:
        force, spin = force + product(uneven, turned), spin + product(uneven, faster)
    return middle, force, spin
