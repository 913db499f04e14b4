"""Explicit central differences (velocity Verlet form) with lumped mass and lumped rotary inertia.

    v_{n+½} = v_n + Δt/2 a_n        x_{n+1} = x_n + Δt v_{n+½}       R_{n+1} = exp(Δt ~ω_{n+½}) R_n
    a_{n+1} = M⁻¹ (f_ext - f_int)_{n+1}                              v_{n+1} = v_{n+½} + Δt/2 a_{n+1}

and the same for the angular velocity ω in space. A third of each element's ρhA and (ρh³/12)A goes to each of its
nodes, and the nodal rotary inertia J is ISOTROPIC: the drilling rotation gets the ρh³/12 of the other two. So J
needs no rotation and no gyroscopic term, J ω̇ = m; the price is a drilling oscillation of frequency of the order
√(E/ρ)/h, which physics does not have and which sets the critical step of thin shells. With rotary="scaled" the
inertia is at least that of ρhA²/8, as explicit programs have it (Key & Beisinger; Hughes, The Finite Element Method,
section 9.6): bending waves no longer than a few elements are slowed down, and the step is that of the membrane waves.

Rayleigh damping: α M (v_{n-½} + v_{n+½})/2, which a diagonal mass leaves explicit, with a_n of the other forces:
v_n = (v_{n-½} + Δt/2 a_n)/(1 + αΔt/2) and v_{n+½} = (1 - αΔt/2) v_n + Δt/2 a_n. The viscous stresses are those of the
last half step, K̂ β (e_n - e_{n-1})/Δt. This lag makes a damped run first order in Δt (a mode's mass changes by the
part βω²Δt/2), though Δt is so small that it hardly shows, and costs stability: with ζ = βω/2 of an element's largest
frequency Δt ≤ (√(1 + ζ²) - ζ) 2/ω (Belytschko, Liu & Moran, section 6.2).

Stability: Δt ≤ 2/ω_max, and ω_max is bounded by the largest frequency of any single element with its own lumped
mass (Irons' theorem; Belytschko, Liu & Moran, Nonlinear Finite Elements, section 6.2). Springs add to ω_max² at most
the largest eigenvalue of their own stiffness, and dashpots lag as viscous stresses do.
"""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.assembly.discretised import Model
from jaxshell.assembly.structure import structure_of
from jaxshell.assembly.tables import Tables, nodal_tables
from jaxshell.elements import corotational
from jaxshell.methods import damping
from jaxshell.methods.lumped import ROTARY, lumped, lumped_mass, part_of_area, thirds
from jaxshell.methods.method import Method, Observation, StepInfo, may_have_first_moment
from jaxshell.methods.start import initial_motion
from jaxshell.methods.state import MovingState
from jaxshell.model.contribution import Constraint
from jaxshell.model.scene import Scene
from jaxshell.numerics.checks import check_choice, check_number, is_concrete
from jaxshell.numerics.compiled import compiled_once
from jaxshell.numerics.kernels import each
from jaxshell.numerics.products import dot
from jaxshell.numerics.rotations import exp
from jaxshell.solvers.iteration import SUCCESSFUL, UNSTABLE

_EXPLOSION = 10.0
"""Unstable: energy this many times what the start and the loads have supplied. Growth is exponential then, so
the factor decides on a few steps more or less only."""


class Damped(eqx.Module):
    """What damping adds to the state."""

    dissipated: Float[Array, ""]
    alpha: Float[Array, "n 6"] | None
    """The nodes' own, from the lumped masses; zero where degrees of freedom are held. Constant."""
    deformations: Float[Array, "m d"] | None
    """At the end of the step, where a material is viscous."""


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
    damped: Damped | None = None
    """Of a scene with damping."""

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
        rotary: "physical", ρh³/12; or "scaled", ρh max(h²/12, A/8) with each element's area A, for larger steps. Its
            excess goes to zero with the elements' size as their other errors do.

    `simulate` raises ValueError, naming the critical step, for a dt above it. A run whose energy exceeds
    ten times the energy supplied ends with the result `unstable`. Raises ValueError unless 0 < safety <= 1, and for
    another rotary.
    """

    uses_matrix: ClassVar[bool] = False
    controls_step: ClassVar[bool] = False

    safety: float = eqx.field(static=True, default=0.9)
    rotary: str = eqx.field(static=True, default="physical")

    def __check_init__(self):
        check_choice("rotary", self.rotary, ROTARY)
        check_number("safety", self.safety)
        if not is_concrete(self.safety) or not 0.0 < self.safety <= 1.0:
            raise ValueError(f"safety must lie in (0, 1], but it is {self.safety}.")

    def critical_step(self, scene: Scene) -> float:
        """The largest step allowed [time]: safety · 2/ω_max about the initial state, by the element bound."""
        return float(self.safety * _stable_step(scene, nodal_tables(structure_of(scene)), part_of_area(self.rotary)))

    def check(self, scene: Scene, steps) -> None:
        if may_have_first_moment(scene):
            raise ValueError(
                "CentralDifference has no first moment of mass ∫ρz dz, which this section has, or may have while JAX "
                "traces it: use an implicit method, or a laminate that is symmetric=True without offset."
            )
        _check_joined(scene)
        if not all(is_concrete(leaf) for leaf in jax.tree.leaves((scene, steps))):
            return
        critical, largest = self.critical_step(scene), float(np.max(steps))
        if largest > critical:
            raise ValueError(
                f"dt is {largest:g}, but the critical step of CentralDifference for this scene is {critical:g}"
                f" ({self.safety:g} of the element bound 2/ω_max). Use a smaller dt, a coarser mesh, or an"
                " implicit method."
            )

    def start(self, model: Model, scene: Scene, time, solvers=None) -> ExplicitState:
        x, R, v, omega = initial_motion(model, scene)
        time, zero = jnp.asarray(time, float), jnp.zeros(())
        mass, rates = lumped_mass(model, self.rotary), jnp.concatenate([v, omega], axis=1)
        internal, strain, deformations = _internal(model, x, R, time)
        damped = None
        if model.dissipates:
            damped = Damped(zero, _nodal_alpha(model, mass, self.rotary), deformations)
        if model.resisting:
            internal = internal - model.resistance((x, R, time), (x, R, time), rates)
        if model.damping is not None and model.damping.beta is not None:
            rates_of_e = damping.stretching(model, x, R, v, omega)
            internal = internal + damping.viscous_force(model, x, R, rates_of_e)
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
            damped=damped,
        )

    def step(self, model: Model, state: ExplicitState, dt, solvers, memory):
        mass, end, held = state.mass, state.time + dt, model.tables.held

        def holding(nodal, held_rates):
            """The rates with those of held degrees of freedom, along the nodes' own axes where they have some."""
            along = nodal if model.elimination is None else model.elimination.along(nodal)
            along = along.reshape(-1).at[held].set(held_rates).reshape(-1, 6)
            return along if model.elimination is None else model.elimination.nodal_forces(along)

        def acceleration(load, internal):
            return holding((load - internal) / mass, 0.0)

        alpha = None if state.damped is None else state.damped.alpha
        slowed = state.rates if alpha is None else state.rates * (1.0 - 0.5 * dt * alpha)
        middle = slowed + 0.5 * dt * acceleration(state.load, state.internal)
        if model.moving:
            moved = model.held_increment(state.time, dt)
            middle = holding(middle, moved / dt)
        u = dt * middle
        x, R = state.x + u[:, :3], jnp.einsum("nij,njk->nik", jax.vmap(exp)(u[:, 3:]), state.R)
        before = None if state.damped is None else state.damped.deformations
        load, (internal, strain, deformations) = model.external_load(x, R, end), _internal(model, x, R, end, before, dt)
        resisted = None
        ends = (state.x, state.R, state.time), (x, R, end)
        if model.resisting:
            # With the velocities of the half step, which the next kick would change: explicit.
            resisted = model.resistance(*ends, middle)
            internal = internal - resisted
        rates = middle + 0.5 * dt * acceleration(load, internal)
        if alpha is not None:
            rates = rates / (1.0 + 0.5 * dt * alpha)
        # Work by the trapezoidal rule; that of a moving support is done on the shell and on the mass it carries.
        work = state.external_work + 0.5 * jnp.sum((state.load + load) * u)
        work = work + model.work_of_rests(*ends) + model.work_of_drives(*ends, u)
        taken = None
        if resisted is not None:
            through = model.work_through_resistance(*ends, middle)
            work, taken = work + through, through - jnp.sum(resisted * u)
        if model.moving:
            against = 0.5 * (state.internal + internal - state.load - load) * u
            if model.damping is not None and model.damping.alpha is not None:
                against = against + lumped(model, self.rotary, model.damping.alpha) * u * u / dt
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
            damped=_damped(model, self.rotary, state, u, deformations, dt, taken),
        )
        # Written so that NaN fails too.
        stable = new.kinetic + strain <= _EXPLOSION * supplied
        zero = jnp.zeros((), jnp.int32)
        return new, StepInfo(jnp.where(stable, SUCCESSFUL, UNSTABLE), zero, zero, jnp.zeros(())), memory

    def unbalanced(self, model: Model, before: ExplicitState, after: ExplicitState, dt):
        """The mean of the step's two kicks."""
        forces = 0.5 * (before.internal + after.internal - before.load - after.load)
        if model.damping is not None and model.damping.alpha is not None:
            forces = forces + 0.5 * lumped(model, self.rotary, model.damping.alpha) * (before.rates + after.rates)
        return before.mass * (after.rates - before.rates) / dt + forces

    def observe(self, model: Model, state: ExplicitState) -> Observation:
        """Energies and momenta with the lumped inertia, velocities of the end of the step."""
        momentum = state.mass * state.rates
        angular = jnp.sum(jnp.cross(state.x, momentum[:, :3]) + momentum[:, 3:], axis=0)
        linear = jnp.sum(momentum[:, :3], axis=0)
        dissipated = jnp.zeros(()) if state.damped is None else state.damped.dissipated
        return Observation(state.kinetic, state.strain, state.external_work, dissipated, linear, angular)


def _check_joined(scene: Scene) -> None:
    """Raise ValueError for what an explicit step cannot have."""
    if any(isinstance(part, Constraint) for part in scene.contributions):
        raise ValueError("CentralDifference solves no equations, which joints need: use an implicit method.")
    if scene.bodies:
        raise ValueError("CentralDifference has no rigid bodies, whose nodes' masses move as one: use another method.")
    if scene.turned is not None and (scene.damping is not None or any(s.moves for s in scene.supports)):
        raise ValueError("CentralDifference has slanted supports without damping and prescribed motions only.")
    masses = scene.point_masses
    if masses is None or not is_concrete(masses.inertia):
        return
    inertia = np.asarray(masses.inertia)
    if inertia.size and np.abs(inertia - inertia[:, :1, :1] * np.eye(3)).max() > 1e-12 * np.abs(inertia).max():
        raise ValueError(
            "CentralDifference has no gyroscopic moments: a point mass's inertia must be one value, a ball's, here."
        )


def _internal(model: Model, x, R, time, before=None, dt=None) -> tuple[Float[Array, "n 6"], Float[Array, ""], Any]:
    """Internal forces and moments, the strain energy, and deformations, from one pass over the elements.

    With deformations `before` (m, 12), a step `dt` ago, the forces hold those of a viscous material. Deformations are
    returned where there is one, else None.
    """
    beta = None if model.damping is None else model.damping.beta

    def one(x, R, element, beta, before):
        kin = corotational.kinematics(x, R, element)
        f = corotational.stresses(kin.deformations, element)
        energy = 0.5 * jnp.sum(kin.deformations * f)
        total = None if beta is None else corotational.total_deformations(kin, element)
        if before is not None:
            f = f + corotational.stresses(beta * (total - before) / dt, element)
        force = corotational.to_global(corotational.local_forces(kin, f), kin)
        return force, energy, total

    elements = model.elements_at((1.0, time))
    force, energy, deformations = each(one)(model.gather(x), model.gather(R), elements, beta, before)
    total, energy = model.assemble_vector(force), jnp.sum(energy)
    if model.elastic:
        total = total - model.sum_of(model.elastic, x, R, time)
        energy = energy + model.energy_of(model.elastic, x, R, time)
    return total, energy, deformations


def _nodal_alpha(model: Model, mass: Float[Array, "n 6"], rotary: str) -> Float[Array, "n 6"] | None:
    """α of each degree of freedom that is free, from the lumped masses of the elements around its node."""
    if model.damping is None or model.damping.alpha is None:
        return None
    ratio = lumped(model, rotary, model.damping.alpha) / mass
    return ratio.reshape(-1).at[model.tables.held].set(0.0).reshape(-1, 6)


def _damped(model: Model, rotary: str, state: ExplicitState, u, deformations, dt, taken) -> Damped | None:
    """The state of damping after a step with the increments u, with what it and contributions have removed."""
    if state.damped is None:
        return None
    removed = state.damped.dissipated
    if taken is not None:
        removed = removed + taken
    if model.damping is None:
        return Damped(removed, None, None)
    alpha, beta = model.damping
    if alpha is not None:
        removed = removed + jnp.sum(lumped(model, rotary, alpha) * u * u) / dt
    if beta is not None:
        change = deformations - state.damped.deformations
        squares = jax.vmap(lambda e, element: dot(e, corotational.stresses(e, element)))(change, model.elements)
        removed = removed + jnp.sum(beta * squares) / dt
    return Damped(removed, state.damped.alpha, deformations)


@compiled_once
def _stable_step(scene: Scene, tables: Tables, rotary: Float[Array, ""]) -> Float[Array, ""]:
    """2/ω_max, ω_max the largest frequency of an element of the initial state with its own lumped mass.

    With viscous elements the smallest of their own √(β² + 4/ω²) - β, the bound at the top of this file.
    """
    model = Model.build(scene, tables)
    x, R, _, _ = initial_motion(model, scene)

    def largest(x, R, element):
        K = corotational.tangent_stiffness(x, R, element)
        third = thirds(element, rotary)
        scale = jnp.tile(jnp.repeat(1.0 / jnp.sqrt(third), 3), 3)
        return jnp.linalg.eigvalsh(0.5 * (K + K.T) * scale[:, None] * scale[None, :])[-1]

    squares = jax.vmap(largest)(model.gather(x), model.gather(R), model.elements_at((1.0, 0.0)))
    beta = None if model.damping is None else model.damping.beta
    if model.elastic or model.resisting:
        stiff, lagging = _of_contributions(model, rotary, x, R)
        squares = squares + stiff
        lagging = lagging if beta is None else lagging + beta * squares
        return jnp.min((jnp.sqrt(4.0 * squares + lagging**2) - lagging) / squares)
    if beta is not None:
        return jnp.min(jnp.sqrt(beta**2 + 4.0 / squares) - beta)
    return 2.0 / jnp.sqrt(jnp.max(squares))


def _of_contributions(model: Model, rotary: Float[Array, ""], x, R) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Bounds of the eigenvalues of M⁻¹K and M⁻¹C of connectors and the like at the start, by Gershgorin's circles.

    The eigenvalues of a sum are no more than the sums of the largest.
    """
    place, scale = (x, R, jnp.zeros(())), 1.0 / jnp.sqrt(lumped_mass(model, rotary))

    def largest(matrices):
        rows = jnp.zeros_like(scale)
        for acting, blocks in matrices:
            of_group = scale[acting.nodes].reshape(len(blocks), -1)
            sums = of_group * jnp.einsum("kij,kj->ki", jnp.abs(blocks), of_group)
            rows = rows.at[acting.nodes].add(sums.reshape(len(blocks), -1, 6))
        return jnp.max(rows)

    def resisting(acting):
        def one(data, at):
            def force(rates):
                return acting.contribution.resistance(data, at, at, at, rates.reshape(-1, 6)).reshape(-1)

            return jax.jacfwd(force)(jnp.zeros(6 * at.x.shape[0]))

        return jax.vmap(one)(acting.data, acting.places(*place))

    lagging = [(acting, resisting(acting)) for acting in model.resisting]
    stiff = [(acting, acting.stiffest(acting.places(*place))) for acting in model.elastic]
    return largest(stiff), largest(lagging)
