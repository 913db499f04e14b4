"""Pictures of sweeps: bands of quantiles over time, sensitivities as bars, and what members gave against parameters."""

import contextlib
from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from jaxshell.plotting.histories import watched_axis
from jaxshell.plotting.style import BLACK, BLUE, COLOURS, SKY, STYLE, VERMILLION, WIDTH, plain, scaled
from jaxshell.results.export.units import symbol_of
from jaxshell.results.sensitivities import MAIN, REGRESSION, SOBOL, Sensitivities
from jaxshell.results.sweep import Sweep

_MOST_COLUMNS, _MOST_ROWS = 4, 6
"""Panels of a picture of parameters against quantities."""
_MEANING = {
    MAIN: "Fraction of the variance (main effect)",
    REGRESSION: "Standardised regression coefficient",
    SOBOL: "First-order Sobol index (line: total index)",
}
_FEW = 12
"""So many members are drawn one by one beside the band."""


def sweep_figures(sweep: Sweep, quantities: Sequence[str] | None = None) -> dict[str, Figure]:
    """The pictures that `plot_sweep` writes: quantiles, sensitivities, scatter.

    Those that a sweep does not have are left out: sensitivities that its design cannot tell, histories of nothing
    watched. `quantities` are names of `Sweep.responses`; None is all that vary.
    """
    names = [*sweep.responses()] if quantities is None else list(quantities)
    usable = sweep.successful
    names = [name for name in names if np.ptp(sweep.response(name)[usable]) > 0] if usable.any() else []
    numbers = [name for name, values in sweep.parameters.items() if values.ndim == 1 and values.dtype.kind in "fiu"]
    found = {}
    with matplotlib.rc_context(STYLE):
        if sweep.watched and usable.any():
            found["quantiles"] = _quantiles(sweep)
        if names:
            with contextlib.suppress(ValueError):  # the report says why there are none
                found["sensitivities"] = _bars(sweep, sweep.sensitivities(names))
            if numbers:
                found["scatter"] = _scatter(sweep, numbers[:_MOST_COLUMNS], names[:_MOST_ROWS])
    return found


def plot_sweep(sweep: Sweep, directory, stem: str, quantities: Sequence[str] | None = None) -> list[Path]:
    """Draw a sweep into PNG files `directory`/`stem`_<what>.png; returns their paths."""
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    paths = []
    with matplotlib.rc_context(STYLE):
        for what, figure in sweep_figures(sweep, quantities).items():
            path = directory / f"{stem}_{what}.png"
            figure.savefig(path)
            paths.append(path)
    return paths


def _title(sweep: Sweep) -> str:
    ended = int(sweep.successful.sum())
    method = str(sweep.settings.get("method", "")).split("(")[0]
    return plain(f"{sweep.scene.name}, {method}: {ended} members ({sweep.settings.get('sample', sweep.kind)})")


def _quantiles(sweep: Sweep) -> Figure:
    """A panel for each watched quantity: the median, and the bands with 90 and 50 % of the members."""
    rows = len(sweep.watched)
    figure = Figure(figsize=(WIDTH, rows * 2.2 + 1.0), layout="constrained")
    panels = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
    seconds, unit = scaled(sweep.scene, float(sweep.times[-1]), "s")
    bands = sweep.quantile((0.05, 0.25, 0.5, 0.75, 0.95))
    t, ended = sweep.times / seconds, np.flatnonzero(sweep.successful)
    for panel, (label, component) in zip(panels, _watch(sweep), strict=True):
        divisor, text = watched_axis(sweep.scene, label, component, float(np.nanmax(np.abs(bands[label]))))
        low, lower, middle, upper, high = bands[label] / divisor
        panel.fill_between(t, low, high, color=SKY, alpha=0.35, linewidth=0, label="5 to 95 %")
        panel.fill_between(t, lower, upper, color=BLUE, alpha=0.35, linewidth=0, label="25 to 75 %")
        for number in ended if len(ended) <= _FEW else ():
            panel.plot(t, sweep.watched[label][number] / divisor, color="0.5", linewidth=0.6)
        panel.plot(t, middle, color=BLACK, label="median")
        panel.set_ylabel(text)
    panels[-1].set_xlabel(f"Time{unit}")
    lines = panels[0].get_legend_handles_labels()
    figure.suptitle(_title(sweep), fontsize=9.5)
    figure.legend(*lines, loc="outside lower center", ncols=3)
    return figure


def _watch(sweep: Sweep) -> list[tuple[str, str]]:
    components = {label: component for label, _, component in sweep.scene.watch}
    return [(label, components[label]) for label in sweep.watched]


def _bars(sweep: Sweep, found: Sensitivities) -> Figure:
    """A group of bars for each quantity, a bar for each parameter."""
    names, count = list(found.values), len(found.parameters)
    height = min(9.0, 0.6 + len(names) * (0.22 + 0.16 * count))
    figure = Figure(figsize=(WIDTH, height + 0.9), layout="constrained")
    panel = figure.subplots()
    width = 0.8 / count
    for j, key in enumerate(found.parameters):
        at = np.arange(len(names)) + (j - (count - 1) / 2) * width
        values = [found.values[name][j] for name in names]
        panel.barh(at, values, 0.9 * width, color=COLOURS[j % len(COLOURS)], label=plain(key))
        if found.total is not None:
            panel.plot([found.total[name][j] for name in names], at, "|", color=BLACK, markersize=7)
    labels = [plain(name) for name in names]
    if found.r_squared is not None:
        labels = [f"{label}\nR² = {found.r_squared[name]:.2f}" for label, name in zip(labels, names, strict=True)]
    panel.set_yticks(range(len(names)), labels)
    panel.invert_yaxis()
    panel.grid(axis="y", visible=False)
    panel.axvline(0.0, color=BLACK, linewidth=0.8)
    panel.set_xlabel(_MEANING[found.estimate])
    figure.suptitle(_title(sweep), fontsize=9.5)
    figure.legend(*panel.get_legend_handles_labels(), loc="outside lower center", ncols=min(count, 3))
    return figure


def _scatter(sweep: Sweep, parameters: list[str], names: list[str]) -> Figure:
    """A row for each quantity, a column for each parameter, a point for each member that ended successfully."""
    figure = Figure(figsize=(WIDTH, 1.7 * len(names) + 0.9), layout="constrained")
    panels = figure.subplots(len(names), len(parameters), sharex="col", sharey="row", squeeze=False)
    usable = sweep.successful
    for row, name in enumerate(names):
        values = sweep.response(name)[usable]
        divisor, unit = _unit(sweep, name, values)
        for column, key in enumerate(parameters):
            panel = panels[row, column]
            panel.plot(sweep.parameters[key][usable], values / divisor, ".", color=VERMILLION, markersize=4)
            if row == len(names) - 1:
                panel.set_xlabel(plain(f"{key} (factor)" if key in sweep.settings.get("factors", ()) else key))
        panels[row, 0].set_ylabel(f"{plain(name)}{unit}")
    figure.suptitle(_title(sweep), fontsize=9.5)
    return figure


def _unit(sweep: Sweep, name: str, values: np.ndarray) -> tuple[float, str]:
    """Divisor and unit of a response; of what a function gave none is known."""
    for label, component in _watch(sweep):
        if name in (f"{label} min", f"{label} max", f"{label} end"):
            return scaled(sweep.scene, float(np.max(np.abs(values))), symbol_of(component))
    return 1.0, ""
