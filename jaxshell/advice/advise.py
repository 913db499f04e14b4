"""The cheapest way to run a scene to a tolerance, found by short trial runs and given with its reasons.

Trials against a converged reference (`jaxshell.advice.references`), over the reference's window:
1. methods, each at the largest step of a halving sequence that meets the tolerance, given up as soon as it is
   dearer than the best so far;
   Step control in the same way, over its tolerance;
2. physics that the answer does not feel: rotary inertia, compared at equal step;
3. for the winner: a looser Newton tolerance, and factors kept over iterations and steps;
4. for scenes of the library: fewer elements, where the answer stays within the tolerance; and what more would change.
"""

from collections.abc import Callable

import numpy as np

from jaxshell import methods
from jaxshell.advice.chart import (
    Configuration,
    Point,
    controlled,
    default_window,
    divided,
    measure,
    reference_of,
    timed,
)
from jaxshell.advice.references import Reference, signal_error, signals
from jaxshell.advice.text import Advice, divisions_text
from jaxshell.analyses.step_control import StepControl
from jaxshell.model.scene import Scene
from jaxshell.results.solution import Solution
from jaxshell.solvers.newton import Newton

_MARGIN = 0.8
"""Fraction of the tolerance that a configuration may use: the reference and the window are not everything."""
_FINEST = 7
"""Halvings of the step tried for a method before it is given up."""
_FEWEST = 8
"""Steps that a trial has at least, where steps are doubled: fewer show little of the motion."""


def advise(
    scene: Scene,
    tolerance: float,
    dt: float,
    t_end: float | None = None,
    say: Callable[[str], None] = print,
    reference: Reference | None = None,
    make: Callable[..., Scene] | None = None,
) -> Advice:
    """The cheapest configuration whose answer is within `tolerance` of the converged one.

    Arguments:
        tolerance: of the scene's figure of merit, relative (see `jaxshell.advice.references`); above 0, below 1.
        dt: step from which trials start, up and down.
        t_end: time that trials cover; default: a shipped reference's whole window, else 100 dt.
        say: told each trial. reference: instead of the shipped or a new one.
        make: the function of the library that made the scene; other meshes of it are tried by its `divisions`.

    Raises ValueError for a tolerance out of range, or when the scene does not run at any step.
    """
    if not 0 < tolerance < 1:
        raise ValueError(f"tolerance must lie between 0 and 1, but it is {tolerance}.")
    if reference is None:
        reference = reference_of(scene, dt, default_window(scene, dt, t_end), 0.1 * tolerance, say)
    goal = _MARGIN * tolerance - reference.uncertainty
    if goal <= 0:
        raise ValueError(
            f"The reference is known to {reference.uncertainty:.1e} only: ask for a tolerance above "
            f"{1.5 * reference.uncertainty / _MARGIN:.1e}, a smaller dt, or a shorter trial."
        )
    search = _Search(scene, reference, goal, say)
    for label, method in candidates():
        search.try_method(label, method, dt)
    search.try_step_control(dt)
    if search.best is None:
        point, best = min(search.tried, key=lambda pair: (pair[0].error, pair[0].seconds))
        reasons = [f"Nothing tried meets {tolerance:g}; the most accurate has an error of {point.error:.1e}"]
        return Advice(best, point, reasons, search.points, reference, tolerance, False)
    reasons = search.method_reasons()
    reasons += search.refine_newton()
    more, divisions = search.other_meshes(make) if make is not None else ([], None)
    assert search.best is not None
    point, best = search.best
    return Advice(best, point, reasons + more, search.points, reference, tolerance, True, divisions)


def candidates() -> list[tuple[str, methods.Method]]:
    """The methods that are tried, the likely winners first since they bound the others' cost."""
    gem = methods.GeneralizedEnergyMomentum
    return [
        ("EMC", gem()),
        ("EMC without rotary inertia", gem(inertia="none")),
        ("EDMC, ρ∞ 0.8, without rotary inertia", gem(0.8, inertia="none")),
        ("exact", methods.EnergyMomentum()),
        ("generalised α, ρ∞ 0.8", methods.GeneralizedAlpha()),
        ("central differences", methods.CentralDifference()),
    ]


class _Search:
    """What was tried so far and the best of it."""

    def __init__(self, scene: Scene, reference: Reference, goal: float, say):
        self.scene, self.reference, self.goal, self.say = scene, reference, goal, say
        self.tried: list[tuple[Point, Configuration]] = []
        self.best: tuple[Point, Configuration] | None = None
        self.given_up: dict[str, str] = {}

    @property
    def points(self) -> list[Point]:
        return [point for point, _ in self.tried]

    def attempt(self, configuration: Configuration, scene: Scene | None = None) -> Point:
        """Measure, remember, and keep it when it is the cheapest that meets the goal."""
        point = measure(self.scene if scene is None else scene, configuration, self.reference)
        self.tried.append((point, configuration))
        self.say(
            f"  {point.label}, dt = {point.dt:.3g}: error {point.error:.1e}, {point.seconds:.3g} s"
            + (" (meets it)" if point.error <= self.goal else "")
        )
        if point.error <= self.goal and (self.best is None or point.seconds < self.best[0].seconds):
            self.best = point, configuration
        return point

    def try_method(self, label: str, method: methods.Method, dt: float) -> None:
        """The largest step that meets the goal: doubled while it does, else halved while it can still pay."""
        if isinstance(method, methods.CentralDifference):
            dt = method.critical_step(self.scene)
            expected = self._seconds_per_step(explicit=True) * float(self.reference.times[-1]) / dt
            if self.best is not None and expected > self.best[0].seconds:
                self.given_up[label] = (
                    f"its critical step, {dt:.2g}, asks for {float(self.reference.times[-1]) / dt:.0f} steps"
                )
                return
        point = self.attempt(Configuration("method", label, method, dt))
        if point.error <= self.goal:
            largest = float(self.reference.times[-1]) / _FEWEST
            while not isinstance(method, methods.CentralDifference) and 2.0 * dt <= largest * (1 + 1e-9):
                dt *= 2.0
                if self.attempt(Configuration("method", label, method, dt)).error > self.goal:
                    return
            return
        last = point.error
        for _ in range(_FINEST):
            dt *= 0.5
            if self.best is not None and 1.5 * point.seconds > self.best[0].seconds:
                self.given_up[label] = f"at dt = {2 * dt:.3g} its error is {point.error:.1e} and it is no cheaper"
                return
            point = self.attempt(Configuration("method", label, method, dt))
            if point.error <= self.goal:
                return
            stuck = np.isfinite(point.error) and point.error > 0.9 * last and point.error > 3 * self.goal
            if stuck and last < 0.1:
                self.given_up[label] = f"its error does not fall below {point.error:.1e}: it models something else"
                return
            last = point.error
        self.given_up[label] = f"at dt = {dt:.3g} its error is still {point.error:.1e}"

    def try_step_control(self, dt: float) -> None:
        """The largest tolerance of the local error that meets the goal, while it can still pay."""
        for tolerance in (1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5):
            tried = controlled(tolerance, dt, float(self.reference.times[-1]))
            point = self.attempt(tried)
            if point.error <= self.goal:
                return
            if self.best is not None and point.seconds > self.best[0].seconds:
                self.given_up[tried.label] = (
                    f"with {point.steps} steps its error is {point.error:.1e} and it is no cheaper"
                )
                return

    def other_meshes(self, make: Callable[..., Scene]) -> tuple[list[str], int | tuple[int, ...] | None]:
        """Coarser meshes while they meet the goal and pay, and what a finer one changes: (reasons, divisions)."""
        assert self.best is not None
        reasons, divisions, winner = [], None, self.best
        for factor in (0.8, 0.6, 0.5):
            count = divided(make, factor)
            coarse, before = make(divisions=count), self.best
            label = f"{winner[0].label}, {coarse.mesh.n_elements} triangles"
            point = self.attempt(winner[1]._replace(kind="mesh", label=label), coarse)
            said = f"{coarse.mesh.n_elements} triangles (divisions {divisions_text(count)})"
            if self.best is before:
                reasons.append(f"{said} are not enough: error {point.error:.1e}")
                break
            reasons.append(f"{said} are enough: error {point.error:.1e}")
            divisions = count
        finer = make(divisions=divided(make, 1.5))
        t_end = float(self.reference.times[-1])
        runs = [timed(scene, winner[1], t_end)[0] for scene in (self.scene, finer)]
        if not any(run.message for run in runs):
            times, found = zip(*((np.asarray(r.frame_times), _signals(r)) for r in runs), strict=True)
            change = signal_error(Reference(times[1], dict(found[1]), 0.0, ""), times[0], found[0])
            reasons.append(
                f"{finer.mesh.n_elements} triangles would change the answer by {change:.1e}: the mesh's own error, "
                "which the tolerance does not speak of"
            )
        return reasons, divisions

    def _seconds_per_step(self, explicit: bool) -> float:
        """A first guess from implicit trials: an explicit step costs about a tenth."""
        rates = [p.seconds / p.steps for p in self.points if p.steps]
        return (min(rates) if rates else 0.0) * (0.1 if explicit else 1.0)

    def method_reasons(self) -> list[str]:
        """Why this method and step, and what rotary inertia does."""
        assert self.best is not None
        point, best = self.best
        reasons = [
            f"{point.label} at dt = {point.dt:.3g} has an error of {point.error:.1e} and takes {point.seconds:.3g} s"
        ]
        larger = [p for p in self.points if p.label == point.label and p.dt > 1.01 * point.dt]
        if isinstance(best.dt, StepControl):
            reasons[0] += f", step control with a tolerance of {float(best.dt.tolerance):g}"
        elif larger:
            nearest = min(larger, key=lambda p: p.dt)
            reasons.append(f"dt = {nearest.dt:.3g} would miss: error {nearest.error:.1e}")
        elif not isinstance(best.method, methods.CentralDifference):
            steps = float(self.reference.times[-1]) / point.dt
            reasons.append(f"larger steps were not tried: the trial has {steps:.0f} of these (--t-end makes it longer)")
        for label in dict.fromkeys(p.label for p in self.points):
            meeting = [p for p in self.points if p.label == label and p.error <= self.goal]
            if label != point.label and meeting:
                cheapest = min(meeting, key=lambda p: p.seconds)
                times = cheapest.seconds / point.seconds
                reasons.append(f"{label} meets it at dt = {cheapest.dt:.3g} in {times:.1f} times the time")
        reasons += [f"{label}: {why}" for label, why in self.given_up.items()]
        if isinstance(best.method, methods.GeneralizedEnergyMomentum):
            change = inertia_change(self.scene, best, self.reference)
            left_out = best.method.inertia == "none"
            verdict = "left out" if left_out else ("could be left out" if change <= 0.1 * self.goal else "kept")
            reasons.append(f"rotary inertia changes the answer by {change:.1e}: {verdict}")
        return reasons

    def refine_newton(self) -> list[str]:
        """Looser Newton tolerances while they pay and the answer stands, then kept factors."""
        assert self.best is not None
        if not self.best[1].method.uses_matrix:
            return []
        reasons = []
        exact = self.best[0]
        for tolerance in (1e-6, 1e-4, 1e-3):
            before = self.best
            tried = before[1]._replace(newton=Newton(tolerance), label=f"{exact.label}, Newton to {tolerance:g}")
            point = self.attempt(tried)
            if self.best is before:
                why = f"error {point.error:.1e}" if point.error > self.goal else "no cheaper"
                reasons.append(f"Newton to {tolerance:g} instead of {_newton_of(before[1]):g}: {why}")
                break
            reasons.append(f"Newton to {tolerance:g} is enough: error {point.error:.1e}")
        before = self.best
        point = self.attempt(
            before[1]._replace(
                newton=Newton(_newton_of(before[1]), reuse=False), label=f"{before[0].label}, full Newton"
            )
        )
        gain = point.seconds / before[0].seconds
        if self.best is before:
            reasons.append(f"factorizations kept over steps: {gain:.2f} times as fast as one an iteration")
        else:
            reasons.append(f"a factorization in every iteration: {1 / gain:.2f} times as fast as kept ones")
        return reasons


def inertia_change(scene: Scene, configuration: Configuration, reference: Reference) -> float:
    """How much rotary inertia changes the answer: the same run with and without it."""
    t_end = float(reference.times[-1])
    runs: list[Solution] = [
        timed(scene, configuration._replace(method=_with_inertia(configuration.method, form)), t_end)[0]
        for form in ("seven_point", "none")
    ]
    if any(run.message for run in runs):
        return np.inf
    with_, without = runs
    base = Reference(np.asarray(with_.frame_times), dict(_signals(with_)), 0.0, "")
    if len(base.times) < 4:
        return np.inf
    return signal_error(base, base.times, _signals(without))


def _signals(run: Solution):
    return signals(run.scene, np.asarray(run.displacements))


def _with_inertia(method, form: str):
    return methods.GeneralizedEnergyMomentum(method.spectral_radius, method.dissipation, inertia=form)


def _newton_of(configuration: Configuration) -> float:
    return float(configuration.newton.tolerance)
