"""A run in a few lines of text: what was run, how long it took, what its energy and momentum did."""

from pathlib import Path

import numpy as np

from jaxshell.model.gauge import ply_counts
from jaxshell.model.mechanisms import connected_parts
from jaxshell.model.scene import Scene
from jaxshell.numerics.plane_stress import principal
from jaxshell.results.diagnostics import energy_balance, momentum_drift
from jaxshell.results.penetration import penetration
from jaxshell.results.section_forces import section_forces
from jaxshell.results.solution import Solution
from jaxshell.results.stresses import largest_von_mises

_PARTS = 5
"""So many loose parts are named one by one."""


def describe_scene(scene: Scene) -> str:
    """One line: the scene's name and size; and one that names the parts of a shell that nothing connects."""
    free = 6 * scene.mesh.n_nodes - len(scene.held_dofs)
    line = f"{scene.name}: {scene.mesh.n_elements} triangles, {scene.mesh.n_nodes} nodes, {free} unknowns"
    # Points, which no triangle has by intention, are the last nodes.
    count, part = connected_parts(scene.mesh.triangles, scene.mesh.n_nodes - scene.mesh.points)
    if count <= 1:
        return line
    sizes, first = np.bincount(part), np.unique(part, return_index=True)[1]
    named = [f"one of {size} nodes with node {node}" for size, node in zip(sizes, first, strict=True)]
    more = f", and {count - _PARTS} more" if count > _PARTS else ""
    return f"{line}\n  {count} loose parts, which no triangle connects: {', '.join(named[:_PARTS])}{more}"


def describe_run(label: str, run: Solution, path: Path) -> str:
    """Steps, time, drift of energy and of a free shell's momentum, extremes of what is watched, the file."""
    times = np.asarray(run.times)
    steps = len(times) - 1
    lines = [f"{label}: {steps} steps to t = {times[-1]:.6g}"]
    if "wall_time" in run.stats:
        lines[0] += f" in {run.stats['wall_time']:.1f} s"
    if steps:
        lines[0] += f", {np.asarray(run.iterations)[1:].mean():.2f} Newton iterations a step"
        lines += _energy(run) + _momentum(run)
    for name, values in run.watched.items():
        values = np.asarray(values)
        low, high = int(values.argmin()), int(values.argmax())
        least, most = (f"{values[i]:.6g} at t = {times[i]:.6g}" for i in (low, high))
        lines.append(f"  {name}: {least} to {most}")
    if len(run.frame_times):
        lines += penetrated(run)
        lines += strained(run, f"at t = {float(run.frame_times[-1]):.6g}")
    lines.append(f"  {size_of(path)}")
    return "\n".join(lines)


def penetrated(run: Solution) -> list[str]:
    """How deep the shell was in each obstacle at a frame."""
    lines = []
    for found in penetration(run):
        depth, thickness = found.depth[found.worst], found.thickness[found.worst]
        if not depth:
            lines.append(f"  {found.obstacle}: not touched at any frame")
            continue
        part = "" if np.isnan(thickness) else f", {depth / thickness:.2g} of the thickness"
        line = f"  {found.obstacle}: penetrated by {depth:.3g}{part}"
        lines.append(f"{line}, by node {found.node[found.worst]} at t = {float(run.frame_times[found.worst]):.6g}")
    return lines


def size_of(path: Path) -> str:
    """A file's name and size."""
    return f"{path} ({path.stat().st_size / 1e6:.1f} MB)"


def strained(run: Solution, when: str) -> list[str]:
    """The largest stress of the last frame, or of sections without layers the largest section forces."""
    if not len(run.frame_times):
        return []
    if ply_counts(run.scene.section, run.scene.mesh) is not None:
        largest = largest_von_mises(run)
        return [f"  largest von Mises stress {when}: {largest.value:.6g}, element {largest.element}, {largest.face}"]
    found = section_forces(run, at="mean")
    lines = []
    for name, values in (("membrane force", found.N), ("moment", found.M)):
        largest = np.abs(np.asarray(principal(values).values)).max(axis=1)
        lines.append(f"  largest principal {name} {when}: {largest.max():.6g}, element {int(largest.argmax())}")
    return lines


def _energy(run: Solution) -> list[str]:
    balance = energy_balance(run)
    worst = balance[np.argmax(np.abs(balance))]
    removed = float(run.energy.dissipated[-1])
    terms = "K + S + D - W" if removed else "K + S - W"
    lines = [f"  energy: {terms} changes by {worst:.1e} of the largest K + S, {balance[-1]:.1e} at the end"]
    return [*lines, f"  damping and dissipation have removed D = {removed:.6g}"] if removed else lines


def _momentum(run: Solution) -> list[str]:
    """Drift of the momenta of a shell without supports, once its loads have ended."""
    drift = momentum_drift(run)
    if drift is None:
        return []
    since = f" after the loads (t = {drift.since:.6g})" if drift.since > 0 else ""
    linear, angular = drift.linear.max(), drift.angular.max()
    return [
        f"  momentum{since} changes by linear {linear:.1e} of √(2 M K), angular {angular:.1e} of that times "
        "the shell's size"
    ]
