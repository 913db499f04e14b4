"""Static equilibrium as a method: internal forces balance the loads at a load factor.

f_int(x, R) - λ f_ext = 0, eq. (70) without the inertial forces of eq. (87). The "time" of the state is the
load factor λ and the "time step" its increment, so that statics shares residual, tangent, autodiff and the
derivative of the converged step with the implicit methods.

Newton is mixed (D. Magisano, L. Leonetti & G. Garcea, "How to improve efficiency and robustness of the Newton
method in geometrically non-linear structural problem discretized via displacement-based finite elements",
Comput. Methods Appl. Mech. Eng. 313 (2017) 986-1005): the stresses in the geometric stiffness are those that
the last correction predicts linearly, not those of the corrected shape. A correction that turns elements
moves the nodes along tangents, which stretches the membrane; the false stresses would dominate the next
tangent. A cantilever rolled up in ten steps takes 8 iterations a step instead of 32 to 52.

The state keeps displacements d, and an element sees its corners from its node 1, as edges of the reference shape
plus differences of d. Positions X + d would round d off by 1e-16 |X|, which the membrane's stiffness turns into
forces: a thin shell of many elements under a small load is then out of balance by more than 1e-9 of the load.
"""

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.assembly.discretised import Model
from jaxshell.elements import corotational
from jaxshell.elements.element import Element
from jaxshell.methods.balance import Begun, Forces
from jaxshell.methods.base import ImplicitMethod
from jaxshell.methods.method import Observation
from jaxshell.methods.start import initial_motion
from jaxshell.methods.state import State
from jaxshell.numerics.checks import Real


class StaticState(State):
    """A state of equilibrium."""

    time: Float[Array, ""]
    """The load factor λ."""
    d: Float[Array, "n 3"]
    """Displacements from the reference shape."""
    R: Float[Array, "n 3 3"]
    v: Float[Array, "n 3"]
    """Zero: nothing moves."""
    external_work: Float[Array, ""]

    def displacements(self, x0):
        return self.d


class ElementData(NamedTuple):
    """Constants of one element during a step."""

    element: Element
    edges: Float[Array, "3 3"]
    """Corners of the reference shape, seen from node 1."""
    excess: Float[Array, " d"] | None = None
    """Stresses added to those of the deformations, in the tangent of a mixed iteration only."""
    damping: Float[Array, "18 18"] | None = None
    """Resists the increments of the step: see `Relaxing`."""


class Static(ImplicitMethod):
    """Static equilibrium; `solve_static` runs it, with the scene's loads in proportion to the load factor."""

    has_rates: ClassVar[bool] = False

    def element_forces(self, motion, u, data: ElementData, step) -> Forces:
        x = _corners(motion.x, data.edges)
        kin = corotational.kinematics(x, motion.R, data.element)
        force = corotational.to_global(corotational.local_forces(kin, _stresses(kin, data)), kin)
        if data.damping is not None:
            force = force + data.damping @ u.reshape(-1)
        return Forces(force, jnp.zeros_like(force))

    def element_tangent(self, motion, u, data: ElementData, step) -> Float[Array, "18 18"]:
        x = _corners(motion.x, data.edges)
        kin = corotational.kinematics(x, motion.R, data.element)
        f = _stresses(kin, data)
        K = corotational.stiffness(kin, f, data.element, motion.spin)
        return K if data.damping is None else K + data.damping

    def mixed_matrices(self, model: Model, state, begun, u, last, tangent: str) -> Float[Array, "m 18 18"]:
        def excess(u, last, d, R, data: ElementData):
            """K̂ [e(last) + ∂e/∂u (u - last) - e(u)]: predicted less actual stresses."""

            def deformations(u):
                motion = jax.vmap(self.node_motion)(u, d, R)
                return corotational.kinematics(_corners(motion.x, data.edges), motion.R, data.element).deformations

            before, change = jax.jvp(deformations, (last,), (u - last,))
            return corotational.stresses(before + change - deformations(u), data.element)

        data = begun.data
        u_e, last_e, d, R = model.gather((u, last, state.d, state.R))
        data = data._replace(excess=jax.vmap(excess)(u_e, last_e, d, R, data))
        return self.matrices(model, state, begun._replace(data=data), u, tangent)

    def start(self, model: Model, scene, time, solvers=None) -> StaticState:
        x, R, v, _ = initial_motion(model, scene)
        return StaticState(
            time=jnp.asarray(time, float),
            d=x - model.x0,
            R=R,
            v=jnp.zeros_like(v),
            external_work=jnp.zeros(()),
        )

    def configuration(self, state: StaticState):
        return state.d, state.R

    def positions(self, model: Model, x):
        return model.x0 + x

    def predict(self, model: Model, state: StaticState, dt) -> Float[Array, "n 6"]:
        """Newton starts where the last step ended, since what one extrapolates stretches the membrane."""
        return jnp.zeros((state.d.shape[0], 6))

    def begin(self, model: Model, state: StaticState, dt):
        end = state.time + dt
        corners = model.gather(model.x0)
        return Begun(
            ElementData(model.elements_at((1.0, end)), corners - corners[:, :1]), None, model.dead_load(end), end
        )

    def finish(self, model: Model, state: StaticState, dt, u, motion, begun) -> StaticState:
        end = state.time + dt
        # Work by the trapezoidal rule along the step.
        before, after = model.x0 + state.d, model.x0 + motion.x
        ends = model.external_load(before, state.R, state.time), model.external_load(after, motion.R, end)
        force = 0.5 * (ends[0] + ends[1])
        if model.moving:
            carried = reactions_at(model, state.d, state.R, state.time)
            force = force + 0.5 * (carried + reactions_at(model, motion.x, motion.R, end))
        work = state.external_work + jnp.sum(force * u)
        ends = (before, state.R, state.time), (after, motion.R, end)
        work = work + model.work_of_rests(*ends) + model.work_of_drives(*ends, u)
        return StaticState(
            time=end,
            d=motion.x,
            R=motion.R,
            v=state.v,
            external_work=work,
        )

    def observe(self, model: Model, state: StaticState) -> Observation:
        zero = jnp.zeros(())
        strain = model.strain_energy(model.x0 + state.d, state.R, state.time)
        return Observation(zero, strain, state.external_work, zero, jnp.zeros(3), jnp.zeros(3))


class Relaxing(Static):
    """One step of a shell without mass that sinks to a lower potential energy at a constant load factor.

    f_int(x, R) - λ f_ext + s K₀ u = 0 for the increments u of the step, with the material stiffness K₀ at its start:
    backward Euler for the viscous flow s K₀ u̇ = -r. It ends in an equilibrium that is stable, however far. A motion φ
    with K φ = μ K₀ φ grows by s/(s + μ) a step, if s is above -μ.
    """

    viscosity: Real
    """s, without a unit."""

    def begin(self, model: Model, state: StaticState, dt):
        begun = super().begin(model, state, dt)

        def damping(d, R, data: ElementData):
            kin = corotational.kinematics(_corners(d, data.edges), R, data.element)
            still = jnp.zeros_like(kin.deformations)
            return self.viscosity * corotational.stiffness(kin, still, data.element, None, geometric=0.0)

        d, R = model.gather((state.d, state.R))
        return begun._replace(data=begun.data._replace(damping=jax.vmap(damping)(d, R, begun.data)))


def _stresses(kin: corotational.Kinematics, data: ElementData) -> Float[Array, " d"]:
    f = corotational.stresses(kin.deformations, data.element)
    return f if data.excess is None else f + data.excess


def _corners(d: Float[Array, "3 3"], edges: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Corners of an element seen from the reference place of node 1, moved with it."""
    return edges + (d - d[0])


def reactions_at(model: Model, d, R, time) -> Float[Array, "n 6"]:
    """Forces and moments of the supports on the shell in equilibrium: f_int - f_ext at the held degrees of freedom."""
    carried = jnp.zeros(6 * d.shape[0]).at[model.tables.held].set(_carried(model, d, R, time)).reshape(-1, 6)
    return carried if model.elimination is None else model.elimination.nodal_forces(carried)


def held_reactions(model: Model, state: StaticState) -> Float[Array, " nh"]:
    """What supports carry in equilibrium, along the held degrees of freedom. The state knows the multipliers."""
    return _carried(model, state.d, state.R, state.time)[: model.tables.supported]


def _carried(model: Model, d, R, time) -> Float[Array, " nh"]:
    """The residual f_int - f_ext at the held degrees of freedom."""
    method, zero = Static(), jnp.zeros(())
    state = StaticState(jnp.asarray(time), d, R, jnp.zeros_like(d), zero)
    residual = method.balance(model, state, method.begin(model, state, zero), jnp.zeros((d.shape[0], 6))).residual
    return residual.reshape(-1)[model.tables.held]
