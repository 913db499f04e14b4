"""Newmark, HHT and generalised-α methods at force level: what most codes for structural dynamics offer.

One scheme, the generalised-α method, of which the others are choices of its four numbers. The balance weights
the FORCES of the two ends of the step,

    f_iner + (1-αf) (f_int - f_ext)_{n+1} + αf (f_int - f_ext)_n = 0,

with f_iner of the accelerations (1-αm) (·)_{n+1} + αm (·)_n, and Newmark's formulas for velocities and
accelerations, eqs. (13), (14), (104), (105). The paper's method weights the kinematics instead and evaluates one
force of the averages; that is the only difference in this file's equations.

Inertia: the paper's seven-point form, eq. (40), as the generalised mid-point has it; at αm = αf = 0 the balance
stands at the end of the step. (Many codes lump rotary inertia at the nodes and leave out the gyroscopic term.)
Rotations and angular velocities enter with the weight αf and angular accelerations with αm: Newmark's
accelerations lag by (αm - αf)Δt, and any other weighting of the product R Ω̇ loses the second order.
Finite rotations: R_{n+1} = exp(~θ) R_n, with θ the unknown of the step and Θ = R_nᵀθ in Newmark's formulas.
"""

import abc
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.assembly.discretised import Model
from jaxshell.elements import corotational
from jaxshell.elements.element import Element
from jaxshell.elements.inertia import PointStart, Spins, StepFactors
from jaxshell.methods import damping, masses, predictor, seven_point
from jaxshell.methods.balance import Begun, Forces
from jaxshell.methods.base import ImplicitMethod
from jaxshell.methods.method import Observation
from jaxshell.methods.start import initial_accelerations, initial_motion, linear_of, translational_inertia
from jaxshell.methods.state import PredictedState
from jaxshell.numerics.checks import Real, check_number, check_within, is_concrete


class NewmarkState(PredictedState):
    """State at the end of a step."""

    time: Float[Array, ""]
    x: Float[Array, "n 3"]
    R: Float[Array, "n 3 3"]
    v: Float[Array, "n 3"]
    a: Float[Array, "n 3"]
    spins: Spins
    """At the seven Gauss points of each element, (m, 7, ...)."""
    external_work: Float[Array, ""]
    reaction: Float[Array, " nh"]
    """Of the last balance at the held degrees of freedom; (0,) where no support moves."""
    rates: predictor.Rates
    """Of the last steps, for the predictor."""
    damped: damping.DampedState | None = None
    """Of a scene with damping."""
    lumps: Spins | None = None
    """Of point masses."""


class ElementData(NamedTuple):
    """Constants of one element during a step."""

    element: Element
    v: Float[Array, "3 3"]
    a: Float[Array, "3 3"]
    points: PointStart
    damped: damping.Damped | None = None


class ForceLevelMethod(ImplicitMethod):
    """The generalised-α scheme; a subclass states β, γ, α_m, α_f."""

    balance_at_end: ClassVar[bool] = False
    """α_f = 0: the forces at the start of the step do not enter."""

    @abc.abstractmethod
    def factors(self, dt) -> StepFactors:
        """β, γ, α_m, α_f, and Δt."""

    # --- one element ---------------------------------------------------------------------------------------

    def element_forces(self, motion, u, data: ElementData, step: StepFactors) -> Forces:
        alpha = damping.alpha_of(data.damped)
        kin = corotational.kinematics(motion.x, motion.R, data.element)
        elastic = corotational.to_global(corotational.local_forces(kin, _stresses(kin, data, step)), kin)
        inertial = seven_point.inertial_forces(
            u[:, :3], motion.theta, data.v, data.a, data.points, data.element, step, alpha
        )
        return Forces((1.0 - step.alpha_f) * elastic, inertial)

    def element_tangent(self, motion, u, data: ElementData, step: StepFactors):
        kin = corotational.kinematics(motion.x, motion.R, data.element)
        f = _stresses(kin, data, step)
        weight = material = 1.0 - step.alpha_f
        if data.damped is not None:
            material = weight * (1.0 + damping.viscous_material(data.damped, step, 0.0))
        K = corotational.stiffness(kin, f, data.element, motion.spin, material=material, geometric=weight)
        alpha = damping.alpha_of(data.damped)
        acceleration = step.mid_acceleration(u[:, :3], data.v, data.a, alpha)
        return K + seven_point.inertial_tangent(motion.theta, data.points, data.element, step, acceleration, alpha)

    def lump_force(self, u, lump: masses.Start, step: StepFactors):
        return masses.force(u, lump, step)

    # --- the shell -----------------------------------------------------------------------------------------

    def weight_at_end(self, step: StepFactors):
        return 1.0 - step.alpha_f

    def start(self, model: Model, scene, time, solvers=None) -> NewmarkState:
        x, R, v, omega = initial_motion(model, scene)
        reaction = jnp.zeros(0)
        a, alpha = initial_accelerations(model, linear_of(solvers), x, R, time, v, omega)
        if model.moving:
            force = model.internal_force(x, R, time) - model.external_load(x, R, jnp.asarray(time))
            if model.damping is not None:
                force = force + damping.initial_force(model, x, R, v, omega)
            if model.resisting:
                here = x, R, jnp.asarray(time)
                force = force - model.resistance(here, here, jnp.concatenate([v, omega], axis=1))
            # Of the inertia what does work there: gyroscopic moments are normal to the spin.
            force = force.at[:, :3].add(translational_inertia(model, a))
            reaction = model.collected(force, R).reshape(-1)[model.tables.held]
        return NewmarkState(
            time=jnp.asarray(time, float),
            x=x,
            R=R,
            v=v,
            a=a,
            spins=seven_point.initial_spins(model, R, omega),
            external_work=jnp.zeros(()),
            reaction=reaction,
            rates=predictor.initial_rates(v, omega),
            damped=damping.initial_state(model, x, R, v, omega, a),
            lumps=masses.initial_spins(model.lumps, R, omega, alpha),
        )

    def begin(self, model: Model, state: NewmarkState, dt):
        factors = self.factors(dt)
        end = state.time + dt
        loads = (1.0 - factors.alpha_f) * model.dead_load(end)
        if not self.balance_at_end:
            before = state.x, state.R, state.time
            earlier = model.external_load(*before) - model.internal_force(*before)
            if state.damped is not None and state.damped.rates is not None:
                earlier = earlier - damping.viscous_force(model, state.x, state.R, state.damped.rates.first)
            loads = loads + factors.alpha_f * earlier
        v, a = model.gather((state.v, state.a))
        points = seven_point.points_at_start(model, state.spins)
        damped = damping.begin(model, state.damped, state.x, state.R)
        lumps = masses.start(model.lumps, state.v, state.a, state.lumps)
        return Begun(ElementData(model.elements_at((1.0, end)), v, a, points, damped), factors, loads, end, lumps)

    def finish(self, model: Model, state: NewmarkState, dt, u, motion, begun) -> NewmarkState:
        factors = begun.step
        # Work by the trapezoidal rule, which at β = 1/4, γ = 1/2 is the work that a linear shell receives.
        ends = model.external_load(state.x, state.R, state.time)
        ends = ends + model.external_load(motion.x, motion.R, begun.end)
        work, reaction = 0.5 * jnp.sum(ends * u), state.reaction
        ends = (state.x, state.R, state.time), (motion.x, motion.R, begun.end)
        work = work + model.work_of_rests(*ends) + model.work_of_drives(*ends, u)
        if model.moving:
            # The balance gives the reaction at t_{n+1-αf}; brought to the middle of the step, linearly.
            reaction = self.balance(model, state, begun, u).residual.reshape(-1)[model.tables.held]
            middle = (0.5 + factors.alpha_f) * reaction + (0.5 - factors.alpha_f) * state.reaction
            work = work + jnp.sum(middle * model.along_held(u))
        turning = damping.turning_of_points(model, u, state.spins)
        taken = self.taken(model, state, begun, motion, u)
        if model.resisting:
            work = work + taken.work
        return NewmarkState(
            time=begun.end,
            x=motion.x,
            R=motion.R,
            v=factors.first(u[:, :3], state.v, state.a),
            a=factors.second(u[:, :3], state.v, state.a),
            spins=seven_point.turned_spins(model, motion.theta, state.spins, factors),
            external_work=state.external_work + work,
            reaction=reaction,
            rates=predictor.remember(state.rates, model.without_multipliers(u), dt),
            damped=damping.finish(state.damped, model, begun.data.damped, motion, u, turning, factors, taken.lost),
            lumps=masses.turned(model.lumps, u, state.lumps, factors),
        )

    def observe(self, model: Model, state: NewmarkState) -> Observation:
        """Energies and momenta of the end of the step, eqs. (27), (28), (34), (61)."""
        kinetic, linear, angular = seven_point.kinetic_and_momenta(model, state.x, state.v, state.spins)
        if model.lumps is not None and state.lumps is not None:
            more = masses.momentum(model.lumps, state.x, state.v, state.lumps)
            kinetic, linear, angular = kinetic + more.kinetic, linear + more.linear, angular + more.angular
        strain = model.strain_energy(state.x, state.R, state.time)
        dissipated = damping.dissipated(state.damped)
        return Observation(kinetic, strain, state.external_work, dissipated, linear, angular)


def _stresses(kin: corotational.Kinematics, data: ElementData, step: StepFactors) -> Float[Array, " d"]:
    """At the end of the step, with those of a viscous material."""
    f = corotational.stresses(kin.deformations, data.element)
    if data.damped is None:
        return f
    return f + damping.viscous_stresses(kin, data.damped, data.element, step, 0.0)


def step_factors(beta, gamma, alpha_m, alpha_f, dt) -> StepFactors:
    """The scheme's numbers as arrays."""
    return StepFactors(*(jnp.asarray(number, float) for number in (beta, gamma, alpha_m, alpha_f, dt)))


class Newmark(ForceLevelMethod):
    """Newmark's method (1959), balance at the end of the step.

    Arguments:
        beta, gamma: Newmark's parameters, both traced. β = 1/4, γ = 1/2 is the average-acceleration method
            (trapezoidal rule): second order, no dissipation, unconditionally stable in LINEAR problems only.

    Raises ValueError unless 2β >= γ >= 1/2, without which a linear run with a large step blows up.
    """

    balance_at_end: ClassVar[bool] = True

    beta: Real = 0.25
    gamma: Real = 0.5

    def __check_init__(self):
        check_number("beta", self.beta)
        check_number("gamma", self.gamma)
        if is_concrete(self.gamma) and self.gamma < 0.5:
            raise ValueError(f"gamma must be at least 0.5, or oscillations grow, but it is {self.gamma}.")
        if is_concrete(self.beta) and is_concrete(self.gamma) and self.beta < 0.5 * self.gamma:
            raise ValueError(f"beta must be at least gamma/2 = {0.5 * self.gamma:g}, but it is {self.beta}.")

    def factors(self, dt) -> StepFactors:
        return step_factors(self.beta, self.gamma, 0.0, 0.0, dt)


class HHT(ForceLevelMethod):
    """Hilber, Hughes & Taylor's α method (1977): α_f = -α, α_m = 0, β = (1 - α)²/4, γ = 1/2 - α.

    Arguments:
        alpha: α in [-1/3, 0], traced. 0 is Newmark's trapezoidal rule; -1/3 dissipates high frequencies most.

    Raises ValueError for α out of range.
    """

    alpha: Real = -0.05

    def __check_init__(self):
        check_number("alpha", self.alpha)
        if is_concrete(self.alpha) and not -1.0 / 3.0 <= self.alpha <= 0.0:
            raise ValueError(f"alpha must lie in [-1/3, 0], but it is {self.alpha}.")

    def factors(self, dt) -> StepFactors:
        return step_factors(0.25 * (1.0 - self.alpha) ** 2, 0.5 - self.alpha, 0.0, -self.alpha, dt)


class GeneralizedAlpha(ForceLevelMethod):
    """Chung & Hulbert's generalised-α method (1993), with the parameters of eq. (92).

    Arguments:
        spectral_radius: ρ∞ in [0, 1], traced: the factor by which the highest frequencies shrink in a step.

    Raises ValueError for ρ∞ out of range.
    """

    spectral_radius: Real = 0.8

    def __check_init__(self):
        check_within("spectral_radius", self.spectral_radius, 0.0, 1.0)

    def factors(self, dt) -> StepFactors:
        return step_factors(*StepFactors.of_spectral_radius(self.spectral_radius, dt))
