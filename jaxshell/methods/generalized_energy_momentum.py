"""The paper's time integration: generalised energy-momentum method, EMC and EDMC, eqs. (86)-(105).

Kinematic quantities (accelerations, velocities, rotation matrices, Λ, deformations) are averaged between the
ends of the step, and the balance is written with the averages. EMC is ρ∞ = 1, ξ = 0; EDMC is ρ∞ < 1 or ξ > 0.
Linear momentum is conserved by the equations; energy and angular momentum to O(Δt²) only, since averaged
matrices are no rotations.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.assembly.discretised import Model
from jaxshell.elements import corotational, inertia
from jaxshell.elements.corotational import Kinematics
from jaxshell.elements.element import Element
from jaxshell.elements.inertia import Spins, StepFactors
from jaxshell.methods import damping, masses, predictor, seven_point, traditional
from jaxshell.methods.balance import Begun, Forces
from jaxshell.methods.base import ImplicitMethod
from jaxshell.methods.method import Observation, may_have_first_moment
from jaxshell.methods.start import initial_accelerations, initial_motion, linear_of
from jaxshell.methods.state import PredictedState
from jaxshell.numerics.checks import Real, check_choice, check_within
from jaxshell.numerics.fusion import formed
from jaxshell.numerics.kernels import each


class GEMState(PredictedState):
    """State of the generalised energy-momentum method."""

    time: Float[Array, ""]
    x: Float[Array, "n 3"]
    R: Float[Array, "n 3 3"]
    v: Float[Array, "n 3"]
    a: Float[Array, "n 3"]
    spins: Any
    """`Spins` at the seven Gauss points of each element (m, 7, ...), or at the nodes (n, ...), or None."""
    external_work: Float[Array, ""]
    rates: predictor.Rates
    """Of the last steps, for the predictor."""
    damped: damping.DampedState | None = None
    """Of a scene with damping."""
    lumps: Spins | None = None
    """Of point masses."""


class ElementData(NamedTuple):
    """Constants of one element during a step."""

    element: Element
    start: Kinematics
    v: Float[Array, "3 3"]
    a: Float[Array, "3 3"]
    R: Float[Array, "3 3 3"]
    spins: Any
    """`PointStart` at the Gauss points (7, ...), `Spins` at the nodes (3, ...), or None."""
    damped: damping.Damped | None = None


class Shared(NamedTuple):
    """Constants of the step that all elements share."""

    factors: StepFactors
    xi: Float[Array, ""]


class GeneralizedEnergyMomentum(ImplicitMethod):
    """Generalised energy-momentum method of Yang & Xia 2014, section V.

    Arguments:
        spectral_radius: ρ∞ in [0, 1], eq. (92). 1 does not dissipate.
        dissipation: ξ ≥ 0, eq. (93), Armero & Petocz's dissipation of the local forces.
        initial_acceleration: "consistent" solves the translational balance at the start (the drilling
            inertia is zero, so rotations start without acceleration); "zero" starts from zero.
        inertia: "seven_point" (the paper's, eq. (40)), "traditional" (nodal rotations, no centrifugal term)
            or "none" (no rotary inertia).

    EMC: spectral_radius=1, dissipation=0. EDMC: spectral_radius<1 or dissipation>0. Both numbers are traced:
    another value does not compile again. Raises ValueError for values out of range.
    """

    spectral_radius: Real = 1.0
    dissipation: Real = 0.0
    initial_acceleration: str = eqx.field(static=True, default="consistent")
    inertia: str = eqx.field(static=True, default="seven_point")

    def __check_init__(self):
        check_within("spectral_radius", self.spectral_radius, 0.0, 1.0)
        check_within("dissipation", self.dissipation, 0.0, 0.5)
        check_choice("initial_acceleration", self.initial_acceleration, ("consistent", "zero"))
        check_choice("inertia", self.inertia, ("seven_point", "traditional", "none"))

    def check(self, scene, steps) -> None:
        if self.inertia != "seven_point" and may_have_first_moment(scene):
            raise ValueError(
                f'inertia="{self.inertia}" has no first moment of mass ∫ρz dz, which this section has, or may have '
                'while JAX traces it: use inertia="seven_point".'
            )

    def factors(self, dt) -> StepFactors:
        """β, γ, α_m, α_f of eq. (92)."""
        return StepFactors.of_spectral_radius(self.spectral_radius, dt)

    # --- one element ---------------------------------------------------------------------------------------

    def element_forces(self, motion, u, data: ElementData, step: Shared) -> Forces:
        factors, element = step.factors, data.element
        kin = corotational.kinematics(motion.x, motion.R, element)
        f, alpha = _stresses(kin, data, step), damping.alpha_of(data.damped)
        elastic = factors.mid(
            corotational.to_global(corotational.local_forces(kin, f), kin),
            corotational.to_global(corotational.local_forces(data.start, f), data.start),
            factors.alpha_f,
        )
        points = data.spins if self.inertia == "seven_point" else None
        inertial = seven_point.inertial_forces(u[:, :3], motion.theta, data.v, data.a, points, element, factors, alpha)
        if self.inertia == "traditional":
            moment = traditional.moments(motion, data.R, data.spins, element, factors, alpha)
            inertial = inertial + jnp.pad(moment, ((0, 0), (3, 0))).reshape(18)
        return Forces(formed(elastic), inertial)

    def element_tangent(self, motion, u, data: ElementData, step: Shared):
        factors, element = step.factors, data.element
        kin = corotational.kinematics(motion.x, motion.R, element)
        f, alpha = _stresses(kin, data, step), damping.alpha_of(data.damped)
        material = 1.0 - factors.alpha_f + step.xi
        if data.damped is not None:
            material = material + damping.viscous_material(data.damped, factors, factors.alpha_f)
        # Λ_n, formed here: a step that keeps a factorization has no use for it.
        gradient = formed(corotational.deformation_gradient(data.start))
        at_start = formed(corotational.gradient_to_global(gradient, data.start))
        K = corotational.stiffness(  # eq. (97)
            kin,
            f,
            element,
            motion.spin,
            material=material,
            geometric=1.0 - factors.alpha_f,
            average=lambda Lambda: factors.mid(Lambda, at_start, factors.alpha_f),
        )
        points = data.spins if self.inertia == "seven_point" else None
        acceleration = factors.mid_acceleration(u[:, :3], data.v, data.a, alpha)
        K = K + seven_point.inertial_tangent(motion.theta, points, element, factors, acceleration, alpha)  # eq. (95)
        if self.inertia == "traditional":
            blocks = traditional.stiffness(motion, data.R, data.spins, element, factors, alpha)
            K = K + jnp.pad(blocks, [(0, 0), (3, 0)] * 2).reshape(18, 18)
        return K

    def lump_force(self, u, lump: masses.Start, step: Shared):
        return masses.force(u, lump, step.factors)

    # --- the shell -----------------------------------------------------------------------------------------

    def weight_at_end(self, step: Shared):
        return 1.0 - step.factors.alpha_f

    def start(self, model: Model, scene, time, solvers=None) -> GEMState:
        x, R, v, omega = initial_motion(model, scene)
        if self.initial_acceleration == "consistent":
            a, alpha = initial_accelerations(model, linear_of(solvers), x, R, time, v, omega)
        else:
            a = alpha = jnp.zeros_like(v)
        spins = self._initial_spins(model, R, omega)
        rates = predictor.initial_rates(v, omega)
        return GEMState(
            time=jnp.asarray(time, float),
            x=x,
            R=R,
            v=v,
            a=a,
            spins=spins,
            external_work=jnp.zeros(()),
            rates=rates,
            damped=damping.initial_state(model, x, R, v, omega, a),
            lumps=masses.initial_spins(model.lumps, R, omega, alpha),
        )

    def _initial_spins(self, model: Model, R, omega) -> Spins | None:
        if self.inertia == "none":
            return None
        if self.inertia == "traditional":
            return traditional.initial_spins(R, omega)
        return seven_point.initial_spins(model, R, omega)

    def begin(self, model: Model, state: GEMState, dt):
        factors = self.factors(dt)
        end, start = state.time + dt, state.time
        loads = factors.mid(model.dead_load(end), model.dead_load(start), factors.alpha_f)
        if model.contributions:
            loads = loads + factors.alpha_f * model.following_load(state.x, state.R, start)
        damped = damping.begin(model, state.damped, state.x, state.R)
        x, R, v, a = model.gather((state.x, state.R, state.v, state.a))
        spins = None
        if self.inertia == "seven_point":
            spins = seven_point.points_at_start(model, state.spins)
        elif self.inertia == "traditional":
            spins = model.gather(state.spins)
        # One stress-free state for the step, weighted as the deformations are in eq. (93).
        elements = model.elements_at((1.0 - factors.alpha_f, end), (factors.alpha_f, start))
        kin = each(corotational.kinematics)(x, R, elements)
        data = ElementData(elements, kin, v, a, R, spins, damped)
        lumps = masses.start(model.lumps, state.v, state.a, state.lumps)
        return Begun(data, Shared(factors, jnp.asarray(self.dissipation)), loads, end, lumps)

    def finish(self, model: Model, state: GEMState, dt, u, motion, begun) -> GEMState:
        factors = begun.step.factors
        spins = state.spins
        if self.inertia == "seven_point":
            spins = seven_point.turned_spins(model, motion.theta, spins, factors)
        elif self.inertia == "traditional":
            spins = each(inertia.end_of_step, in_axes=(0, 0, None))(motion.theta, spins, factors)
        work = self.work_of_loads(model, state, begun, motion, u)
        taken = self.taken(model, state, begun, motion, u)
        if model.resisting:
            work = work + taken.work
        work = work + model.work_of_rests((state.x, state.R, state.time), (motion.x, motion.R, begun.end))
        turning = self._turning(model, u, state.spins)
        return GEMState(
            time=begun.end,
            x=motion.x,
            R=motion.R,
            v=factors.first(u[:, :3], state.v, state.a),
            a=factors.second(u[:, :3], state.v, state.a),
            spins=spins,
            external_work=state.external_work + work,
            rates=predictor.remember(state.rates, model.without_multipliers(u), dt),
            damped=damping.finish(state.damped, model, begun.data.damped, motion, u, turning, factors, taken.lost),
            lumps=masses.turned(model.lumps, u, state.lumps, factors),
        )

    def _turning(self, model: Model, u, spins) -> Any:
        """Σ θ·I_ρ θ in each element (m,), where damping asks for it."""
        if model.damping is None or model.damping.alpha is None:
            return None
        if self.inertia == "none":
            return jnp.zeros_like(model.elements.area)
        if self.inertia == "traditional":
            return traditional.turning(model, u[:, 3:], spins)
        return damping.turning_of_points(model, u, spins)

    def observe(self, model: Model, state: GEMState) -> Observation:
        """Energies and momenta, eqs. (27), (28), (34), (61)."""
        kinetic, linear, angular = seven_point.kinetic_and_momenta(
            model, state.x, state.v, state.spins if self.inertia == "seven_point" else None
        )
        if self.inertia == "traditional":
            turning, spin_momentum = traditional.energy_and_momentum(model, state.spins)
            kinetic, angular = kinetic + turning, angular + spin_momentum
        if model.lumps is not None and state.lumps is not None:
            more = masses.momentum(model.lumps, state.x, state.v, state.lumps)
            kinetic, linear, angular = kinetic + more.kinetic, linear + more.linear, angular + more.angular
        strain = model.strain_energy(state.x, state.R, state.time)
        dissipated = damping.dissipated(state.damped)
        return Observation(kinetic, strain, state.external_work, dissipated, linear, angular)


def _stresses(kin: Kinematics, data: ElementData, step: Shared) -> Float[Array, " d"]:
    """Of deformations weighted as in eq. (93), and of a viscous material."""
    alpha, xi = step.factors.alpha_f, step.xi
    weighted = (1.0 - alpha + xi) * kin.deformations + (alpha - xi) * data.start.deformations
    f = corotational.stresses(weighted, data.element)
    if data.damped is None:
        return f
    return f + damping.viscous_stresses(kin, data.damped, data.element, step.factors, alpha)
