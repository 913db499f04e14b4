"""Static equilibrium: `solve_static` steps the load factor, `reactions` are what the supports carry.

One load step is one compiled program (`jaxshell.methods.static`); the host cuts a step that fails in half
and lets the steps grow back. When `solve_static` is being traced (by `jax.grad`, `jax.vmap`, `jax.jit`) the
given load factors are taken as they are, in one program, and differentiated by the implicit function
theorem.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.analyses import program
from jaxshell.analyses.driver import (
    Log,
    Setup,
    SimulationError,
    check_options,
    check_untraced,
    is_traced,
    result_of,
    run_traced,
    set_up,
    single,
)
from jaxshell.analyses.program import Plan
from jaxshell.analyses.progress import Progress
from jaxshell.assembly.discretised import Model, structure_of
from jaxshell.assembly.tables import Tables, analyse
from jaxshell.gradients import Stored
from jaxshell.methods.static import Static, StaticState, reactions_at
from jaxshell.model.history import History
from jaxshell.model.mechanisms import check_supported
from jaxshell.model.scene import Scene
from jaxshell.numerics.checks import check_finite, is_concrete, require_float64
from jaxshell.numerics.compiled import compiled
from jaxshell.results.solution import RESULTS, Solution
from jaxshell.solvers.iteration import SUCCESSFUL
from jaxshell.solvers.linear_solver import LinearSolver
from jaxshell.solvers.newton import Newton

DEFAULT_NEWTON = Newton(tolerance=1e-12, reuse=False)
"""Tighter than in dynamics, so that loads and reactions are in balance to 1e-9."""
_CUTS = 10
"""A load step is halved at most this many times."""


class LoadFactor(History):
    """The history of every load in statics: the load factor itself, of either sign and any size."""

    def __init__(self):
        super().__init__([0.0, 1.0], [0.0, 1.0])

    def __call__(self, time) -> Float[Array, ""]:
        return jnp.asarray(time)


def proportional(scene: Scene) -> Scene:
    """The scene with all loads and prescribed displacements in proportion to the load factor."""

    loads = range(len(scene.loads))
    moving = [i for i, support in enumerate(scene.supports) if support.displacement is not None]

    def histories(scene):
        return [scene.loads[i].history for i in loads] + [scene.supports[i].history for i in moving]

    return eqx.tree_at(histories, scene, [LoadFactor() for _ in (*loads, *moving)])


def solve_static(
    scene: Scene,
    load_factors: Sequence[float] | np.ndarray | None = None,
    *,
    tangent: str = "closed_form",
    newton: Newton | None = None,
    linear_solver: LinearSolver | None = None,
    save_every: int = 1,
    throw: bool = True,
    progress: bool = False,
    output=None,
) -> Solution:
    """Static equilibrium at a sequence of load factors.

    Every load and every prescribed displacement acts as load factor times its full value; its history (how it
    varies in time) is not looked at. Initial displacements and rotations of the scene are where the iteration
    starts, initial velocities are ignored.

    Arguments:
        scene: what to load. Its supports must leave no rigid-body motion free. Differentiable in its floats.
        load_factors: where equilibrium is wanted, in the order in which the loads pass through them (they may
            fall again and change sign); None is 0.1, 0.2, ..., 1. A step that fails is halved, up to ten
            times, and the steps grow back to the factors asked for. Around a limit point no load step is
            small enough: see `solve_arc_length`.
        tangent: "closed_form" or "autodiff"; the same answer.
        newton, linear_solver, progress, output: as in `simulate`.
        save_every: load factors between frames.
        throw: raise `SimulationError` when a load factor is not reached (it carries the solution so far);
            otherwise the solution's `result` and `message` say so.

    Returns a `Solution` whose times are the load factors (the first entry, 0, is the start); after a failure
    the last entry is the largest part of the failed step that was reached. `iterations` counts all that were
    spent on the way to a load factor. Kinetic energy and momenta are zero. Under `jax.grad` and the like no
    step is halved.

    Raises ValueError for bad input and for a mechanism, which it names, before anything is compiled.
    """
    require_float64()
    newton = DEFAULT_NEWTON if newton is None else newton
    check_options(scene, Static(), save_every, tangent, newton)
    factors = _load_factors(load_factors)
    check_supported(scene)
    traced = is_traced(scene, newton, factors)
    setup = set_up(
        scene,
        Static(),
        newton,
        linear_solver=linear_solver,
        tangent=tangent,
        save_every=save_every,
        differentiated=traced,
    )
    if traced:
        check_untraced(output, progress)
        steps = jnp.diff(jnp.asarray(factors), prepend=0.0)
        loaded = setup._replace(scene=proportional(scene))
        solution = run_traced(loaded, steps, Stored(), throw, analysis="static")
        return eqx.tree_at(lambda s: s.scene, solution, scene)
    with Progress(float(factors[-1]), enabled=progress) as bar:
        solution = _driven(setup, factors, output, bar)
    if throw and solution.message:
        raise SimulationError(solution.message, solution)
    return solution


@compiled
def _advance(model: Model, plan: Plan, state: StaticState, memory, step, end):
    """One load step of size `step` to the load factor `end`: state, memory, result, record and frame."""
    state, info, memory = plan.method.step(model, state, step, plan.solvers, memory)
    state = eqx.tree_at(lambda s: s.time, state, end)
    record = program.record(model, plan, state, None, info.iterations, info.factorizations, jnp.array(True))
    return state, memory, info.result, record, program.frame(model, state)


class _Reached(NamedTuple):
    """How far the load factor has come."""

    state: StaticState
    memory: Any
    at: float
    size: float
    """The largest step to try next."""
    code: int


def _driven(setup: Setup, factors, output, bar) -> Solution:
    log = StaticLog(setup, output)
    model, carry, record, frame = setup.prepare(proportional(setup.scene))
    now = _Reached(carry.state, carry.memory, 0.0, np.inf, int(SUCCESSFUL))
    message = ""
    with log:
        log.start(record, frame)
        for position, target in enumerate(factors):
            now, found, spent = _reach(model, setup.plan, now, target)
            failed = now.code != SUCCESSFUL
            if found is not None:
                log.step(*found, spent, last=failed or position == len(factors) - 1)
                bar.advance(log.records[-1])
            if failed:
                message = _message(now.code, now.at, target)
                break
        return log.finish(now.state, now.code, message)


def _reach(model: Model, plan: Plan, now: _Reached, target):
    """Go to the load factor `target`, halving steps that fail and letting them grow back.

    Returns (where that led, the last step's record and frame if there was one, iterations and factorizations).
    """
    state, memory, at, size, code = now
    smallest = abs(target - at) / 2**_CUTS
    spent, found = np.zeros(2, int), None
    while at != target:
        rest = target - at
        # All of the rest where only round-off keeps it from fitting: no sliver of a step is left.
        whole = abs(rest) <= size * (1 + 1e-6)
        step, end = (rest, target) if whole else (np.copysign(size, rest), at + np.copysign(size, rest))
        new, memory, code, record, frame = _advance(model, plan, state, memory, jnp.asarray(step), jnp.asarray(end))
        code = int(code)
        spent += int(record.iterations), int(record.factorizations)
        if code == SUCCESSFUL:
            state, at, size, found = new, float(end), max(size, 2 * abs(step)), (record, frame)
        elif abs(step) / 2 < smallest:
            break
        else:
            size = abs(step) / 2
    return _Reached(state, memory, at, size, code), found, spent


class StaticLog(Log):
    """The log of an analysis that goes step by step along a path of equilibria."""

    def __init__(self, setup: Setup, output):
        super().__init__(setup.scene, setup.plan, output, analysis="static")

    def start(self, record, frame) -> None:
        """The start of the path."""
        self.append(single(record), single(frame))

    def step(self, record, frame, spent, last: bool = False) -> None:
        """A finished step that cost `spent` = (iterations, factorizations); `last` always keeps its frame."""
        record = record._replace(iterations=np.asarray(spent[0]), factorizations=np.asarray(spent[1]))
        keep = last or (self.steps + 1) % self.plan.save_every == 0
        self.append(single(record), jax.tree.map(lambda a: a if keep else a[:0], single(frame)))


def reactions(solution: Solution) -> Float[Array, "*k n 6"]:
    """Forces and moments of the supports on the shell, at every frame of a static solution or, of a run in time
    made with `simulate(..., reactions=True)`, in every step.

    Zero at degrees of freedom that are not held; forces [force] first, then moments [force·length] about the nodes.
    In statics they are in balance with the loads: their resultant and their moment about any point vanish.
    In motion they also carry the inertial forces. They are those of the balance that the method solves in the
    step: at its end (`Newmark`, `Bathe`), the mean over it (`EnergyMomentum`, `CentralDifference`, EMC), or
    between (the other α methods, which weigh the end of the step with 1 - αf). NaN at the start, before any
    step. Differentiable.

    Raises ValueError for a run in time without reactions=True: frames do not hold the inertial forces.
    """
    if solution.reaction is not None:
        n, steps = solution.scene.mesh.n_nodes, solution.reaction.shape[:-1]
        nodal = jnp.zeros((*steps, 6 * n)).at[..., solution.scene.held_dofs].set(solution.reaction)
        return nodal.reshape(*steps, n, 6)
    if solution.analysis != "static":
        raise ValueError(
            "reactions() of a run in time need simulate(..., reactions=True), which this run of "
            f"{solution.stats.get('method', '')!r} was made without."
        )
    tables, _ = analyse(structure_of(solution.scene))
    frames = solution.displacements, solution.rotations, solution.frame_times
    return _reactions(proportional(solution.scene), tables, *frames)


@compiled
def _reactions(scene: Scene, tables: Tables, displacements, rotations, factors):
    model = Model.build(scene, tables)
    frames = displacements, rotations, factors
    return jax.lax.map(lambda frame: reactions_at(model, *frame), frames)


def _load_factors(values):
    if values is None:
        return np.arange(1, 11) / 10
    if not all(is_concrete(value) for value in jax.tree.leaves(values)):
        return jnp.asarray(values)
    values = np.asarray(values, float)
    check_finite("load_factors", values)
    if values.ndim != 1 or values.size == 0:
        raise ValueError(f"load_factors must be a list of numbers, but it has shape {values.shape}.")
    values = values[1:] if values[0] == 0 else values
    repeated = np.flatnonzero(np.diff(values, prepend=0.0) == 0)
    if values.size == 0 or repeated.size:
        raise ValueError(f"load_factors must change from each to the next, but are {values.tolist()}.")
    return values


def _message(code: int, at: float, target: float) -> str:
    return (
        f"Equilibrium was followed to load factor {at:.6g} and not found between it and {target:.6g}, with "
        f"steps halved {_CUTS} times. Past a limit point only solve_arc_length can go on. "
        f"The last attempt: {RESULTS[result_of(code)]}"
    )
