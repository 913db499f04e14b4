"""Histories as a table: a line for every step, with one line of names (and units) above."""

import csv
import io
import os
from pathlib import Path
from typing import Any

import numpy as np

from jaxshell.results.export.fields import check_one_run
from jaxshell.results.export.histories import histories, times_are, watched
from jaxshell.results.export.units import with_unit
from jaxshell.results.solution import Solution


def columns(solution: Solution) -> dict[str, np.ndarray]:
    """{name, with its unit in scenes of SI: (k,)} of what the run recorded at every step."""
    check_one_run(solution, "to_csv")
    scene, times = solution.scene, times_are(solution)
    found: dict[str, Any] = {with_unit(times, scene, times): solution.times}
    for label, (values, quantity) in watched(solution).items():
        found[with_unit(f"watched {label}", scene, quantity)] = values
    for name, (values, quantity) in histories(solution).items():
        if np.ndim(values) == 1:
            found[with_unit(name, scene, quantity)] = values
        else:
            of_axes = zip("xyz", np.asarray(values).T, strict=True)
            found |= {with_unit(f"{name} {axis}", scene, quantity): along for axis, along in of_axes}
    if solution.reaction is not None:
        for i, axis in enumerate("xyz"):
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
