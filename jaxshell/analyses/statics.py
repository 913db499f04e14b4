"""Static equilibrium: `solve_static` steps the load factor, `reactions` are what the supports carry.

One load step is one compiled program (`jaxshell.methods.static`); the host cuts a step that fails in half
and lets the steps grow back. When `solve_static` is being traced (by `jax.grad`, `jax.vmap`, `jax.jit`) the
given load factors are taken as they are, in one program, and differentiated by the implicit function
theorem.
"""

import dataclasses
import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.analyses.branches import descent, load_step
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
from jaxshell.analyses.program import Carry, Plan
from jaxshell.analyses.progress import Progress
from jaxshell.analyses.stability import Path
from jaxshell.assembly.discretised import Model
from jaxshell.assembly.structure import structure_of
from jaxshell.assembly.tables import Tables, analyse
from jaxshell.gradients import Stored
from jaxshell.methods.static import Static, StaticState, reactions_at
from jaxshell.model.history import History
from jaxshell.model.mechanisms import check_supported
from jaxshell.model.scene import Scene
from jaxshell.model.supports import Support
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


LOST = (
    "The equilibrium is unstable from about load factor {:.4g} on, where a real structure buckles or snaps. "
    'branch="follow" goes on along the stable path.'
)


class LoadFactor(History):
    """The history of every load in statics: the load factor itself, of either sign and any size."""

    def __init__(self):
        super().__init__([0.0, 1.0], [0.0, 1.0])

    def __call__(self, time) -> Float[Array, ""]:
        return jnp.asarray(time)


def proportional(scene: Scene) -> Scene:
    """The scene with all loads, prescribed displacements and rotations in proportion to the load factor.

    Supports with a prescribed acceleration hold what they accelerate: there is no time.
    """
    if any(support.acceleration is not None for support in scene.supports):
        still = [
            support if support.acceleration is None else Support(support.nodes.array, support.dofs)
            for support in scene.supports
        ]
        scene = dataclasses.replace(scene, supports=still)
    loads, names = range(len(scene.loads)), ("connectors", "obstacles")
    items = [(name, i) for name in names for i in range(len(getattr(scene, name)))]
    driven = [(name, i) for name, i in items if getattr(getattr(scene, name)[i], "history", None) is not None]
    moving = [i for i, support in enumerate(scene.supports) if support.moves]

    def histories(scene):
        given = [scene.loads[i].history for i in loads] + [scene.supports[i].history for i in moving]
        return given + [getattr(scene, name)[i].history for name, i in driven]

    scene = eqx.tree_at(histories, scene, [LoadFactor() for _ in (*loads, *moving, *driven)])
    at_end = {i: scene.loads[i].for_statics() for i in loads}
    changed = [i for i in loads if at_end[i] is not scene.loads[i]]
    return eqx.tree_at(lambda scene: [scene.loads[i] for i in changed], scene, [at_end[i] for i in changed])


def solve_static(
    scene: Scene,
    load_factors: Sequence[float] | np.ndarray | jax.Array | None = None,
    *,
    tangent: str = "closed_form",
    newton: Newton | None = None,
    linear_solver: LinearSolver | None = None,
    branch: str = "straight",
    save_every: int = 1,
    throw: bool = True,
    progress: bool = False,
    output=None,
) -> Solution:
    """Static equilibrium at a sequence of load factors.

    Every load, every prescribed displacement and every angle of a prescribed rotation acts as load factor times its
    full value; its history (how it varies in time) is not looked at. Steps of half a turn or more are halved. Supports
    with a prescribed acceleration hold what they accelerate. Initial displacements and rotations of the scene are where
    the iteration starts, initial velocities are ignored.

    Arguments:
        scene: what to load. Its supports must leave no rigid-body motion free. Differentiable in its floats.
        load_factors: where equilibrium is wanted, in the order in which the loads pass through them (they may
            fall again and change sign); None is 0.1, 0.2, ..., 1. A step that fails is halved, up to ten
            times, and the steps grow back to the factors asked for. Around a limit point no load step is
            small enough: see `solve_arc_length`.
        tangent: "closed_form" or "autodiff"; the same answer.
        newton, linear_solver, progress, output: as in `simulate`.
        branch: what is done where the equilibrium becomes unstable, as at a column's buckling load. "straight" goes on
            along the unstable path and warns. "follow" moves the shell by 1e-3 of its size along its critical motion,
            and lets it sink from there, at the same load factor, to an equilibrium that is stable: the branch behind
            the bifurcation, or where a snap ends. Of the motion's two senses it takes the one in which the first
            displacement (in the order of nodes, then x, y, z) that is within a tenth of the largest is positive.
        save_every: load factors between frames.
        throw: raise `SimulationError` when a load factor is not reached (it carries the solution so far);
            otherwise the solution's `result` and `message` say so.

    Returns a `Solution` whose times are the load factors (the first entry, 0, is the start); after a failure
    the last entry is the largest part of the failed step that was reached. `iterations` counts all that were
    spent on the way to a load factor. Kinetic energy and momenta are zero. Under `jax.grad` and the like no
    step is halved. `stable` says which of the entries are stable equilibria (None under `jax.grad` and the like), and
    the stats at which load factors stability was lost (`stability_lost`, interpolated) and a branch was followed
    (`branched`).

    Raises ValueError for bad input and for a mechanism, which it names, before anything is compiled.
    """
    require_float64()
    newton = DEFAULT_NEWTON if newton is None else newton
    check_options(scene, Static(), save_every, tangent, newton)
    if branch not in ("straight", "follow"):
        raise ValueError(f'branch must be "straight" or "follow", but it is {branch!r}.')
    factors = _load_factors(load_factors)
    check_supported(scene)
    traced = is_traced(scene, newton, factors)
    if traced and branch == "follow":
        raise ValueError('branch="follow" chooses its steps as it goes and cannot be traced by jax.grad and the like.')
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
        solution = _driven(setup, factors, branch, output, bar, linear_solver)
    lost = solution.stats["stability_lost"]
    if lost and branch == "straight":
        warnings.warn(LOST.format(lost[0]), stacklevel=2)
    if throw and solution.message:
        raise SimulationError(solution.message, solution)
    return solution


class _Reached(NamedTuple):
    """How far the load factor has come."""

    state: StaticState
    memory: Any
    at: float
    size: float
    """The largest step to try next."""
    code: int


def _driven(setup: Setup, factors, branch: str, output, bar, linear_solver) -> Solution:
    asked = {"load_factors": tuple(factors.tolist()), "branch": branch}
    log = StaticLog(setup, output, linear_solver, analysis="static", **asked)
    model, carry, record, frame = setup.prepare(proportional(setup.scene))
    now = _Reached(carry.state, carry.memory, 0.0, np.inf, int(SUCCESSFUL))
    message = ""
    with log:
        log.start(record, frame)
        for position, target in enumerate(factors):
            now, found = _reach(model, setup.plan, now, target, branch == "follow", log.path)
            failed = bool(now.code != SUCCESSFUL)
            if found is not None:
                log.step(found.record, found.frame, found.spent, last=failed or position == len(factors) - 1)
                bar.advance(log.records[-1])
            if failed:
                message = _message(now.code, now.at, target, log.path, branch)
                break
        return log.finish(now.state, now.code, message)


def _reach(model: Model, plan: Plan, now: _Reached, target, follow: bool, path: Path):
    """Go to the load factor `target`, halving steps that fail and letting them grow back.

    With `follow` from equilibria that are not stable on to those that are. `path` is told of all that are kept. Returns
    (where that led, the last step if there was one, with the cost of all).
    """
    state, memory, at, size, code = now
    smallest = abs(target - at) / 2**_CUTS
    spent, found = np.zeros(2, int), None
    while at != target:
        rest = target - at
        # All of the rest where only round-off keeps it from fitting: no sliver of a step is left.
        whole = abs(rest) <= size * (1 + 1e-6)
        step, end = (rest, target) if whole else (np.copysign(size, rest), at + np.copysign(size, rest))
        new = load_step(model, plan, state, memory, step, end)
        if follow and new.code == SUCCESSFUL and not float(new.weakest.quotient) > 0:
            lost = path.zero(end, new.weakest)
            new = descent(model, plan, new)
            if new.code == SUCCESSFUL:
                path.branched.append(lost)
        code, memory, spent = new.code, new.memory, spent + new.spent
        if code == SUCCESSFUL:
            state, at, size, found = new.state, float(end), max(size, 2 * abs(step)), new
            path.sees(at, new.weakest)
        elif abs(step) / 2 < smallest:
            break
        else:
            size = abs(step) / 2
    return _Reached(state, memory, at, size, code), None if found is None else found._replace(spent=spent)


class StaticLog(Log):
    """The log of an analysis that goes step by step along a path of equilibria.

    `asked` are its name and its arguments, for the stats and for files that ask for the same run again, which name the
    `linear_solver` that was given too.
    """

    def __init__(self, setup: Setup, output, linear_solver: LinearSolver | None, **asked):
        solver = {} if linear_solver is None else {"linear_solver": type(linear_solver).__name__.lower()}
        super().__init__(setup.scene, setup.plan, output, asked | solver, analysis="static")
        self.path, self.asked = Path(), asked

    def start(self, record, frame) -> None:
        """The start of the path."""
        self.append(single(record._replace(stable=True)), single(frame))

    def step(self, record, frame, spent, last: bool = False) -> None:
        """A finished step that cost `spent` = (iterations, factorizations); `last` always keeps its frame."""
        iterations, factorizations = np.asarray(spent[0]), np.asarray(spent[1])
        record = record._replace(iterations=iterations, factorizations=factorizations, stable=self.path.stable)
        keep = last or (self.steps + 1) % self.plan.save_every == 0
        self.append(single(record), jax.tree.map(lambda a: a if keep else a[:0], single(frame)))

    def finish(self, state, code: int, message: str, **figures) -> Solution:
        """As every log, with what the path knows of stability in the stats."""
        carry = Carry(state, None, jnp.asarray(code))
        return super().finish(carry, code, message, **self.asked, **self.path.figures(), **figures)


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
        carried = solution.reaction
        if solution.analysis == "static":
            carried = carried[_steps_of_frames(solution)]
        n, steps = solution.scene.mesh.n_nodes, carried.shape[:-1]
        nodal = jnp.zeros((*steps, 6 * n)).at[..., solution.scene.held_dofs].set(carried)
        nodal = nodal.reshape(*steps, n, 6)
        if solution.scene.turned is None:
            return nodal
        # Along the supports' own axes.
        turned, axes = solution.scene.turned.array, solution.scene.axes
        pairs = nodal[..., turned, :].reshape(*steps, len(turned), 2, 3)
        return nodal.at[..., turned, :].set(jnp.einsum("sij,...skj->...ski", axes, pairs).reshape(*steps, -1, 6))
    if solution.analysis != "static":
        raise ValueError(
            "reactions() of a run in time need simulate(..., reactions=True), which this run of "
            f"{solution.stats.get('method', '')!r} was made without."
        )
    tables, _ = analyse(structure_of(solution.scene))
    frames = solution.displacements, solution.rotations, solution.frame_times
    return _reactions(proportional(solution.scene), tables, *frames)


def _steps_of_frames(solution: Solution) -> np.ndarray:
    """Which steps the frames are of."""
    steps, frames = len(solution.times), len(solution.frame_times)
    if steps == frames:
        return np.arange(steps)
    times, found, at = np.asarray(solution.times), [], 0
    for time in np.asarray(solution.frame_times):
        at += int(np.argmax(times[at:] == time))
        found.append(at)
    return np.array(found)


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
    check_finite("load_factors", values)
    values = np.asarray(values, float)
    if values.ndim != 1 or values.size == 0:
        raise ValueError(f"load_factors must be a list of numbers, but it has shape {values.shape}.")
    values = values[1:] if values[0] == 0 else values
    repeated = np.flatnonzero(np.diff(values, prepend=0.0) == 0)
    if values.size == 0 or repeated.size:
        raise ValueError(f"load_factors must change from each to the next, but are {values.tolist()}.")
    return values


def _message(code: int, at: float, target: float, path: Path, branch: str) -> str:
    return (
        f"Equilibrium was followed to load factor {at:.6g} and not found between it and {target:.6g}, with "
        f"steps halved {_CUTS} times. {path.advice(branch)} The last attempt: {RESULTS[result_of(code)]}"
    )
