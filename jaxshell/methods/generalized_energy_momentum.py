"""The paper's time integration: generalised energy-momentum method, EMC and EDMC, eqs. (86)-(105).

Kinematic quantities (accelerations, velocities, rotation matrices, Λ, deformations) are averaged between the
ends of the step, and the balance is written with the averages. EMC is ρ∞ = 1, ξ = 0; EDMC is ρ∞ < 1 or ξ > 0.
Linear momentum is conserved by the equations; energy and angular momentum to O(Δt²) only, since averaged
matrices are no rotations.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.checks import check_finite, is_concrete
from jaxshell.elements import corotational, inertia
from jaxshell.elements.corotational import Element, Kinematics
from jaxshell.elements.inertia import GAUSS_POINTS, GAUSS_WEIGHTS, LINEAR_MASS, Spins, StepFactors
from jaxshell.methods import predictor
from jaxshell.methods.base import Forces, ImplicitMethod, Observation
from jaxshell.methods.start import initial_motion, initial_translational_acceleration
from jaxshell.model import Model, pressure_force, pressure_stiffness
from jaxshell.rotations import exp, log


class GEMState(eqx.Module):
    """State of the generalised energy-momentum method."""

    time: Float[Array, ""]
    x: Float[Array, "n 3"]
    R: Float[Array, "n 3 3"]
    v: Float[Array, "n 3"]
    a: Float[Array, "n 3"]
    spins: Spins | None
    """At the seven Gauss points of each element (m, 7, ...), or at the nodes (n, ...), or absent."""
    external_work: Float[Array, ""]
    rates: predictor.Rates
    """Of the last steps, for the predictor."""


class ElementData(NamedTuple):
    """Constants of one element during a step."""

    element: Element
    start: Kinematics
    v: Float[Array, "3 3"]
    a: Float[Array, "3 3"]
    R: Float[Array, "3 3 3"]
    spins: Spins | None
    pressure: Float[Array, ""] | None


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

    spectral_radius: float = 1.0
    dissipation: float = 0.0
    initial_acceleration: str = eqx.field(static=True, default="consistent")
    inertia: str = eqx.field(static=True, default="seven_point")

    def __check_init__(self):
        for name, value, top in (
            ("spectral_radius", self.spectral_radius, 1.0),
            ("dissipation", self.dissipation, 0.5),
        ):
            check_finite(name, value)
            if is_concrete(value) and not 0 <= value <= top:
                raise ValueError(f"{name} must lie in [0, {top}], but it is {value}.")
        _check_choice("initial_acceleration", self.initial_acceleration, ("consistent", "zero"))
        _check_choice("inertia", self.inertia, ("seven_point", "traditional", "none"))

    def factors(self, dt) -> StepFactors:
        """β, γ, α_m, α_f of eq. (92)."""
        rho = self.spectral_radius
        alpha_m, alpha_f = (2.0 * rho - 1.0) / (rho + 1.0), rho / (rho + 1.0)
        return StepFactors(0.25 * (1.0 - alpha_m + alpha_f) ** 2, 0.5 - alpha_m + alpha_f, alpha_m, alpha_f, dt)

    # --- one element ---------------------------------------------------------------------------------------

    def element_forces(self, motion, u, data: ElementData, step: Shared) -> Forces:
        factors, element = step.factors, data.element
        kin = corotational.kinematics(motion.x, motion.R, element)
        f = corotational.stresses(_weighted(kin, data.start, step), element)
        elastic = factors.mid(
            corotational.to_global(corotational.local_forces(kin, f), kin),
            corotational.to_global(corotational.local_forces(data.start, f), data.start),
            factors.alpha_f,
        )
        if data.pressure is not None:
            elastic = elastic - (1.0 - factors.alpha_f) * pressure_force(motion.x, data.pressure)

        acceleration = factors.mid(factors.second(u[:, :3], data.v, data.a), data.a, factors.alpha_m)
        mass = element.mass_per_area * element.area / 12.0
        force = mass * (acceleration + jnp.sum(acceleration, axis=0))
        moment = self._inertial_moments(motion, data, step)
        return Forces(elastic, jnp.stack([force, moment], axis=1).reshape(18))

    def _inertial_moments(self, motion, data: ElementData, step: Shared) -> Float[Array, "3 3"]:
        element, factors = data.element, step.factors
        axis = element.frame[2]
        if self.inertia == "seven_point":
            theta = jnp.asarray(GAUSS_POINTS) @ motion.theta
            moments = jax.vmap(inertia.point_inertia, in_axes=(0, 0, None, None, None))(
                theta, data.spins, axis, element.rotary_inertia, factors
            )
            return element.area * (jnp.asarray(GAUSS_WEIGHTS[:, None] * GAUSS_POINTS).T @ moments)
        if self.inertia == "traditional":
            turned = jax.vmap(lambda theta, spins: _nodal_acceleration(theta, spins, element, factors))
            acceleration = element.area * (jnp.asarray(LINEAR_MASS) @ turned(motion.theta, data.spins))
            R = factors.mid(motion.R, data.R, factors.alpha_f)
            return jnp.sum(R * acceleration[:, None, :], axis=2)
        return jnp.zeros((3, 3))

    def element_tangent(self, motion, u, data: ElementData, step: Shared):
        factors, element = step.factors, data.element
        kin = corotational.kinematics(motion.x, motion.R, element)
        f = corotational.stresses(_weighted(kin, data.start, step), element)
        gradient = corotational.deformation_gradient(kin)
        # Λ_{n+1-αf} in the frame of the end of the step, eq. (91).
        turn = jnp.einsum("ik,jk->ij", data.start.frame, kin.frame)
        start = corotational.deformation_gradient(data.start).reshape(12, 6, 3)
        left = factors.mid(gradient, jnp.einsum("rai,ij->raj", start, turn).reshape(12, 18), factors.alpha_f)
        local = corotational.local_forces(kin, f)
        # eq. (97)
        K = (1.0 - factors.alpha_f + step.xi) * corotational.material_stiffness(gradient, left, element)
        K = K + (1.0 - factors.alpha_f) * corotational.geometric_stiffness(kin, f, local)
        K = corotational.matrix_to_global(K, kin)
        if data.pressure is not None:
            K = K - (1.0 - factors.alpha_f) * pressure_stiffness(motion.x, data.pressure)
        # From spins to the unknown rotation vectors, then inertia, eq. (95).
        K = K.reshape(18, 3, 2, 3)
        turned = jnp.einsum("rbi,bij->rbj", K[:, :, 1], motion.spin)
        K = jnp.stack([K[:, :, 0], turned], axis=2).reshape(3, 2, 3, 3, 2, 3)
        mass = (1.0 - factors.alpha_m) / (factors.beta * factors.dt**2) * element.mass_per_area * element.area
        translational = mass * jnp.asarray(LINEAR_MASS)[:, None, :, None] * jnp.eye(3)[None, :, None, :]
        rotational = self._inertial_stiffness(motion, data, step)
        zero = jnp.zeros_like(translational)
        rows = [jnp.stack([translational, zero], axis=3), jnp.stack([zero, rotational], axis=3)]
        return (K + jnp.stack(rows, axis=1)).reshape(18, 18)

    def _inertial_stiffness(self, motion, data: ElementData, step: Shared) -> Float[Array, "3 3 3 3"]:
        """Rotational part of K_Dyn by the rotation vectors: axes (node, component, node, component)."""
        element, factors = data.element, step.factors
        axis = element.frame[2]
        if self.inertia == "seven_point":
            theta = jnp.asarray(GAUSS_POINTS) @ motion.theta
            points = jax.vmap(inertia.point_tangent, in_axes=(0, 0, None, None, None))(
                theta, data.spins, axis, element.rotary_inertia, factors
            )
            weights = GAUSS_WEIGHTS[:, None, None] * GAUSS_POINTS[:, :, None] * GAUSS_POINTS[:, None, :]
            blocks = jnp.asarray(weights.reshape(7, 9)).T @ points.stiffness.reshape(7, 9)
            return element.area * jnp.transpose(blocks.reshape(3, 3, 3, 3), (0, 2, 1, 3))
        if self.inertia == "traditional":
            tensor = inertia.inertia_tensor(axis, element.rotary_inertia)
            mass = element.area * jnp.asarray(LINEAR_MASS)
            R = factors.mid(motion.R, data.R, factors.alpha_f)
            second = (1.0 - factors.alpha_m) / (factors.beta * factors.dt**2)
            linear = second * jnp.einsum("ab,aij,jk,blk->aibl", mass, R, tensor, data.R)
            turned = jax.vmap(lambda theta, spins: _nodal_acceleration(theta, spins, element, factors))
            moment = jnp.einsum("aij,aj->ai", motion.R, mass @ turned(motion.theta, data.spins))
            skews = jax.vmap(inertia.rotations.skew)(moment)
            turning = (1.0 - factors.alpha_f) * jnp.einsum("aij,ajk->aik", skews, motion.spin)
            return linear - jnp.einsum("aij,ab->aibj", turning, jnp.eye(3))
        return jnp.zeros((3, 3, 3, 3))

    # --- the shell -----------------------------------------------------------------------------------------

    def start(self, model: Model, scene, time) -> GEMState:
        x, R, v, omega = initial_motion(model, scene)
        if self.initial_acceleration == "consistent":
            a = initial_translational_acceleration(model, x, R, time)
        else:
            a = jnp.zeros_like(v)
        spins = self._initial_spins(model, R, omega)
        rates = predictor.initial_rates(v, omega)
        return GEMState(jnp.asarray(time, float), x, R, v, a, spins, jnp.zeros(()), rates)

    def _initial_spins(self, model: Model, R, omega) -> Spins | None:
        if self.inertia == "none":
            return None
        if self.inertia == "traditional":
            material = jnp.einsum("nij,ni->nj", R, omega)
            return Spins(R, material, jnp.zeros_like(material))

        def gauss_points(R, omega):
            """Rotations between the nodes by the rotation vectors that lead from node 1 to the others."""
            relative = jax.vmap(log)(jnp.einsum("aij,kj->aik", R, R[0]))
            points = jax.vmap(exp)(jnp.asarray(GAUSS_POINTS) @ relative) @ R[0]
            material = jnp.einsum("pij,pi->pj", points, jnp.asarray(GAUSS_POINTS) @ omega)
            return Spins(points, material, jnp.zeros_like(material))

        return jax.vmap(gauss_points)(model.gather(R), model.gather(omega))

    def begin(self, model: Model, state: GEMState, dt):
        factors = self.factors(dt)
        end, start = state.time + dt, state.time
        loads = factors.mid(model.dead_load(end), model.dead_load(start), factors.alpha_f)
        pressure = None
        if model.pressures:
            loads = loads + factors.alpha_f * model.pressure_load(state.x, start)
            pressure = model.pressure(end)
        x, R, v, a = model.gather((state.x, state.R, state.v, state.a))
        spins = model.gather(state.spins) if self.inertia == "traditional" else state.spins
        kin = jax.vmap(corotational.kinematics)(x, R, model.elements)
        data = ElementData(model.elements, kin, v, a, R, spins, pressure)
        return data, Shared(factors, jnp.asarray(self.dissipation)), loads

    def finish(self, model: Model, state: GEMState, dt, u, motion, begun) -> GEMState:
        data, step, loads = begun
        factors = step.factors
        spins = state.spins
        if self.inertia == "seven_point":
            theta = jnp.asarray(GAUSS_POINTS) @ model.gather(motion.theta)
            spins = jax.vmap(jax.vmap(inertia.end_of_step, (0, 0, None)), (0, 0, None))(theta, spins, factors)
        elif self.inertia == "traditional":
            spins = jax.vmap(inertia.end_of_step, in_axes=(0, 0, None))(motion.theta, spins, factors)
        work = jnp.sum(loads * u)
        if model.pressures:
            end = state.time + dt
            work = work + (1.0 - factors.alpha_f) * jnp.sum(model.pressure_load(motion.x, end) * u)
        if model.moving:
            # Supports that move work with the reaction, the residual at the held freedoms.
            reaction = self.balance(model, state, begun, u).residual.reshape(-1)[model.tables.held]
            work = work + jnp.sum(reaction * u.reshape(-1)[model.tables.held])
        return GEMState(
            state.time + dt,
            motion.x,
            motion.R,
            factors.first(u[:, :3], state.v, state.a),
            factors.second(u[:, :3], state.v, state.a),
            spins,
            state.external_work + work,
            predictor.remember(state.rates, u, dt),
        )

    def observe(self, model: Model, state: GEMState) -> Observation:
        """Energies and momenta, eqs. (27), (28), (34), (61)."""
        elements = model.elements
        mass = elements.mass_per_area * elements.area
        x, v = model.gather((state.x, state.v))
        momentum = mass[:, None, None] * (jnp.asarray(LINEAR_MASS) @ v)
        kinetic = 0.5 * jnp.sum(v * momentum)
        linear, angular = jnp.sum(momentum, axis=(0, 1)), jnp.sum(jnp.cross(x, momentum), axis=(0, 1))
        if state.spins is not None:
            turning, spin_momentum = self._spin_energy(model, state.spins)
            kinetic, angular = kinetic + turning, angular + spin_momentum
        strain = model.strain_energy(state.x, state.R)
        return Observation(kinetic, strain, state.external_work, jnp.zeros(()), linear, angular)

    def _spin_energy(self, model: Model, spins: Spins):
        """Rotational kinetic energy and angular momentum ∫ R I_ρ Ω dA."""
        elements = model.elements
        axis = elements.frame[:, None, 2]
        weight = elements.area * elements.rotary_inertia
        if self.inertia == "seven_point":
            momentum = jnp.asarray(GAUSS_WEIGHTS)[:, None] * inertia.apply_inertia(axis, 1.0, spins.Omega)
        else:
            spins = model.gather(spins)
            momentum = inertia.apply_inertia(axis, 1.0, jnp.asarray(LINEAR_MASS) @ spins.Omega)
        momentum = weight[:, None, None] * momentum
        return 0.5 * jnp.sum(spins.Omega * momentum), jnp.einsum("mpij,mpj->i", spins.R, momentum)


def _weighted(kin: Kinematics, start: Kinematics, step: Shared) -> Float[Array, "12"]:
    """Deformations weighted as in eq. (93)."""
    alpha, xi = step.factors.alpha_f, step.xi
    return (1.0 - alpha + xi) * kin.deformations + (alpha - xi) * start.deformations


def _nodal_acceleration(theta, spins: Spins, element: Element, factors: StepFactors) -> Float[Array, "3"]:
    """I_ρ Ω̇ at the generalised mid-point for one node, as the traditional inertia has it."""
    end = inertia.end_of_step(theta, spins, factors)
    acceleration = factors.mid(end.Omega_dot, spins.Omega_dot, factors.alpha_m)
    return inertia.inertia_tensor(element.frame[2], element.rotary_inertia) @ acceleration


def _check_choice(name: str, value: Any, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise ValueError(f"{name} must be one of {', '.join(choices)}, but it is {value!r}.")
