"""Curves against time: watched quantities, energies and their balance, momenta; one or several runs."""

from collections.abc import Iterable, Mapping

import numpy as np
from matplotlib.figure import Figure

from jaxshell.model.gauge import gauge_of
from jaxshell.model.quantities import QUANTITIES
from jaxshell.model.scene import Scene
from jaxshell.plotting.colouring import name_of
from jaxshell.plotting.shapes import symmetry_planes
from jaxshell.plotting.style import (
    BLACK,
    BLUE,
    GREEN,
    PURPLE,
    VERMILLION,
    WIDTH,
    line,
    plain,
    scaled,
    symmetry_note,
    title,
)
from jaxshell.results.diagnostics import Drift, energy_balance, momentum_drift, momentum_scales
from jaxshell.results.export.units import symbol_of
from jaxshell.results.solution import Solution

Runs = Mapping[str, Solution]


def watched_figure(runs: Runs, kind: str) -> Figure | None:
    """A panel for each watched quantity of a `kind` (`kind_of`); None when none is watched."""
    scene = next(iter(runs.values())).scene
    watched = [(label, component) for label, _, component in scene.watch if kind_of(component) == kind]
    if not watched:
        return None
    figure, panels, seconds = _panels(runs, len(watched), 1, height=2.6 if len(watched) == 1 else 2.0)
    # One unit for all panels, so that they can be compared.
    largest = max(_largest(run.watched[label] for run in runs.values() if label in run.watched) for label, _ in watched)
    for (label, component), panel in zip(watched, panels[:, 0], strict=True):
        held = [(name, run) for name, run in runs.items() if label in run.watched]
        divisor, text = watched_axis(scene, label, component, largest)
        for position, (name, run) in enumerate(held):
            panel.plot(run.times / seconds, run.watched[label] / divisor, label=name, **line(position))
        panel.set_ylabel(text)
    _head(figure, panels[0, 0], runs, _WHAT[kind])
    return figure


_WHAT = {"u": "displacement", "v": "velocity", "stress": "stress", "N": "membrane force", "M": "moment"}
_WHAT |= {f"{kind} of item": f"{kind} of connectors and obstacles" for kind in ("force", "moment", "length", "angle")}
_WHAT["energy of item"] = "energy of connectors and obstacles"


def kind_of(component: str) -> str:
    """Of a watched component: "u" for displacements, "v" for velocities, "stress", "N" or "M" for section forces,
    "force of item" and so on for what connectors and obstacles measure."""
    if component in QUANTITIES:
        return f"{QUANTITIES[component].kind} of item"
    gauge = gauge_of(component)
    return component[0] if gauge is None else gauge.quantity


def energy_figure(runs: Runs) -> Figure:
    """Above, kinetic, strain, total energy and external work, a panel for each run; below, the balance."""
    scene = next(iter(runs.values())).scene
    seconds, time_text = _time(runs)
    figure = Figure(figsize=(WIDTH, 4.6), layout="constrained")
    grid = figure.add_gridspec(2, len(runs), height_ratios=(1.6, 1))
    largest = _largest(run.energy.total for run in runs.values())
    divisor, unit = scaled(scene, largest, "J")
    top = None
    for position, (name, run) in enumerate(runs.items()):
        panel = top_panel = figure.add_subplot(grid[0, position], sharey=top)
        top = top or top_panel
        t, energy = run.times / seconds, run.energy
        curves = [
            (energy.kinetic, "kinetic K", BLUE, "--"),
            (energy.strain, "strain S", VERMILLION, "-."),
            (energy.total, "K + S", BLACK, "-"),
            (energy.external_work, "external work W", GREEN, ":"),
        ]
        if np.any(energy.dissipated):
            curves.append((energy.dissipated, "dissipated D", PURPLE, "--"))
        for values, text, colour, dashes in curves:
            panel.plot(t, values / divisor, label=text, color=colour, linestyle=dashes, linewidth=1.0)
        if len(runs) > 1:
            panel.set_title(name)
        panel.tick_params(labelleft=position == 0)
    assert top is not None
    note = symmetry_note(len(symmetry_planes(scene)))
    top.set_ylabel(f"Energy{note}{unit}".replace("of the ", "of the\n"))
    lines = {str(curve.get_label()): curve for axes in figure.axes for curve in axes.get_lines()}
    figure.legend(lines.values(), lines.keys(), loc="outside lower center", ncols=len(lines))
    below = figure.add_subplot(grid[1, :])
    for position, (name, run) in enumerate(runs.items()):
        error = energy_balance(run)
        text = f"{name if len(runs) > 1 else ''}: largest {np.max(np.abs(error)):.1e}".lstrip(": ")
        below.plot(run.times / seconds, _magnitude(error), label=text, **line(position))
    dissipates = any(np.any(run.energy.dissipated) for run in runs.values())
    below.set_ylabel(f"|Δ(K + S{' + D' if dissipates else ''} - W)|\n/ largest K + S", fontsize=8.5)
    _logarithmic(below)
    below.set_xlabel(time_text)
    below.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(runs))
    figure.suptitle(_title(runs, "energy"), fontsize=9.5)
    return figure


def momentum_figure(runs: Runs) -> Figure | None:
    """Components of the linear and of the angular momentum about the origin, a panel each; below, their drift once the
    loads have ended, if they do.

    None for a shell that supports hold, whose momenta nothing conserves.
    """
    scene = next(iter(runs.values())).scene
    if scene.supports:
        return None
    drifts = {label: drift for label, run in runs.items() if (drift := momentum_drift(run)) is not None}
    figure, panels, seconds = _panels(runs, 4 if drifts else 3, 2, height=1.5)
    scales = np.max([momentum_scales(run) for run in runs.values()], axis=0)
    for column, (name, symbol, unit) in enumerate((("linear", "L", "N s"), ("angular", "J", "N m s"))):
        values = [np.asarray(getattr(run.momentum, name)) for run in runs.values()]
        largest = _largest(values)
        # A momentum that vanishes, of a shell that only spins for one, is a flat line too.
        largest = scales[column] if largest < 1e-6 * scales[column] else largest
        divisor, unit = scaled(scene, largest, unit)
        for row in range(3):
            panel = panels[row, column]
            for position, (label, run) in enumerate(runs.items()):
                component = values[position][:, row] / divisor
                panel.plot(run.times / seconds, component, label=label, **line(position))
            panel.set_ylabel(f"${symbol}_{'xyz'[row]}${unit}")
            # A component that vanishes is a flat line, not its round-off blown up.
            if max(np.max(np.abs(v[:, row])) for v in values) < 1e-6 * largest:
                panel.set_ylim(-0.05 * largest / divisor, 0.05 * largest / divisor)
        panels[0, column].set_title(f"{name.capitalize()} momentum")
        if drifts:
            _draw_drifts(panels[3, column], runs, drifts, name, symbol, seconds)
    _head(figure, panels[0, 0], runs, "momentum")
    return figure


def _draw_drifts(panel, runs: Runs, drifts: dict[str, Drift], name: str, symbol: str, seconds: float) -> None:
    for position, label in enumerate(runs):
        if label in drifts:
            drift = drifts[label]
            panel.plot(drift.times / seconds, _magnitude(getattr(drift, name)), label=label, **line(position))
    scale = r"\sqrt{2MK}" if name == "linear" else r"\ell\sqrt{2MK}"
    panel.set_ylabel(f"$|Δ{symbol}| / {scale}$")
    _logarithmic(panel)


def _magnitude(values: np.ndarray) -> np.ndarray:
    """Absolute values for a logarithmic axis, on which zero has no place."""
    size = np.abs(values)
    return np.where(size > 0, size, np.nan)


def _logarithmic(panel) -> None:
    """A logarithmic axis, on which methods that drift and those that keep to round-off are told apart."""
    drawn = [np.asarray(curve.get_ydata(), float) for curve in panel.get_lines()]
    largest = max((float(np.nanmax(d)) for d in drawn if np.isfinite(d).any()), default=1.0)
    smallest = min((float(np.nanmin(d)) for d in drawn if np.isfinite(d).any()), default=1e-16)
    panel.set_yscale("log")
    # Not less than round-off, nor than one decade.
    panel.set_ylim(max(min(smallest, 0.1 * largest), 1e-17) / 2, max(largest, 1e-16) * 2)


def _panels(runs: Runs, rows: int, columns: int, height: float):
    """A figure with a grid of panels over one time axis, and the divisor of times."""
    seconds, time_text = _time(runs)
    figure = Figure(figsize=(WIDTH, rows * height + 0.7), layout="constrained")
    panels = figure.subplots(rows, columns, sharex=True, squeeze=False)
    for panel in panels[-1]:
        panel.set_xlabel(time_text)
    return figure, panels, seconds


def _time(runs: Runs) -> tuple[float, str]:
    """(divisor, axis label) of times, which in statics are factors of the loads."""
    first = next(iter(runs.values()))
    if first.analysis == "static":
        return 1.0, "Load factor λ"
    divisor, unit = scaled(first.scene, max(float(run.times[-1]) for run in runs.values()), "s")
    return divisor, f"Time{unit}"


def watched_axis(scene: Scene, label: str, component: str, largest: float) -> tuple[float, str]:
    """Divisor and axis label of a watched quantity: the scene's own where it names one."""
    for own, divisor, text in () if scene.defaults is None else scene.defaults.axes:
        if own == label:
            return divisor, text
    if component in QUANTITIES:
        divisor, unit = scaled(scene, largest, symbol_of(component))
        return divisor, f"{plain(label)}, {QUANTITIES[component].says}{unit}"
    gauge = gauge_of(component)
    if gauge is not None:
        divisor, unit = scaled(scene, largest, symbol_of(component))
        return divisor, f"{plain(label)}, {name_of(component, gauge)}{unit}"
    divisor, unit = scaled(scene, largest, symbol_of(component))
    return divisor, f"{plain(label)}, ${component[0]}_{component[1]}${unit}"


def _largest(values: Iterable) -> float:
    return max(float(np.max(np.abs(value))) for value in values)


def _head(figure: Figure, panel, runs: Runs, what: str) -> None:
    """Title, and a legend where there is more than one run."""
    figure.suptitle(_title(runs, what), fontsize=9.5)
    if len(runs) > 1:
        lines = panel.get_legend_handles_labels()
        figure.legend(*lines, loc="outside lower center", ncols=len(runs), handlelength=3)


def _title(runs: Runs, what: str) -> str:
    name, run = next(iter(runs.items()))
    return title(run.scene, name if len(runs) == 1 else "", what)
