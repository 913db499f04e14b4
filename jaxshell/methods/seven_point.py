"""Seven-point inertia of the shell for methods that keep spins at the Gauss points: forces, tangents, energies.

Eqs. (27), (28), (34), (40), (51) with the points of `jaxshell.elements.inertia`. Translations are linear in area
coordinates, and their mass is exact; rotations, angular velocities and accelerations live at the points.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.assembly.discretised import Model
from jaxshell.elements import corotational, inertia
from jaxshell.elements.element import Element
from jaxshell.elements.inertia import (
    GAUSS_POINTS,
    GAUSS_WEIGHTS,
    LINEAR_MASS,
    PointStart,
    Spins,
    StepFactors,
)
from jaxshell.numerics.fusion import formed
from jaxshell.numerics.kernels import each
from jaxshell.numerics.products import cross, dot, product, scaled
from jaxshell.numerics.rotations import exp, log, skew

# --- one element ------------------------------------------------------------------------------------------


def inertial_forces(
    increment, theta, v, a, points: PointStart | None, element: Element, factors: StepFactors, alpha=None
):
    """f_iner of eqs. (40), (88), (18,): `increment`, `theta`, `v`, `a` are (3, 3), node by component.

    `points` None leaves the rotary inertia out. Mass-proportional damping `alpha`, where it is not None, adds α M v
    with the velocities of n+1-αf.
    """
    acceleration = formed(factors.mid_acceleration(increment, v, a, alpha))
    mass = element.mass_per_area * element.area
    force = scaled(mass, product(jnp.asarray(LINEAR_MASS), acceleration))
    if points is None:
        return jnp.stack([force, jnp.zeros((3, 3))], axis=1).reshape(18)
    moments = jax.vmap(lambda theta, point: inertia.point_inertia(theta, point, factors, alpha=alpha))(
        product(jnp.asarray(GAUSS_POINTS), theta), points
    )
    moments = formed(moments)
    moment = scaled(element.area * element.rotary_inertia, product(jnp.asarray(_POINTS_TO_NODES), moments))
    if element.first_moment is not None:
        # ∫ρz dz couples the two: the force is that of ẗ, the moment t × a.
        directors, changes = jax.vmap(inertia.point_director, in_axes=(0, 0, None, None))(
            product(jnp.asarray(GAUSS_POINTS), theta), points, factors, alpha
        )
        uneven = scaled(element.area * element.first_moment, jnp.asarray(_POINTS_TO_NODES))
        force = force + product(uneven, changes)
        moment = moment + product(uneven, cross(directors, product(jnp.asarray(GAUSS_POINTS), acceleration)))
    # Formed before and after: no entry of the stack makes them anew, and no sum over elements makes the stack anew.
    return formed(jnp.stack(formed([force, moment]), axis=1).reshape(18))


def inertial_tangent(
    theta, points: PointStart | None, element: Element, factors: StepFactors, acceleration=None, alpha=None
):
    """Derivative of `inertial_forces` by displacements and rotation vectors of the step, eqs. (51), (95); (18, 18).

    `acceleration` (3, 3), of `StepFactors.mid_acceleration`, is needed where ∫ρz dz does not vanish.
    """
    second = factors.mid_acceleration_slope(alpha)
    K = second * element.mass_per_area * element.area * jnp.asarray(_TRANSLATIONAL_MASS)
    if points is None:
        return K
    stiffness = jax.vmap(lambda theta, point: inertia.point_tangent(theta, point, factors, alpha=alpha))(
        product(jnp.asarray(GAUSS_POINTS), theta), points
    )
    stiffness = formed(element.area * element.rotary_inertia * stiffness)
    K = K + corotational.on_rotations(_PAIR_WEIGHTS, stiffness)
    if element.first_moment is not None:
        K = K + element.area * element.first_moment * _uneven_tangent(theta, points, acceleration, factors, alpha)
    return K


def _uneven_tangent(theta, points: PointStart, acceleration, factors: StepFactors, alpha) -> Float[Array, "18 18"]:
    """Derivative of the forces of ∫ρz dz, over it and the area; `acceleration` (3, 3) of the nodes at the mid-point."""
    at_points, shape = product(jnp.asarray(GAUSS_POINTS), theta), jnp.asarray(GAUSS_POINTS)
    (directors, _), (turned, changed) = jax.vmap(
        lambda theta, point: (
            inertia.point_director(theta, point, factors, alpha),
            jax.jacfwd(inertia.point_director)(theta, point, factors, alpha),
        )
    )(at_points, points)
    moved = -jax.vmap(product)(jax.vmap(skew)(product(shape, acceleration)), turned)
    weights = jnp.asarray(_PAIR_WEIGHTS)

    def pairs(blocks):  # between the nodes
        return jnp.einsum("abp,pij->aibj", weights, blocks)

    by_displacement = factors.mid_acceleration_slope(alpha) * pairs(jax.vmap(skew)(directors))
    rows = [
        jnp.stack([jnp.zeros((3, 3, 3, 3)), pairs(changed)], axis=3),
        jnp.stack([by_displacement, pairs(moved)], axis=3),
    ]
    return jnp.stack(rows, axis=1).reshape(18, 18)


_POINTS_TO_NODES = (GAUSS_WEIGHTS[:, None] * GAUSS_POINTS).T
_PAIR_WEIGHTS = np.einsum("p,pa,pb->abp", GAUSS_WEIGHTS, GAUSS_POINTS, GAUSS_POINTS)
_TRANSLATIONAL_MASS = np.kron(LINEAR_MASS, np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]))


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

    return each(points)(model.gather(R), model.gather(omega))


def points_at_start(model: Model, spins: Spins) -> PointStart:
    """What the elements need of the spins (m, 7, ...) during a step."""
    return each(PointStart.of)(spins, model.elements.frame[:, 2])


def turned_spins(model: Model, theta: Float[Array, "n 3"], spins: Spins, factors: StepFactors) -> Spins:
    """Spins at the end of the step from the nodal rotation vectors, eqs. (103), (13), (14)."""

    def points(theta, spins):
        at_points = formed(product(jnp.asarray(GAUSS_POINTS), theta))
        return jax.vmap(inertia.end_of_step, (0, 0, None))(at_points, spins, factors)

    return each(points)(model.gather(theta), spins)


def kinetic_and_momenta(model: Model, x: Float[Array, "n 3"], v: Float[Array, "n 3"], spins: Spins | None):
    """Kinetic energy, linear and angular momentum about the origin, eqs. (34), (27), (28); spins None: without.

    The print of eq. (28) drops the R that turns the material I_ρ Ω into space.
    """
    elements = model.elements
    mass = elements.mass_per_area * elements.area
    corners, rates = model.gather((x, v))
    momentum = mass[:, None, None] * (jnp.asarray(LINEAR_MASS) @ rates)
    kinetic, angular = 0.5 * jnp.sum(rates * momentum), jnp.sum(jnp.cross(corners, momentum), axis=(0, 1))
    if spins is not None:
        turning = jnp.asarray(GAUSS_WEIGHTS)[None, :, None] * inertia.apply_inertia(
            elements.frame[:, None, 2], 1.0, spins.Omega
        )
        turning = (elements.area * elements.rotary_inertia)[:, None, None] * turning
        kinetic = kinetic + 0.5 * jnp.sum(spins.Omega * turning)
        angular = angular + jnp.sum(dot(spins.R, turning[..., None, :]), axis=(0, 1))
        if elements.first_moment is not None:
            return _with_first_moment(elements, corners, rates, spins, kinetic, jnp.sum(momentum, axis=(0, 1)), angular)
    return kinetic, jnp.sum(momentum, axis=(0, 1)), angular


def _with_first_moment(elements: Element, x, v, spins: Spins, kinetic, linear, angular):
    """Kinetic energy and momenta with what ∫ρz dz adds: v·ṫ, ṫ, and x × ṫ + t × v."""
    assert elements.first_moment is not None
    points = jnp.asarray(GAUSS_POINTS)
    weight = (elements.area * elements.first_moment)[:, None, None] * jnp.asarray(GAUSS_WEIGHTS)[None, :, None]
    axis = elements.frame[:, None, 2]
    directors = dot(spins.R, axis[:, :, None])
    rates = weight * dot(spins.R, jnp.cross(spins.Omega, axis)[:, :, None])
    x, v = points @ x, points @ v
    return (
        kinetic + jnp.sum(v * rates),
        linear + jnp.sum(rates, axis=(0, 1)),
        angular + jnp.sum(jnp.cross(x, rates) + weight * jnp.cross(directors, v), axis=(0, 1)),
    )
