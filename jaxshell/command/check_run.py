"""What a scene's run would be, in lines of text: analysis, frequencies, steps in time, and what would refuse it."""

import math

import numpy as np

from jaxshell.analyses.modal import natural_frequencies
from jaxshell.analyses.simulation import check_turns, step_sizes
from jaxshell.command.adapted import check_adapting
from jaxshell.command.check_scene import entry
from jaxshell.command.run_settings import arguments_of_simulate, chosen_methods, with_defaults
from jaxshell.files.quoted import quote
from jaxshell.files.run_keys import ANALYSES, RunSettings
from jaxshell.methods import CentralDifference
from jaxshell.model.mechanisms import check_supported
from jaxshell.model.scene import Scene

_PER_PERIOD, _PER_INTERVAL = 20, 10
"""Steps that are suggested: so many in the shortest of the periods shown, and in the shortest part of a history."""


def described_run(scene: Scene, of_file: RunSettings, count: int) -> tuple[list[str], list[str]]:
    """(lines, what would refuse the run) of a scene with the settings of its file; `count` frequencies are sought."""
    analysis = of_file.analysis or ANALYSES[0]
    settings = with_defaults(of_file, scene, analysis)
    lines, wrong = _run(scene, settings) if analysis == ANALYSES[0] else _other(scene, settings)
    found, periods = _frequencies(scene, count)
    return lines + found + _steps(scene, settings, periods), wrong


def _run(scene: Scene, settings: RunSettings) -> tuple[list[str], list[str]]:
    """Of a run in time: methods and steps."""
    if settings.dt is None or settings.t_end is None:
        missing = " and ".join(key for key in ("dt", "t_end") if getattr(settings, key) is None)
        return [entry("run", f"in time; the scene gives no {missing}")], []
    try:
        methods, arguments = chosen_methods(settings, scene), arguments_of_simulate(settings)
        _check_adapting(settings, scene)
        for method in methods.values():
            method.check(scene, np.asarray([settings.dt]))
        if isinstance(arguments["dt"], float):
            check_turns(scene, step_sizes(arguments["dt"], settings.t_end))
    except ValueError as error:
        return [entry("run", "in time")], [str(error)]
    dt = arguments["dt"]
    size = (
        f"dt {dt:.6g}: {math.ceil(settings.t_end / dt * (1 - 1e-10))} steps"
        if isinstance(dt, float)
        else f"dt {quote(dt)}"
    )
    lines = [entry("run", f"in time: {', '.join(methods)} to t = {settings.t_end:.6g}, {size}")]
    if settings.adapt is not None:
        lines.append(
            entry("adapted", f"the mesh, to {100 * settings.adapt:.3g} % of {settings.goal or 'the strain energy'}")
        )
    if scene.damping is not None:
        parts = {"α": scene.damping.alpha, "β": scene.damping.beta}
        given = [f"{name} {float(np.max(np.asarray(value))):.6g}" for name, value in parts.items() if value is not None]
        lines.append(entry("damping", ", ".join(given)))
    return lines, []


def _other(scene: Scene, settings: RunSettings) -> tuple[list[str], list[str]]:
    """Of statics and eigenvalues."""
    said = {key: value for key, value in settings.said().items() if key not in ("analysis", "save_every")}
    listed = ", ".join(f"{key} {_shown(value)}" for key, value in said.items())
    line = entry("run", f"{settings.analysis}{': ' + listed if listed else ''}")
    if settings.analysis == "modes" and settings.preload is None:
        return [line], []
    try:
        _check_adapting(settings, scene)
        check_supported(scene)
    except ValueError as error:
        return [line], [str(error)]
    if not scene.loads and not any(support.moves_with_load for support in scene.supports):
        return [line], [f"Nothing loads or moves the shell: {settings.analysis} has nothing to do."]
    return [line], []


def _check_adapting(settings: RunSettings, scene: Scene) -> None:
    if settings.adapts:
        check_adapting(settings, scene)


def _shown(value) -> str:
    return ", ".join(f"{item:g}" for item in value) if isinstance(value, tuple) else str(value)


def _frequencies(scene: Scene, count: int) -> tuple[list[str], np.ndarray]:
    """Lines of the lowest frequencies that deform the shell, and their periods."""
    count = min(count, 6 * scene.mesh.n_nodes - len(scene.held_dofs) - 2)
    if count < 1:
        return [], np.zeros(0)
    try:
        frequencies = np.asarray(natural_frequencies(scene, count, rigid_modes=False).frequencies)
    except RuntimeError as error:
        return [entry("frequencies", f"not found: {error}")], np.zeros(0)
    frequencies = frequencies[np.isfinite(frequencies)]
    si = scene.defaults is not None and scene.defaults.units == "SI"
    lines = []
    for position, value in enumerate(frequencies):
        unit, time = (" Hz", " s") if si else ("", "")
        text = f"{value:<11.6g}{unit}" + (
            f"   period {1 / value:.6g}{time}" if value > 0 else "   unstable at the start"
        )
        lines.append(entry("frequencies" if not position else "", text))
    return lines, 1 / frequencies[frequencies > 0]


def _steps(scene: Scene, settings: RunSettings, periods: np.ndarray) -> list[str]:
    """The critical step of the explicit method, and a step for the implicit ones."""
    lines = []
    try:
        method = CentralDifference(1.0)
        method.check(scene, np.zeros(1))
        lines.append(
            entry("critical step", f"{method.critical_step(scene):.6g} of central differences (element bound)")
        )
    except ValueError as error:
        lines.append(entry("critical step", f"none: {error}"))
    if settings.analysis != ANALYSES[0]:
        return lines
    candidates, limits, intervals = [], [], _intervals(scene)
    if len(periods):
        lowest = _round(float(periods.max()) / _PER_PERIOD)
        why = f"{_PER_PERIOD} steps in the shortest period above ({lowest:g} in the longest)"
        candidates.append((float(periods.min()) / _PER_PERIOD, why))
        limits.append(float(periods.max()) / _PER_PERIOD)
    if len(intervals):
        why = f"{_PER_INTERVAL} steps in the shortest part of a history"
        candidates.append((float(intervals.min()) / _PER_INTERVAL, why))
        limits.append(float(intervals.min()) / _PER_INTERVAL)
    if candidates:
        step, why = min(candidates)
        lines.append(entry("suggested dt", f"{_round(step):g} for implicit methods: {why}"))
        if settings.dt is not None and settings.step_tolerance is None and settings.dt > 1.01 * min(limits):
            lines.append(entry("", f"the run's dt = {settings.dt:g} is too long for the lowest frequency or the loads"))
    return lines


def _intervals(scene: Scene) -> np.ndarray:
    """Times between the samples of all histories."""
    histories = [item.history for item in (*scene.loads, *scene.supports) if item.history is not None]
    return np.concatenate([np.zeros(0), *(np.diff(np.asarray(history.times)) for history in histories)])


def _round(value: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above."""
    power = 10.0 ** math.floor(math.log10(value))
    return max(factor * power for factor in (1, 2, 5) if factor * power <= value * (1 + 1e-9))
