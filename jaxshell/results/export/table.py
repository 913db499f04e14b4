"""Histories as a table: a line for every step, with one line of names (and units) above."""

import csv
import io
import os
from pathlib import Path

import numpy as np

from jaxshell.results.export.fields import check_one_run
from jaxshell.results.export.units import watched_quantity, with_unit
from jaxshell.results.solution import Solution


def columns(solution: Solution) -> dict[str, np.ndarray]:
    """{name, with its unit in scenes of SI: (k,)} of what the run recorded at every step."""
    check_one_run(solution, "to_csv")
    scene, energy, momentum = solution.scene, solution.energy, solution.momentum
    static = solution.analysis == "static"
    found = {with_unit("load factor" if static else "time", scene, "load factor" if static else "time"): solution.times}
    for label, _, component in scene.watch:
        found[with_unit(f"watched {label}", scene, watched_quantity(component))] = solution.watched[label]
    for name, values in {
        "kinetic energy": energy.kinetic,
        "strain energy": energy.strain,
        "external work": energy.external_work,
        "dissipated energy": energy.dissipated,
    }.items():
        found[with_unit(name, scene, "energy")] = values
    for name, values in {"linear momentum": momentum.linear, "angular momentum": momentum.angular}.items():
        for i, axis in enumerate("xyz"):
            found[with_unit(f"{name} {axis}", scene, name)] = np.asarray(values)[:, i]
    for i, axis in enumerate("xyz"):
        if solution.reaction is not None:
            held = scene.held_dofs % 6 == i
            found[with_unit(f"reaction {axis}", scene, "force")] = np.asarray(solution.reaction)[:, held].sum(axis=1)
    found["iterations"] = solution.iterations
    if solution.stable is not None:
        found["stable"] = np.asarray(solution.stable).astype(int)
    return {name: np.asarray(values) for name, values in found.items()}


def save_csv(solution: Solution, path) -> None:
    """Write the histories as a file of comma-separated values (UTF-8), with all digits; an existing one is replaced.

    Raises ValueError for a batch of solutions.
    """
    path = Path(path)
    found = columns(solution)
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(found)
    table.writerows(zip(*(values.tolist() for values in found.values()), strict=True))
    beside = path.with_name(f".{path.name}.part")
    beside.write_text(text.getvalue(), encoding="utf-8")
    os.replace(beside, path)
