"""Exactly conserving time integration: `EnergyMomentum`. docs/energy_momentum.md derives it.

Mid-point kinematics with Cayley vectors and director inertia (Simo & Tarnow 1994) and elastic forces from a
discrete gradient of the strain energy (Gonzalez 1996; `jaxshell.elements.energy_momentum`). The equations of
the step conserve linear and angular momentum and the energy to round-off, whatever its size; the state holds
no accelerations and no history at Gauss points, so the step size may change freely.
"""

from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.assembly.discretised import Model
from jaxshell.elements import corotational, cubic_inertia, director_inertia, energy_momentum
from jaxshell.elements.element import Element
from jaxshell.elements.energy_momentum import StepStart, edges_of, mid_matrix, spin_matrix
from jaxshell.methods import masses, predictor
from jaxshell.methods.balance import Begun, Forces, Motion
from jaxshell.methods.base import ImplicitMethod
from jaxshell.methods.method import Observation
from jaxshell.methods.start import initial_motion
from jaxshell.methods.state import PredictedState
from jaxshell.model.damping import Damping
from jaxshell.numerics.checks import Real, check_choice, check_within
from jaxshell.numerics.kernels import each
from jaxshell.numerics.products import dot
from jaxshell.numerics.rotations import cayley, skew

_INERTIA = {"linear": director_inertia, "cubic": cubic_inertia}
"""The forms of inertia: each states its motion at the start of a step, forces, their tangent, and momenta."""


class EnergyMomentumState(PredictedState):
    """State of the exactly conserving method."""

    time: Float[Array, ""]
    x: Float[Array, "n 3"]
    R: Float[Array, "n 3 3"]
    v: Float[Array, "n 3"]
    W: Float[Array, "n 3 3"]
    """Ṙ, whose product with an element's normal is the rate of its director."""
    external_work: Float[Array, ""]
    dissipated: Float[Array, ""]
    rates: predictor.Rates
    """Of the last steps, for the predictor."""


class ElementData(NamedTuple):
    """Constants of one element during a step."""

    element: Element
    start: StepStart
    inertia: Any
    """The motion at the start of the step, as the form of inertia has it."""
    excess: Float[Array, " d"] | None = None
    """Deformations added at the end in the stresses, in the tangent of a mixed iteration only."""
    damping: Damping | None = None


class Shared(NamedTuple):
    """Constants of the step that all elements share."""

    dt: Float[Array, ""]
    dissipation: Real


class EnergyMomentum(ImplicitMethod):
    """Energy- and momentum-conserving integration with a discrete gradient in the element's invariants.

    Arguments:
        dissipation: ξ in [0, ½]. 0 conserves the energy exactly (work of the loads included). A positive value
            removes ξ ΔeᵀK̂Δe of every element in every step, Δe the change of its deformations: exactly that, so
            the energy of a free shell never rises, and momenta stay conserved. It damps the highest
            frequencies most, and makes the method first order in Δt. The energy removed is recorded
            (`Solution.energy.dissipated`).
        inertia: "linear", whose positions are linear in the element as the paper's, or "cubic", whose positions follow
            the nodes' rotations along every edge (`jaxshell.elements.cubic_inertia`): nearer by far where a mesh is
            coarse for the bending waves in it. It conserves as exactly.

    A scene's `RayleighDamping` is exact here too: β removes (β/Δt) ΔeᵀK̂Δe of every element in every step, as ξ does,
    and α removes α Δt (v_mᵀ M v_m + ṫ_mᵀ J ṫ_m) with the mean velocities of nodes and directors. Both are recorded.

    The plain number 0 leaves dissipation out of the compiled program; other values are traced. External
    moments M do the work M·θ on the Cayley vectors θ of the steps (2 tan(½ angle) about the axis), which
    approaches ∫ M·ω dt with second order. Raises ValueError for values out of range.
    """

    balances_means: ClassVar[bool] = True

    dissipation: Real = 0.0
    inertia: str = eqx.field(static=True, default="linear")

    def __init__(self, dissipation=0.0, inertia: str = "linear"):
        # An exact zero is held as an integer: floats become traced numbers, integers stay in the program's text.
        is_zero = isinstance(dissipation, int | float) and not isinstance(dissipation, bool) and dissipation == 0
        self.dissipation = 0 if is_zero else dissipation
        self.inertia = inertia

    def __check_init__(self):
        check_within("dissipation", self.dissipation, 0.0, 0.5)
        check_choice("inertia", self.inertia, tuple(_INERTIA))

    @property
    def bends_mass(self) -> bool:
        return self.inertia == "cubic"

    @property
    def _inertia(self) -> Any:
        return _INERTIA[self.inertia]

    @property
    def _dissipates(self) -> bool:
        return not isinstance(self.dissipation, int)

    # --- one node or one element ---------------------------------------------------------------------------

    def node_motion(self, u: Float[Array, "6"], x: Float[Array, "3"], R: Float[Array, "3 3"]) -> Motion:
        """x₁ = x + Δx, R₁ = cay(θ) R."""
        theta = u[3:]
        return Motion(x + u[:3], cayley(theta) @ R, theta, spin_matrix(theta))

    def size_of_turn(self, angle):
        """Of the Cayley vector."""
        return 2.0 * jnp.tan(0.5 * angle)

    def element_forces(self, motion: Motion, u: Float[Array, "3 6"], data: ElementData, step: Shared) -> Forces:
        state = _evaluate(motion, u, data, step)
        elastic = energy_momentum.elastic_forces(state)
        inertial = self._inertia.forces(u, data.inertia, data.element, step.dt, _alpha(data))
        return Forces(elastic, inertial)

    def element_tangent(self, motion: Motion, u: Float[Array, "3 6"], data: ElementData, step: Shared):
        state = _evaluate(motion, u, data, step)
        K = energy_momentum.elastic_tangent(state, data.start, data.element, _dissipation(data, step))
        return K + self._inertia.tangent(motion.spin, u, data.inertia, data.element, step.dt, _alpha(data))

    def lump_force(self, u: Float[Array, "6"], lump: masses.ExactStart, step: Shared):
        return masses.exact_force(u, lump, step.dt)

    # --- the shell -----------------------------------------------------------------------------------------

    def weight_at_end(self, step: Shared):
        return 0.5

    def mean_turn(self, theta):
        return mid_matrix(theta)

    def calm(self, model: Model, state: EnergyMomentumState, dt) -> Float[Array, "n 6"]:
        """A start without new strains: a free shell moves as a rigid body, a held one stays where it is.

        Large steps cannot be extrapolated: nodes that overshoot stretch the membrane, whose forces then rule
        Newton's iteration.
        """
        if model.tables.held.size > 0:
            return jnp.zeros_like(state.rates[0])
        return predictor.rigid(state.rates, state.x, dt)

    def mixed_matrices(self, model: Model, state, begun, u, last, tangent: str) -> Float[Array, "m 18 18"]:
        """Tangents with the stresses that the last correction predicts linearly, as in `jaxshell.methods.static`.

        Nodes that turn by their tangents stretch the membrane; these false stresses would rule the next tangent.
        """

        def excess(u, last, x, R, element):
            """e(last) + ∂e/∂u (u - last) - e(u): predicted less actual deformations."""

            def deformations(u):
                motion = jax.vmap(self.node_motion)(u, x, R)
                return corotational.kinematics(motion.x, motion.R, element).deformations

            before, change = jax.jvp(deformations, (last,), (u - last,))
            return before + change - deformations(u)

        u_corners, last, x, R = model.gather((u, last, state.x, state.R))
        data = begun.data._replace(excess=each(excess)(u_corners, last, x, R, begun.data.element))
        return self.matrices(model, state, begun._replace(data=data), u, tangent)

    def start(self, model: Model, scene, time, solvers=None) -> EnergyMomentumState:
        x, R, v, omega = initial_motion(model, scene)
        W = jax.vmap(skew)(omega) @ R
        zero, rates = jnp.zeros(()), predictor.initial_rates(v, omega)
        return EnergyMomentumState(
            time=jnp.asarray(time, float),
            x=x,
            R=R,
            v=v,
            W=W,
            external_work=zero,
            dissipated=zero,
            rates=rates,
        )

    def begin(self, model: Model, state: EnergyMomentumState, dt):
        def middle(history):
            return 0.5 * (history(state.time) + history(state.time + dt))

        x, R, v, W = model.gather((state.x, state.R, state.v, state.W))
        motion = self._inertia.at_start(model.elements, R, v, W)
        elements = model.elements_at((0.5, state.time), (0.5, state.time + dt))  # one stress-free state for the step
        kin = jax.vmap(corotational.kinematics)(x, R, elements)
        data = ElementData(elements, StepStart(each(edges_of)(x), kin), motion, damping=model.damping)
        lumps = None if model.lumps is None else masses.exact_start(model.lumps, state.v, state.R, state.W)
        return Begun(data, Shared(dt, self.dissipation), middle(model.dead_load), state.time + dt, lumps)

    def finish(self, model: Model, state: EnergyMomentumState, dt, u, motion, begun) -> EnergyMomentumState:
        data, step = begun.data, begun.step
        work = self.work_of_loads(model, state, begun, motion, u)
        work = work + model.work_of_rests((state.x, state.R, state.time), (motion.x, motion.R, begun.end))
        dissipated = state.dissipated
        if model.resisting:
            taken = self.taken(model, state, begun, motion, u)
            work, dissipated = work + taken.work, dissipated + taken.lost
        if model.damping is not None:
            dissipated = dissipated + self._removed(model, data, step, u, motion)
        elif self._dissipates:
            x, R = model.gather((motion.x, motion.R))
            kin = each(corotational.kinematics)(x, R, data.element)
            change = kin.deformations - data.start.kin.deformations
            energies = jax.vmap(corotational.strain_energy)(change, model.elements)
            dissipated = dissipated + 2.0 * step.dissipation * jnp.sum(energies)
        # R₁ - R₀ = ~θ R_m, without the digits that a subtraction loses.
        turned = jax.vmap(skew)(u[:, 3:]) @ (state.R + motion.R)
        return EnergyMomentumState(
            time=begun.end,
            x=motion.x,
            R=motion.R,
            v=2.0 * u[:, :3] / dt - state.v,
            W=turned / dt - state.W,
            external_work=state.external_work + work,
            dissipated=dissipated,
            rates=predictor.remember(state.rates, model.without_multipliers(u), dt),
        )

    def _removed(self, model: Model, data: ElementData, step: Shared, u, motion) -> Float[Array, ""]:
        """What a damped shell loses in the step: by α, and by β and ξ, whose forces do just this work."""

        def one(u, x, R, data):
            total = jnp.zeros(())
            if data.damping.beta is not None or self._dissipates:
                change = corotational.kinematics(x, R, data.element).deformations - data.start.kin.deformations
                work = dot(change, corotational.stresses(change, data.element))
                total = total + _dissipation(data, step) * work
            if data.damping.alpha is not None:
                # Of a motion without acceleration what is left are the forces of α.
                mean = self._inertia.steady(u, data.inertia, step.dt)
                forces = self._inertia.forces(u, mean, data.element, step.dt, data.damping.alpha)
                total = total + jnp.sum(forces * u.reshape(18))
            return total

        u, x, R = model.gather((u, motion.x, motion.R))
        return jnp.sum(each(one)(u, x, R, data))

    def observe(self, model: Model, state: EnergyMomentumState) -> Observation:
        """Energies and momenta, eqs. (27), (28), (34), (61), with the masses that the scheme conserves them with."""
        x, R, v, W = model.gather((state.x, state.R, state.v, state.W))
        kinetic, linear, angular = self._inertia.momenta(model.elements, x, R, v, W)
        if model.lumps is not None:
            more = masses.exact_momentum(model.lumps, state.x, state.v, state.R, state.W)
            kinetic, linear, angular = kinetic + more.kinetic, linear + more.linear, angular + more.angular
        strain = model.strain_energy(state.x, state.R, state.time)
        return Observation(kinetic, strain, state.external_work, state.dissipated, linear, angular)


def _evaluate(motion: Motion, u, data: ElementData, step: Shared) -> energy_momentum.StepState:
    dissipation = _dissipation(data, step)
    return energy_momentum.evaluate(data.start, motion.x, motion.R, u, data.element, dissipation, data.excess)


def _dissipation(data: ElementData, step: Shared) -> Any:
    """ξ + β/Δt of an element: a viscous material's stresses K̂ β Δe/Δt are those of that dissipation."""
    if data.damping is None or data.damping.beta is None:
        return step.dissipation
    return step.dissipation + data.damping.beta / step.dt


def _alpha(data: ElementData) -> Any:
    return None if data.damping is None else data.damping.alpha
