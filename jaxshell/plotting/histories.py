"""Curves against time: watched quantities, energies and their balance, momenta; one or several runs."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from jaxshell.model.gauge import gauge_of
from jaxshell.model.scene import Scene
from jaxshell.plotting.colouring import name_of, symbol_of
from jaxshell.plotting.shapes import symmetry_planes
from jaxshell.plotting.style import BLACK, BLUE, GREEN, PURPLE, VERMILLION, WIDTH, line, plain, scaled, symmetry_note
from jaxshell.results.diagnostics import energy_balance, momentum_scales
from jaxshell.results.solution import Solution

Runs = Mapping[str, Solution]


def watched_figure(runs: Runs, kind: str) -> Figure | None:
    """A panel for each watched quantity of a `kind` (`kind_of`); None when none is watched."""
    scene = next(iter(runs.values())).scene
    watched = [(label, component) for label, _, component in scene.watch if kind_of(component) == kind]
    if not watched:
        return None
    figure, panels, seconds = _panels(runs, len(watched), 1, height=2.6 if len(watched) == 1 else 2.0)
    for (label, component), panel in zip(watched, panels[:, 0], strict=True):
        held = [(name, run) for name, run in runs.items() if label in run.watched]
        divisor, text = watched_axis(scene, label, component, [run.watched[label] for _, run in held])
        for position, (name, run) in enumerate(held):
            panel.plot(run.times / seconds, run.watched[label] / divisor, label=name, **line(position))
        panel.set_ylabel(text)
    _legend(figure, panels[0, 0], runs)
    return figure


def kind_of(component: str) -> str:
    """Of a watched component: "u" for displacements, "v" for velocities, "stress", "N" or "M" for section forces."""
    gauge = gauge_of(component)
    return component[0] if gauge is None else gauge.quantity


def energy_figure(runs: Runs) -> Figure:
    """Above, kinetic, strain, total energy and external work, a panel for each run; below, the balance."""
    scene = next(iter(runs.values())).scene
    seconds, time_text = _time(runs)
    figure = Figure(figsize=(WIDTH, 4.6), layout="constrained")
    grid = figure.add_gridspec(2, len(runs), height_ratios=(1.6, 1))
    largest = max(float(np.max(np.abs(run.energy.total))) for run in runs.values())
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
        panel.set_title(name)
        panel.tick_params(labelleft=position == 0)
    assert top is not None
    note = symmetry_note(len(symmetry_planes(scene)))
    top.set_ylabel(f"Energy{note}{unit}".replace("of the ", "of the\n"))
    lines = {str(curve.get_label()): curve for axes in figure.axes for curve in axes.get_lines()}
    figure.legend(lines.values(), lines.keys(), loc="outside upper center", ncols=len(lines))
    below = figure.add_subplot(grid[1, :])
    for position, (name, run) in enumerate(runs.items()):
        error = energy_balance(run)
        text = f"{name}: largest {100 * np.max(np.abs(error)):.2g} %".lstrip(": ")
        below.plot(run.times / seconds, 100 * error, label=text, **line(position))
    dissipates = any(np.any(run.energy.dissipated) for run in runs.values())
    below.set_ylabel(f"K + S{' + D' if dissipates else ''} - W\nin % of largest K + S")
    below.set_xlabel(time_text)
    below.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(runs))
    return figure


def momentum_figure(runs: Runs) -> Figure | None:
    """Components of the linear and of the angular momentum about the origin, a panel each.

    None for a model bounded by planes of symmetry, of which the part says nothing about the whole.
    """
    scene = next(iter(runs.values())).scene
    if symmetry_planes(scene):
        return None
    figure, panels, seconds = _panels(runs, 3, 2, height=1.6)
    scales = np.max([momentum_scales(run) for run in runs.values()], axis=0)
    for column, (name, symbol, unit) in enumerate((("linear", "L", "N s"), ("angular", "J", "N m s"))):
        values = [np.asarray(getattr(run.momentum, name)) for run in runs.values()]
        largest = max(float(np.max(np.abs(v))) for v in values)
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
    _legend(figure, panels[0, 0], runs)
    return figure


def _panels(runs: Runs, rows: int, columns: int, height: float):
    """A figure with a grid of panels over one time axis, and the divisor of times."""
    seconds, time_text = _time(runs)
    figure = Figure(figsize=(WIDTH, rows * height + 0.7), layout="constrained")
    panels = figure.subplots(rows, columns, sharex=True, squeeze=False)
    for panel in panels[-1]:
        panel.set_xlabel(time_text)
    return figure, panels, seconds


def _time(runs: Runs) -> tuple[float, str]:
    scene, end = next(iter(runs.values())).scene, max(float(run.times[-1]) for run in runs.values())
    divisor, unit = scaled(scene, end, "s")
    return divisor, f"Time{unit}"


def watched_axis(scene: Scene, label: str, component: str, values) -> tuple[float, str]:
    """Divisor and axis label of a watched quantity: the scene's own where it names one."""
    for own, divisor, text in () if scene.defaults is None else scene.defaults.axes:
        if own == label:
            return divisor, text
    largest = max(float(np.max(np.abs(value))) for value in values)
    gauge = gauge_of(component)
    if gauge is not None:
        divisor, unit = scaled(scene, largest, symbol_of(gauge))
        return divisor, f"{plain(label)}, {name_of(component, gauge)}{unit}"
    divisor, unit = scaled(scene, largest, "m" if component[0] == "u" else "m/s")
    return divisor, f"{plain(label)}, ${component[0]}_{component[1]}${unit}"


def _legend(figure: Figure, panel, runs: Runs) -> None:
    if len(runs) > 1:
        lines = panel.get_legend_handles_labels()
        figure.legend(*lines, loc="outside upper center", ncols=len(runs), handlelength=3)
