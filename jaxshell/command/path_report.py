"""Statics, arc length, frequencies and buckling factors in a few lines of text."""

from pathlib import Path

import equinox as eqx
import numpy as np

from jaxshell.analyses.statics import reactions
from jaxshell.command.report import size_of, strained
from jaxshell.results.eigenmodes import Eigenmodes
from jaxshell.results.head import MODES
from jaxshell.results.nodal_loads import resultant
from jaxshell.results.solution import Solution

NAMES = {"static": "statics", "arc-length": "arc length"}
"""Of analyses, in reports and pictures."""
_SAME = 1e-9
"""Of the largest entry: smaller ones of a sum are round-off, and print as zero."""


def describe_path(run: Solution, path: Path) -> str:
    """How far the loads went, stability, what is watched, reactions at the end, the largest stress, the file."""
    factors = np.asarray(run.times)
    steps, last = len(factors) - 1, f"at load factor {factors[-1]:.6g}"
    lines = [f"{NAMES[run.stats['analysis']]}: {steps} steps to load factor {factors[-1]:.6g}"]
    lines[0] += f" in {run.stats['wall_time']:.1f} s"
    if steps:
        lines[0] += f", {np.asarray(run.iterations)[1:].mean():.2f} Newton iterations a step"
        if factors.max() > factors[-1]:
            lines.append(f"  largest load factor: {factors.max():.6g}")
    lines.append(f"  {_stability(run)}")
    for name, values in run.watched.items():
        values = np.asarray(values)
        low, high = int(values.argmin()), int(values.argmax())
        least, most = (f"{values[i]:.6g} at load factor {factors[i]:.6g}" for i in (low, high))
        lines.append(f"  {name}: {least} to {most}; {values[-1]:.6g} {last}")
    if len(run.scene.held_dofs) and len(run.frame_times):
        force, moment = resultant(*_last_reactions(run))
        lines.append(f"  reactions {last}: force {vector(force)}, moment about the origin {vector(moment)}")
    return "\n".join([*lines, *strained(run, last), f"  {size_of(path)}"])


def describe_modes(found: Eigenmodes, seconds: float, path: Path) -> str:
    """A table of frequencies and periods, or of buckling factors, and where each mode moves most."""
    units = found.scene.defaults.units if found.scene.defaults is not None else ""
    count = int(np.isfinite(np.asarray(found.values)).sum())
    if found.kind == MODES:
        lines = [f"modes: {count} natural frequencies in {seconds:.1f} s"]
        head = ("mode", *(("frequency [Hz]", "period [s]") if units == "SI" else ("frequency", "period")), "moves most")
    else:
        lines = [f"buckling: {count} load factors in {seconds:.1f} s"]
        head = ("mode", "load factor", "moves most")
    rows: list[tuple[str, ...]] = [head]
    for number, (value, shape) in enumerate(zip(found.values, found.shapes, strict=True), 1):
        rows.append((str(number), *_figures(found.kind, float(value)), _largest(np.asarray(shape)[:, :3])))
    widths = [max(len(row[k]) for row in rows) for k in range(len(head) - 1)]
    for row in rows:
        cells = [cell.rjust(width) for cell, width in zip(row, widths, strict=False)]
        lines.append("  " + "  ".join([*cells, row[-1]]).rstrip())
    if count < len(found.values):
        lines.append(f"  There are no more than {count}.")
    return "\n".join([*lines, f"  {size_of(path)}"])


def vector(values, least: float | None = None) -> str:
    """Three numbers; those that are round-off beside the largest, or below `least`, as 0."""
    values = np.asarray(values)
    least = _SAME * np.abs(values).max() if least is None else least
    return "(" + ", ".join(f"{0.0 if abs(value) <= least else value:.6g}" for value in values) + ")"


def _last_reactions(run: Solution) -> tuple[np.ndarray, np.ndarray]:
    """(places of the nodes, forces and moments) of the last frame."""
    last = eqx.tree_at(lambda s: (s.frames, s.frame_times), run, (run.frames.at([-1]), run.frame_times[-1:]))
    return np.asarray(run.scene.mesh.nodes) + np.asarray(last.displacements[0]), np.asarray(reactions(last)[0])


def _stability(run: Solution) -> str:
    stable = None if run.stable is None else np.asarray(run.stable)
    if stable is None or stable.all():
        return "every equilibrium is stable"
    lost = ", ".join(f"{factor:.6g}" for factor in run.stats["stability_lost"])
    text = f"stability is lost at load factor {lost}"
    if run.stats["branched"]:
        return f"{text}, and the stable path followed"
    return f"{text}; {int((~stable).sum())} of {len(stable)} equilibria are unstable"


def _figures(kind: str, value: float) -> tuple[str, ...]:
    if kind != MODES:
        return (f"{value:.6g}",)
    if value > 0:
        return f"{value:.6g}", f"{1 / value:.6g}"
    return (f"{value:.6g}", "rigid motion" if value == 0 else "unstable")


def _largest(motion: np.ndarray) -> str:
    """Where a shape moves most, and along which axis."""
    node, axis = np.unravel_index(int(np.abs(motion).argmax()), motion.shape)
    return f"node {node} along {'xyz'[int(axis)]}"
