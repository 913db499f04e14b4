"""Mid-point inertia that knows that the shell bends: positions follow the rotations of the nodes along every edge.

The paper's translational inertia has positions that are linear in the element, while the plate bends with cubic
deflections along its edges. Here, with E_ab = X_b - X_a projected onto the tangent plane of the surface at node a,

    x = Σ_a N_a x_a + ½ Σ_a Σ_b≠a N_a N_b R_a E_ab,

which has that cubic along every edge and is linear in the x_a and R_a. A point of the director t = Σ_a N_a R_a n moves
with ẋ + z ṫ. So T = ½∫ρ|ẋ + z ṫ|² dz dA is a quadratic form, with a constant matrix, in the rates of the twelve vectors
(x_a, R_a e1, R_a e2, R_a e3), e_i the element's reference axes, and the mid-point rule keeps the energy and both
momenta as exactly as with linear positions (`jaxshell.elements.director_inertia`). It holds the mass of the curved
surface.
"""

from math import factorial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.elements.bending import EDGES
from jaxshell.elements.director_inertia import Momenta, rate_of_change
from jaxshell.elements.element import Element, corners
from jaxshell.elements.energy_momentum import mid_matrix
from jaxshell.numerics.products import cross, product
from jaxshell.numerics.rotations import skew

_POWERS = np.concatenate([np.eye(3, dtype=int), np.array([[a in e for a in range(3)] for e in EDGES], int)])
"""Of N1, N2, N3 in the six functions N_a, N_a N_b."""


def _integral(powers) -> float:
    """∫ N1^p N2^q N3^r dA / A."""
    return 2.0 * np.prod([factorial(p) for p in powers]) / factorial(int(np.sum(powers)) + 2)


_GRAM = np.array([[_integral(a + b) for b in _POWERS] for a in _POWERS])


class CubicMotion(NamedTuple):
    """One element's motion at the start of the step."""

    v: Float[Array, "*m 3 3"]
    axes: Float[Array, "*m 3 3 3"]
    """R_a e_i: (node, axis, component)."""
    rates: Float[Array, "*m 3 3 3"]
    """W_a e_i."""


def mass_of(element: Element, normals: Float[Array, "3 3"] | None) -> Float[Array, "12 12"]:
    """The masses of (x_a, R_a e1, R_a e2, R_a e3), node after node.

    `normals` (corner, 3) of the surface in space; None where the triangle is the surface.
    """
    xy = corners(element.coordinates)
    positions, directors = jnp.zeros((3, 4, 6)), jnp.zeros((3, 4, 6))
    for a in range(3):
        positions = positions.at[a, 0, a].set(1.0)
        directors = directors.at[a, 3, a].set(1.0)
    for number, (i, j) in enumerate(EDGES):
        edge = jnp.append(xy[j] - xy[i], 0.0)
        for a, E in ((i, edge), (j, -edge)):
            if normals is not None:
                normal = element.frame @ normals[a]
                E = E - (E @ normal) * normal
            positions = positions.at[a, 1:, 3 + number].set(0.5 * E)
    positions, directors = positions.reshape(12, 6), directors.reshape(12, 6)
    gram = jnp.asarray(_GRAM)
    mass = element.mass_per_area * (positions @ gram @ positions.T)
    mass = mass + element.rotary_inertia * (directors @ gram @ directors.T)
    if element.first_moment is not None:
        coupled = positions @ gram @ directors.T
        mass = mass + element.first_moment * (coupled + coupled.T)
    return element.area * mass


def at_start(elements: Element, R: Float[Array, "m 3 3 3"], v: Float[Array, "m 3 3"], W) -> CubicMotion:
    """The motion of all elements from rotations, velocities and Ṙ at their corners."""
    axes, rates = (jnp.einsum("maij,mbj->mabi", of, elements.frame) for of in (R, W))
    return CubicMotion(v, axes, rates)


def steady(u: Float[Array, "3 6"], start: CubicMotion, dt) -> CubicMotion:
    """A motion that begins with the step's mean rates, and so has no acceleration."""
    return CubicMotion(u[:, :3] / dt, start.axes, _change(u, start)[1] / dt)


def forces(u, start: CubicMotion, element: Element, dt, alpha=None) -> Float[Array, "18"]:
    """Rate of momentum as force, and moment Σ_i (R_a e_i)_m × (rate of the momentum of R_a e_i), on every node a.

    Mass-proportional damping `alpha`, where it is not None, adds α times the mean momenta to the rates.
    """
    middle, momentum = _step(u, start, element, dt, alpha)
    moment = cross(middle, momentum[:, 1:])
    return jnp.stack([momentum[:, 0], moment[:, 0] + moment[:, 1] + moment[:, 2]], axis=1).reshape(18)


def tangent(spin: Float[Array, "3 3 3"], u, start: CubicMotion, element: Element, dt, alpha=None):
    """Derivative of `forces` by u, (18, 18); `spin` are the derivatives of the nodal spins by the rotations in u."""
    assert element.mass is not None
    factor = 2.0 / dt**2 if alpha is None else 2.0 / dt**2 + alpha / dt
    mass = factor * element.mass.reshape(3, 4, 3, 4)
    middle, momentum = _step(u, start, element, dt, alpha)
    end = 2.0 * middle - start.axes
    eye = jnp.eye(3)
    # Σ_j M_aj,b· (R_a e_j)_m, and M_a0,b· against the axes at the end.
    weighted = jnp.stack(
        [jnp.stack([product(mass[a, 1:, b].T, middle[a]) for b in range(3)]) for a in range(3)]
    )  # (a, b, column, 3)
    pulled = jnp.stack([jnp.stack([product(mass[a, 0, b, 1:], end[b]) for b in range(3)]) for a in range(3)])
    lever = weighted[:, :, 0]
    rows = []
    for a in range(3):
        row_force, row_moment = [], []
        for b in range(3):
            row_force.append(jnp.concatenate([mass[a, 0, b, 0] * eye, -product(skew(pulled[a, b]), spin[b])], axis=1))
            turning = _skew_products(weighted[a, b, 1:], end[b])
            if a == b:
                turning = turning - 0.5 * _skew_products(momentum[a, 1:], end[a])
            row_moment.append(jnp.concatenate([skew(lever[a, b]), -product(turning, spin[b])], axis=1))
        rows += [jnp.concatenate(row_force, axis=1), jnp.concatenate(row_moment, axis=1)]
    return jnp.concatenate(rows)


def _skew_products(a: Float[Array, "k 3"], b: Float[Array, "k 3"]) -> Float[Array, "3 3"]:
    """Σ_k ~a_k ~b_k = Σ_k b_k a_kᵀ - (a_k·b_k) I."""
    outer = product(b.T, a)
    return outer - (outer[0, 0] + outer[1, 1] + outer[2, 2]) * jnp.eye(3)


def momenta(elements: Element, x: Float[Array, "m 3 3"], R, v, W) -> Momenta:
    """Kinetic energy and momenta with the masses with which the scheme keeps them."""
    assert elements.mass is not None
    motion = at_start(elements, R, v, W)
    rates = jnp.concatenate([v[:, :, None], motion.rates], axis=2)
    places = jnp.concatenate([x[:, :, None], motion.axes], axis=2)
    momentum = (elements.mass @ rates.reshape(-1, 12, 3)).reshape(rates.shape)
    linear = jnp.sum(momentum[:, :, 0], axis=(0, 1))
    return Momenta(0.5 * jnp.sum(rates * momentum), linear, jnp.sum(jnp.cross(places, momentum), axis=(0, 1, 2)))


def levers(elements: Element) -> Float[Array, "m 3 3"]:
    """∫ρ times what R_a turns in positions, for every corner a: a uniform field g has the moments (R_a lever_a) × g."""
    assert elements.mass is not None
    of_axes = jnp.sum(elements.mass.reshape(-1, 3, 4, 3, 4)[:, :, 1:, :, 0], axis=3)
    return of_axes @ elements.frame


def mass_matrix(R: Float[Array, "3 3 3"], element: Element) -> Float[Array, "18 18"]:
    """Mass of one element turned by the nodal rotations R, by velocities and angular velocities in space."""
    assert element.mass is not None
    mass, axes = element.mass.reshape(3, 4, 3, 4), R @ element.frame.T
    turns = -jax.vmap(jax.vmap(skew))(jnp.swapaxes(axes, 1, 2))  # (node, axis, 3, 3): the rates of axes by spins
    translational = mass[:, 0, :, 0][:, None, :, None] * jnp.eye(3)[None, :, None, :]
    coupled = jnp.einsum("abk,bkij->aibj", mass[:, 0, :, 1:], turns)
    rotational = jnp.einsum("ajbk,ajli,bklm->aibm", mass[:, 1:, :, 1:], turns, turns)
    rows = [
        jnp.stack([translational, coupled], axis=3),
        jnp.stack([jnp.transpose(coupled, (2, 3, 0, 1)), rotational], axis=3),
    ]
    return jnp.stack(rows, axis=1).reshape(18, 18)


def _change(u, start: CubicMotion):
    """Axes at the mid-point (3, 3, 3) and their change in the step."""
    turns = jax.vmap(mid_matrix)(u[:, 3:])
    middle = jnp.stack([product(axes, A.T) for axes, A in zip(start.axes, turns, strict=True)])
    return middle, cross(u[:, None, 3:], middle)


def _step(u, start: CubicMotion, element: Element, dt, alpha):
    """Axes at the mid-point (3, 3, 3), and the rates of momentum of the twelve vectors (3, 4, 3)."""
    assert element.mass is not None
    middle, change = _change(u, start)
    faster = rate_of_change(u[:, :3], start.v, dt, alpha)
    turned = rate_of_change(change, start.rates, dt, alpha)
    accelerations = jnp.concatenate([faster[:, None], turned], axis=1).reshape(12, 3)
    return middle, product(element.mass, accelerations).reshape(3, 4, 3)
