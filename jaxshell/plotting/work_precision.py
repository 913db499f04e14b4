"""Error against time for every way to run a scene: the picture of `jaxshell chart`, from its points."""

from collections.abc import Iterable, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from jaxshell.plotting.style import COLOURS, DASHES, STYLE, WIDTH, plain

_BESIDE = 0.4
"""Difference of logarithms within which two points share the number of their triangles."""


def pareto(points: Iterable) -> list:
    """Those that no other beats in both error and time, by time."""
    front = []
    for point in sorted(points, key=lambda p: (p.seconds, p.error)):
        if np.isfinite(point.error) and (not front or point.error < front[-1].error):
            front.append(point)
    return front


def draw(title: str, points: Sequence, peers: Sequence = (), floor: float = 0.0, whole_floor: float = 0.0):
    """Figure: total errors, if any; methods over step sizes and peers; other choices at one step; meshes, if any.

    Pareto fronts in grey. `floor` and `whole_floor` are the uncertainties of the mesh's and of the continuous answer.
    """
    if any(p.kind == "total" for p in points):
        return _draw_with_total(title, points, floor, whole_floor)
    meshes = [p for p in points if p.kind == "mesh"]
    points = [p for p in points if p.kind != "mesh"]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH * (1.4 if meshes else 1.0), 4.6), layout="constrained")
        left, right, *third = figure.subplots(1, 3 if meshes else 2, sharex=True, sharey=True)
        for axes in third:
            _line(axes, meshes, COLOURS[0], "-", "o", "EMC")
            for point in meshes:
                axes.annotate(
                    point.label.split()[0], (point.seconds, point.error), (0, 6), textcoords="offset points",
                    fontsize=7, ha="center",
                )  # fmt: skip
            axes.set(title="Triangles, against the finest mesh", xlabel="Time of the run in s")
        _choices(left, right, points, peers, floor)
        left.set_ylabel("Largest error of the answer")
        figure.suptitle(plain(title))
    return figure


def _choices(left, right, points: Sequence, peers: Sequence, floor: float) -> None:
    """Methods over step sizes, with peers, in one pair of axes; other choices at one step in another."""
    markers = "os^DvPX<>*hd"
    over_steps = ("method", "step control")
    names = list(dict.fromkeys(p.label for p in points if p.kind in over_steps))
    for axes in (left, right):
        _front(axes, points)
    for k, label in enumerate(names):
        _line(left, [p for p in points if p.label == label], COLOURS[k % 7], DASHES[k % 7], markers[k], label)
    for k, label in enumerate(dict.fromkeys(p.label for p in peers)):
        own = [p for p in peers if p.label == label]
        _line(left, own, "black", DASHES[k % 7], markers[-1 - k], label, hollow=True)
    base = [p for p in points if p.kind == "method" and p.label == names[0]] if names else []
    _line(right, base, COLOURS[0], "-", markers[0], names[0] if names else "")
    for k, point in enumerate(p for p in points if p.kind not in over_steps):
        _line(right, [point], COLOURS[(k + 1) % 7], "", markers[(k + 1) % len(markers)], point.label)
    _finish(left, floor, "Methods, over the time step")
    _finish(right, floor, f"Other choices, {names[0]}" if names else "Other choices")
    for axes in (left, right):
        axes.legend(
            loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, fontsize=7.5, handlelength=2.6, columnspacing=1.0,
        )  # fmt: skip


def _front(axes, points: Sequence) -> None:
    front = pareto(points)
    axes.plot(
        [p.seconds for p in front], [p.error for p in front], color="0.8", linewidth=6, zorder=0,
        solid_capstyle="round", label="best of all (Pareto front)",
    )  # fmt: skip


def _finish(axes, floor: float, title: str) -> None:
    if floor and np.isfinite(floor):
        axes.axhline(floor, color="0.5", linewidth=0.8, linestyle=":", label="reference's uncertainty")
    axes.set(xscale="log", yscale="log", xlabel="Time of the run in s", title=title)


def _line(axes, points: Sequence, colour, dashes, marker, label, hollow: bool = False) -> None:
    shown = sorted((p for p in points if np.isfinite(p.error) and p.error > 0), key=lambda p: p.dt)
    axes.plot(
        [p.seconds for p in shown], [p.error for p in shown], color=colour, linestyle=dashes or "none",
        marker=marker, markersize=5, markerfacecolor="white" if hollow or not dashes else colour, label=label,
    )  # fmt: skip


def _draw_with_total(title: str, points: Sequence, floor: float, whole_floor: float):
    """Total errors, mesh and step together, above; the choices on the scene's own mesh below."""
    total = [p for p in points if p.kind == "total"]
    others = [p for p in points if p.kind not in ("total", "mesh")]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 8.6), layout="constrained")
        halves: Any = figure.subfigures(2, 1, height_ratios=(1.1, 1.0))
        above, below = halves
        axes = above.subplots()
        _front(axes, total)
        told: list[tuple[int, float, float]] = []
        for k, label in enumerate(dict.fromkeys(p.label for p in total)):
            own = [p for p in total if p.label == label]
            for number, elements in enumerate(sorted({p.elements for p in own})):
                on = [p for p in own if p.elements == elements]
                _line(axes, on, COLOURS[k % 7], DASHES[k % 7], "os^DvPX<"[k % 8], "" if number else label)
                _annotate(axes, on, elements, told)
        _finish(axes, whole_floor, "Total error: mesh and step together; numbers of triangles")
        axes.set_ylabel("Largest error of the continuous answer")
        axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), fontsize=7.5, handlelength=2.6)
        left, right = below.subplots(1, 2, sharex=True, sharey=True)
        _choices(left, right, others, (), floor)
        left.set_ylabel("Largest error of the mesh's answer")
        figure.suptitle(plain(title))
    return figure


def _annotate(axes, points: Sequence, elements: int, told: list[tuple[int, float, float]]) -> None:
    """The number of triangles at the end of a line over steps, where it has not been told beside it already."""
    shown = [p for p in points if np.isfinite(p.error) and p.error > 0]
    if not shown:
        return
    last = min(shown, key=lambda p: p.dt)
    if any(n == elements and max(abs(np.log([s / last.seconds, e / last.error]))) < _BESIDE for n, s, e in told):
        return
    told.append((elements, last.seconds, last.error))
    axes.annotate(
        str(elements), (last.seconds, last.error), (5, -2), textcoords="offset points", fontsize=6.5, color="0.3"
    )
