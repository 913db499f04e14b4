"""What every analysis shares on the host: checks and set-up of a run, the log of what it finished, its solution."""

import contextlib
import dataclasses
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxshell.analyses import program
from jaxshell.analyses.program import Carry, Frame, Plan, Record
from jaxshell.assembly.conditions import check_conditions
from jaxshell.assembly.structure import structure_of
from jaxshell.assembly.tables import Tables, analyse, nodal_tables
from jaxshell.files.quoted import quote
from jaxshell.gradients import Gradients
from jaxshell.methods.method import Method, Solvers
from jaxshell.model.scene import Scene
from jaxshell.numerics.checks import check_count, is_concrete
from jaxshell.numerics.kernels import kernels_chosen
from jaxshell.results.frames import Frames, StoredFrames
from jaxshell.results.output import Output
from jaxshell.results.penetration import warn_of_depth
from jaxshell.results.restart import restored
from jaxshell.results.solution import RESULTS, Energy, Momentum, Solution, Stats
from jaxshell.solvers.iteration import Linear
from jaxshell.solvers.linear_solver import Handle, LinearSolver, default_solver
from jaxshell.solvers.newton import Newton

RESULT_NAMES = ("successful", "diverged", "stagnated", "singular", "step_too_small", "unstable", "not_at_rest")
"""In the order of the codes in `jaxshell.solvers.iteration`; the last is that of `settle`."""


class SimulationError(RuntimeError):
    """A run that ended early. `solution` holds every step that was finished."""

    def __init__(self, message: str, solution: Solution):
        super().__init__(message)
        self.solution = solution


class Setup(NamedTuple):
    """A run before its first step."""

    scene: Scene
    tables: Tables
    plan: Plan

    def prepare(self, scene: Scene | None = None):
        """(model, carry, record and frame of the start), of `scene` in place of the set-up's own where given."""
        return program.prepare(self.scene if scene is None else scene, self.tables, self.plan)


def check_options(scene, method, save_every, tangent, newton) -> None:
    """Raise ValueError for arguments that every analysis takes and cannot be."""
    for name, value, kind in (("scene", scene, Scene), ("method", method, Method), ("newton", newton, Newton)):
        if not isinstance(value, kind):
            raise ValueError(f"{name} must be a jaxshell.{kind.__name__}, but it is {value!r}.")
    check_count("save_every", save_every)
    if tangent not in ("closed_form", "autodiff"):
        raise ValueError(f'tangent must be "closed_form" or "autodiff", but it is {tangent!r}.')
    scene.section.check(scene.mesh)


def is_traced(*trees) -> bool:
    """Whether JAX is tracing any of them, by jax.grad, jax.vmap or jax.jit."""
    return not all(is_concrete(leaf) for leaf in jax.tree.leaves(trees))


def check_untraced(output, progress: bool) -> None:
    """Raise ValueError for what a traced run cannot have."""
    if output is not None or progress:
        raise ValueError("output= and progress= need a run that is not traced by jax.grad, jax.vmap or jax.jit.")


def set_up(
    scene: Scene,
    method: Method,
    newton: Newton,
    *,
    linear_solver: LinearSolver | None = None,
    tangent: str = "closed_form",
    save_every: int = 1,
    reactions: bool = False,
    differentiated: bool = False,
) -> Setup:
    """Analyse the scene's structure, and wrap method and solvers for the compiled programs."""
    check_conditions(scene)
    solver = default_solver() if linear_solver is None else linear_solver
    if method.uses_matrix:
        tables, pattern = analyse(structure_of(scene))
        handle = solver.prepare(pattern)
    else:
        empty = jnp.zeros(0, jnp.int32)
        tables, handle = nodal_tables(structure_of(scene)), Handle(empty, empty, empty, ())
    method, newton = floats_to_arrays((method, newton))
    solvers = Solvers(newton, Linear(solver, handle), tangent, differentiated)
    return Setup(scene, tables, Plan(method, solvers, scene.watch, save_every, reactions))


def floats_to_arrays(tree: Any) -> Any:
    """Python floats as arrays, so that another value compiles nothing anew."""
    return jax.tree.map(lambda leaf: jax.device_put(np.float64(leaf)) if isinstance(leaf, float) else leaf, tree)


def resumed(model, plan: Plan, carry: Carry, record: Record, frame: Frame, restart: Solution | None):
    """(carry, record, frame, time) of the start, or of the end of the run that `restart` is of."""
    if restart is None:
        return carry, record, frame, 0.0
    carry = carry._replace(state=restored(restart.state, carry.state))
    record, frame = program.first_again(model, plan, carry.state)
    if plan.reactions and restart.reaction is not None:
        record = record._replace(reaction=jnp.asarray(restart.reaction[-1]))
    record = record._replace(watched=_as_read(plan, record.watched, restart))
    if restart.newton is not None and carry.memory is not None:
        carry = _remembering(plan, carry, restart.newton)
    return carry, record, frame, float(carry.state.time)


def _as_read(plan: Plan, values, restart: Solution):
    """What is watched at the start of a run that goes on; of connectors and obstacles as the last step had it."""
    for i, (label, number, _) in enumerate(plan.watch):
        if isinstance(number, str) and label in restart.watched:
            values = values.at[i].set(restart.watched[label][-1])
    return values


def kept_by_newton(carry: Carry):
    """What of Newton's memory a file can hold: all but the factorization, which is made anew of its matrix."""
    if carry.memory is None:
        return None
    names = (field.name for field in dataclasses.fields(carry.memory) if field.name != "factorization")
    return {name: getattr(carry.memory, name) for name in names}


def _remembering(plan: Plan, carry: Carry, kept: dict) -> Carry:
    """`carry` with Newton's memory of an earlier run, where that run was of the same equations and settings."""
    memory, own = carry.memory, kept_by_newton(carry)
    if (
        memory is None
        or own is None
        or {k: np.shape(a) for k, a in own.items()} != {k: np.shape(a) for k, a in kept.items()}
    ):
        return carry
    memory = dataclasses.replace(memory, **{name: jnp.asarray(kept[name], own[name].dtype) for name in own})
    return program.with_memory(plan, carry, memory) if memory.values.size else carry._replace(memory=memory)


def single(tree):
    """A record or frame of one step as arrays of length 1, on the host."""
    return jax.tree.map(lambda a: np.asarray(a)[None], tree)


class Log:
    """What a run has finished: records, frames, and the outputs that get them. A context manager.

    `settings` are what a result file says about how the run was made, besides what the plan says.
    """

    def __init__(self, scene: Scene, plan: Plan, output, settings: dict | None = None, analysis: str = "time"):
        self.scene, self.plan, self.analysis = scene, plan, analysis
        self.settings = {
            "method": quote(plan.method),
            "newton": quote(plan.solvers.newton),
            "tangent": plan.solvers.tangent,
            "kernels": kernels_chosen(),
            "save_every": plan.save_every,
            "reactions": plan.reactions,
            **(settings or {}),
        }
        self.outputs = _outputs_of(output)
        self.records: list[Record] = []
        self.frames: list[Frame] = []
        self.frame_times: list[Any] = []
        self.begun = time.perf_counter()

    def __enter__(self) -> "Log":
        with contextlib.ExitStack() as stack:
            for output in self.outputs:
                stack.callback(output.close)
                output.begin(self.scene, self.settings)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error) -> None:
        self._stack.__exit__(*error)

    @property
    def steps(self) -> int:
        """Steps finished; the first record is the start."""
        return sum(record.time.size for record in self.records) - 1

    @property
    def latest_time(self) -> float:
        """Reached until now."""
        return float(next(record.time[-1] for record in reversed(self.records) if record.time.size))

    def append(self, record: Record, frame: Frame, carry: Carry | None = None) -> None:
        """Steps and frames, each leaf with a leading axis, and the carry at their end where a run can go on from it."""
        self.records.append(record)
        self.frame_times.append(frame.time)
        if self.outputs:
            part = solution_of(self.scene, record, frame, carry, analysis=self.analysis)
            for output in self.outputs:
                output.append(part)
        if all(output.frames() is None for output in self.outputs):
            self.frames.append(frame)

    def finish(self, carry: Carry | None, code: int, message: str, **figures) -> Solution:
        """Tell the outputs how the run ended, and return all of it. `figures` stand in the stats besides the usual.

        Frames that an output stored are read from there, and have not been kept in memory.
        """
        record = jax.tree.map(lambda *a: np.concatenate(a), *self.records)
        stats = Stats(
            method=self.settings["method"],
            newton=self.settings["newton"],
            linear_solver=type(self.plan.solvers.linear.solver).__name__,
            tangent=self.plan.solvers.tangent,
            kernels=self.settings["kernels"],
            steps=record.time.size - 1,
            iterations=int(record.iterations.sum()),
            factorizations=int(record.factorizations.sum()),
            wall_time=time.perf_counter() - self.begun,
            **figures,
        )
        for output in self.outputs:
            output.finish(RESULT_NAMES[code], message, stats)
        stored = next((frames for output in self.outputs if (frames := output.frames()) is not None), None)
        if stored is not None:
            frame = StoredAs(np.concatenate(self.frame_times), stored)
        else:
            frame = jax.device_put(jax.tree.map(lambda *a: np.concatenate(a), *self.frames))
        record = jax.device_put(record)
        solution = solution_of(self.scene, record, frame, carry, result_of(code), message, stats, self.analysis)
        warn_of_depth(solution)
        return solution


def _outputs_of(given) -> tuple[Output, ...]:
    """The outputs of an `output=` argument: a path of a result or a VTKHDF file, an `Output`, several, or None."""
    if given is None:
        return ()
    if isinstance(given, Output):
        return (given,)
    if isinstance(given, Sequence) and not isinstance(given, str | bytes):
        return tuple(output for item in given for output in _outputs_of(item))
    if str(given).endswith(".vtkhdf"):
        from jaxshell.results.export.vtkhdf import VTKHDFWriter

        return (VTKHDFWriter(given),)
    from jaxshell.results.hdf5 import ResultWriter  # h5py only where it writes

    return (ResultWriter(given),)


def result_of(code: int) -> RESULTS:
    """The item of RESULTS for a result code."""
    return getattr(RESULTS, RESULT_NAMES[code])


class StoredAs(NamedTuple):
    """The frames of a run that an output has stored."""

    time: Any
    frames: StoredFrames


def solution_of(
    scene: Scene,
    record: Record,
    frame: Frame | StoredAs,
    carry: Carry | None,
    result=None,
    message="",
    stats=None,
    analysis="time",
) -> Solution:
    """The solution that histories and frames, each with a leading axis, make; `carry` is of its end."""
    seen = record.observed
    if isinstance(frame, StoredAs):
        frames = frame.frames
    else:
        frames = Frames(frame.displacements, frame.rotations, frame.velocities)
    return Solution(
        scene=scene,
        times=record.time,
        watched={label: record.watched[:, i] for i, (label, _, _) in enumerate(scene.watch)},
        energy=Energy(seen.kinetic, seen.strain, seen.external_work, seen.dissipated),
        momentum=Momentum(seen.linear, seen.angular),
        iterations=record.iterations,
        frame_times=frame.time,
        frames=frames,
        state=None if carry is None else carry.state,
        newton=None if carry is None else kept_by_newton(carry),
        result=RESULTS.successful if result is None else result,
        message=message,
        stats=Stats() if stats is None else stats,
        reaction=record.reaction,
        stable=record.stable,
        analysis=analysis,
    )


def run_traced(
    setup: Setup, steps, gradients: Gradients, throw: bool, *, restart: Solution | None = None, analysis: str = "time"
) -> Solution:
    """A whole run in one program that JAX may transform; `steps` (N,) are the step sizes."""
    model, carry, record, frame = setup.prepare()
    carry, record, frame, start = resumed(model, setup.plan, carry, record, frame, restart)
    pairs = jnp.asarray(steps), start + jnp.cumsum(jnp.asarray(steps))
    carry, records, shots = program.run_whole(model, setup.plan, gradients, carry, pairs)
    record, frame = (
        jax.tree.map(lambda first, rest: jnp.concatenate([first[None], rest]), *parts)
        for parts in ((record, records), (frame, shots))
    )
    result = RESULTS.successful
    for code in range(len(RESULT_NAMES) - 1):  # no traced run settles
        result = RESULTS.where(carry.result == code, result_of(code), result)
    solution = solution_of(setup.scene, record, frame, carry._replace(memory=None), result, analysis=analysis)
    return _raise_on_failure(solution) if throw else solution


def _raise_on_failure(solution: Solution) -> Solution:
    """Tie an error to every float of a traced solution, so that it comes with values and with gradients alone."""
    failed = solution.result != RESULTS.successful
    sound = solution.result.error_if(jnp.array(1.0), failed)
    floats, rest = eqx.partition(solution, eqx.is_inexact_array)
    scene = floats.scene
    floats = jax.tree.map(lambda a: a * sound, floats)
    return eqx.combine(eqx.tree_at(lambda s: s.scene, floats, scene), rest)
