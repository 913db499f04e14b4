"""Load steps, and the way from an equilibrium that has become unstable to one that is stable.

At an unstable equilibrium the load factor is held, the shell is moved a little along its critical motion, and sinks
from there through the viscous steps of `jaxshell.methods.static.Relaxing`. Their viscosity is at first a little more
than what keeps their equations solvable, by the critical μ of `jaxshell.analyses.stability`, and fades as the steps get
smaller. The last step has none: an equilibrium like any other. Behind a bifurcation that is stable at first (columns,
plates) it is on the new branch, near by; else where the shell comes to rest after a snap without inertia.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.analyses import program
from jaxshell.analyses.program import Frame, Plan, Record
from jaxshell.analyses.stability import Critical, critical
from jaxshell.assembly.discretised import Model
from jaxshell.methods.static import Relaxing, StaticState
from jaxshell.numerics import rotations
from jaxshell.numerics.compiled import compiled
from jaxshell.solvers.iteration import STAGNATED, SUCCESSFUL

NUDGE = 1e-3
"""How far an unstable equilibrium is moved along its critical motion, as a fraction of the shell's size."""
_MARGIN = 1.5
"""The viscosity begins with -μ times this. It is kept while the steps grow, and shrinks as they do ..."""
_FADING, _STIFFENING = 0.1, 4.0
"""... down to this part of it at once, and grows by so much where a step fails, ..."""
_ENDS, _MOST = 1e-4, 1e4
"""... until a step moves the shell by less than this part of its size (or so many radians), or it is above this."""
_STEPS = 200
"""So many viscous steps at most lead from an equilibrium to the next."""


class Step(NamedTuple):
    """What a load step, or the descent to a stable equilibrium, led to."""

    state: StaticState
    memory: Any
    code: int
    record: Record
    frame: Frame
    weakest: Critical
    spent: np.ndarray
    """Iterations and factorizations, (2,)."""


def load_step(model: Model, plan: Plan, state: StaticState, memory, step: float, end: float) -> Step:
    """One load step of size `step` to the load factor `end`."""
    found = _advance(model, plan, state, memory, jnp.asarray(step), jnp.asarray(end))
    state, memory, code, record, frame, weakest = found
    return Step(state, memory, int(code), record, frame, weakest, _cost(record))


def descent(model: Model, plan: Plan, unstable: Step) -> Step:
    """From an unstable equilibrium to a stable one at the same load factor.

    Where none is found the code says so, with the equilibrium that it started from.
    """
    end = float(unstable.state.time)
    state, memory, spent = _nudged(model, unstable.state, unstable.weakest.mode), unstable.memory, unstable.spent.copy()
    viscosity, last = -_MARGIN * float(unstable.weakest.quotient), np.inf
    for _ in range(_STEPS):
        found = load_step(model, plan._replace(method=Relaxing(jnp.asarray(viscosity))), state, memory, 0.0, end)
        memory, spent = found.memory, spent + found.spent
        if found.code != SUCCESSFUL:
            viscosity, last = max(_STIFFENING * viscosity, _ENDS), np.inf
            if viscosity > _MOST:
                break
            continue
        quotient, moved = float(found.weakest.quotient), _moved(model, state, found.state)
        state = found.state
        if viscosity > 0:
            fading = float(np.clip(moved / last, _FADING, 1.0)) if np.isfinite(last) else 1.0
            viscosity = 0.0 if moved < _ENDS else max(fading * viscosity, -_MARGIN * quotient)
            last = moved
        elif quotient > 0:
            return found._replace(spent=spent)
        else:
            state, viscosity, last = _nudged(model, state, found.weakest.mode), -_MARGIN * quotient, np.inf
    return unstable._replace(code=int(STAGNATED), spent=spent)


def _moved(model: Model, before: StaticState, after: StaticState) -> float:
    """The largest motion of a node between two states, over the shell's size and in radians."""
    moves = jnp.max(jnp.abs(after.d - before.d)) / model.size
    return float(jnp.maximum(moves, jnp.max(jnp.abs(after.R - before.R))))


@compiled
def _advance(model: Model, plan: Plan, state: StaticState, memory, step, end):
    """State, memory, result, record, frame and critical motion of a step to the load factor `end`."""
    before = state
    state, info, memory = plan.method.step(model, before, step, plan.solvers, memory)
    state = eqx.tree_at(lambda s: s.time, state, end)
    weakest, memory = critical(model, plan.solvers, before, state, memory)
    record = program.record(model, plan, before, state, None, info.iterations, info.factorizations, jnp.array(True))
    return state, memory, info.result, record, program.frame(model, state), weakest


def _cost(record: Record) -> np.ndarray:
    return np.array([int(record.iterations), int(record.factorizations)])


@compiled
def _nudged(model: Model, state: StaticState, mode: Float[Array, "n 6"]) -> StaticState:
    move = NUDGE * model.size * mode
    turned = jax.vmap(rotations.exp)(move[:, 3:]) @ state.R
    return eqx.tree_at(lambda s: (s.d, s.R), state, (state.d + move[:, :3], turned))
