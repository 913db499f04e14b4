"""What the implicit methods have in common: the residual and its tangent from one element, and one Newton step.

A method states, for ONE element, the forces in its balance and their closed-form tangent as functions of the
nodal increments u = (Δx, θ) of the step. This file gathers, vmaps, assembles, differentiates (`jax.jacfwd`)
and hands both to Newton. Δx [length] and θ [rad] are increments from the start of the step, so that what
converges does not depend on the path of the iterates.
"""

import abc
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.assembly.acting import Acting
from jaxshell.assembly.discretised import Model
from jaxshell.gradients import keep
from jaxshell.methods.balance import Balance, Begun, Forces, Motion, Taken
from jaxshell.methods.method import Method, Solvers, StepInfo
from jaxshell.methods.predictor import extrapolate
from jaxshell.methods.turning import turning
from jaxshell.model.contribution import Constraint, Contribution, Place, Resisting, between
from jaxshell.numerics.batching import one_by_one
from jaxshell.numerics.kernels import each
from jaxshell.numerics.rotations import H_inverse, exp
from jaxshell.solvers.iteration import Memory, Problem
from jaxshell.solvers.newton import attach_derivative


class ImplicitMethod(Method):
    """A method whose step solves a nonlinear balance with Newton's iteration."""

    # --- for one node or one element -----------------------------------------------------------------------

    def node_motion(self, u: Float[Array, "6"], x: Float[Array, "3"], R: Float[Array, "3 3"]) -> Motion:
        """Position and rotation of one node after the increments u; rotation vectors by default, eq. (103)."""
        theta = u[3:]
        return Motion(x + u[:3], exp(theta) @ R, theta, H_inverse(theta))

    def size_of_turn(self, angle) -> Float[Array, ""]:
        """The size of the rotation's parameters of a turn by `angle` [rad] about a fixed axis, in its direction."""
        return angle

    @abc.abstractmethod
    def element_forces(self, motion: Motion, u: Float[Array, "3 6"], data, step) -> Forces:
        """Forces of one element; `data` is its own step data, `step` what all elements share."""

    @abc.abstractmethod
    def element_tangent(self, motion: Motion, u: Float[Array, "3 6"], data, step) -> Float[Array, "18 18"]:
        """Derivative of the sum of `element_forces` by u, (18, 18), in closed form."""

    def lump_force(self, u: Float[Array, "6"], lump, step) -> Float[Array, "6"]:
        """Inertia of one point mass; `lump` is its own step data, in `Begun.lumps`."""
        return jnp.zeros(6)

    # --- for the whole shell -------------------------------------------------------------------------------

    @abc.abstractmethod
    def begin(self, model: Model, state, dt) -> Begun:
        """Constants of the step."""

    @abc.abstractmethod
    def finish(self, model: Model, state, dt, u: Float[Array, "n 6"], motion: Motion, begun: Begun) -> Any:
        """The state at the end of the step from the converged increments."""

    def predict(self, model: Model, state, dt) -> Float[Array, "n 6"]:
        """The increments from which Newton starts; states keep the `rates` of the last steps for it."""
        return extrapolate(state.rates, dt)

    def calm(self, model: Model, state, dt) -> Float[Array, "n 6"] | None:
        """Increments to start from where those of `predict` are far from balance; None where there are none."""
        return None

    def mean_turn(self, theta: Float[Array, "3"]) -> Float[Array, "3 3"]:
        """A with R₁ - R₀ = ~θ A R₀ for a node's rotation in a step."""
        return H_inverse(theta)

    def increments(self, model: Model, state, free: Float[Array, " nf"], held: Float[Array, " nh"]):
        """The increments of all nodes (n, 6) from those that are unknown and those that are held."""
        unknown = model.expand(free, held)
        if model.elimination is None:
            return unknown
        return model.elimination.nodal(unknown, self.configuration(state)[1], self.mean_turn)

    def _levers(self, model: Model, state, begun: "Begun", u):
        """Of followers, at the place of the balance and at the end of the step."""
        assert model.elimination is not None
        R, weight = self.configuration(state)[1], self.weight_at_end(begun.step)
        return model.elimination.levers(u, R, self.mean_turn, weight)

    def configuration(self, state) -> tuple[Float[Array, "n 3"], Float[Array, "n 3 3"]]:
        """Positions and rotations to which the increments of a step are added."""
        return state.x, state.R

    def positions(self, model: Model, x: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """Positions from what `configuration` and a `Motion` hold."""
        return x

    def weight_at_end(self, step) -> Any:
        """What the forces of contributions at the end of the step count in the balance; `step` as `begin` gives it.

        What they count at its start stands in the loads of `begin`. It is also where between the ends of the step
        the balance stands.
        """
        return 1.0

    def rates_at(self, state, begun: "Begun", u: Float[Array, "n 6"]) -> Float[Array, "n 6"]:
        """Velocities and angular velocities where the balance stands, for what resists the motion.

        From the mean rates of this step and the last one, of second order where steps are equal.
        """
        mean = u / (begun.end - state.time)
        return mean + (self.weight_at_end(begun.step) - 0.5) * (mean - state.rates[0])

    def motion(self, state, u: Float[Array, "n 6"]) -> Motion:
        """Motion of all nodes."""
        return each(self.node_motion)(u, *self.configuration(state))

    def balance(self, model: Model, state, begun, u: Float[Array, "n 6"]) -> Balance:
        """The residual of the step at the increments u: at the unknowns, see `jaxshell.assembly.elimination`."""
        found = self.nodal_balance(model, state, begun, u)
        if model.elimination is None:
            return found
        levers, _ = self._levers(model, state, begun, u)
        return found._replace(residual=model.elimination.collected(found.residual, levers))

    def nodal_balance(self, model: Model, state, begun, u: Float[Array, "n 6"]) -> Balance:
        """The same at every node."""
        data, step, loads = begun.data, begun.step, begun.loads
        motion, corners = self.motion(state, u), model.gather(u)
        forces = each(self.element_forces, in_axes=(0, 0, 0, None))(model.gather(motion), corners, data, step)
        residual = model.assemble_vector(forces.elastic + forces.inertial) - loads
        residual, others = self._with_others(model, state, begun, motion, u, residual)
        parts = [(forces.elastic, corners), (forces.inertial, corners), (loads, u), *others]
        parts = [part for part in parts if part[0].size]
        works = [jnp.sum(f.reshape(len(f), -1) * d.reshape(len(f), -1), axis=1) for f, d in parts]
        work = sum((jnp.sum(jnp.abs(w)) for w in works), jnp.zeros(()))
        halves = [f.reshape(-1, 2, 3) for f, _ in parts]
        force, moment = (jnp.max(jnp.stack([jnp.max(jnp.abs(f[:, k])) for f in halves])) for k in (0, 1))
        return Balance(residual, force, moment, work)

    def _with_others(self, model: Model, state, begun, motion: Motion, u, residual: Float[Array, "n 6"]):
        """A residual with contributions and point masses, and (force, increments of its nodes) of each of them."""
        parts = []
        for acting, force in self.following(model, state, begun, motion, u):
            residual = residual - model.sum_over_nodes(acting, force)
            parts.append((force, u[acting.nodes]))
        if model.lumps is not None:
            force = jax.vmap(self.lump_force, in_axes=(0, 0, None))(u[model.lumps.at], begun.lumps, begun.step)
            residual = residual.at[model.lumps.at].add(force)
            parts.append((force, u[model.lumps.at]))
        return residual, parts

    def _at_followers(self, model: Model, state, begun, motion: Motion, u) -> Float[Array, "n 6"]:
        """The residual of `nodal_balance` at nodes that follow others, from the elements that they belong to alone."""
        assert model.tables.dependent is not None
        touched = model.tables.dependent.touched
        whole = model.gather(motion), model.gather(u), begun.data
        moved, corners, data = jax.tree.map(lambda a: a[touched], whole)
        forces = each(self.element_forces, in_axes=(0, 0, 0, None))(moved, corners, data, begun.step)
        own = (forces.elastic + forces.inertial).reshape(-1, 3, 6)
        found = (-begun.loads).at[model.tables.triangles[touched]].add(own)
        return self._with_others(model, state, begun, motion, u, found)[0]

    def matrices(self, model: Model, state, begun, u: Float[Array, "n 6"], tangent: str) -> Float[Array, "m 18 18"]:
        """Element tangents at the increments u: `tangent` is "closed_form" or "autodiff"."""
        data, step = begun.data, begun.step
        if tangent == "closed_form":
            motion = model.gather(self.motion(state, u))
            return each(self.element_tangent, in_axes=(0, 0, 0, None))(motion, model.gather(u), data, step)

        def forces(u, x, R, data):
            u = u.reshape(3, 6)
            found = self.element_forces(jax.vmap(self.node_motion)(u, x, R), u, data, step)
            return found.elastic + found.inertial

        corners = model.gather((u, *self.configuration(state)))
        return jax.vmap(jax.jacfwd(forces))(corners[0].reshape(-1, 18), corners[1], corners[2], data)

    def following(self, model: Model, state, begun: Begun, motion: Motion, u) -> list[tuple[Acting, Any]]:
        """The contributions and their forces (k, c, 6) on each group, as they stand in the balance."""
        found = []
        rates = self._rates(model, state, begun, u)
        for acting in self.acting(model):
            start, end = self._places(model, acting, state, begun, motion)
            found.append((acting, self._group_forces(acting, start, end, rates, begun.step)))
        return found

    def acting(self, model: Model) -> tuple[Acting, ...]:
        """The contributions that stand in the balance."""
        return tuple(a for a in model.contributions if self.has_rates or not a.resists)

    def _rates(self, model: Model, state, begun: Begun, u) -> Any:
        return self.rates_at(state, begun, u) if self.has_rates and model.resisting else None

    def _group_forces(self, acting: Acting, start: Place, end: Place, rates, step) -> Float[Array, "k c 6"]:
        """What a contribution puts into the balance, on each group."""
        own = rates[acting.nodes] if acting.resists else None
        on_group = jax.vmap(self._on_group, in_axes=(None, 0, 0, 0, 0, None))
        return on_group(acting.contribution, acting.data, start, end, own, step)

    def _on_group(self, contribution: Contribution, data, start: Place, end: Place, rates, step, last=None):
        """The same on one group (c, 6); `rates` are of its nodes, None but for what resists, and `last` those of the
        iterate before, where a tangent of the iteration is wanted."""
        if isinstance(contribution, Resisting):
            middle = between(start, end, self.weight_at_end(step))
            if last is not None:
                return contribution.iterated(data, start, end, middle, rates, last)
            return contribution.resistance(data, start, end, middle, rates)
        if isinstance(contribution, Constraint):
            return contribution.balanced(data, start, end, self.weight_at_end(step))
        if self.balances_means:
            return contribution.mean_force(data, start, end)
        return self.weight_at_end(step) * contribution.end_force(data, start, end)

    def work_of_loads(self, model: Model, state, begun: Begun, motion: Motion, u) -> Float[Array, ""]:
        """External work on the increments u, as the balance has it: of loads, of moving supports and of what moves
        elastic contributions."""
        work = jnp.sum(begun.loads * u)
        for acting, force in self.following(model, state, begun, motion, u):
            done = jnp.sum(force * u[acting.nodes])
            if acting.is_elastic:
                work = work + self._work_of_drive(model, acting, state, begun, motion, u, done)
            elif acting.is_plain:
                work = work + done
        if model.moving:
            # Supports that move work with the reaction, the residual at the held degrees of freedom.
            reaction = self.balance(model, state, begun, u).residual.reshape(-1)[model.tables.held]
            work = work + jnp.sum(reaction * model.along_held(u))
        return work

    def taken(self, model: Model, state, begun: Begun, motion: Motion, u) -> Taken:
        """Energy taken in the step by what resists, from mean velocities: never negative, and of second order.

        Exact where the balance stands in the middle of the step.
        """
        rates, lost, work = u / (begun.end - state.time), jnp.zeros(()), jnp.zeros(())
        for acting in model.resisting:
            start, end = self._places(model, acting, state, begun, motion)
            forces = acting.resistance(start, end, between(start, end), rates[acting.nodes])
            lost = lost - jnp.sum(forces * u[acting.nodes])
            if acting.is_carried:
                done = jnp.sum(forces * acting.carried(start, end))
                lost, work = lost + done, work + done
        return Taken(lost, work)

    def _work_of_drive(self, model: Model, acting: Acting, state, begun: Begun, motion: Motion, u, done):
        """External work at an elastic contribution, whose forces at the end do the work `done`: what drives it.

        The loads of the balance hold its forces at the start, where they are no mean: their work is taken out again.
        """
        start, end = self._places(model, acting, state, begun, motion)
        of_start = jnp.zeros(())
        if not self.balances_means:
            forces = (1.0 - self.weight_at_end(begun.step)) * acting.forces(start)
            of_start = jnp.sum(forces * u[acting.nodes])
        return acting.energy(end) - acting.energy(start) + done if acting.is_driven else -of_start

    def following_matrices(
        self, model: Model, state, begun: Begun, u, tangent: str, last=None
    ) -> list[tuple[Acting, Any]]:
        """What `following` adds to the tangent: matrices (k, 6c, 6c) by the increments u, reached from `last`."""
        motion, found = self.motion(state, u), []
        for acting in self.acting(model):
            start, end = self._places(model, acting, state, begun, motion)
            if tangent == "autodiff" or acting.resists or acting.constrains:
                K = self._differentiated(model, acting, state, begun, u, last)
            elif self.balances_means:
                K = by_increments(acting.mean_stiffness(start, end), motion.spin[acting.nodes])
            else:
                weight = self.weight_at_end(begun.step)
                K = weight * by_increments(acting.stiffness(end), motion.spin[acting.nodes])
            found.append((acting, -K))
        return found

    def _places(self, model: Model, acting: Acting, state, begun: Begun, motion: Motion):
        x, R = self.configuration(state)
        start = acting.places(self.positions(model, x), R, state.time)
        return start, acting.places(self.positions(model, motion.x), motion.R, begun.end)

    def _differentiated(self, model: Model, acting: Acting, state, begun: Begun, u, last):
        """The matrices of a contribution by `jax.jacfwd`, the reference."""
        x, R = self.configuration(state)
        offset = self.positions(model, x) - x
        # Rates change with the increments alike at every node.
        rates = slope = jnp.zeros((x.shape[0], 6))
        if acting.resists:
            rates, slope = jax.jvp(lambda u: self.rates_at(state, begun, u), (u,), (jnp.ones_like(u),))
        earlier = None if last is None or not acting.resists else self.rates_at(state, begun, last)[acting.nodes]

        def force(u, x, R, offset, start, data, before, rates, slope, earlier):
            motion = jax.vmap(self.node_motion)(u.reshape(-1, 6), x, R)
            end = Place(motion.x + offset, motion.R, begun.end)
            rates = rates + slope * (u.reshape(-1, 6) - before)
            return self._on_group(acting.contribution, data, start, end, rates, begun.step, earlier).reshape(-1)

        nodes = acting.nodes
        start = acting.places(self.positions(model, x), R, state.time)
        groups = u[nodes].reshape(nodes.shape[0], -1)
        more = start, acting.data, u[nodes], rates[nodes], slope[nodes], earlier
        return jax.vmap(jax.jacfwd(force))(groups, x[nodes], R[nodes], offset[nodes], *more)

    def tangent(self, model: Model, state, begun: Begun, u, last, tangent: str) -> Float[Array, " nnz"]:
        """Values of the sparse tangent at the iterate u, reached from `last`; None for the exact one."""
        if last is None:
            matrices = self.matrices(model, state, begun, u, tangent)
        else:
            matrices = self.mixed_matrices(model, state, begun, u, last, tangent)
        others: list[Any] = [*self.following_matrices(model, state, begun, u, tangent, last)]
        if model.lumps is not None:
            slope = jax.vmap(jax.jacfwd(self.lump_force), in_axes=(0, 0, None))
            others.append((model.lumps, slope(u[model.lumps.at], begun.lumps, begun.step)))
        if model.elimination is None:
            return model.assemble_matrix(matrices, others)
        levers, ends = self._levers(model, state, begun, u)
        motion = self.motion(state, u)
        spin, forces = motion.spin, self._at_followers(model, state, begun, motion, u)
        turning = model.elimination.turning(forces, ends, spin, self.weight_at_end(begun.step))
        return model.assemble_matrix(matrices, others, model.elimination.blocks(levers, ends, spin), turning)

    def mixed_matrices(self, model: Model, state, begun, u, last, tangent: str) -> Float[Array, "m 18 18"]:
        """Element tangents that Newton uses at the iterate u (n, 6), which it reached from the iterate `last`.

        The exact ones, unless a method knows better before convergence; the same where u and `last` agree.
        """
        return self.matrices(model, state, begun, u, tangent)

    def step(self, model, state, dt, solvers, memory):
        # The iteration is outside differentiation; its result then gets the derivative of the equations solved.
        solvers = solvers._replace(linear=solvers.linear.posed(model))
        begun, held = self.begin(model, state, dt), model.held_increment(state.time, dt, self.size_of_turn)
        fixed = jax.lax.stop_gradient((self, model, state, dt, begun, held))
        solved, memory = one_by_one(_converge, memory, *fixed, solvers)
        solved = keep(solved)
        u = self._differentiable(model, state, begun, held, solved.free, solvers)
        info = StepInfo(solved.result, solved.iterations, solved.factorizations, solved.correction)
        return self.finish(model, state, dt, u, self.motion(state, u), begun), info, memory

    def unbalanced(self, model, before, after, dt):
        return self.balance(model, before, self.begin(model, before, dt), dt * after.rates[0]).residual

    def _differentiable(self, model, state, begun, held, free, solvers) -> Float[Array, "n 6"]:
        """The converged increments, with the derivatives of the equations that they solve."""
        if solvers.differentiated:
            parameters = self, model, state, begun, held, solvers.tangent
            free = attach_derivative(solvers.linear, _residual, _tangent, free, parameters)
        return self.increments(model, state, free, held)


def _residual(free, parameters) -> Float[Array, " nf"]:
    """Of the free degrees of freedom, as a function of all that a step's equations depend on."""
    method, model, state, begun, held, _ = parameters
    return model.free(method.balance(model, state, begun, method.increments(model, state, free, held)).residual)


def _tangent(free, parameters) -> Float[Array, " nnz"]:
    method, model, state, begun, held, tangent = parameters
    return method.tangent(model, state, begun, method.increments(model, state, free, held), None, tangent)


def by_increments(K: Float[Array, "k d d"], spin: Float[Array, "k c 3 3"]) -> Float[Array, "k d d"]:
    """Matrices by displacements and spins → by displacements and the rotations that are unknowns."""
    blocks = K.reshape(*K.shape[:2], -1, 2, 3)
    turned = jnp.einsum("krci,kcij->krcj", blocks[:, :, :, 1], spin)
    return jnp.stack([blocks[:, :, :, 0], turned], axis=3).reshape(K.shape)


def _converge(memory: Memory, method: ImplicitMethod, model: Model, state, dt, begun, held, solvers: Solvers):
    """Newton's iteration of one step: (Solved, Memory). In a batch the factorization kept is another member's."""
    problem = _problem(method, model, state, begun, held, solvers)
    guess, calm = model.unknowns(method.predict(model, state, dt)), method.calm(model, state, dt)
    calm = None if calm is None else model.unknowns(calm)
    return solvers.newton.solve(problem, guess, *_scales(model), solvers.linear, memory, calm)


def _scales(model: Model):
    """What scales the corrections: the shell's size, and which free degrees of freedom are rotations."""
    return model.size, model.tables.free % 6 >= 3


def _problem(method: ImplicitMethod, model: Model, state, begun: Begun, held, solvers: Solvers) -> Problem:
    """The equations of one step."""

    def matrix(free, last):
        # At the start of the step, where `last` is zero, the held degrees of freedom have not moved either.
        last = method.increments(model, state, last, jnp.where(jnp.any(last != 0), held, 0.0))
        u = method.increments(model, state, free, held)
        return method.tangent(model, state, begun, u, last, solvers.tangent)

    return Problem(
        lambda free: method.balance(model, state, begun, method.increments(model, state, free, held)),
        matrix,
        model.free,
        turning(model, method.configuration(state)[1]),
    )
