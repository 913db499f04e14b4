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
from jaxshell.methods.method import Observation
from jaxshell.methods.start import initial_motion
from jaxshell.methods.static import Static, StaticState


class SettlingState(StaticState):
    """A state on the way to rest; `v` are the displacements of the last step over Δt."""

    omega: Float[Array, "n 3"]
    """The rotation vectors of the last step over Δt."""

    @property
    def velocities(self) -> Float[Array, "n 6"]:
        return jnp.concatenate([self.v, self.omega], axis=1)


class Settling(Static):
    """Backward Euler with the static balance at the end of the step; `settle` runs it."""

    def start(self, model: Model, scene, time, solvers=None) -> SettlingState:
        _, _, v, omega = initial_motion(model, scene)
        return _moving(super().start(model, scene, time), v, omega)

    def begin(self, model: Model, state: SettlingState, dt):
        begun, M = super().begin(model, state, dt), masses(model)
        momenta = jnp.einsum("mij,mj->mi", M, model.gather(state.velocities).reshape(-1, 18))
        data = begun.data._replace(damping=M / dt**2)
        return begun._replace(data=data, loads=begun.loads + model.assemble_vector(momenta) / dt)

    def finish(self, model: Model, state: SettlingState, dt, u, motion, begun) -> SettlingState:
        return _moving(super().finish(model, state, dt, u, motion, begun), u[:, :3] / dt, u[:, 3:] / dt)

    def observe(self, model: Model, state: SettlingState) -> Observation:
        strain = model.strain_energy(model.x0 + state.d, state.R, state.time)
        rates = model.gather(state.velocities).reshape(-1, 18)
        momenta = jnp.einsum("mij,mj->mi", masses(model), rates)
        zero, linear = jnp.zeros(()), model.assemble_vector(momenta)
        angular = jnp.sum(jnp.cross(model.x0 + state.d, linear[:, :3]) + linear[:, 3:], axis=0)
        kinetic = 0.5 * jnp.sum(rates * momenta)
        return Observation(kinetic, strain, state.external_work, zero, jnp.sum(linear[:, :3], axis=0), angular)


def _moving(state: StaticState, v, omega) -> SettlingState:
    return SettlingState(state.time, state.d, state.R, v, state.external_work, omega)


def masses(model: Model) -> Float[Array, "m 18 18"]:
    """∫ N_a N_b dA times the mass per area at the displacements and ρh³/12 at the rotations, about all axes."""

    def one(element):
        each = jnp.repeat(jnp.stack([element.mass_per_area, element.rotary_inertia]), 3)
        return element.area * jnp.kron(jnp.asarray(LINEAR_MASS), jnp.diag(each))

    return jax.vmap(one)(model.elements)
