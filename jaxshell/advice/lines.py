"""Ways to run a scene, each over meshes and steps: what is known of its errors, and what to try next.

A line is a method with a shape of the elements. Its error on a mesh with N steps is taken for m(mesh) + s(N): m from
the line's own runs, a power of the element size between and beyond them; s from runs on the coarsest mesh with ever
more steps, a power of N. These are expectations, which choose what is run; what is advised was measured.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxshell import methods
from jaxshell.advice.chart import Configuration, Point
from jaxshell.advice.converged import Converged, Trial, apart, explicit_label, explicit_steps, label_of
from jaxshell.advice.family import FACTORS, Family, Member
from jaxshell.advice.references import Reference, signal_error

_FEWEST = 8
"""Steps that a run has at least: fewer show little of the motion."""
_SLOPES = (1.0, 2.5)
"""Powers of the element size between which a mesh's error is expected to fall; 2 where one mesh is known."""
_GROWTH = 1.1
"""Time of a step grows with the number of elements to this power."""
_PAYS = 0.9
"""What is expected to take more than this part of the best's time is not run."""
_SHARE = 0.6
"""Part of the goal that a mesh's error may have: the step has the rest."""
_NOISE = 0.25
"""Part of an error that is the mesh's at least, whatever the step is thought to add."""


class Entry(NamedTuple):
    """A configuration on a mesh, and how it did."""

    member: Member
    configuration: Configuration
    point: Point


class StepErrors:
    """s(N): the error of the step, from runs of one mesh with ever more steps."""

    def __init__(self, steps: list[int], errors: list[float]):
        order = np.argsort(steps)
        self.steps = np.asarray(steps, float)[order]
        self.errors = np.maximum(np.asarray(errors, float)[order], 1e-12)

    def __call__(self, steps: float | int) -> float:
        n, e = np.log(self.steps), np.log(self.errors)
        at = np.log(steps)
        if at <= n[0] or len(n) == 1:
            return float(np.exp(e[0] - 2.0 * (at - n[0])))
        if at >= n[-1]:
            return float(np.exp(e[-1] - 2.0 * (at - n[-1])))
        return float(np.exp(np.interp(at, n, e)))


class Line:
    """A method with a shape of the elements.

    Arguments:
        label: what it is called.
        configure: dt -> its configuration.
        members: the meshes that it may run on, coarse to fine.
        window: time of a run.
        step_errors: None of a method whose step the mesh settles.
        steps_on: of such a method, the steps that a mesh asks for.
        begin: the meshes that it is tried on first, where nothing is known of it.
    """

    def __init__(
        self,
        label: str,
        configure: Callable[[float], Configuration],
        members: list[Member],
        window: float,
        step_errors: StepErrors | None,
        steps_on: Callable[[Member], int] | None = None,
        begin: list[Member] | None = None,
    ):
        self.label, self.configuration, self.members, self.window = label, configure, members, window
        self.step_errors, self.steps_on, self.begin = step_errors, steps_on, begin or []
        self.known: list[tuple[Member, int, float, float]] = []
        """(mesh, steps, error, seconds) of its runs."""
        self.measured: set[tuple[float, int]] = set()

    def add(self, entry: Entry) -> None:
        """Learn from a run that was measured."""
        steps = round(self.window / entry.point.dt)
        self.known.append((entry.member, steps, entry.point.error, entry.point.seconds))
        self.measured.add((entry.member.factor, steps))

    def add_trial(self, trial: Trial, reference: Reference) -> None:
        """Learn from a run that the reference was made of."""
        error = signal_error(reference, trial.times, trial.signals, everywhere=True)
        self.known.append((trial.member, trial.steps, error, trial.seconds))

    def beginnings(self, goal: float) -> list[tuple[Member, float]]:
        """(mesh, dt) of the runs that tell the first of it."""
        return [(member, self.window / self._first_steps(member, goal)) for member in self.begin]

    def _first_steps(self, member: Member, goal: float) -> int:
        if self.steps_on is not None:
            return self.steps_on(member)
        assert self.step_errors is not None
        return next((n for n in self._counts() if self.step_errors(n) <= goal / 3.0), max(self._counts()))

    def around(self, member: Member, multiples: tuple[float, ...]) -> list[float]:
        """Steps on a mesh that show where its own error begins: multiples of the number whose error is about that."""
        if self.steps_on is not None:
            return [self.window / self.steps_on(member)]
        assert self.step_errors is not None
        error = self.mesh_error(member) if self.known else self.step_errors.errors[-1]
        enough = next((n for n in self._counts() if self.step_errors(n) <= error), max(self._counts()))
        return [self.window / max(_FEWEST, round(multiple * enough)) for multiple in multiples]

    def choice(self, goal: float, limit: float) -> tuple[Member, float] | None:
        """(mesh, dt) of the cheapest run that is expected to meet the goal in clearly less than `limit` seconds."""
        found = [c for c in self._candidates(goal) if c[0] < _PAYS * limit]
        if not found:
            return None
        _, member, steps = min(found, key=lambda c: c[0])
        return member, self.window / (steps if self.steps_on is None else self.steps_on(member))

    def least_seconds(self, goal: float) -> float:
        """Of the cheapest run that is expected to meet the goal; infinite where none is, or nothing is known yet."""
        return min((seconds for seconds, *_ in self._candidates(goal)), default=np.inf)

    def _candidates(self, goal: float) -> list[tuple[float, Member, int]]:
        """(expected seconds, mesh, steps) of what is not measured yet and expected to meet the goal."""
        failed = [(member.factor, steps) for member, steps, error, _ in self.known if error > goal]
        found = []
        for member in self.members if self.known else []:
            counts = self._counts() if self.steps_on is None else [self._expected_steps(member)]
            for steps in counts:
                hopeless = any(member.factor <= f and steps <= n for f, n in failed)
                if hopeless or (member.factor, steps) in self.measured:
                    continue
                if self.expected_error(member, steps) <= goal:
                    found.append((self.expected_seconds(member, steps), member, steps))
        return found

    def _counts(self) -> list[int]:
        """Numbers of steps to choose from, by factors of the root of 2."""
        assert self.step_errors is not None
        base = self.step_errors.steps[-1]
        counts = [round(base * 2.0 ** (k / 2.0)) for k in range(-16, 9)]
        return sorted({n for n in counts if n >= _FEWEST})

    def expected_error(self, member: Member, steps: int) -> float:
        return self.mesh_error(member) + (0.0 if self.step_errors is None else self.step_errors(steps))

    def mesh_error(self, member: Member) -> float:
        """m: of the runs on a mesh the least, less what the step adds; powers of the size between and beyond."""
        least: dict[float, float] = {}
        for on, steps, error, _ in self.known:
            of_step = 0.0 if self.step_errors is None else self.step_errors(steps)
            if np.isfinite(error):
                own = max(error - of_step, _NOISE * error)
                least[on.factor] = min(own, least.get(on.factor, np.inf))
        if not least:
            return np.inf
        factors = sorted(least)
        f, e = np.log(factors), np.log([max(least[factor], 1e-12) for factor in factors])
        at = np.log(member.factor)
        if len(f) == 1:
            return float(np.exp(e[0] - 2.0 * (at - f[0])))
        if at < f[0] or at > f[-1]:
            i, j = (0, 1) if at < f[0] else (-2, -1)
            slope = np.clip(-(e[j] - e[i]) / (f[j] - f[i]), *_SLOPES)
            near = 0 if at < f[0] else -1
            return float(np.exp(e[near] - slope * (at - f[near])))
        return float(np.exp(np.interp(at, f, e)))

    def expected_seconds(self, member: Member, steps: int) -> float:
        """By the run on the mesh that is nearest in size."""
        near, count, _, seconds = min(
            self.known, key=lambda k: (abs(np.log(k[0].factor / member.factor)), abs(np.log(k[1] / steps)))
        )
        elements = member.scene.mesh.n_elements / near.scene.mesh.n_elements
        return seconds / count * steps * elements**_GROWTH

    def _expected_steps(self, member: Member) -> int:
        """Of a method whose step the mesh settles: a power of the size through the meshes that were tried."""
        known = sorted({(on.factor, steps) for on, steps, _, _ in self.known})
        if len(known) == 1:
            return round(known[0][1] * member.factor / known[0][0])
        (f, n), (g, m) = known[0], known[-1]
        return round(n * (member.factor / f) ** (np.log(m / n) / np.log(g / f)))

    def why_not(self, goal: float, limit: float) -> str:
        """Why it is not followed further."""
        meeting = [(seconds, member, steps) for member, steps, error, seconds in self.known if error <= goal]
        expected = self._candidates(goal)
        if meeting or expected:
            seconds, member, steps = min(meeting + expected, key=lambda c: c[0])
            is_measured = (member.factor, steps) in self.measured
            return (
                f"{self.label}: {'meets it' if is_measured else 'expected to meet it'} with {member.label} and dt = "
                f"{self.window / steps:.3g} in {seconds:.2g} s"
                + ("" if np.isinf(limit) else f", against {limit:.2g} s")
            )
        if not self.known or all(np.isinf(error) for *_, error, _ in self.known):
            return f"{self.label}: does not run"
        member, _, error, _ = min(self.known, key=lambda k: k[2])
        finest = self.members[-1]
        return (
            f"{self.label}: its error is {error:.1e} on {member.label}, and {self.mesh_error(finest):.1e} is expected "
            f"on {finest.label}, the finest mesh considered"
        )


def lines_of(family: Family, found: Converged, goal: float = np.inf) -> list[Line]:
    """The lines, those that the reference was made of first; they know what its runs showed.

    Their meshes are those of the reference and between them, and finer ones until one can be expected to meet the goal.
    """
    reference, window = found.reference, float(found.reference.times[-1])
    members = _members(family, found)
    coarsest, errors = members[0], step_errors(found)
    lines = []
    for form in dict.fromkeys(trial.form for trial in found.trials if not trial.form.explicit):
        line = Line(form.configuration(1.0).label, form.configuration, members, window, errors)
        for trial in found.trials:
            if trial.form == form:
                line.add_trial(trial, reference)
        lines.append(line)
    begin = [coarsest]
    shape = found.trials[0].form.shape
    explicit = [_explicit(members, window, shape, begin, rotary) for rotary in ("scaled", "physical")]
    for line in explicit:
        own = [t for t in found.trials if t.form.explicit and t.form.label == line.label]
        for trial in own:
            line.add_trial(trial, reference)
        if own:
            line.begin = []
    known = [line for line in (*lines, *explicit) if line.known]
    while min(line.mesh_error(members[-1]) for line in known) > _SHARE * goal:
        finer = family.finer(members[-1].factor)
        if finer is None:
            break
        members.append(finer)
    for line in explicit:
        if line.begin:  # errors of lumped masses fall in their own way: two meshes tell it
            line.begin = [coarsest] + [m for m in members if m.factor >= 1.9 * coarsest.factor][:1]
    return [*lines, *explicit, *([] if errors is None else [_emc(members, window, shape, errors, begin)])]


def _members(family: Family, found: Converged) -> list[Member]:
    """The meshes of the reference and those between them, coarse to fine."""
    made = {trial.member.factor: trial.member for trial in found.trials}
    coarsest, finest = min(made), max(made)
    for factor in FACTORS:
        if coarsest <= factor <= finest and not any(abs(np.log(factor / f)) < 0.15 for f in made):
            member = family.at(factor)
            if member is not None:
                made[member.factor] = member
    return [made[factor] for factor in sorted(made)]


def _explicit(members: list[Member], window: float, shape: str | None, begin: list[Member], rotary: str) -> Line:
    """Central differences at the critical step of every mesh."""
    method = methods.CentralDifference(rotary=rotary)

    def steps_on(member: Member) -> int:
        return explicit_steps(member, shape, method, window)

    return _line(explicit_label(shape, rotary), method, shape, members, window, None, steps_on, begin)


def _emc(members: list[Member], window: float, shape: str | None, errors: StepErrors, begin: list[Member]) -> Line:
    """The paper's method without rotary inertia, the cheapest step that it has."""
    method = methods.GeneralizedEnergyMomentum(inertia="none")
    return _line(label_of("EMC without rotary inertia", shape), method, shape, members, window, errors, None, begin)


def _line(label: str, method: methods.Method, shape: str | None, *given) -> Line:
    """A line of one method with one shape; `given` are the arguments of `Line` from `members` on."""
    return Line(label, lambda dt: Configuration("total", label, method, dt, shape=shape), *given)


def step_errors(found: Converged) -> StepErrors | None:
    """From the implicit runs on the coarsest mesh: their distance from the one with most steps, whose own is a third of
    that of half as many. None where there are none."""
    implicit = [trial for trial in found.trials if not trial.form.explicit]
    coarsest = min((trial.member.factor for trial in implicit), default=0.0)
    runs = [t for t in implicit if t.member.factor == coarsest and t.form == implicit[0].form]
    if not runs:
        return None
    finest = max(runs, key=lambda t: t.steps)
    others = {t.steps: apart(t, finest) for t in runs if t.steps < finest.steps}
    if not others:
        return StepErrors([finest.steps], [_NOISE * signal_error(found.reference, finest.times, finest.signals)])
    counts = [*others, finest.steps]
    return StepErrors(counts, [4.0 / 3.0 * e for e in others.values()] + [others[max(others)] / 3.0])
