"""Error against time for every way to run a scene: the picture of `jaxshell chart`, from its points."""

from collections.abc import Iterable, Sequence

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from jaxshell.plotting.style import COLOURS, DASHES, STYLE, WIDTH, plain


def pareto(points: Iterable) -> list:
    """Those that no other beats in both error and time, by time."""
    front = []
    for point in sorted(points, key=lambda p: (p.seconds, p.error)):
        if np.isfinite(point.error) and (not front or point.error < front[-1].error):
            front.append(point)
    return front


def draw(title: str, points: Sequence, peers: Sequence = (), floor: float = 0.0):
    """Figure: methods over step sizes and peers; other choices at one step; meshes, if any. Pareto front in grey."""
    markers = "os^DvPX<>*hd"
    meshes = [p for p in points if p.kind == "mesh"]
    points = [p for p in points if p.kind != "mesh"]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH * (1.4 if meshes else 1.0), 4.6), layout="constrained")
        left, right, *third = figure.subplots(1, 3 if meshes else 2, sharex=True, sharey=True)
        front = pareto(points)
        for axes in third:
            _line(axes, meshes, COLOURS[0], "-", "o", "EMC")
            for point in meshes:
                axes.annotate(
                    point.label.split()[0], (point.seconds, point.error), (0, 6), textcoords="offset points",
                    fontsize=7, ha="center",
                )  # fmt: skip
            axes.set(title="Triangles, against the finest mesh", xlabel="Time of the run in s")
        for axes in (left, right):
            axes.plot(
                [p.seconds for p in front], [p.error for p in front], color="0.8", linewidth=6, zorder=0,
                solid_capstyle="round", label="best of all (Pareto front)",
            )  # fmt: skip
            if floor:
                axes.axhline(floor, color="0.5", linewidth=0.8, linestyle=":", label="reference's uncertainty")
            axes.set(xscale="log", yscale="log", xlabel="Time of the run in s")
        over_steps = ("method", "step control")
        methods_ = list(dict.fromkeys(p.label for p in points if p.kind in over_steps))
        for k, label in enumerate(methods_):
            _line(
                left,
                [p for p in points if p.label == label],
                COLOURS[k % 7],
                DASHES[k % 7],
                markers[k],
                label,
            )
        for k, label in enumerate(dict.fromkeys(p.label for p in peers)):
            own = [p for p in peers if p.label == label]
            _line(left, own, "black", DASHES[k % 7], markers[-1 - k], label, hollow=True)
        base = [p for p in points if p.kind == "method" and p.label == methods_[0]] if methods_ else []
        _line(right, base, COLOURS[0], "-", markers[0], methods_[0] if methods_ else "")
        others = [p for p in points if p.kind not in over_steps]
        for k, point in enumerate(others):
            _line(right, [point], COLOURS[(k + 1) % 7], "", markers[(k + 1) % len(markers)], point.label)
        left.set_ylabel("Largest error of the answer")
        left.set_title("Methods, over the time step")
        right.set_title(f"Other choices, {methods_[0]}" if methods_ else "Other choices")
        for axes in (left, right):
            axes.legend(
                loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, fontsize=7.5, handlelength=2.6,
                columnspacing=1.0,
            )  # fmt: skip
        figure.suptitle(plain(title))
    return figure


def _line(axes, points: Sequence, colour, dashes, marker, label, hollow: bool = False) -> None:
    shown = sorted((p for p in points if np.isfinite(p.error) and p.error > 0), key=lambda p: p.dt)
    axes.plot(
        [p.seconds for p in shown], [p.error for p in shown], color=colour, linestyle=dashes or "none",
        marker=marker, markersize=5, markerfacecolor="white" if hollow or not dashes else colour, label=label,
    )  # fmt: skip
