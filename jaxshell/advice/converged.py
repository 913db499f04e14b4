"""The answer of the continuous problem, from trials: two discretisations on a family of meshes, extrapolated.

`EnergyMomentum` on meshes whose elements halve in size, with the step halved along; by two forms of the element that
have little in common but the limit. Where the critical step is not far below the motion's, or no larger step resolves
what rings, as after a force on a point that is there at once, both forms are taken by central differences, which
compile sooner besides. Errors of mesh and step are of second order together, so that Richardson's extrapolation of the
two finest, which differ by c, takes both out: c/3. Runs whose changes fall by the factor ρ have c/(ρ-1) left, and a
form's extrapolation is known to the difference of the two, with ρ as seen but for some safety: 4 where all is of
second order, 2 of first, 1 where noise is left. So what does not converge as it should is not thought known. Of two
meshes only, it is known to twice what extrapolation moved. The answer is the extrapolation of the form that is known
best; where it is further from the other's than that one is known to, it is not known better than by that.
"""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from jaxshell import methods
from jaxshell.advice.chart import Configuration, run_once
from jaxshell.advice.family import FACTORS, Family, Member, shapes_of
from jaxshell.advice.references import Reference, Signals, agreement, extrapolate
from jaxshell.model.scene import Scene
from jaxshell.model.with_shape import with_shape

_COARSEST, _COARSEST_EXPLICIT = 40, 100
"""Triangles with which the first mesh begins, if the family goes so far down; and of central differences, which show
waves that coarser ones cannot carry."""
_HALVINGS = 4
"""Of the step on the coarsest mesh, before it is taken for what it is."""
_GROWTH, _GROWTH_EXPLICIT = 1.2, 1.1
"""Time of a step grows with the number of elements to this power, at most: what a finer mesh is expected to cost. Of
central differences it is that of a run."""
_FIRST = 0.25
"""Steps that the coarsest mesh begins with, over those that the scene asks for there."""
_SECOND_ORDER, _SLOWEST, _SAFE = 4.0, 1.2, 2 / 3
"""By these factors the changes of a refinement are thought to fall, at most and at least; and what is trusted
of the factor that was seen: coarse meshes show one that is too large."""
_FEWEST = 8
"""Steps of a run at least."""
_LUMPED = "lumped"
_EXPLICIT_SECONDS = 1e-6
"""Of one element in one step of central differences, about."""
_TWICE_FINER = 20
"""Times the coarsest mesh's work is that of the one that is halved twice: 16 times the elements, and some more steps:
bending settles them on coarse meshes, whatever the size of elements."""
_CHEAP, _BEARABLE = 0.5, 4.0
"""That work over the time there is: below the one central differences are taken, below the other where larger steps do
not resolve what happens."""


class Form(NamedTuple):
    """A discretisation by elements."""

    shape: str | None
    """None: the scene's own, which regions may have of several kinds."""
    inertia: str
    """Of `EnergyMomentum`; or "lumped": by central differences."""

    @property
    def explicit(self) -> bool:
        return self.inertia == _LUMPED

    @property
    def label(self) -> str:
        if self.explicit:
            return explicit_label(self.shape, "physical")
        return ("" if self.shape is None else f"{self.shape}, ") + f"{self.inertia} inertia"

    def configuration(self, dt: float) -> Configuration:
        if self.explicit:
            return Configuration("total", self.label, methods.CentralDifference(), dt, shape=self.shape)
        label = f"exact, {self.label}"
        return Configuration("total", label, methods.EnergyMomentum(inertia=self.inertia), dt, shape=self.shape)

    def steps_on(self, member: Member, t_end: float) -> int:
        """The fewest steps of central differences."""
        return explicit_steps(member, self.shape, methods.CentralDifference(), t_end)


def explicit_label(shape: str | None, rotary: str) -> str:
    """What central differences are called."""
    return label_of(f"central differences, {rotary} rotary inertia", shape)


def label_of(method: str, shape: str | None) -> str:
    """What a method is called with elements of a shape."""
    return method if shape in (None, "flat") else f"{method}, {shape}"


def explicit_steps(member: Member, shape: str | None, method: methods.CentralDifference, t_end: float) -> int:
    """Steps at the critical one of a mesh. Raises ValueError for a scene that the method is not for."""
    scene = member.scene if shape is None else with_shape(member.scene, shape)
    method.check(scene, [0.0])
    return int(np.ceil(t_end / method.critical_step(scene)))


class Trial(NamedTuple):
    """A run for the reference."""

    form: Form
    member: Member
    dt: float
    steps: int
    times: Float[np.ndarray, " k"]
    signals: Signals
    iterations: int
    seconds: float
    """Of its steps, compilation apart."""


class Converged(NamedTuple):
    """The answer, and what it was made of."""

    reference: Reference
    trials: list[Trial]
    notes: list[str]


def forms_of(scene: Scene) -> tuple[Form, Form]:
    """The two discretisations, the nearer one first."""
    shapes = shapes_of(scene)
    if not shapes:
        return Form(None, "cubic"), Form(None, "linear")
    if "curved" not in shapes:
        return Form(shapes[0], "cubic"), Form(shapes[0], "linear")
    other = next(shape for shape in shapes if shape != "curved")
    return Form("curved", "cubic"), Form(other, "cubic")


def converged(
    family: Family,
    dt: float,
    t_end: float,
    target: float,
    seconds: float,
    say: Callable = print,
) -> Converged:
    """The continuous answer up to t_end, refined until it is known to `target` or `seconds` are spent.

    Raises ValueError where the scene does not run on its coarsest mesh at any step tried.
    """
    begun = time.perf_counter()
    implicit_forms = forms_of(family.scene)
    forms: tuple[Form, ...] = implicit_forms
    coarse = _coarsest(family)
    trials, notes, levels, steps = [], [], [], 0
    member: Member | None = _coarsest(family, _COARSEST_EXPLICIT)
    work = _explicit_work(member, forms, t_end) / seconds
    explicit = work <= _CHEAP
    if not explicit:
        steps, trials, resolved = _first_steps(family, coarse, forms[0], dt, t_end, 4.0 * target, say)
        explicit = not resolved and work <= _BEARABLE
    if explicit:
        forms = tuple(Form(form.shape, _LUMPED) for form in forms)
    else:
        member = coarse
    found: Reference | None = None
    while member is not None:
        implicit = max(_FEWEST, round(steps * member.factor / coarse.factor))
        counts = {form: form.steps_on(member, t_end) if form.explicit else implicit for form in forms}
        wanted = [(f, n) for f, n in counts.items() if not any(_is(t, f, member, n) for t in trials)]
        made = [_trial(family, member, form, t_end, count) for form, count in wanted]
        trials += [trial for trial in made if trial is not None]
        level = [t for form, count in counts.items() for t in trials if _is(t, form, member, count)]
        notes += [
            f"{form.label} does not run on {member.label} with {count} steps"
            for form, count in counts.items()
            if not any(t.form == form for t in level)
        ]
        forms = tuple(t.form for t in level)
        if not level:
            break
        levels.append(level)
        if len(levels) > 1:
            found = _extrapolated(levels)
            say(f"  reference: {member.label}, {level[0].steps} steps: known to {found.uncertainty:.1e}")
            if found.uncertainty <= target:
                break
        finer = family.at(2.0 * member.factor) if member.factor < FACTORS[-1] else None
        left = seconds - (time.perf_counter() - begun)
        if finer is not None and not _affordable(levels[-1], finer, left, after=forms[0].explicit):
            if len(forms) == 1 or not _affordable(levels[-1][:1], finer, left):
                notes.append(f"{finer.label} would have taken too long: a larger budget, or a shorter trial")
                break
            forms = forms[:1]
        member = finer
    if found is None:
        found = _of_one_mesh(trials)
        notes.append("on one mesh alone nothing tells its own error")
    if not steps and time.perf_counter() - begun < seconds:
        # What implicit methods' steps cost in accuracy.
        try:
            trials += _first_steps(family, coarse, implicit_forms[0], dt, t_end, 4.0 * target, say)[1]
        except ValueError as error:
            notes.append(f"{implicit_forms[0].label}: {error}")
    return Converged(found, trials, family.notes + notes)


def _coarsest(family: Family, elements: int = _COARSEST) -> Member:
    """Where refinement begins: the coarsest mesh that has so many elements."""
    member = family.at(1.0)
    assert member is not None
    while (half := family.at(0.5 * member.factor)) is not None and half.scene.mesh.n_elements >= elements:
        member = half
    return member


def _first_steps(
    family: Family, member: Member, form: Form, dt: float, t_end: float, target: float, say: Callable
) -> tuple[int, list[Trial], bool]:
    """Steps for the coarsest mesh, with an error of `target` at most, the runs that told it, and whether there is one.

    Raises ValueError where no run succeeds.
    """
    count = max(_FEWEST, round(_FIRST * member.factor * t_end / dt))
    trials: list[Trial] = []
    for _ in range(_HALVINGS + 1):
        trial = _trial(family, member, form, t_end, count)
        if trial is not None:
            trials.append(trial)
            if len(trials) > 1:
                change = apart(trials[-1], trials[-2])
                say(f"  {member.label}, {count} steps instead of half as many change the answer by {change:.1e}")
                if 4.0 / 3.0 * change <= target:
                    return trials[-2].steps, trials, True
        count *= 2
    if not trials:
        raise ValueError("The scene does not run at any step tried: give a smaller dt.")
    return trials[-1].steps, trials, False


def _explicit_work(coarse: Member, forms: tuple[Form, ...], t_end: float) -> float:
    """Seconds of a run by central differences on a mesh halved twice, about. Infinite where there is one shape of
    elements only, or the method is not for the scene."""
    if len({form.shape for form in forms}) < 2:
        return np.inf
    try:
        steps = Form(forms[0].shape, _LUMPED).steps_on(coarse, t_end)
    except ValueError:
        return np.inf
    return steps * coarse.scene.mesh.n_elements * _TWICE_FINER * _EXPLICIT_SECONDS


def _trial(family: Family, member: Member, form: Form, t_end: float, steps: int) -> Trial | None:
    """A run with so many steps; None where it fails."""
    dt = t_end / steps
    begun = time.perf_counter()
    run = run_once(member.scene, form.configuration(dt), t_end)
    seconds = time.perf_counter() - begun - float(run.stats.get("first_chunk_time", 0.0))
    if run.message:
        return None
    found = family.signals(member.scene, np.asarray(run.displacements))
    return Trial(
        form, member, dt, steps, np.asarray(run.frame_times), found, int(run.stats["iterations"]), max(seconds, 1e-6)
    )


def _is(trial: Trial, form: Form, member: Member, steps: int) -> bool:
    return trial.form == form and trial.member is member and trial.steps == steps


def _affordable(level: list[Trial], finer: Member, left: float, after: bool = False) -> bool:
    """Whether the next level ends in the time that is left, compilation not counted: of twice the steps.

    Of several forms with the nearer one's level `after` it, which tells more than the other form does.
    """

    def expected(trial: Trial, halvings: int = 1) -> float:
        ratio = finer.scene.mesh.n_elements / trial.member.scene.mesh.n_elements
        return trial.seconds * ratio ** (halvings * (_GROWTH_EXPLICIT if trial.form.explicit else _GROWTH))

    later = expected(level[0], 2) if after and len(level) > 1 else 0.0
    return sum(map(expected, level)) + later <= left


def _extrapolated(levels: list[list[Trial]]) -> Reference:
    """The extrapolation of the form that is known best, and how well that is."""
    fine = levels[-1]
    times = fine[0].times
    known = sorted((_known(levels, t, times) for t in fine if _chain(levels, t)), key=lambda pair: pair[1])
    limit, uncertainty = known[0]
    for other, its in known[1:]:
        uncertainty = max(uncertainty, _between(times, other, limit) - its)
    meshes = ", ".join(str(level[0].member.scene.mesh.n_elements) for level in levels)
    origin = f"{' and '.join(f.form.label for f in fine)} on {meshes} triangles, {fine[0].steps} steps, extrapolated"
    return Reference(times, limit, uncertainty, origin)


def _chain(levels: list[list[Trial]], last: Trial) -> list[Trial]:
    """The runs of a form on coarser meshes, from coarse to fine, as far as there is one on each."""
    found: list[Trial] = []
    for level in reversed(levels[:-1]):
        before = [t for t in level if t.form == last.form]
        if not before:
            break
        found.insert(0, before[0])
    return found


def _known(levels: list[list[Trial]], fine: Trial, times: Float[np.ndarray, " k"]) -> tuple[dict[str, Any], float]:
    """A form's extrapolation of its two finest meshes, and how well it is known by itself."""
    *coarser, coarse = _chain(levels, fine)
    limit = _limit(coarse, fine, times)
    if not coarser:
        # Two meshes do not tell the order: of first order, the answer is twice as far as the extrapolation moved it.
        return limit, 2.0 * _between(times, at_times(fine, times), limit)
    change = apart(coarse, fine)
    rate = max(_SAFE * min(_SECOND_ORDER, apart(coarser[-1], coarse) / max(change, 1e-300)), _SLOWEST)
    return limit, change / (rate - 1.0) - change / (_SECOND_ORDER - 1.0)


def _limit(coarse: Trial, fine: Trial, times: Float[np.ndarray, " k"]) -> dict[str, Float[np.ndarray, "k q"]]:
    """Richardson's extrapolation of two meshes, second order."""
    ratio = fine.member.factor / coarse.member.factor
    return extrapolate(at_times(coarse, times), at_times(fine, times), ratio=ratio)


def _of_one_mesh(trials: list[Trial]) -> Reference:
    """The answer on the only mesh there is, extrapolated in the step alone: its distance from the finest run."""
    fine = trials[-1]
    if len(trials) < 2:
        return Reference(fine.times, dict(fine.signals), np.inf, "one run")
    limit = extrapolate(at_times(trials[-2], fine.times), fine.signals)
    origin = f"{fine.form.label} on {fine.member.label}, {fine.steps} steps, extrapolated in the step"
    return Reference(fine.times, limit, _between(fine.times, fine.signals, limit), origin)


def apart(one: Trial, other: Trial) -> float:
    """The largest distance of two runs, at the times of the one with more steps."""
    times = max(one, other, key=lambda t: t.steps).times
    return _between(times, at_times(one, times), at_times(other, times))


def at_times(trial: Trial, times: Float[np.ndarray, " k"]) -> Signals:
    """A run's signals at other times, by cubic splines."""
    return at(Reference(trial.times, dict(trial.signals), 0.0, ""), times)


def at(reference: Reference, times: Float[np.ndarray, " k"]) -> Signals:
    """A reference's signals at other times, by cubic splines."""
    return {name: CubicSpline(reference.times, values)(times) for name, values in reference.signals.items()}


def _between(times: Float[np.ndarray, " k"], one: Signals, other: Signals) -> float:
    return float(agreement(times, one, other)[-1])
