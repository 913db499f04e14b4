"""Backward Euler in time for shells that are to come to rest: the step of `jaxshell.settle`.

    M (u/Δt - q̇_n)/Δt + f_int(x, R) - f_ext(x, R, t) = 0,      q̇ = u/Δt,

for the increments u of displacements and rotations, with the balance of `jaxshell.methods.static` at the step's end.
Backward Euler is L-stable: what a step does not resolve is gone after it. Small steps follow the motion that the
inertia gives (and damp it, with first order); steps that grow turn into Newton's method for the static equilibrium, and
where they end nothing of M is left. So M is made simply: the consistent translational mass of the start of the step and
a rotary inertia that is the same about all axes.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.assembly.discretised import Model
from jaxshell.elements.inertia import LINEAR_MASS
from jaxshell.methods.base import Observation
from jaxshell.methods.start import initial_motion
from jaxshell.methods.state import State
from jaxshell.methods.static import Static, StaticState


class SettlingState(State):
    """A state on the way to rest."""

    time: Float[Array, ""]
    d: Float[Array, "n 3"]
    """Displacements from the reference shape."""
    R: Float[Array, "n 3 3"]
    velocities: Float[Array, "n 6"]
    """Of the last step: displacements and rotation vectors over Δt."""
    external_work: Float[Array, ""]

    @property
    def v(self) -> Float[Array, "n 3"]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.velocities[:, :3]

    def displacements(self, x0):
        return self.d


class Settling(Static):
    """Backward Euler with the static balance at the end of the step; `settle` runs it."""

    def start(self, model: Model, scene, time) -> SettlingState:
        x, R, v, omega = initial_motion(model, scene)
        zero = jnp.zeros(())
        velocities = jnp.concatenate([v, omega], axis=1)
        return SettlingState(  # pyright: ignore[reportCallIssue]  # v is a property
            time=jnp.asarray(time, float), d=x - model.x0, R=R, velocities=velocities, external_work=zero
        )

    def begin(self, model: Model, state: SettlingState, dt):
        begun = super().begin(model, _at_rest(state), dt)
        M = masses(model)
        momenta = jnp.einsum("mij,mj->mi", M, model.gather(state.velocities).reshape(-1, 18))
        data = begun.data._replace(damping=M / dt**2)
        return begun._replace(data=data, loads=begun.loads + model.assemble_vector(momenta) / dt)

    def finish(self, model: Model, state: SettlingState, dt, u, motion, begun) -> SettlingState:
        found = super().finish(model, _at_rest(state), dt, u, motion, begun)
        return SettlingState(  # pyright: ignore[reportCallIssue]
            time=found.time, d=found.d, R=found.R, velocities=u / dt, external_work=found.external_work
        )

    def observe(self, model: Model, state: SettlingState) -> Observation:
        strain = model.strain_energy(model.x0 + state.d, state.R)
        rates = model.gather(state.velocities).reshape(-1, 18)
        momenta = jnp.einsum("mij,mj->mi", masses(model), rates)
        zero, linear = jnp.zeros(()), model.assemble_vector(momenta)
        angular = jnp.sum(jnp.cross(model.x0 + state.d, linear[:, :3]) + linear[:, 3:], axis=0)
        kinetic = 0.5 * jnp.sum(rates * momenta)
        return Observation(kinetic, strain, state.external_work, zero, jnp.sum(linear[:, :3], axis=0), angular)


def masses(model: Model) -> Float[Array, "m 18 18"]:
    """∫ N_a N_b dA times the mass per area at the displacements and ρh³/12 at the rotations, about all axes."""

    def one(element):
        each = jnp.repeat(jnp.stack([element.mass_per_area, element.rotary_inertia]), 3)
        return element.area * jnp.kron(jnp.asarray(LINEAR_MASS), jnp.diag(each))

    return jax.vmap(one)(model.elements)


def _at_rest(state: SettlingState) -> StaticState:
    return StaticState(state.time, state.d, state.R, jnp.zeros_like(state.d), state.external_work)
