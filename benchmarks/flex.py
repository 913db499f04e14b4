"""Beside MuJoCo's flex shell, on one core: `python benchmarks/flex.py --peers PYTHON_OF_PEERS`.

The first second of the opened cap, against the answer of the continuous problem; the error is the largest distance from it
over its largest size, mesh and step together. MuJoCo gets the largest of the steps 20, 10, 5, ... ms at which it stays
finite, since smaller ones do not change its error. jaxshell's runs, implicit and explicit, and MuJoCo's are asked in
turn, medians of five; jaxshell's time is of the whole `simulate`, warm, MuJoCo's of its loop alone. Writes the table of
docs/performance.md.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import total_error  # (beside this script) takes one core before anything is computed

import jaxshell as js
from benchmarks.cases import write_case
from benchmarks.pages import fill, mesh_name, table
from benchmarks.workers import Worker, machine, median
from jaxshell.advice.chart import Configuration, measure, run_once
from jaxshell.advice.limits import limit_reference

ROUNDS, LARGEST = 5, 0.02
THEIRS = ((24, 5), (34, 7), (48, 10), (72, 15))
OURS = ((10, 2), (14, 3), (19, 4))
CASE = total_error.Case(js.scenes.opened_cap, "", 1.0, tuple((mesh, (0.1, 0.05)) for mesh in OURS), OURS, (), ())


def theirs(worker: Worker, limit, folder: Path) -> Iterator[tuple[Any, dict, float]]:
    """(mesh, request, error) of MuJoCo's runs."""
    for mesh in THEIRS:
        scene, dt, history = CASE.make(mesh), LARGEST, folder / "history.npz"
        case, error = str(write_case(scene, folder / f"{mesh_name(mesh)}.npz")), np.inf
        while not error < 1.0:
            dt /= 2.0
            request = {"case": case, "dt": dt, "steps": round(CASE.window / dt)}
            if worker(**request, history=str(history))["converged"]:
                error = total_error.stored_error(limit, scene, history)
        yield mesh, request, error


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peers", required=True, help="Python of the environment that has mujoco")
    options = parser.parse_args()
    limit = limit_reference(CASE.make(), CASE.window)
    assert limit is not None
    tried = [(CASE.make(mesh), mesh, how) for mesh, how in total_error.configurations(CASE)]
    mine = [(*run, measure(run[0], run[2], limit, CASE.window).error) for run in tried]
    worker = Worker("mujoco", 1, options.peers)
    with tempfile.TemporaryDirectory() as folder:
        peer = list(theirs(worker, limit, Path(folder)))
        rounds = []
        for _ in range(ROUNDS):
            rounds.append(
                [timed_once(scene, how) for scene, _, how, _ in mine] + [worker(**r)["seconds"] for _, r, _ in peer]
            )
    worker.close()
    seconds = [median(values) for values in zip(*rounds, strict=True)]
    rows = []
    for (mesh, request, error), spent in zip(peer, seconds[len(mine) :], strict=True):
        rows.append(["MuJoCo", "", mesh_name(mesh), f"{request['dt']:.3g}", f"{100 * error:.1f} %", f"{spent:.4f}", ""])
        good = [k for k, (_, _, _, own) in enumerate(mine) if own <= error]
        if good:
            k = min(good, key=lambda k: seconds[k])
            _, own, how, reached = mine[k]
            ratio = f"{spent / seconds[k]:.1f}"
            cells = [how.label, mesh_name(own), f"{how.dt:.3g}", f"{100 * reached:.1f} %", f"{seconds[k]:.4f}", ratio]
            rows.append(["jaxshell, as near", *cells])
    m = machine()
    header = ["program", "method and element", "mesh", "dt s", "error", "seconds", "times quicker"]
    text = f"{m['processor']}, one core, load {m['load'][0]}; {m['commit']}, {m['date']}.\n\n{table(header, rows)}"
    print(text)
    fill(total_error.PAGE, {"flex": text})
    return 0


def timed_once(scene: js.Scene, how: Configuration) -> float:
    """Seconds of a warm run."""
    begun = time.perf_counter()
    run_once(scene, how, CASE.window)
    return time.perf_counter() - begun


if __name__ == "__main__":
    sys.exit(main())
