"""What the implicit methods have in common: the residual and its tangent from one element, and one Newton step.

A method states, for ONE element, the forces in its balance and their closed-form tangent as functions of the
nodal increments u = (Δx, θ) of the step. This file gathers, vmaps, assembles, differentiates (`jax.jacfwd`)
and hands both to Newton. Δx [length] and θ [rad] are increments from the start of the step, so that what
converges does not depend on the path of the iterates.
"""

import abc
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxshell.batching import one_by_one
from jaxshell.gradients import keep
from jaxshell.methods.predictor import extrapolate
from jaxshell.model import Model
from jaxshell.newton import Linear, Memory, Newton, Problem, attach_derivative
from jaxshell.rotations import H_inverse, exp


class Motion(NamedTuple):
    """A node at the end of the step."""

    x: Float[Array, "*n 3"]
    """Position; in statics displacement."""
    R: Float[Array, "*n 3 3"]
    theta: Float[Array, "*n 3"]
    """The rotation of the step, in the method's parameters."""
    spin: Float[Array, "*n 3 3"]
    """Derivative of the spin: δω = spin δθ."""


class Forces(NamedTuple):
    """One element's contributions to the balance, each (18,)."""

    elastic: Float[Array, "*m 18"]
    inertial: Float[Array, "*m 18"]


class Balance(NamedTuple):
    """The assembled residual and the scale of what is in balance."""

    residual: Float[Array, "n 6"]
    """Inertial plus internal minus external forces and moments."""
    force: Float[Array, ""]
    """Largest force of an element or a load on a node."""
    moment: Float[Array, ""]


class Observation(NamedTuple):
    """What is recorded at every step."""

    kinetic: Float[Array, ""]
    strain: Float[Array, ""]
    external_work: Float[Array, ""]
    dissipated: Float[Array, ""]
    linear: Float[Array, "3"]
    angular: Float[Array, "3"]
    reaction: Float[Array, " nh"] | None = None
    """Of the supports at the held freedoms, where it was asked for."""


class StepInfo(NamedTuple):
    """How a step went."""

    result: Int[Array, ""]
    """0 or the index of a failure, see `jaxshell.newton.CODES`."""
    iterations: Int[Array, ""]
    factorizations: Int[Array, ""]
    correction: Float[Array, ""]
    """The last correction, scaled."""


class Solvers(NamedTuple):
    """How the equations of a step are solved."""

    newton: Newton
    linear: Linear
    tangent: str
    differentiated: bool = True
    """Whether the program may be transformed by JAX. Others are spared the derivative of every step."""


class Method(eqx.Module):
    """A time integrator: states, and one step as a pure function of (model, state, Δt)."""

    uses_matrix: ClassVar[bool] = True
    """Whether a step solves equations. Explicit methods do not, and nothing is analysed or kept for them."""

    def check(self, scene, steps) -> None:
        """Raise ValueError where the method cannot run `scene` with these step sizes; before compilation."""

    @abc.abstractmethod
    def start(self, model: Model, scene, time) -> Any:
        """The state at the start."""

    @abc.abstractmethod
    def observe(self, model: Model, state) -> Observation:
        """Energies and momenta of a state."""

    @abc.abstractmethod
    def step(self, model: Model, state, dt, solvers: Solvers, memory) -> tuple[Any, StepInfo, Any]:
        """One step: the new state, how it went, and Newton's memory (factorization, contraction) for the next."""

    @abc.abstractmethod
    def unbalanced(self, model: Model, before, after, dt) -> Float[Array, "n 6"]:
        """Inertial plus internal minus external forces in the balance of the step between two states.

        At held freedoms what the supports carry, at free ones what Newton has left.
        """


class ImplicitMethod(Method):
    """A method whose step solves a nonlinear balance with Newton's iteration."""

    # --- for one node or one element -----------------------------------------------------------------------

    def node_motion(self, u: Float[Array, "6"], x: Float[Array, "3"], R: Float[Array, "3 3"]) -> Motion:
        """Position and rotation of one node after the increments u; rotation vectors by default, eq. (103)."""
        theta = u[3:]
        return Motion(x + u[:3], exp(theta) @ R, theta, H_inverse(theta))

    @abc.abstractmethod
    def element_forces(self, motion: Motion, u: Float[Array, "3 6"], data, step) -> Forces:
        """Forces of one element; `data` is its own step data, `step` what all elements share."""

    @abc.abstractmethod
    def element_tangent(self, motion: Motion, u: Float[Array, "3 6"], data, step) -> Float[Array, "18 18"]:
        """Derivative of the sum of `element_forces` by u, (18, 18), in closed form."""

    # --- for the whole shell -------------------------------------------------------------------------------

    @abc.abstractmethod
    def begin(self, model: Model, state, dt) -> tuple[Any, Any, Float[Array, "n 6"]]:
        """Constants of the step: data per element, data that they share, and the dead loads of the balance."""

    @abc.abstractmethod
    def finish(self, model: Model, state, dt, u: Float[Array, "n 6"], motion: Motion, begun) -> Any:
        """The state at the end of the step from the converged increments."""

    def predict(self, model: Model, state, dt) -> Float[Array, "n 6"]:
        """The increments from which Newton starts; states keep the `rates` of the last steps for it."""
        return extrapolate(state.rates, dt)

    def configuration(self, state) -> tuple[Float[Array, "n 3"], Float[Array, "n 3 3"]]:
        """Positions and rotations to which the increments of a step are added."""
        return state.x, state.R

    def motion(self, state, u: Float[Array, "n 6"]) -> Motion:
        """Motion of all nodes."""
        return jax.vmap(self.node_motion)(u, *self.configuration(state))

    def balance(self, model: Model, state, begun, u: Float[Array, "n 6"]) -> Balance:
        """The residual of the step at the increments u."""
        data, step, loads = begun
        forces = jax.vmap(self.element_forces, in_axes=(0, 0, 0, None))(
            model.gather(self.motion(state, u)), model.gather(u), data, step
        )
        residual = model.assemble_vector(forces.elastic + forces.inertial) - loads
        parts = [f.reshape(-1, 2, 3) for f in (forces.elastic, forces.inertial, loads)]
        force, moment = (jnp.max(jnp.stack([jnp.max(jnp.abs(f[:, k])) for f in parts])) for k in (0, 1))
        return Balance(residual, force, moment)

    def matrices(self, model: Model, state, begun, u: Float[Array, "n 6"], tangent: str) -> Float[Array, "m 18 18"]:
        """Element tangents at the increments u: `tangent` is "closed_form" or "autodiff"."""
        data, step, _ = begun
        if tangent == "closed_form":
            motion = model.gather(self.motion(state, u))
            return jax.vmap(self.element_tangent, in_axes=(0, 0, 0, None))(motion, model.gather(u), data, step)

        def forces(u, x, R, data):
            u = u.reshape(3, 6)
            found = self.element_forces(jax.vmap(self.node_motion)(u, x, R), u, data, step)
            return found.elastic + found.inertial

        corners = model.gather((u, *self.configuration(state)))
        return jax.vmap(jax.jacfwd(forces))(corners[0].reshape(-1, 18), corners[1], corners[2], data)

    def mixed_matrices(self, model: Model, state, begun, u, last, tangent: str) -> Float[Array, "m 18 18"]:
        """Element tangents that Newton uses at the iterate u (n, 6), which it reached from the iterate `last`.

        The exact ones, unless a method knows better before convergence; the same where u and `last` agree.
        """
        return self.matrices(model, state, begun, u, tangent)

    def step(self, model, state, dt, solvers, memory):
        # The iteration is outside differentiation; its result then gets the derivative of the equations solved.
        fixed = jax.lax.stop_gradient((self, model, state, dt))
        solved, memory = one_by_one(_converge, memory, *fixed, solvers)
        solved = keep(solved)
        begun, held, problem = _problem(self, model, state, dt, solvers)
        u = self._differentiable(model, state, begun, held, problem, solved, solvers)
        info = StepInfo(solved.result, solved.iterations, solved.factorizations, solved.correction)
        return self.finish(model, state, dt, u, self.motion(state, u), begun), info, memory

    def unbalanced(self, model, before, after, dt):
        return self.balance(model, before, self.begin(model, before, dt), dt * after.rates[0]).residual

    def _differentiable(self, model, state, begun, held, problem, solved, solvers) -> Float[Array, "n 6"]:
        """The converged increments, with the derivative of the equations that they solve."""
        if not solvers.differentiated:
            return model.expand(solved.free, held)
        matrices = self.matrices(model, state, begun, model.expand(solved.free, held), solvers.tangent)
        free = attach_derivative(
            solvers.linear.solver,
            solvers.linear.handle,
            solved.free,
            model.free(problem.balance(solved.free).residual),
            jax.lax.stop_gradient(model.assemble_matrix(matrices)),
        )
        return model.expand(free, held)


def _converge(memory: Memory, method: ImplicitMethod, model: Model, state, dt, solvers: Solvers):
    """Newton's iteration of one step: (Solved, Memory). In a batch the factorization kept is another member's."""
    _, _, problem = _problem(method, model, state, dt, solvers)
    guess = model.free(method.predict(model, state, dt))
    return solvers.newton.solve(problem, guess, *_scales(model), solvers.linear, memory)


def _scales(model: Model):
    """What scales the corrections: the shell's size, and which free freedoms are rotations."""
    return model.size, model.tables.free % 6 >= 3


def _problem(method: ImplicitMethod, model: Model, state, dt, solvers: Solvers):
    """(constants of the step, held increments, equations) of one step."""
    begun = method.begin(model, state, dt)
    held = model.held_displacement(state.time + dt) - model.held_displacement(state.time)

    def matrix(free, last):
        # At the start of the step, where `last` is zero, the held freedoms have not moved either.
        last = model.expand(last, jnp.where(jnp.any(last != 0), held, 0.0))
        u = model.expand(free, held)
        return model.assemble_matrix(method.mixed_matrices(model, state, begun, u, last, solvers.tangent))

    problem = Problem(
        lambda free: method.balance(model, state, begun, model.expand(free, held)),
        matrix,
        model.free,
    )
    return begun, held, problem
