"""Work against precision: a scene run by every choice a user has, error against time, and the best of them.

`measure` runs one configuration and sets it against a reference; `configurations` lists the choices on the scene's own
mesh, which `chart` measures against the answer of that mesh; `mesh_points` compares meshes at one step. Total errors,
of mesh and step together, are `jaxshell.advice.total`'s. `jaxshell chart SCENE` shows both.
"""

import json
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxshell import methods
from jaxshell.advice.limits import limit_reference
from jaxshell.advice.references import (
    Reference,
    Signals,
    agreement,
    extrapolate,
    run_error,
    shipped_reference,
    signal_error,
    signals,
)
from jaxshell.analyses.simulation import simulate
from jaxshell.analyses.step_control import StepControl
from jaxshell.model.scene import Scene
from jaxshell.model.with_shape import with_shape
from jaxshell.results.solution import Solution
from jaxshell.scenes import default_divisions
from jaxshell.solvers.linear_solver import KLU, Dense, LinearSolver, default_solver
from jaxshell.solvers.newton import Newton

TRIAL_STEPS = 100
"""Default steps that trials cover in scenes without a shipped reference."""
_LONG_ENOUGH = 0.5
"""A run of so many seconds is timed once, a shorter one three times."""
_DENSE_UNKNOWNS = 500
"""Dense factorization is not worth trying above."""
_FRAMES = 25
"""Times at which a run under step control is compared: it lands on each."""
_AIM, _SMALLEST = 1e-2, 1 / 30
"""A chart's methods go on to smaller steps until their error is below the one, or dt times the other reached."""
_MESHES = (0.4, 0.6, 1.0, 1.6, 2.5)
"""Divisions of a mesh study over the scene's own; the last is what the others are compared with."""


class Configuration(NamedTuple):
    """One way to run a scene."""

    kind: str
    """What is varied: "method", "step control", "tangent", "inertia", "newton", "linear solver", "mesh"; or "total",
    all of it."""
    label: str
    method: methods.Method
    dt: float | StepControl
    newton: Newton = Newton()
    tangent: str = "closed_form"
    linear_solver: LinearSolver | None = None
    shape: str | None = None
    """Of the elements; None: as the scene has them."""


class Point(NamedTuple):
    """A configuration's place in the picture."""

    kind: str
    label: str
    dt: float
    """Under step control: the mean step."""
    seconds: float
    error: float
    steps: int
    iterations: int
    elements: int = 0
    """Triangles of the mesh; 0 where all points of a chart have the same."""


def measure(
    scene: Scene,
    tried: Configuration,
    reference: Reference,
    t_end: float | None = None,
    signals_of: Callable[[Scene, np.ndarray], Signals] | None = None,
) -> Point:
    """Run `scene` over the reference's window: warm time [s] and error. A failed run's error is infinite.

    `signals_of` tells the answer of a mesh that is not the reference's own; errors then count at all times of the run.
    """
    run, seconds = timed(scene, tried, float(reference.times[-1]) if t_end is None else t_end)
    error = np.inf
    if not run.message and signals_of is None:
        error = run_error(reference, run)
    elif not run.message:
        assert signals_of is not None
        found = signals_of(scene, np.asarray(run.displacements))
        error = signal_error(reference, np.asarray(run.frame_times), found, everywhere=True)
    return _point(tried, run, seconds, error)


def _point(tried: Configuration, run: Solution, seconds: float, error: float) -> Point:
    steps, iterations = int(run.stats["steps"]), int(run.stats["iterations"])
    dt = float(run.times[-1]) / max(1, steps) if isinstance(tried.dt, StepControl) else tried.dt
    return Point(tried.kind, tried.label, dt, seconds, error, steps, iterations, run.scene.mesh.n_elements)


def run_once(scene: Scene, tried: Configuration, t_end: float) -> Solution:
    """A run of a configuration; of one that fails, as far as it went."""
    return simulate(
        scene if tried.shape is None else with_shape(scene, tried.shape),
        tried.method,
        dt=tried.dt,
        t_end=t_end,
        newton=tried.newton,
        tangent=tried.tangent,
        linear_solver=tried.linear_solver,
        throw=False,
    )


def timed(scene: Scene, tried: Configuration, t_end: float) -> tuple[Solution, float]:
    """A run and its time without compilation: the first chunk is run beforehand, short runs three times."""

    def go(until: float) -> tuple[Solution, float]:
        begun = time.perf_counter()
        solution = run_once(scene, tried, until)
        return solution, time.perf_counter() - begun

    # As many steps as a chunk has compile the program that a longer run uses.
    go(t_end if isinstance(tried.dt, StepControl) else min(t_end, 50 * tried.dt))
    solution, seconds = go(t_end)
    if seconds < _LONG_ENOUGH:
        seconds = sorted([seconds, go(t_end)[1], go(t_end)[1]])[1]
    return solution, seconds


def make_reference(
    scene: Scene, dt: float, t_end: float, target: float, say: Callable = print, halvings: int = 6
) -> Reference:
    """A reference of any scene: `EnergyMomentum`, the step halved until Richardson's extrapolation is known to
    `target`, or `halvings` times. The uncertainty reached stands in the result."""
    steps = max(8, round(t_end / dt))
    dt = t_end / steps
    runs: list[dict] = []
    found = None
    for level in range(halvings + 1):
        # Every step is a frame, so that all levels are one compiled program.
        solution = simulate(
            scene, methods.EnergyMomentum(), dt=dt / 2**level, t_end=t_end, newton=Newton(1e-10), throw=False
        )
        if solution.message:
            runs.clear()  # too coarse a step; the next is finer
            continue
        times = np.asarray(solution.frame_times)[:: 2**level]
        runs.append(dict(signals(scene, np.asarray(solution.displacements)[:: 2**level])))
        if len(runs) < 2:
            continue
        second = extrapolate(runs[-2], runs[-1])
        # One extrapolation is known to about its distance from the run; two, to their distance from each other.
        before = runs[-1] if len(runs) < 3 else extrapolate(runs[-3], runs[-2])
        uncertainty = float(agreement(times, before, second)[-1]) / (1 if len(runs) < 3 else 15)
        found = Reference(times, second, uncertainty, f"EnergyMomentum to dt = {dt / 2**level:.3g}, extrapolated")
        say(f"  reference: dt = {dt / 2**level:.3g}, known to {uncertainty:.1e}")
        if uncertainty <= target:
            break
    if found is None:
        raise ValueError("The scene does not run at any step tried: give a smaller dt.")
    return found


def reference_of(scene: Scene, dt: float, t_end: float, target: float, say: Callable = print) -> Reference:
    """The shipped reference up to t_end where there is one, or one made here."""
    shipped = shipped_reference(scene)
    if shipped is None:
        return make_reference(scene, dt, t_end, target, say)
    within = shipped.times <= t_end * (1 + 1e-9)
    return shipped._replace(
        times=shipped.times[within], signals={name: v[within] for name, v in shipped.signals.items()}
    )


def default_window(scene: Scene, dt: float, t_end: float | None) -> float:
    """The time that trials cover: as asked, else as long as a shipped answer, else `TRIAL_STEPS` of dt."""
    if t_end is not None:
        return t_end
    shipped = limit_reference(scene) or shipped_reference(scene)
    return TRIAL_STEPS * dt if shipped is None else float(shipped.times[-1])


def controlled(tolerance: float, dt: float, t_end: float) -> Configuration:
    """The exact scheme under step control, started with dt."""
    control = StepControl(tolerance, initial=dt, output_interval=t_end / _FRAMES)
    return Configuration("step control", "exact, step control", methods.EnergyMomentum(), control)


def configurations(scene: Scene, dt: float, t_end: float) -> list[Configuration]:
    """Every choice: methods over steps, step control over its tolerance up to t_end; and at the step dt tangents,
    inertia, Newton variants, linear solvers."""
    gem = methods.GeneralizedEnergyMomentum
    found = []
    for label, method in (
        ("EMC", gem()),
        ("EDMC, ρ∞ 0.8", gem(0.8)),
        ("exact", methods.EnergyMomentum()),
        ("Newmark", methods.Newmark()),
        ("HHT", methods.HHT()),
        ("generalised α, ρ∞ 0.8", methods.GeneralizedAlpha()),
        ("Bathe", methods.Bathe()),
    ):
        found += [Configuration("method", label, method, dt * 2.0**k) for k in (2, 1, 0, -1, -2)]
    explicit = methods.CentralDifference()
    critical = explicit.critical_step(scene)
    found += [Configuration("method", "central differences", explicit, critical / 2**k) for k in (0, 1)]
    found += [controlled(tolerance, dt, t_end) for tolerance in (1e-3, 1e-4, 1e-5, 1e-6)]
    for inertia, label in (("traditional", "traditional inertia"), ("none", "no rotary inertia")):
        found.append(Configuration("inertia", label, gem(inertia=inertia), dt))
    found.append(Configuration("tangent", "tangent by autodiff", gem(), dt, tangent="autodiff"))
    for tolerance in (1e-3, 1e-5, 1e-11):
        found.append(Configuration("newton", f"Newton to {tolerance:g}", gem(), dt, Newton(tolerance)))
    found.append(Configuration("newton", "full Newton", gem(), dt, Newton(reuse=False)))
    solvers: list[LinearSolver] = [KLU()] if type(default_solver()) is not KLU else []
    if 6 * scene.mesh.n_nodes - len(scene.held_dofs) <= _DENSE_UNKNOWNS:
        solvers.append(Dense())
    for solver in solvers:
        found.append(Configuration("linear solver", type(solver).__name__, gem(), dt, linear_solver=solver))
    return found


def chart(
    scene: Scene,
    dt: float,
    t_end: float,
    tried: Sequence[Configuration] | None = None,
    say: Callable = print,
    reference: Reference | None = None,
) -> tuple[list[Point], Reference]:
    """Measure `tried` one after the other, by default `configurations`. Methods that have not come to 1 % of the answer
    get smaller steps too."""
    reference = reference_of(scene, dt, t_end, 1e-4, say) if reference is None else reference
    points = []
    left = list(configurations(scene, dt, float(reference.times[-1])) if tried is None else tried)
    while left:
        configuration = left.pop(0)
        try:
            points.append(measure(scene, configuration, reference))
        except (ImportError, ValueError) as error:
            say(f"  {configuration.label}: {error}")
            continue
        point = points[-1]
        say(
            f"  {point.label:24} dt = {point.dt:<9.3g} error {point.error:.1e}  {point.seconds:8.3f} s"
            f"  {point.iterations / max(1, point.steps):.2f} iterations a step"
        )
        step, smallest = configuration.dt, dt * _SMALLEST
        more = configuration.kind == "method" and configuration.method.uses_matrix
        if more and not isinstance(step, StepControl) and smallest < step <= dt / 4 and point.error > _AIM:
            left.insert(0, configuration._replace(dt=step / 2))
    return points, reference


def divided(make: Callable, factor: float):
    """A library scene's default `divisions` times `factor`."""
    default = default_divisions(make)
    scaled = [max(1, round(factor * count)) for count in np.atleast_1d(default).tolist()]
    return tuple(scaled) if isinstance(default, tuple) else scaled[0]


def mesh_points(make: Callable, dt: float, t_end: float, say: Callable = print) -> list[Point]:
    """A library scene on coarser and finer meshes, EMC at the step dt: the distance of its answer from the finest's.

    `make(divisions=...)` makes the scene. The step's own error, common to all, does not count.
    """
    runs = []
    for factor in _MESHES:
        scene = make(divisions=divided(make, factor))
        label = f"{scene.mesh.n_elements} triangles"
        tried = Configuration("mesh", label, methods.GeneralizedEnergyMomentum(), dt)
        run, seconds = timed(scene, tried, t_end)
        if run.message:
            say(f"  {label}: {run.message}")
            continue
        runs.append((tried, run, seconds, signals(scene, np.asarray(run.displacements))))
    *coarser, finest = runs
    answer = Reference(np.asarray(finest[1].frame_times), dict(finest[3]), 0.0, "the finest mesh")
    points = []
    for tried, run, seconds, found in coarser:
        points.append(_point(tried, run, seconds, signal_error(answer, np.asarray(run.frame_times), found)))
        say(f"  {tried.label:24} is {points[-1].error:.1e} from {finest[0].label}  {seconds:8.3f} s")
    return points


def write_points(
    path: Path, scene: Scene, points: Sequence[Point], reference: Reference, whole: Reference | None = None
) -> None:
    """The measured points as JSON, with what they were measured against: those of kind "total" against `whole`."""
    content = {
        "scene": scene.name,
        "elements": scene.mesh.n_elements,
        "window": float(reference.times[-1]),
        "reference": reference.origin,
        "uncertainty": reference.uncertainty,
        "points": plain(p._asdict() for p in points),
    }
    if whole is not None:
        content |= {"continuous": whole.origin, "continuous_uncertainty": whole.uncertainty}
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def plain(points: Iterable[dict]) -> list[dict]:
    """Points as JSON has them: without infinities."""
    return [p | {"error": p["error"] if np.isfinite(p["error"]) else None} for p in points]
