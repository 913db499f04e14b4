"""Exactly conserving time integration: `EnergyMomentum`. docs/energy_momentum.md derives it.

Mid-point kinematics with Cayley vectors and director inertia (Simo & Tarnow 1994) and elastic forces from a
discrete gradient of the strain energy (Gonzalez 1996; `jaxshell.elements.energy_momentum`). The equations of
the step conserve linear and angular momentum and the energy to round-off, whatever its size; the state holds
no accelerations and no history at Gauss points, so the step size may change freely.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.checks import check_finite, is_concrete
from jaxshell.elements import corotational, energy_momentum
from jaxshell.elements.corotational import Element
from jaxshell.elements.energy_momentum import StepStart, edges_of, spin_matrix
from jaxshell.elements.inertia import LINEAR_MASS
from jaxshell.methods.base import Forces, ImplicitMethod, Motion, Observation
from jaxshell.methods.start import initial_motion
from jaxshell.model import Model, pressure_stiffness
from jaxshell.rotations import cayley, skew


class EnergyMomentumState(eqx.Module):
    """State of the exactly conserving method."""

    time: Float[Array, ""]
    x: Float[Array, "n 3"]
    R: Float[Array, "n 3 3"]
    v: Float[Array, "n 3"]
    W: Float[Array, "n 3 3"]
    """Ṙ, whose product with an element's normal is the rate of its director."""
    external_work: Float[Array, ""]
    dissipated: Float[Array, ""]
    rates: Float[Array, "2 n 6"]
    """Increments over Δt of the last two steps, for the predictor."""

    def predictor(self, dt) -> Float[Array, "n 6"]:
        """Linear extrapolation of the last two steps' mean velocities."""
        return dt * (2.0 * self.rates[0] - self.rates[1])


class Inertia(NamedTuple):
    """One element's translational and director motion at the start of the step."""

    v: Float[Array, "3 3"]
    director: Float[Array, "3 3"]
    """t_a = R_a n, with n the element's reference normal."""
    director_rate: Float[Array, "3 3"]
    """W_a n."""


class ElementData(NamedTuple):
    """Constants of one element during a step."""

    element: Element
    x: Float[Array, "3 3"]
    start: StepStart
    inertia: Inertia
    pressure: Float[Array, ""] | None
    """Mean of the step."""


class Shared(NamedTuple):
    """Constants of the step that all elements share."""

    dt: Float[Array, ""]
    dissipation: Float[Array, ""] | float


class EnergyMomentum(ImplicitMethod):
    """Energy- and momentum-conserving integration with a discrete gradient in the element's invariants.

    Arguments:
        dissipation: ξ in [0, ½]. 0 conserves the energy exactly (work of the loads included). A positive value
            removes ξ ΔeᵀK̂Δe of every element in every step, Δe the change of its deformations: exactly that, so
            the energy of a free shell never rises, and momenta stay conserved. It damps the highest
            frequencies most, and makes the method first order in Δt. The energy removed is recorded
            (`Solution.energy.dissipated`).

    The plain number 0 leaves dissipation out of the compiled program; other values are traced. External
    moments M do the work M·θ on the Cayley vectors θ of the steps (2 tan(½ angle) about the axis), which
    approaches ∫ M·ω dt with second order. Raises ValueError for values out of range.
    """

    dissipation: float = 0.0

    def __init__(self, dissipation=0.0):
        # An exact zero is held as an integer: floats become traced numbers, integers stay in the program's text.
        self.dissipation = 0 if isinstance(dissipation, int | float) and dissipation == 0 else dissipation

    def __check_init__(self):
        check_finite("dissipation", self.dissipation)
        if is_concrete(self.dissipation) and not 0 <= self.dissipation <= 0.5:
            raise ValueError(f"dissipation must lie in [0, 0.5], but it is {self.dissipation}.")

    @property
    def _dissipates(self) -> bool:
        return not isinstance(self.dissipation, int)

    # --- one node or one element ---------------------------------------------------------------------------

    def node_motion(self, u: Float[Array, "6"], x: Float[Array, "3"], R: Float[Array, "3 3"]) -> Motion:
        """x₁ = x + Δx, R₁ = cay(θ) R."""
        theta = u[3:]
        return Motion(x + u[:3], cayley(theta) @ R, theta, spin_matrix(theta))

    def element_forces(self, motion: Motion, u: Float[Array, "3 6"], data: ElementData, step: Shared) -> Forces:
        state = energy_momentum.evaluate(data.start, motion.x, motion.R, u, data.element, step.dissipation)
        elastic = energy_momentum.elastic_forces(state)
        if data.pressure is not None:
            elastic = elastic - mean_pressure_force(data.x, u[:, :3], data.pressure)
        force = _translational_mass(data.element) @ (2.0 * (u[:, :3] / step.dt - data.inertia.v) / step.dt)
        moment = jnp.cross(*_directors(u, data.inertia), _director_acceleration(u, data, step))
        return Forces(elastic, jnp.stack([force, moment], axis=1).reshape(18))

    def element_tangent(self, motion: Motion, u: Float[Array, "3 6"], data: ElementData, step: Shared):
        raise NotImplementedError

    # --- the shell -----------------------------------------------------------------------------------------

    def start(self, model: Model, scene, time) -> EnergyMomentumState:
        x, R, v, omega = initial_motion(model, scene)
        W = jax.vmap(skew)(omega) @ R
        rate = jnp.concatenate([v, omega], axis=1)
        zero = jnp.zeros(())
        return EnergyMomentumState(jnp.asarray(time, float), x, R, v, W, zero, zero, jnp.stack([rate, rate]))
