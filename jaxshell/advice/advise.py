"""The cheapest way to run a scene to a tolerance of the continuous answer: mesh, element, method and step together.

1. The answer: two discretisations on a family of meshes, extrapolated (`jaxshell.advice.converged`). What is not known
   of it counts against the tolerance.
2. Every trial of it is a way to run the scene, with its error: how the error falls with the mesh, and with the step on
   the coarsest mesh, where steps are cheap. Other methods are tried on coarse meshes too: central differences with the
   critical step of each mesh and the error of their own lumped masses.
3. From that each way's cheapest mesh and step are predicted. The best are run as they are, and what is advised is what
   was measured to be within the tolerance; looser Newton tolerances at last, and step control where it may pay.
"""

import time
from collections.abc import Callable

import numpy as np

from jaxshell import methods
from jaxshell.advice.chart import Configuration, Point, controlled, default_window, measure
from jaxshell.advice.converged import Converged, Trial, converged
from jaxshell.advice.family import Family
from jaxshell.advice.lines import Entry, Line, lines_of
from jaxshell.advice.references import Reference, signal_error
from jaxshell.advice.text import Advice, mesh_text
from jaxshell.model.scene import Scene
from jaxshell.numerics.checks import check_kind, check_positive_number
from jaxshell.solvers.newton import Newton

MARGIN = 0.8
"""Fraction of the tolerance that a configuration may use: the reference and the window are not everything."""
_LEAST = 0.25
"""Fraction of the tolerance that the reference's uncertainty has to leave, or nothing is promised."""
_KNOWN = 0.25
"""Fraction of the tolerance that the reference is to be known to."""
_FOR_REFERENCE = 0.8
"""Fraction of the budget that the reference may take."""
_ROOM = 0.6
"""Part of the time that is left that a run may be expected to take: it is compiled before."""
_TRIES = 5
"""Runs of one line at most, once its errors are known on coarse meshes."""


def advise(
    scene: Scene,
    tolerance: float = 1e-2,
    dt: float | None = None,
    t_end: float | None = None,
    say: Callable[[str], None] = print,
    make: Callable[..., Scene] | None = None,
    budget: float = 110.0,
    found: Converged | None = None,
) -> Advice:
    """The cheapest configuration whose answer is within `tolerance` of the continuous one.

    Arguments:
        scene: what is to be run. Its answer are its watched displacements, else those of all nodes.
        tolerance: the largest error, relative to the answer's largest size; above 0, below 1.
        dt: step from which trials start, up and down; None is the scene's.
        t_end: time that trials cover; None is a shipped reference's whole window, else 100 dt.
        say: told each trial.
        make: the function of the library that made the scene: other meshes by its `divisions`, of all sizes. None
            refines and coarsens the scene itself.
        budget: seconds after which nothing more is begun, about.
        found: the continuous answer, where it is there already.

    Raises ValueError for a tolerance out of range, without a step, or when the scene does not run at any step.
    """
    check_kind("advise's first argument", scene, Scene, "a jaxshell.Scene")
    if not 0 < tolerance < 1:
        raise ValueError(f"tolerance must lie between 0 and 1, but it is {tolerance}.")
    check_positive_number("budget", budget)
    dt = first_step(scene) if dt is None else dt
    clock = _Clock(budget)
    family = Family(scene, make)
    window = default_window(scene, dt, t_end)
    if found is None:
        found = converged(family, dt, window, _KNOWN * tolerance, _FOR_REFERENCE * budget, say)
    goal = min(MARGIN * tolerance, tolerance - found.reference.uncertainty)
    search = _Search(family, found, goal, clock, say)
    if goal < _LEAST * tolerance:
        return search.unknown(tolerance)
    for line in sorted(search.lines.values(), key=lambda line: line.least_seconds(goal)):
        search.pursue(line)
    if search.best is None:
        search.take_trial()
    if search.best is None:
        return search.nothing(tolerance)
    reasons = search.mesh_and_step_reasons()
    search.loosen_newton(reasons)
    search.control_step(reasons)
    return search.advice(tolerance, reasons, met=search.whole)


def first_step(scene: Scene) -> float:
    """The scene's own step. Raises ValueError where it says none."""
    if scene.defaults is None or scene.defaults.dt is None:
        raise ValueError("The scene says no step to start from: give dt.")
    return float(scene.defaults.dt)


class _Clock:
    def __init__(self, budget: float):
        self.begun, self.budget = time.perf_counter(), budget

    def left(self) -> float:
        return self.budget - (time.perf_counter() - self.begun)

    def spent(self) -> bool:
        return self.left() < 0.0


class _Search:
    """What was measured so far and the best of it."""

    def __init__(self, family: Family, found: Converged, goal: float, clock: _Clock, say: Callable[[str], None]):
        self.family, self.found, self.goal, self.clock, self.say = family, found, goal, clock, say
        self.reference: Reference = found.reference
        self.entries: list[Entry] = []
        self.best: Entry | None = None
        self.said: list[str] = []
        """Why lines were not followed further."""
        sought = goal if goal > 0.0 else np.inf  # no finer mesh is made for what cannot be promised
        self.lines: dict[str, Line] = {line.label: line for line in lines_of(family, found, sought)}
        self.whole = len({trial.member.factor for trial in found.trials}) > 1

    def measured(self, line: Line, member, dt, **changes) -> Entry:
        """Run and remember; keep it when it is the cheapest that meets the goal."""
        tried: Configuration = line.configuration(dt)._replace(**changes)
        point = measure(member.scene, tried, self.reference, signals_of=self.family.signals)
        entry = Entry(member, tried, point)
        self.entries.append(entry)
        line.add(entry)
        self.say(
            f"  {point.label}, {member.label}, dt = {point.dt:.3g}: error {point.error:.1e}, {point.seconds:.3g} s"
            + (" (meets it)" if point.error <= self.goal else "")
        )
        if point.error <= self.goal and (self.best is None or point.seconds < self.best.point.seconds):
            self.best = entry
        return entry

    def pursue(self, line: Line) -> None:
        """Run the cheapest mesh and step that are expected to meet the goal, until that is settled."""
        try:
            self._follow(line)
        except ValueError as error:  # of a method that a scene is not for
            self.said.append(f"{line.label}: {error}")

    def _follow(self, line: Line) -> None:
        for member, dt in line.beginnings(self.goal):
            if self.clock.spent():
                self.said.append(f"{line.label} was not tried: the budget of time was spent")
                return
            self.measured(line, member, dt)
        for _ in range(_TRIES):
            limit = np.inf if self.best is None else self.best.point.seconds
            if _ROOM * self.clock.left() < line.least_seconds(self.goal) < limit:
                self.said.append(f"{line.label} was not followed to its end: the budget of time was spent")
                return
            choice = line.choice(self.goal, limit)
            if choice is None:
                if self.best is None or self.best.configuration.label != line.label:
                    self.said.append(line.why_not(self.goal, limit))
                return
            self.measured(line, *choice)

    def take_trial(self) -> None:
        """The quickest of the reference's own runs that meets the goal."""
        pairs = zip(self.found.trials, self.of_trials(), strict=True)
        good = [(t, p) for t, p in pairs if p.error <= self.goal and p.label in self.lines]
        if good:
            trial, point = min(good, key=lambda pair: pair[1].seconds)
            self.best = Entry(trial.member, trial.form.configuration(trial.dt), point)

    def mesh_and_step_reasons(self) -> list[str]:
        """What the mesh and the step of the best add, what coarser ones would, and why not the other lines."""
        assert self.best is not None
        member, _, point = self.best
        reasons = [
            f"{point.label} on {member.label} ({mesh_text(member)}) with dt = {point.dt:.3g}: measured error "
            f"{point.error:.1e}, {point.seconds:.3g} s"
        ]
        line = self.lines[point.label]
        of_step = "" if line.step_errors is None else f", of the step {line.step_errors(point.steps):.1e}"
        reasons.append(f"about {line.mesh_error(member):.1e} of that is of the mesh{of_step}")
        same = [(m, n, e) for m, n, e, _ in line.known if e > self.goal]
        coarser = [k for k in same if k[0].factor < member.factor]
        if coarser:
            m, n, e = max(coarser, key=lambda k: (k[0].factor, k[1]))
            reasons.append(f"{m.label} would miss, with {n} steps: error {e:.1e}")
        larger = [k for k in same if k[0].factor == member.factor and k[1] < point.steps]
        if larger:
            m, n, e = max(larger, key=lambda k: k[1])
            reasons.append(f"dt = {line.window / n:.3g} would miss: error {e:.1e}")
        elif line.step_errors is not None:
            reasons.append(f"twice the step would add about {line.step_errors(point.steps / 2):.1e}")
        return reasons + self.said

    def loosen_newton(self, reasons: list[str]) -> None:
        """Looser Newton tolerances while they pay and the answer stands."""
        assert self.best is not None
        if not self.best.configuration.method.uses_matrix or self.clock.left() < self.best.point.seconds:
            return
        line = self.lines[self.best.point.label]
        for tolerance in (1e-6, 1e-4):
            before = self.best
            found = self.measured(line, before.member, before.point.dt, newton=Newton(tolerance))
            if self.best is before:
                missed = found.point.error > self.goal
                why = f"error {found.point.error:.1e}" if missed else "no cheaper"
                reasons.append(
                    f"Newton to {tolerance:g} instead of {float(before.configuration.newton.tolerance):g}: {why}"
                )
                return
            reasons.append(f"Newton to {tolerance:g} is enough: error {found.point.error:.1e}")

    def control_step(self, reasons: list[str]) -> None:
        """Steps by their local error, on the mesh and with the element of the best, where they can be chosen."""
        assert self.best is not None
        best = self.best
        if not best.configuration.method.controls_step or self.clock.spent():
            return
        for tolerance in (1e-3, 1e-4, 1e-5):
            tried = controlled(tolerance, best.point.dt, float(self.reference.times[-1]))
            method = best.configuration.method
            if isinstance(method, methods.EnergyMomentum):
                tried = tried._replace(method=method)
            tried = tried._replace(shape=best.configuration.shape)
            point = measure(best.member.scene, tried, self.reference, signals_of=self.family.signals)
            self.entries.append(Entry(best.member, tried, point))
            self.say(f"  step control to {tolerance:g}: error {point.error:.1e}, {point.seconds:.3g} s")
            dearer = point.seconds > best.point.seconds
            if point.error <= self.goal and not dearer:
                self.best = self.entries[-1]
                reasons.append(f"step control with a tolerance of {tolerance:g} is quicker: error {point.error:.1e}")
                return
            if dearer or self.clock.spent():
                reasons.append(
                    f"step control with a tolerance of {tolerance:g}: error {point.error:.1e}, {point.seconds:.3g} s"
                )
                return

    def advice(self, tolerance: float, reasons: list[str], met: bool) -> Advice:
        """The best, with all that was found."""
        assert self.best is not None
        if not self.whole:
            reasons = ["Of the step alone: on one mesh nothing tells the mesh's own error", *reasons]
        points = [*self.of_trials(), *(entry.point for entry in self.entries)]
        member, tried, point = self.best
        return Advice(tried, point, reasons + self.found.notes, points, self.reference, tolerance, met, member)

    def nothing(self, tolerance: float) -> Advice:
        """Nothing met the goal: the most accurate."""
        reason = f"Nothing tried meets {tolerance:g}; the most accurate has an error of"
        return self._most_accurate(tolerance, reason)

    def unknown(self, tolerance: float) -> Advice:
        """The answer itself is not known well enough to promise anything: the most accurate trial."""
        reason = (
            f"The answer is known to {self.reference.uncertainty:.1e} only, and {tolerance:g} cannot be promised: ask "
            "for a larger tolerance, a larger budget or a shorter trial. The most accurate trial has an error of"
        )
        return self._most_accurate(tolerance, reason)

    def _most_accurate(self, tolerance: float, reason: str) -> Advice:
        tried = [*zip(self.found.trials, self.of_trials(), strict=True)]
        entries = [Entry(t.member, t.form.configuration(t.dt), point) for t, point in tried] + self.entries
        self.best = min(entries, key=lambda e: (e.point.error, e.point.seconds))
        return self.advice(tolerance, [f"{reason} {self.best.point.error:.1e}", *self.said], met=False)

    def of_trials(self) -> list[Point]:
        """The trials that the reference was made of, as points."""
        return [_point(trial, self.reference) for trial in self.found.trials]


def _point(trial: Trial, reference: Reference) -> Point:
    error = signal_error(reference, trial.times, trial.signals, everywhere=True)
    label = trial.form.configuration(trial.dt).label
    elements = trial.member.scene.mesh.n_elements
    return Point("total", label, trial.dt, trial.seconds, error, trial.steps, trial.iterations, elements)
