"""`sweep`: runs of many scenes that differ in a few values, in batches, resumable, with a file that grows.

Members are made one after the other and gathered by structure; as soon as enough of one structure wait, they run as a
batch. So a sweep of any size takes the memory of a few batches besides its results.
"""

import contextlib
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from jaxshell.analyses.driver import RESULT_NAMES
from jaxshell.analyses.step_control import StepControl
from jaxshell.analyses.sweep import workers as pool
from jaxshell.analyses.sweep.batch import Batch, Kept, Quantities, batch_of
from jaxshell.analyses.sweep.design import Design, design
from jaxshell.analyses.sweep.identity import fingerprints, sweep_before
from jaxshell.analyses.sweep.making import called, check_used, maker
from jaxshell.analyses.sweep.member import Case, CaseOf, Member, Options, prepared
from jaxshell.analyses.sweep.varied import varied
from jaxshell.model.scene import Scene
from jaxshell.numerics.checks import check_count, check_finite, require_float64, shown
from jaxshell.numerics.kernels import kernels_chosen
from jaxshell.results.sweep import REFUSED, SUCCESSFUL, Sweep
from jaxshell.results.sweep_file import SweepWriter, check_replaceable, placed, rows_of, sweep_of
from jaxshell.solvers.newton import Newton

POINTS = 201
"""Times of histories that are not those of the steps."""


def sweep(
    scene: Scene | Callable[..., Scene],
    vary: Mapping[str, Any],
    *,
    method,
    dt,
    t_end=None,
    sample: str = "grid",
    seed: int = 0,
    times=None,
    quantities: Quantities | None = None,
    save_every: int | None = None,
    newton: Newton | None = None,
    tangent: str = "closed_form",
    linear_solver=None,
    batch: int = 16,
    workers: int = 1,
    scheduler: str | None = None,
    output=None,
    overwrite: bool = False,
    say: Callable[[str], None] | None = None,
) -> Sweep:
    """Run a scene with many values of some parameters.

    Arguments:
        scene: a function that makes the scene of a member from parameters by name; or a scene, whose floats vary.
        vary: {name: values}. Values are a list or an array (N, ...), a distribution of `scipy.stats` such as
            norm(0.4, 0.02), or a text such as "0.3:0.5:20" (`jaxshell.analyses.sweep.varied` lists them). Where `scene`
            is a scene {name: (where, values)}, `where` as `equinox.tree_at` takes it: lambda s: s.section.thickness.
        method, dt, t_end: as `simulate` takes them; or functions of parameters by name, for what varies.
        sample: which members there are: "grid" (all combinations), "zip", "latin:N", "sobol:N", "random:N" or
            "saltelli:N" (`jaxshell.analyses.sweep.design`).
        seed: of a sample; the same seed gives the same members.
        times: of the histories that are kept: an array, or a number of times from 0 to the end. None is every step, or
            201 times where members have different steps.
        quantities: {name: function of a `Solution`} whose numbers are kept for every member. JAX traces them.
        save_every: steps between frames that are kept; None keeps no frames.
        newton, tangent, linear_solver: as in `simulate`.
        batch: members of one program, at most.
        workers: processes on this machine (more than one needs `distributed`).
        scheduler: address of any Dask cluster, such as "tcp://host:8786", in place of processes on this machine.
        output: path of an HDF5 file that receives members as they end. One that holds the same sweep goes on.
        overwrite: replace what the file holds.
        say: called with a line of text as the sweep goes on, e.g. print.

    Members of the same structure (mesh, supports, kinds of loads, number of steps) share a compiled program. A member's
    numbers are those of its single run within Newton's tolerance. A member that fails is a result, not an error: see
    `Sweep.result` and `Sweep.messages`; so is one that `scene` or a check refuses with a ValueError.

    Returns a `Sweep`. Raises ValueError for bad input, for a file that holds another sweep, and where no member is a
    valid run; RuntimeError when float64 is off, or where several workers died of a batch (what ended is in the file).
    """
    require_float64()
    if not isinstance(vary, Mapping):
        raise ValueError(f"vary must be {{name: values}}, but it is {shown(vary)}.")
    make, values = maker(scene, vary)
    plan = design({name: varied(name, given) for name, given in values.items()}, sample, seed)
    options = Options(Newton() if newton is None else newton, tangent, linear_solver, kernels_chosen())
    functions: dict[str, Any] = {"scene": make, "method": method, "dt": dt, "t_end": t_end}
    check_used(functions, plan)

    def case_of(parameters: dict[str, Any]) -> Case:
        return Case(**{what: called(function, parameters) for what, function in functions.items()}, options=options)

    alike = not callable(dt) and not callable(t_end) and not isinstance(dt, StepControl)
    asked = {"sample": sample, "seed": seed, "vary": {name: varied(name, v).text for name, v in values.items()}}
    return run_sweep(
        plan,
        case_of,
        alike=alike,
        same_end=t_end is not None and not callable(t_end),
        asked=asked,
        times=times,
        quantities={} if quantities is None else quantities,
        save_every=save_every,
        batch=batch,
        workers=workers,
        scheduler=scheduler,
        output=output,
        overwrite=overwrite,
        say=say,
    )


def run_sweep(
    plan: Design,
    case_of: CaseOf,
    *,
    alike: bool,
    same_end: bool,
    asked: dict[str, Any],
    times=None,
    quantities: Quantities,
    save_every: int | None = None,
    batch: int = 16,
    workers: int = 1,
    scheduler: str | None = None,
    output=None,
    overwrite: bool = False,
    say: Callable[[str], None] | None = None,
) -> Sweep:
    """As `sweep`, of members that `case_of` makes; with the same steps (`alike`), until the same time (`same_end`)."""
    _check_numbers(batch, workers, save_every, alike)
    if scheduler is not None or workers > 1:
        pool.imported()
    goes_on = output is not None and check_replaceable(output, overwrite)
    first = _first(plan, case_of)
    grid = _grid(times, first, plan, case_of, alike, alike or same_end)
    shown_times = _times_of(first) if grid is None else grid
    settings = {
        **asked,
        "kind": plan.kind,
        "parameters": list(plan.parameters),
        "labels": [label for label, _, _ in first.case.scene.watch],
        "quantities": list(quantities),
        "save_every": save_every,
        **fingerprints(plan, case_of, first, shown_times),
    }
    before = sweep_before(output, settings) if goes_on else None
    if before is not None and before.done.all():
        return before
    run = _Run(plan, case_of, settings, before, say)
    with contextlib.ExitStack() as stack:
        if output is not None:
            writer = SweepWriter(output, first.case.scene, settings, plan.parameters, shown_times)
            run.writer = stack.enter_context(contextlib.closing(writer))
            if before is not None:
                run.writer.append(rows_of(before))
        task = pool.Task(uuid.uuid4().hex, quantities, Kept(grid, save_every))
        todo = np.flatnonzero(run.waiting)
        at_once = max(1, min(batch, -(-len(todo) // workers)))
        batches = run.batches(todo, at_once)
        if len(todo) == 0:
            ended: Iterator = iter(())
        elif scheduler is not None or workers > 1:
            ended = pool.there(stack.enter_context(pool.cluster(workers, scheduler)), batches, task)
        else:
            ended = pool.here(batches, task)
        for done, rows in ended:
            run.receive(done, rows)
        run.write()
    return run.result(first.case.scene, shown_times)


class _Run:
    """A sweep while it goes on: what has been collected, and what is written of it."""

    def __init__(self, plan: Design, case_of: CaseOf, settings: dict, before: Sweep | None, say):
        self.plan, self.case_of, self.settings, self.say = plan, case_of, settings, say
        self.parts = [] if before is None else [rows_of(before)]
        self.messages = {} if before is None else dict(before.messages)
        self.waiting = np.ones(plan.size, bool) if before is None else ~before.done
        self.failed = 0 if before is None else int((before.done & ~before.successful).sum())
        self.writer: SweepWriter | None = None
        self.refused: list[tuple[int, str]] = []
        self.lost: list[int] = []
        self.begun = time.perf_counter()

    def batches(self, todo: np.ndarray, at_once: int) -> Iterator[Batch]:
        """The members `todo` in batches of one structure; programs of fewer rows only where no other has been made."""
        gathered: dict[Any, list[Member]] = {}
        rows: dict[Any, int] = {}
        for number in todo:
            try:
                member = prepared(int(number), self.case_of(self.plan.member(int(number))))
            except ValueError as error:
                self.refused.append((int(number), str(error)))
                continue
            self._check_labels(member)
            waiting = gathered.setdefault(member.structure, [])
            waiting.append(member)
            if len(waiting) == at_once:
                rows[member.structure] = at_once
                yield batch_of(waiting, at_once)
                waiting.clear()
        for structure, waiting in gathered.items():
            if waiting:
                yield batch_of(waiting, rows.get(structure, len(waiting)))

    def _check_labels(self, member: Member) -> None:
        labels = [label for label, _, _ in member.case.scene.watch]
        if labels != list(self.settings["labels"]):
            raise ValueError(
                f"All members must watch the same: member {member.number} watches {', '.join(labels) or 'nothing'}, "
                f"and the first {', '.join(self.settings['labels']) or 'nothing'}."
            )

    def receive(self, batch: Batch, found) -> None:
        """Take what became of a batch."""
        if isinstance(found, pool.Lost):
            self.lost += batch.numbers
            self._tell(f"members {', '.join(map(str, batch.numbers))} are not done: {found}")
            return
        if isinstance(found, ValueError):
            self.refused += [(number, str(found)) for number in batch.numbers]
            self.write()
            return
        names = np.array(RESULT_NAMES)[found.pop("code")]
        self._keep({**found, "result": names})
        self.write()

    def write(self) -> None:
        """Bring refused members to the table, and say how far the sweep has come."""
        if self.refused and len(self.parts):
            numbers, messages = zip(*self.refused, strict=True)
            self.refused = []
            self._keep(_refused_rows(np.array(numbers), messages, self.parts[0]))

    def _keep(self, rows: dict[str, np.ndarray]) -> None:
        self.parts.append(rows)
        self.waiting[rows["number"]] = False
        self.failed += int((rows["result"] != SUCCESSFUL).sum())
        self.messages |= {int(n): text for n, text in zip(rows["number"], rows["message"], strict=True) if text}
        if self.writer is not None:
            self.writer.append(rows)
        done, size = int((~self.waiting).sum()), self.plan.size
        failed = f", {self.failed} failed" if self.failed else ""
        self._tell(f"{done} of {size} members done{failed}, {time.perf_counter() - self.begun:.0f} s")

    def _tell(self, text: str) -> None:
        if self.say is not None:
            self.say(f"  {text}")

    def result(self, scene: Scene, times: np.ndarray) -> Sweep:
        """The sweep. Raises RuntimeError where members were lost."""
        if not self.parts:
            raise ValueError(
                f"No member of the sweep is a valid run. Member {self.refused[0][0]}: {self.refused[0][1]}"
            )
        rows = {name: np.concatenate([part[name] for part in self.parts]) for name in self.parts[0]}
        found = sweep_of(scene, self.settings, self.plan.parameters, times, placed(rows, self.plan.size), self.messages)
        if self.lost:
            raise RuntimeError(
                f"{len(self.lost)} of {self.plan.size} members were given up, since workers died of them (out of "
                "memory?): what ended is in the output file, if there is one. Run the same sweep again with a smaller "
                "batch."
            )
        return found


def _refused_rows(numbers: np.ndarray, messages, like: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Rows of members that were not run, of the kinds that others have."""
    rows = {
        name: np.full((len(numbers), *values.shape[1:]), np.nan if values.dtype.kind == "f" else 0, values.dtype)
        for name, values in like.items()
        if name not in ("number", "result", "message")
    }
    said = np.empty(len(numbers), object)
    said[:] = messages
    return {"number": numbers, **rows, "result": np.full(len(numbers), REFUSED), "message": said}


def _check_numbers(batch, workers, save_every, alike: bool) -> None:
    check_count("batch", batch)
    check_count("workers", workers)
    if save_every is not None:
        check_count("save_every", save_every)
        if not alike:
            raise ValueError("Frames are kept of members with the same steps only: leave save_every out.")


def _first(plan: Design, case_of: CaseOf) -> Member:
    """The first member that is valid. Raises ValueError where none is."""
    reason = ""
    for number in range(plan.size):
        try:
            return prepared(number, case_of(plan.member(number)))
        except ValueError as error:
            reason = reason or str(error)
    raise ValueError(f"No member of the sweep is a valid run. The first: {reason}")


def _times_of(member: Member) -> np.ndarray:
    assert member.steps is not None
    return np.concatenate([[0.0], np.cumsum(member.steps)])


def _grid(times, first: Member, plan: Design, case_of: CaseOf, alike: bool, same_end: bool) -> np.ndarray | None:
    """Times of the histories; None for those of the steps. Raises ValueError for times that are none."""
    if times is None and alike:
        return None
    if times is None or np.ndim(times) == 0:
        count = POINTS if times is None else times
        check_count("times", count, least=2)
        return np.linspace(0.0, _longest(first, plan, case_of, same_end), int(count))
    check_finite("times", times)
    found = np.asarray(times, float)
    if found.ndim != 1 or not len(found) or found[0] < 0 or np.any(np.diff(found) <= 0):
        raise ValueError(f"times must rise from 0 or later, but they are {shown(times)}.")
    return found


def _longest(first: Member, plan: Design, case_of: CaseOf, same_end: bool) -> float:
    """The end of the longest run."""

    def end(case: Case) -> float:
        return float(np.sum(case.dt)) if case.t_end is None else float(case.t_end)

    longest = end(first.case)
    for number in () if same_end else range(plan.size):
        with contextlib.suppress(ValueError):
            longest = max(longest, end(case_of(plan.member(number))))
    return longest
