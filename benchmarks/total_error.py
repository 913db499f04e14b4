"""Time against the error of the continuous answer, peers beside: `python benchmarks/total_error.py --peers PYTHON`.

Three scenes whose continuous answers are known (`continuous.py`): cap to the end of its first swing, opened cap to 2.6 s
through buckling, plate to 20 ms. jaxshell, Kratos and OpenSees run them over meshes and steps, each pinned to the same one
core, one after the other; the error is the largest distance from the continuous answer over its largest size, mesh and
step together. All iterate to the same tolerance, 1e-6, a hundredth of what the errors ask for: jaxshell's and Kratos' on the
shell's size and a radian, OpenSees' the norm of the correction. Times are warm: of the whole `simulate` for jaxshell, of
the time loop for the peers. Peers get the meshes and steps that their errors are worth; `cheapest` reads the rest. Writes
results/total_error.json, docs/pictures/total_error.png and the table of docs/performance.md. `--only peers` or `ours` keeps
the other half of the file, `--draw` measures nothing.
"""

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))
# One core, before anything starts threads.
os.environ |= {"MKL_NUM_THREADS": "1", "NPROC": "1", "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false"}
os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[-1:])

import jax  # noqa: E402
import matplotlib  # noqa: E402
import numpy as np  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

jax.config.update("jax_enable_x64", True)

import jaxshell as js  # noqa: E402
from benchmarks.cases import write_case  # noqa: E402
from benchmarks.pages import fill, mesh_name, table  # noqa: E402
from benchmarks.workers import HERE, Worker, machine  # noqa: E402
from jaxshell import scenes  # noqa: E402
from jaxshell.advice import references  # noqa: E402
from jaxshell.advice.chart import Configuration, Point, measure, plain  # noqa: E402
from jaxshell.advice.limits import limit_reference  # noqa: E402
from jaxshell.advice.references import Reference  # noqa: E402
from jaxshell.plotting.style import COLOURS, STYLE, WIDTH  # noqa: E402
from jaxshell.plotting.work_precision import pareto  # noqa: E402

RESULTS, PAGE = HERE / "results" / "total_error.json", ROOT / "docs" / "performance.md"
PICTURE = ROOT / "docs" / "pictures" / "total_error.png"
TOLERANCE = 1e-6
WITHIN = (5e-2, 2e-2, 1e-2)
OURS, DEFAULT = "jaxshell", "jaxshell, flat element refined"
PEERS = {"kratos": "Kratos", "opensees": "OpenSees"}


class Case(NamedTuple):
    """A scene, its window, and what is run: meshes with their steps."""

    make: Callable[..., js.Scene]
    title: str
    window: float
    mine: tuple[tuple[Any, tuple[float, ...]], ...]
    """Meshes and steps of jaxshell's implicit runs."""
    explicit: tuple[Any, ...]
    """Meshes of runs by central differences, at the critical step."""
    kratos: tuple[tuple[Any, float], ...]
    opensees: tuple[tuple[Any, float], ...]
    shapes: tuple[str, ...] = ("curved", "flat")


CASES = {
    "cap": Case(
        scenes.spherical_cap,
        "Clamped cap, first swing",
        1.25e-4,
        tuple((n, (2e-6, 1e-6, 5e-7, 2.5e-7)) for n in (7, 10, 14, 20)),
        (7, 10, 14, 20, 28),
        ((10, 1e-6), (14, 5e-7), (20, 2.5e-7), (28, 1.25e-7)),
        ((10, 1e-6), (14, 5e-7), (20, 2.5e-7)),
    ),
    "opened_cap": Case(
        scenes.opened_cap,
        "Opened cap, through buckling",
        2.6,
        (
            ((14, 3), (0.08, 0.04)),
            ((19, 4), (0.08, 0.04)),
            ((24, 5), (0.08, 0.04, 0.02)),
            ((34, 7), (0.08, 0.04, 0.02)),
            ((48, 10), (0.04, 0.02)),
            ((72, 15), (0.04, 0.02)),
            ((96, 20), (0.04, 0.02)),
        ),
        ((14, 3), (19, 4), (24, 5), (34, 7)),
        (((24, 5), 0.04), ((24, 5), 0.02), ((48, 10), 0.04), ((48, 10), 0.02), ((72, 15), 0.02)),
        (((24, 5), 0.02), ((48, 10), 0.04), ((48, 10), 0.02), ((72, 15), 0.02)),
    ),
    "plate": Case(
        scenes.free_plate,
        "Free plate, 20 ms",
        0.02,
        tuple((mesh, (1e-4, 5e-5, 2.5e-5)) for mesh in ((15, 3), (20, 4), (30, 6), (45, 9))),
        (),  # critical steps are a thousandth of the motion's
        (((15, 3), 5e-5), ((30, 6), 2.5e-5)),
        (((15, 3), 5e-5), ((30, 6), 2.5e-5)),
        ("flat",),
    ),
}


def configurations(case: Case) -> Iterator[tuple[Any, Configuration]]:
    """(mesh, how it is run) of jaxshell."""
    newton, emc = js.Newton(TOLERANCE), js.GeneralizedEnergyMomentum
    for shape in case.shapes:
        methods = {"exact, cubic inertia": js.EnergyMomentum(inertia="cubic")}
        if shape == "flat":
            methods["EMC, linear inertia"] = emc()
        methods["EMC, no rotary inertia"] = emc(inertia="none")
        for label, method in methods.items():
            for mesh, steps in case.mine:
                for dt in steps:
                    yield mesh, Configuration("total", f"{label}, {shape}", method, dt, newton, shape=shape)
        for rotary in ("physical", "scaled"):
            explicit = js.CentralDifference(rotary=rotary)
            for mesh in case.explicit:
                dt = explicit.critical_step(js.with_shape(case.make(mesh), shape))
                dt = case.window / np.ceil(case.window / dt)
                label = f"central differences, {rotary} rotary inertia, {shape}"
                yield mesh, Configuration("total", label, explicit, float(dt), newton, shape=shape)


def ours(case: Case, limit: Reference) -> list[dict]:
    """jaxshell's points. A method that a scene is not for has none."""
    found = []
    refused = set()
    for mesh, tried in configurations(case):
        if tried.label in refused:
            continue
        try:
            point = measure(case.make(mesh), tried, limit)
        except ValueError as error:
            print(f"  {tried.label}: {error}", flush=True)
            refused.add(tried.label)
            continue
        found.append(point._asdict() | {"mesh": mesh, "program": OURS})
        tell(found[-1])
    return found


def peers(name: str, case: Case, limit: Reference, python: str) -> list[dict]:
    """The peers' points."""
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for program, label in PEERS.items():
            worker = Worker(program, 1, python)
            for mesh, dt in getattr(case, program):
                scene = case.make(mesh)
                file, history = write_case(scene, Path(folder) / f"{name}.npz"), Path(folder) / "history.npz"
                answer = worker(
                    case=str(file), dt=dt, steps=round(case.window / dt), tolerance=TOLERANCE, absolute=True,
                    history=str(history),
                )  # fmt: skip
                error = stored_error(limit, scene, history) if answer["converged"] else np.inf
                seconds, steps, iterations = (answer[key] for key in ("seconds", "steps", "iterations"))
                point = Point("total", label, dt, seconds, error, steps, iterations, scene.mesh.n_elements)
                found.append(point._asdict() | {"mesh": mesh, "program": label})
                tell(found[-1])
            worker.close()
    return found


def stored_error(limit: Reference, scene: js.Scene, history: Path) -> float:
    """Of the motion that a peer wrote."""
    with np.load(history) as stored:
        return references.signal_error(limit, stored["times"], references.signals(scene, stored["displacements"]))


def tell(p: dict) -> None:
    mesh = mesh_name(p["mesh"])
    print(
        f"  {p['label']:48} {mesh:>6} dt {p['dt']:<9.3g} {100 * p['error']:6.2f} %  {p['seconds']:8.3f} s", flush=True
    )


def cheapest(points: list[dict], within: float) -> dict | None:
    """The quickest point within a tolerance; None where nothing is."""
    good = [p for p in points if p["error"] is not None and p["error"] <= within]
    return min(good, key=lambda p: p["seconds"], default=None)


def by_program(points: list[dict]) -> dict[str, list[dict]]:
    """Points of every row: jaxshell, what its first element gives when it is refined alone, and the peers."""
    mine = [p for p in points if p["program"] == OURS]
    first = [p for p in mine if p["label"] == "EMC, linear inertia, flat"]
    return {OURS: mine, DEFAULT: first} | {
        label: [p for p in points if p["program"] == label] for label in PEERS.values()
    }


def report(found: dict) -> str:
    """The table of docs/performance.md."""
    rows = []
    for name, entry in found.items():
        for within in WITHIN:
            best = cheapest(by_program(entry["points"])[OURS], within)
            for program, points in by_program(entry["points"]).items():
                p = cheapest(points, within)
                start = [f"`{name}`", f"{100 * within:g} %", program]
                if p is None:
                    tried = min((q["error"] for q in points if q["error"] is not None), default=None)
                    least = "no run succeeds" if tried is None else f"{100 * tried:.1f} % at best"
                    rows.append([*start, f"not reached: {least}", "", "", "", "", ""])
                    continue
                mesh = mesh_name(p["mesh"])
                times = "" if best is None else f"{p['seconds'] / best['seconds']:.1f}"
                label = p["label"] if program == OURS else ""
                rows.append(
                    [*start, label, mesh, f"{p['dt']:.3g}", f"{100 * p['error']:.2f} %", f"{p['seconds']:.3g}", times]
                )
    header = ["scene", "within", "program", "method and element", "mesh", "dt", "error", "seconds", "times jaxshell's"]
    m = next(iter(found.values()))["machine"]
    return f"{m['processor']}, one core, load {m['load'][0]} at the start; {m['commit']}, {m['date']}.\n\n" + table(
        header, rows
    )


def draw(found: dict) -> Figure:
    """Error against time of every point, the best of each program joined."""
    looks = {OURS: (COLOURS[0], "o", "-"), DEFAULT: (COLOURS[5], "s", "--")}
    looks |= {"Kratos": (COLOURS[1], "^", "-."), "OpenSees": (COLOURS[2], "v", ":")}
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 3.0), layout="constrained")
        panels: Any = figure.subplots(1, len(found), sharey=True, squeeze=False)[0]
        for axes, name in zip(panels, found, strict=True):
            for program, points in by_program(found[name]["points"]).items():
                colour, marker, dashes = looks[program]
                shown = [Point(**{k: v for k, v in p.items() if k in Point._fields}) for p in points if p["error"]]
                axes.plot(
                    [p.seconds for p in shown], [100 * p.error for p in shown], marker, color=colour, markersize=2.5,
                    alpha=0.35, markeredgewidth=0,
                )  # fmt: skip
                front = pareto(shown)
                axes.plot(
                    [p.seconds for p in front], [100 * p.error for p in front], dashes, marker=marker, color=colour,
                    markersize=4, label=program,
                )  # fmt: skip
            axes.axhline(100 * found[name]["known"], color="0.5", linewidth=0.8, linestyle=":")
            axes.set(
                xscale="log", yscale="log", title=CASES[name].title, xlabel="Time of the run in s", ylim=(0.09, 60)
            )
            axes.set_yticks([0.1, 1, 10], ["0.1", "1", "10"])
        panels[0].set_ylabel("Error of the continuous answer in %")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", choices=[[], *CASES], help="default: all")
    parser.add_argument("--peers", help="Python of the environment that has the peers; left out: jaxshell only")
    parser.add_argument("--only", choices=("ours", "peers"), help="keep the other half of the file")
    parser.add_argument("--draw", action="store_true", help="only the table and the picture")
    options = parser.parse_args()
    found = json.loads(RESULTS.read_text()) if RESULTS.is_file() else {}
    for name in [] if options.draw else options.scenes or CASES:
        print(name, flush=True)
        case, kept = CASES[name], found.get(name, {"points": []})["points"]
        limit = limit_reference(case.make(), case.window)
        assert limit is not None, f"continuous.py makes the answer of {name}"
        entry = {"window": case.window, "known": limit.uncertainty, "machine": machine(), "points": []}
        if options.only == "peers":
            entry["points"] += [p for p in kept if p["program"] == OURS]
        else:
            entry["points"] += plain(ours(case, limit))
        if options.only == "ours" or not options.peers:
            entry["points"] += [p for p in kept if p["program"] != OURS]
        else:
            entry["points"] += plain(peers(name, case, limit, options.peers))
        found[name] = entry
        found = {key: found[key] for key in CASES if key in found}
        RESULTS.write_text(json.dumps(found, indent=1) + "\n")
    fill(PAGE, {"total_error": report(found)})
    draw(found).savefig(PICTURE, bbox_inches="tight", dpi=200)
    print(f"{RESULTS}\n{PICTURE}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
