"""Explicit central differences (velocity Verlet form) with lumped mass and lumped rotary inertia.

    v_{n+½} = v_n + Δt/2 a_n        x_{n+1} = x_n + Δt v_{n+½}       R_{n+1} = exp(Δt ~ω_{n+½}) R_n
    a_{n+1} = M⁻¹ (f_ext - f_int)_{n+1}                              v_{n+1} = v_{n+½} + Δt/2 a_{n+1}

and the same for the angular velocity ω in space. A third of each element's ρhA and (ρh³/12)A goes to each of its
nodes, and the nodal rotary inertia J is ISOTROPIC: the drilling rotation gets the ρh³/12 of the other two. So J
needs no rotation and no gyroscopic term, J ω̇ = m; the price is a drilling oscillation of frequency of the order
√(E/ρ)/h, which physics does not have and which sets the critical step of thin shells.

Stability: Δt ≤ 2/ω_max, and ω_max is bounded by the largest frequency of any single element with its own lumped
mass (Irons' theorem; Belytschko, Liu & Moran, Nonlinear Finite Elements, section 6.2).
"""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.assembly.discretised import Model, structure_of
from jaxshell.assembly.tables import Tables, nodal_tables
from jaxshell.elements import corotational
from jaxshell.methods.base import Method, Observation, StepInfo
from jaxshell.methods.start import initial_motion
from jaxshell.methods.state import MovingState
from jaxshell.model.scene import Scene
from jaxshell.numerics.checks import check_number, is_concrete
from jaxshell.numerics.compiled import compiled
from jaxshell.numerics.rotations import exp
from jaxshell.solvers.iteration import SUCCESSFUL, UNSTABLE

_EXPLOSION = 10.0
"""Unstable: energy this many times what the start and the loads have supplied. Growth is exponential then, so
the factor decides on a few steps more or less only."""


class ExplicitState(MovingState):
    """State at the end of a step."""

    time: Float[Array, ""]
    x: Float[Array, "n 3"]
    R: Float[Array, "n 3 3"]
    rates: Float[Array, "n 6"]
    """Velocities and angular velocities in space."""
    load: Float[Array, "n 6"]
    internal: Float[Array, "n 6"]
    strain: Float[Array, ""]
    external_work: Float[Array, ""]
    initial_energy: Float[Array, ""]
    supplied: Float[Array, ""]
    """The most energy that the start and the loads have put in until now."""
    mass: Float[Array, "n 6"]
    """Lumped masses and rotary inertias; constant."""

    @property
    def v(self) -> Float[Array, "n 3"]:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.rates[:, :3]

    @property
    def kinetic(self) -> Float[Array, ""]:
        return 0.5 * jnp.sum(self.mass * self.rates**2)


class CentralDifference(Method):
    """Central differences, explicit: no equations are solved, and the step is limited.

    Arguments:
        safety: part of 2/ω_max that is allowed as a step; below 1 since ω_max changes as the shell deforms.

    `simulate` raises ValueError, naming the critical step, for a dt above it. A run whose energy exceeds
    ten times the energy supplied ends with the result `unstable`. Raises ValueError unless 0 < safety <= 1.
    """

    uses_matrix: ClassVar[bool] = False
    controls_step: ClassVar[bool] = False

    safety: float = eqx.field(static=True, default=0.9)

    def __check_init__(self):
        check_number("safety", self.safety)
        if not is_concrete(self.safety) or not 0.0 < self.safety <= 1.0:
            raise ValueError(f"safety must lie in (0, 1], but it is {self.safety}.")

    def critical_step(self, scene: Scene) -> float:
        """The largest step allowed [time]: safety · 2/ω_max about the initial state, by the element bound."""
        return float(self.safety * _stable_step(scene, nodal_tables(structure_of(scene))))

    def check(self, scene: Scene, steps) -> None:
        super().check(scene, steps)
        if not all(is_concrete(leaf) for leaf in jax.tree.leaves((scene, steps))):
            return
        critical, largest = self.critical_step(scene), float(np.max(steps))
        if largest > critical:
            raise ValueError(
                f"dt is {largest:g}, but the critical step of CentralDifference for this scene is {critical:g}"
                f" ({self.safety:g} of the element bound 2/ω_max). Use a smaller dt, a coarser mesh, or an"
                " implicit method."
            )

    def start(self, model: Model, scene: Scene, time) -> ExplicitState:
        x, R, v, omega = initial_motion(model, scene)
        time, zero = jnp.asarray(time, float), jnp.zeros(())
        mass, rates = lumped_mass(model), jnp.concatenate([v, omega], axis=1)
        internal, strain = _internal(model, x, R, time)
        energy = strain + 0.5 * jnp.sum(mass * rates**2)
        return ExplicitState(  # pyright: ignore[reportCallIssue]  # v is a property
            time=time,
            x=x,
            R=R,
            rates=rates,
            load=model.external_load(x, R, time),
            internal=internal,
            strain=strain,
            external_work=zero,
            initial_energy=energy,
            supplied=energy,
            mass=mass,
        )

    def step(self, model: Model, state: ExplicitState, dt, solvers, memory):
        mass, end, held = state.mass, state.time + dt, model.tables.held

        def acceleration(load, internal):
            return ((load - internal) / mass).reshape(-1).at[held].set(0.0).reshape(-1, 6)

        middle = state.rates + 0.5 * dt * acceleration(state.load, state.internal)
        if model.moving:
            moved = model.held_increment(state.time, dt)
            middle = middle.reshape(-1).at[held].set(moved / dt).reshape(-1, 6)
        u = dt * middle
        x, R = state.x + u[:, :3], jnp.einsum("nij,njk->nik", jax.vmap(exp)(u[:, 3:]), state.R)
        load, (internal, strain) = model.external_load(x, R, end), _internal(model, x, R, end)
        rates = middle + 0.5 * dt * acceleration(load, internal)
        # Work by the trapezoidal rule; that of a moving support is done on the shell and on the mass it carries.
        work = state.external_work + 0.5 * jnp.sum((state.load + load) * u)
        work = work + model.work_of_rests((state.x, state.R, state.time), (x, R, end))
        if model.moving:
            against = 0.5 * (state.internal + internal - state.load - load) * u
            carried = 0.5 * mass * (rates**2 - state.rates**2)
            work = work + jnp.sum((against + carried).reshape(-1)[held])
        # The velocity at the end already holds the second half of this step's kick, whose work follows.
        coming = 0.5 * dt * jnp.sum(load * rates)
        supplied = jnp.maximum(state.supplied, state.initial_energy + work + coming)
        new = ExplicitState(  # pyright: ignore[reportCallIssue]
            time=end,
            x=x,
            R=R,
            rates=rates,
            load=load,
            internal=internal,
            strain=strain,
            external_work=work,
            initial_energy=state.initial_energy,
            supplied=supplied,
            mass=mass,
        )
        # Written so that NaN fails too.
        stable = new.kinetic + strain <= _EXPLOSION * supplied
        zero = jnp.zeros((), jnp.int32)
        return new, StepInfo(jnp.where(stable, SUCCESSFUL, UNSTABLE), zero, zero, jnp.zeros(())), memory

    def unbalanced(self, model: Model, before: ExplicitState, after: ExplicitState, dt):
        """The mean of the step's two kicks."""
        forces = 0.5 * (before.internal + after.internal - before.load - after.load)
        return before.mass * (after.rates - before.rates) / dt + forces

    def observe(self, model: Model, state: ExplicitState) -> Observation:
        """Energies and momenta with the lumped inertia, velocities of the end of the step."""
        momentum = state.mass * state.rates
        angular = jnp.sum(jnp.cross(state.x, momentum[:, :3]) + momentum[:, 3:], axis=0)
        linear = jnp.sum(momentum[:, :3], axis=0)
        return Observation(state.kinetic, state.strain, state.external_work, jnp.zeros(()), linear, angular)


def lumped_mass(model: Model) -> Float[Array, "n 6"]:
    """A third of each element's mass and of its (ρh³/12)A at each of its nodes."""
    elements = model.elements
    third = jnp.stack([elements.mass_per_area, elements.rotary_inertia], axis=1) * elements.area[:, None] / 3.0
    corner = jnp.broadcast_to(third[:, None, :, None], (third.shape[0], 3, 2, 3))
    return model.tables.nodal(corner.reshape(-1, 6))


def _internal(model: Model, x, R, time) -> tuple[Float[Array, "n 6"], Float[Array, ""]]:
    """Internal forces and moments, and the strain energy, from one pass over the elements."""

    def one(x, R, element):
        kin = corotational.kinematics(x, R, element)
        f = corotational.stresses(kin.deformations, element)
        force = corotational.to_global(corotational.local_forces(kin, f), kin)
        return force, 0.5 * jnp.sum(kin.deformations * f)

    force, energy = jax.vmap(one)(model.gather(x), model.gather(R), model.elements_at((1.0, time)))
    return model.assemble_vector(force), jnp.sum(energy)


@compiled
def _stable_step(scene: Scene, tables: Tables) -> Float[Array, ""]:
    """2/ω_max, ω_max the largest frequency of an element of the initial state with its own lumped mass."""
    model = Model.build(scene, tables)
    x, R, _, _ = initial_motion(model, scene)

    def largest(x, R, element):
        K = corotational.tangent_stiffness(x, R, element)
        third = element.area / 3.0 * jnp.stack([element.mass_per_area, element.rotary_inertia])
        scale = jnp.tile(jnp.repeat(1.0 / jnp.sqrt(third), 3), 3)
        return jnp.linalg.eigvalsh(0.5 * (K + K.T) * scale[:, None] * scale[None, :])[-1]

    squares = jax.vmap(largest)(model.gather(x), model.gather(R), model.elements_at((1.0, 0.0)))
    return 2.0 / jnp.sqrt(jnp.max(squares))
