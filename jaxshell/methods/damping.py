"""Rayleigh damping in the methods of Newmark's kind: viscous stresses K̂ β ė, forces α M v, and the energy they remove.

The rates ė of the corotated deformations follow Newmark's formulas, eqs. (13), (14), with the method's own numbers, as
velocities do: where deformations are linear in the displacements ė is the deformation of the velocities, to round-off,
and the scheme the textbook's with C = αM + βK; where they are not, it is of second order in Δt like the rest. Viscous
stresses stand in the balance where the elastic ones do, at n+1-αf, and α M v with the velocities of n+1-αf.

The energy removed in a step is (α u·M u + β Δe·K̂ Δe)/Δt, from mean velocities. It is never negative, of second order,
and in a linear shell exactly what the trapezoidal rule and the paper's method with ρ∞ = 1 lose.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.assembly.discretised import Model
from jaxshell.elements import corotational, inertia
from jaxshell.elements.corotational import Kinematics
from jaxshell.elements.element import Element
from jaxshell.elements.inertia import GAUSS_POINTS, GAUSS_WEIGHTS, LINEAR_MASS, Spins, StepFactors
from jaxshell.numerics.kernels import each
from jaxshell.numerics.products import dot


class Rates(eqx.Module):
    """First and second rates of the deformations of each element."""

    first: Float[Array, "*m d"]
    second: Float[Array, "*m d"]


class DampedState(eqx.Module):
    """What damping adds to a method's state."""

    dissipated: Float[Array, ""]
    """Energy that it has removed since the start [force·length]."""
    rates: Rates | None
    """None where no material is viscous."""


class Damped(NamedTuple):
    """What damping adds to the constants of a step; per element, each leaf with a leading axis m."""

    alpha: Any
    beta: Any
    deformations: Any
    """At the start of the step (12,); None where no material is viscous."""
    rates: Any
    """`Rates` there, or None."""


# --- one element ------------------------------------------------------------------------------------------


def viscous_stresses(kin: Kinematics, damped: Damped | None, element: Element, factors: StepFactors, alpha_f) -> Any:
    """K̂ β ė (12,) at n+1-`alpha_f`, to be added to the elastic stresses; 0.0 without a viscous material."""
    if damped is None or damped.beta is None:
        return 0.0
    start = damped.rates
    change = corotational.total_deformations(kin, element) - damped.deformations
    end = factors.first(change, start.first, start.second)
    return corotational.stresses(damped.beta * factors.mid(end, start.first, alpha_f), element)


def viscous_material(damped: Damped | None, factors: StepFactors, alpha_f) -> Any:
    """The derivative of β ė at n+1-`alpha_f` by the deformations at the end: what it adds to the factor of K̂."""
    if damped is None or damped.beta is None:
        return 0.0
    return (1.0 - alpha_f) * damped.beta * factors.gamma / (factors.beta * factors.dt)


def alpha_of(damped: Damped | None) -> Any:
    """α of an element, or None."""
    return None if damped is None else damped.alpha


# --- the shell --------------------------------------------------------------------------------------------


def initial_state(model: Model, x, R, v, omega, a) -> DampedState | None:
    """At the start, with accelerations `a` (n, 3); rotations start without. None where nothing takes energy."""
    if not model.dissipates:
        return None
    if model.damping is None or model.damping.beta is None:
        return DampedState(jnp.zeros(()), None)
    rates = Rates(stretching(model, x, R, v, omega), stretching(model, x, R, a, jnp.zeros_like(a)))
    return DampedState(jnp.zeros(()), rates)


def begin(model: Model, state: DampedState | None, x, R) -> Damped | None:
    """The step's constants."""
    if model.damping is None or state is None:
        return None
    alpha, beta = model.damping
    return Damped(alpha, beta, None if beta is None else deformations(model, x, R), state.rates)


def finish(
    state: DampedState | None, model: Model, damped: Damped | None, motion, u, turning, factors: StepFactors, taken
):
    """The state at the end of the step.

    `turning` (m,) is Σ θ·I_ρ θ of the step's rotations in each element, `taken` the energy that contributions took.
    """
    if state is None:
        return None
    if damped is None:
        return DampedState(state.dissipated + taken, None)
    change = rates = None
    if damped.beta is not None:
        change = deformations(model, motion.x, motion.R) - damped.deformations
        start = damped.rates
        first, second = (f(change, start.first, start.second) for f in (factors.first, factors.second))
        rates = Rates(first, second)
    total = state.dissipated + removed(model, u, change, turning, factors.dt)
    return DampedState(total + taken if model.resisting else total, rates)


def removed(model: Model, u: Float[Array, "n 6"], change, turning, dt) -> Float[Array, ""]:
    """Energy removed in a step by mean velocities; `change` (m, 12) of the deformations, `turning` as in `finish`."""
    assert model.damping is not None
    (alpha, beta), elements, total = model.damping, model.elements, jnp.zeros(())
    if alpha is not None:
        moved = model.gather(u[:, :3])
        mass = (elements.mass_per_area * elements.area)[:, None, None]
        squares = jnp.sum(moved * (mass * (jnp.asarray(LINEAR_MASS) @ moved)), axis=(1, 2))
        total = total + jnp.sum(alpha * (squares + turning))
    if beta is not None:
        squares = jax.vmap(lambda e, element: dot(e, corotational.stresses(e, element)))(change, elements)
        total = total + jnp.sum(beta * squares)
    return total / dt


def turning_of_points(model: Model, u: Float[Array, "n 6"], spins: Spins) -> Any:
    """Σ θ·I_ρ θ in each element (m,) with the seven-point inertia; a rotation keeps θ·t, so any t of the step does.

    Where ∫ρz dz couples the two, with 2 ∫ρz dz Δx·(θ × t).
    """
    if model.damping is None or model.damping.alpha is None:
        return None
    elements, points = model.elements, jnp.asarray(GAUSS_POINTS)
    moved, turned = (points @ model.gather(part) for part in (u[:, :3], u[:, 3:]))
    axes = dot(spins.R, elements.frame[:, None, None, 2])
    squares = jnp.sum(turned * inertia.apply_inertia(axes, 1.0, turned), axis=2)
    total = elements.area * elements.rotary_inertia * (squares @ jnp.asarray(GAUSS_WEIGHTS))
    if elements.first_moment is not None:
        products = jnp.sum(moved * jnp.cross(turned, axes), axis=2) @ jnp.asarray(GAUSS_WEIGHTS)
        total = total + 2.0 * elements.area * elements.first_moment * products
    return total


def deformations(model: Model, x: Float[Array, "n 3"], R: Float[Array, "n 3 3"]) -> Float[Array, "m d"]:
    """e of all elements."""
    x, R = model.gather((x, R))
    return each(lambda x, R, element: corotational.kinematics(x, R, element).deformations)(x, R, model.elements)


def stretching(model: Model, x, R, v: Float[Array, "n 3"], omega: Float[Array, "n 3"]) -> Float[Array, "m d"]:
    """ė = Λ (v, ω) of all elements, by velocities and angular velocities in space."""

    def one(x, R, v, omega, element):
        kin = corotational.kinematics(x, R, element)
        rows = corotational.gradient_to_global(corotational.deformation_gradient(kin), kin)
        return rows @ jnp.concatenate([v, omega], axis=1).reshape(18)

    x, R, v, omega = model.gather((x, R, v, omega))
    return each(one)(x, R, v, omega, model.elements)


def viscous_force(model: Model, x, R, rates: Float[Array, "m d"]) -> Float[Array, "n 6"]:
    """Nodal forces Λᵀ K̂ β ė of the whole shell."""
    assert model.damping is not None and model.damping.beta is not None

    def one(x, R, rate, beta, element):
        kin = corotational.kinematics(x, R, element)
        f = corotational.stresses(beta * rate, element)
        return corotational.to_global(corotational.local_forces(kin, f), kin)

    x, R = model.gather((x, R))
    return model.assemble_vector(each(one)(x, R, rates, model.damping.beta, model.elements))


def initial_force(model: Model, x, R, v, omega) -> Float[Array, "n 6"]:
    """Viscous forces and α M v of the translations at the start of a run."""
    assert model.damping is not None
    (alpha, beta), total = model.damping, jnp.zeros((x.shape[0], 6))
    if alpha is not None:
        mass = (alpha * model.elements.mass_per_area * model.elements.area)[:, None, None]
        corner = mass * (jnp.asarray(LINEAR_MASS) @ model.gather(v))
        total = total.at[:, :3].add(model.tables.nodal(corner.reshape(-1, 3)))
    if beta is not None:
        total = total + viscous_force(model, x, R, stretching(model, x, R, v, omega))
    return total


def dissipated(state: DampedState | None) -> Float[Array, ""]:
    """What the record of a state says."""
    return jnp.zeros(()) if state is None else state.dissipated
