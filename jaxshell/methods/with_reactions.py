"""A method that also records what the supports carry: any other one, with one residual more in every step.

    reaction = f_iner + f_int - f_ext   at the held freedoms, of the balance that the method solved in the step.

Accelerations and spins live in the states of a step, not in the frames of a solution, so that reactions are
taken when the step is.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.methods import predictor
from jaxshell.methods.base import Method, Observation
from jaxshell.model import Model


class StateWithReaction(eqx.Module):
    """The method's own state, and what the supports carried in the step that led to it."""

    own: Any
    reaction: Float[Array, " nh"]

    @property
    def time(self) -> Float[Array, ""]:
        return self.own.time

    @property
    def x(self) -> Float[Array, "n 3"]:
        return self.own.x

    @property
    def R(self) -> Float[Array, "n 3 3"]:
        return self.own.R

    @property
    def v(self) -> Float[Array, "n 3"]:
        return self.own.v

    @property
    def rates(self) -> predictor.Rates:
        return self.own.rates


class WithReactions(Method):
    """`method`, recording reactions; `simulate(..., reactions=True)` makes it."""

    method: Method

    @property
    def uses_matrix(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.method.uses_matrix

    def start(self, model: Model, scene, time) -> StateWithReaction:
        """No step has been taken, and no balance solved: NaN."""
        unknown = jnp.full(model.tables.held.shape, jnp.nan)
        return StateWithReaction(self.method.start(model, scene, time), unknown)

    def observe(self, model: Model, state: StateWithReaction) -> Observation:
        return self.method.observe(model, state.own)._replace(reaction=state.reaction)

    def step(self, model: Model, state: StateWithReaction, dt, solvers, memory):
        own, info, memory = self.method.step(model, state.own, dt, solvers, memory)
        left = self.method.unbalanced(model, state.own, own, dt)
        return StateWithReaction(own, left.reshape(-1)[model.tables.held]), info, memory

    def unbalanced(self, model: Model, before: StateWithReaction, after: StateWithReaction, dt):
        return self.method.unbalanced(model, before.own, after.own, dt)
