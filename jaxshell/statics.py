"""Static equilibrium: `solve_static` steps the load factor, `reactions` are what the supports carry.

One load step is one compiled program (`jaxshell.methods.static`); the host cuts a step that fails in half
and lets the steps grow back. When `solve_static` is being traced (by `jax.grad`, `jax.vmap`, `jax.jit`) the
given load factors are taken as they are, in one program, and differentiated by the implicit function
theorem.
"""

import time
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell import program
from jaxshell.assembly import Tables, analyse
from jaxshell.checks import check_finite, is_concrete, require_float64
from jaxshell.compiled import compiled
from jaxshell.gradients import Stored
from jaxshell.linear_solver import LinearSolver, default_solver
from jaxshell.loads import History
from jaxshell.mechanisms import check_supported
from jaxshell.methods.base import Solvers
from jaxshell.methods.static import Static, StaticState, reactions_at
from jaxshell.model import Model, structure_of
from jaxshell.newton import SUCCESSFUL, Linear, Newton
from jaxshell.program import Choices
from jaxshell.progress import Progress
from jaxshell.quoted import quote
from jaxshell.scene import Scene
from jaxshell.simulation import (
    _RESULT_NAMES,
    Run,
    SimulationError,
    _append,
    _check_options,
    _expand,
    _floats_to_arrays,
    _results,
    _solution,
    _traced_run,
    _writer,
)
from jaxshell.solution import RESULTS, Solution, Stats

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
    _check_options(scene, Static(), save_every, tangent, newton)
    factors = _load_factors(load_factors)
    check_supported(scene)
    linear_solver = default_solver() if linear_solver is None else linear_solver
    tables, pattern = analyse(structure_of(scene))
    handle = linear_solver.prepare(pattern)
    as_arrays: Newton = _floats_to_arrays(newton)
    choices = Choices(tangent, linear_solver, save_every, scene.watch)
    if not all(is_concrete(leaf) for leaf in jax.tree.leaves((scene, newton, factors))):
        if output is not None or progress:
            raise ValueError("output= and progress= need a run that is not traced by jax.grad, jax.vmap or jax.jit.")
        steps = jnp.diff(jnp.asarray(factors), prepend=0.0)
        run = Run(proportional(scene), Static(), as_arrays, tables, handle, choices)
        return eqx.tree_at(lambda s: s.scene, _traced_run(run, steps, None, Stored(), throw), scene)
    with Progress(float(factors[-1]), enabled=progress) as bar:
        solution = _driven(scene, as_arrays, tables, handle, choices, factors, output, bar)
    if throw and solution.message:
        raise SimulationError(solution.message, solution)
    return solution


@compiled
def _advance(model: Model, newton: Newton, handle, choices: Choices, state: StaticState, memory, step, end):
    """One load step of size `step` to the load factor `end`: state, memory, result, record and frame."""
    solvers = Solvers(newton, Linear(choices.linear_solver, handle), choices.tangent, differentiated=False)
    state, info, memory = Static().step(model, state, step, solvers, memory)
    state = eqx.tree_at(lambda s: s.time, state, end)
    record = program.record(model, Static(), state, choices, info.iterations, info.factorizations, jnp.array(True))
    return state, memory, info.result, record, program.frame(model, state)


def _driven(scene, newton, tables, handle, choices: Choices, factors, output, bar) -> Solution:
    begun = time.perf_counter()
    model, carry, record, frame = program.prepare(proportional(scene), Static(), newton, tables, handle, choices)
    state, memory = carry.state, carry.memory
    log = Log(scene, choices.save_every, record, frame, output, Static(), newton, choices)
    code, at, size = int(SUCCESSFUL), 0.0, np.inf
    with log:
        for position, target in enumerate(factors):
            smallest = abs(target - at) / 2**_CUTS
            spent, reached = np.zeros(2, int), None
            while at != target:
                rest = target - at
                # All of the rest where only round-off keeps it from fitting: no sliver of a step is left.
                whole = abs(rest) <= size * (1 + 1e-6)
                step, end = (rest, target) if whole else (np.copysign(size, rest), at + np.copysign(size, rest))
                new, memory, code, record, frame = _advance(
                    model, newton, handle, choices, state, memory, jnp.asarray(step), jnp.asarray(end)
                )
                code = int(code)
                spent += int(record.iterations), int(record.factorizations)
                if code == SUCCESSFUL:
                    state, at, size, reached = new, float(end), max(size, 2 * abs(step)), (record, frame)
                elif abs(step) / 2 < smallest:
                    break
                else:
                    size = abs(step) / 2
            if reached is not None:
                log.append(*reached, spent, last=position == len(factors) - 1 or code != SUCCESSFUL)
                bar.advance(log.latest)
            if code != SUCCESSFUL:
                break
        message = "" if code == SUCCESSFUL else _message(code, at, factors[position])
        stats = log.finish(code, message, time.perf_counter() - begun)
    return log.solution(state, code, message, stats)


class Log:
    """What a run driven step by step has finished: records, frames, and the result file that gets them."""

    def __init__(self, scene, save_every: int, record, frame, output, method, newton, choices: Choices):
        self.scene, self.save_every, self.choices, self.newton = scene, save_every, choices, newton
        self.method = method
        self.records, self.frames = [_expand(record)], [_expand(frame)]
        settings = {
            "method": quote(method),
            "newton": quote(newton),
            "tangent": choices.tangent,
            "save_every": save_every,
        }
        self.context = _writer(output, scene, settings)

    def __enter__(self):
        self.writer = self.context.__enter__()
        _append(self.writer, self.scene, self.records[0], self.frames[0])
        return self

    def __exit__(self, *error):
        return self.context.__exit__(*error)

    @property
    def latest(self):
        return self.records[-1]

    def append(self, record, frame, spent, last: bool = False) -> None:
        """A finished step that cost `spent` = (iterations, factorizations); `last` always keeps its frame."""
        record = record._replace(iterations=np.asarray(spent[0]), factorizations=np.asarray(spent[1]))
        self.records.append(_expand(record))
        keep = last or (len(self.records) - 1) % self.save_every == 0
        frame = jax.tree.map(lambda a: a if keep else a[:0], _expand(frame))
        self.frames.append(frame)
        _append(self.writer, self.scene, self.records[-1], frame)

    def finish(self, code: int, message: str, wall_time: float) -> Stats:
        """Figures of the run, also for the file."""
        stats = Stats(
            method=quote(self.method),
            newton=quote(self.newton),
            linear_solver=type(self.choices.linear_solver).__name__,
            tangent=self.choices.tangent,
            steps=len(self.records) - 1,
            iterations=int(sum(int(r.iterations[0]) for r in self.records)),
            factorizations=int(sum(int(r.factorizations[0]) for r in self.records)),
            wall_time=wall_time,
        )
        if self.writer is not None:
            self.writer.finish(_RESULT_NAMES[code], message, stats)
        return stats

    def solution(self, state, code: int, message: str, stats: Stats) -> Solution:
        record, frame = (jax.tree.map(lambda *a: np.concatenate(a), *parts) for parts in (self.records, self.frames))
        result = _results()[code]
        return _solution(self.scene, record, frame, state, result, message, stats, jnp.asarray)


def reactions(solution: Solution) -> Float[Array, "*k n 6"]:
    """Forces and moments of the supports on the shell, at every frame of a static solution or, of a run in time
    made with `simulate(..., reactions=True)`, in every step.

    Zero at freedoms that are not held; forces [force] first, then moments [force·length] about the nodes.
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
    method = solution.stats.get("method", "")
    if not (isinstance(solution.state, StaticState) or method.startswith("Static")):
        raise ValueError(
            f"reactions() of a run in time need simulate(..., reactions=True), which this run of {method!r} "
            "was made without."
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
        f"The last attempt: {RESULTS[_results()[code]]}"
    )
