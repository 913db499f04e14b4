"""Total error against time, mesh and step together, peers beside: `python benchmarks/total_error.py --peers PYTHON`.

The error is the distance from the answer of the continuous problem (`jaxshell/data/*_limit.npz`, made by
continuous.py), so that a mesh pays for what it spoils as a step does. Every program runs on a sequence of meshes, at
several steps on each. jaxshell's times are of whole `simulate` calls, compilation apart. The peers take minutes to
hours for the same, so that their answers are kept in --runs (`--histories` makes them, on any machine, and nothing
else), and their times are the iterations of those runs at the seconds per iteration of a short run, taken beside
jaxshell's. All on one core. Writes results/total_error_SCENE.json, the table of docs/performance.md and the picture.
"""

import argparse
import dataclasses
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))
# One core, before anything starts threads.
os.environ |= {"MKL_NUM_THREADS": "1", "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false"}

import jax  # noqa: E402
import matplotlib  # noqa: E402
import numpy as np  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

jax.config.update("jax_enable_x64", True)

import jaxshell as js  # noqa: E402
from benchmarks.cases import SCENES, write_case  # noqa: E402
from benchmarks.pages import fill, table  # noqa: E402
from benchmarks.workers import HERE, Worker, machine  # noqa: E402
from jaxshell.advice import references  # noqa: E402
from jaxshell.advice.chart import Configuration, timed  # noqa: E402
from jaxshell.advice.limits import limit_reference  # noqa: E402
from jaxshell.advice.references import Reference  # noqa: E402
from jaxshell.plotting.style import COLOURS, STYLE, WIDTH  # noqa: E402

PAGE = ROOT / "docs" / "performance.md"
TOLERANCES = (0.05, 0.02, 0.01)
PEERS = {"Kratos": "kratos", "OpenSees": "opensees"}
SAMPLE = 6
"""Steps that a peer is timed over."""


class Form(NamedTuple):
    """A way that jaxshell goes: method and shape of the elements."""

    label: str
    method: js.methods.Method
    shape: str = "flat"


FORMS = (
    Form("EMC", js.GeneralizedEnergyMomentum()),
    Form("exact", js.EnergyMomentum()),
    Form("generalised α", js.GeneralizedAlpha()),
    Form("central differences", js.CentralDifference()),
    Form("central differences, scaled", js.CentralDifference(rotary="scaled")),
)
CURVED = (
    *FORMS,
    Form("exact, curved, cubic inertia", js.EnergyMomentum(inertia="cubic"), "curved"),
    Form("central differences, scaled, curved", js.CentralDifference(rotary="scaled"), "curved"),
)
PLANE = (*FORMS, Form("exact, cubic inertia", js.EnergyMomentum(inertia="cubic")))


class Plan(NamedTuple):
    """What is run of a scene: the steps of every mesh, of jaxshell and of the peers."""

    title: str
    forms: tuple[Form, ...]
    meshes: tuple
    steps: tuple[float, ...]
    peers: dict[Any, tuple[float, ...]]


PLANS = {
    "cap": Plan(
        "Clamped cap, first swing",
        CURVED,
        (7, 10, 14, 20, 28, 40),
        (1e-6, 5e-7, 2.5e-7, 1.25e-7),
        {14: (2.5e-7,), 20: (2.5e-7,)},
    ),
    "opened_cap": Plan(
        "Top-opened cap, through buckling",
        CURVED,
        ((24, 5), (32, 7), (48, 10), (72, 15), (96, 20)),
        (0.04, 0.02, 0.01, 0.005),
        {(24, 5): (0.02,), (48, 10): (0.02, 0.01), (72, 15): (0.01,)},
    ),
    "plate": Plan(
        "Free plate in flight",
        PLANE,
        ((10, 2), (15, 3), (20, 4), (30, 6), (40, 8), (60, 12)),
        (1e-4, 5e-5, 2.5e-5, 1.25e-5),
        {(15, 3): (5e-5,), (30, 6): (2.5e-5,)},
    ),
}


def ours(name: str, reference: Reference) -> list[dict]:
    """jaxshell's points."""
    found = []
    for mesh in PLANS[name].meshes:
        plain = SCENES[name](mesh)
        for form in PLANS[name].forms:
            scene = dataclasses.replace(plain, section=dataclasses.replace(plain.section, shape=form.shape))
            method, steps = form.method, PLANS[name].steps
            if isinstance(method, js.CentralDifference):
                steps = (method.critical_step(scene),)
            for dt in steps:
                tried = Configuration("total", form.label, form.method, dt)
                run, seconds = timed(scene, tried, float(reference.times[-1]))
                error = np.inf if run.message else references.run_error(reference, run)
                found.append(_point("jaxshell", form.label, mesh, scene, dt, int(run.stats["steps"]), seconds, error))
    return found


def _point(
    program: str, label: str, mesh, scene: js.Scene, dt: float, steps: int, seconds: float, error: float
) -> dict:
    point = {
        "program": program,
        "label": label,
        "mesh": "×".join(map(str, np.atleast_1d(mesh))),
        "elements": scene.mesh.n_elements,
        "dt": dt,
        "steps": steps,
        "seconds": seconds,
        "error": error if np.isfinite(error) else None,
    }
    print(f"  {program} {label} {point['mesh']} dt = {dt:.3g}: error {error:.2e}, {seconds:.3g} s", flush=True)
    return point


def history(name: str, program: str, mesh, dt: float, python: str, window: float, folder: Path) -> dict:
    """A peer's answer, from its file or made now: times, signals, iterations, whether it converged."""
    label = "x".join(map(str, np.atleast_1d(mesh)))
    path = folder / f"{name}_{program}_{label}_{dt:g}.npz"
    scene = SCENES[name](mesh)
    if not path.is_file():
        with tempfile.TemporaryDirectory() as there:
            case, written = write_case(scene, Path(there) / "case.npz"), Path(there) / "history.npz"
            worker = Worker(program, 1, python)
            steps = max(4, round(window / dt))
            answer = worker(case=str(case), dt=dt, steps=steps, tolerance=1e-6, absolute=True, history=str(written))
            worker.close()
            with np.load(written) as stored:
                named = dict(references.signals(scene, stored["displacements"]))
                times = stored["times"]
        done = {key: answer[key] for key in ("iterations", "steps", "converged", "seconds")}
        np.savez(path, times=times, **named, **{f"answer {key}": value for key, value in done.items()})
        print(f"  {program} {label} dt = {dt:.3g}: {answer['seconds']:.1f} s", flush=True)
    with np.load(path) as stored:
        answer = {key[7:]: stored[key].item() for key in stored.files if key.startswith("answer ")}
        named = {key: stored[key] for key in stored.files if key != "times" and not key.startswith("answer ")}
        return answer | {"times": stored["times"], "signals": named}


def theirs(name: str, reference: Reference, python: str, folder: Path) -> list[dict]:
    """The peers' points: errors of their kept answers, times by those of a few steps taken now."""
    found = []
    for label, program in PEERS.items():
        for mesh, steps in PLANS[name].peers.items():
            scene = SCENES[name](mesh)
            with tempfile.TemporaryDirectory() as there:
                case = write_case(scene, Path(there) / "case.npz")
                worker = Worker(program, 1, python)
                sample = worker(case=str(case), dt=steps[0], steps=SAMPLE, tolerance=1e-6, absolute=True)
                worker.close()
            for dt in steps:
                run = history(name, program, mesh, dt, python, float(reference.times[-1]), folder)
                error = np.inf
                if run["converged"]:
                    within = run["times"] <= reference.times[-1] * (1 + 1e-9)
                    cut = {key: value[within] for key, value in run["signals"].items()}
                    error = references.signal_error(reference, run["times"][within], cut)
                seconds = run["iterations"] * sample["seconds"] / max(1, sample["iterations"])
                found.append(_point(label, label, mesh, scene, dt, run["steps"], seconds, error))
    return found


def cheapest(points: list[dict], tolerance: float, program: str) -> dict | None:
    """The quickest of a program's points within the tolerance."""
    good = [p for p in points if p["program"] == program and p["error"] is not None and p["error"] <= tolerance]
    return min(good, key=lambda p: p["seconds"], default=None)


def report(results: dict[str, dict]) -> str:
    """Cheapest configurations, for every tolerance."""
    rows = []
    for name, found in results.items():
        for tolerance in TOLERANCES:
            best = cheapest(found["points"], tolerance, "jaxshell")
            for program in ("jaxshell", *PEERS):
                point = cheapest(found["points"], tolerance, program)
                head = [f"`{name}`", f"{100 * tolerance:g} %", program]
                if point is None or best is None:
                    rows.append([*head, "not reached", "", "", "", "", ""])
                    continue
                times = point["seconds"] / best["seconds"]
                label = point["label"] if program == "jaxshell" else ""
                figures = [f"{point['dt']:.3g}", f"{100 * point['error']:.2f} %", f"{point['seconds']:.3g}"]
                rows.append([*head, label, point["mesh"], *figures, f"{times:.1f}"])
    return table(["scene", "within", "program", "configuration", "mesh", "dt, s", "error", "seconds", "times"], rows)


def draw(results: dict[str, dict], path: Path) -> None:
    """A panel for each scene: the best of every program and form, over meshes and steps."""
    markers, lines = "os^DvPX", ("-", "--", "-.", ":")
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH * 1.4, 4.4), layout="constrained")
        panels = np.atleast_1d(figure.subplots(1, len(results)))
        kinds = list(dict.fromkeys((p["program"], p["label"]) for r in results.values() for p in r["points"]))
        for axes, (name, found) in zip(panels, results.items(), strict=True):
            for k, kind in enumerate(kinds):
                points = [p for p in found["points"] if (p["program"], p["label"]) == kind and p["error"] is not None]
                front = []
                for p in sorted(points, key=lambda p: p["seconds"]):
                    if not front or p["error"] < front[-1]["error"]:
                        front.append(p)
                peer = kind[0] != "jaxshell"
                axes.plot(
                    [p["seconds"] for p in front], [100 * p["error"] for p in front],
                    color="black" if peer else COLOURS[k % 7], linestyle=lines[k % 4], marker=markers[k % 7], markersize=5,
                    markerfacecolor="white" if peer else None, label=kind[1],
                )  # fmt: skip
            axes.axhline(100 * found["uncertainty"], color="0.5", linewidth=0.8, linestyle=":")
            for tolerance in TOLERANCES:
                axes.axhline(100 * tolerance, color="0.9", linewidth=0.8, zorder=0)
            axes.set(xscale="log", yscale="log", xlabel="Time of the run in s", title=PLANS[name].title)
        panels[0].set_ylabel("Total error, mesh and step, in %")
        handles = {label: h for axes in panels for h, label in zip(*axes.get_legend_handles_labels(), strict=True)}
        figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=5, fontsize=8)
        figure.savefig(path, bbox_inches="tight")


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", choices=[[], *PLANS], help="default: all three")
    parser.add_argument("--peers", help="Python of the environment that has the peers; left out: jaxshell only")
    parser.add_argument("--histories", action="store_true", help="only make the peers' answers that are not kept yet")
    parser.add_argument("--redraw", action="store_true", help="only the table and the picture, from the results")
    parser.add_argument(
        "--runs", type=Path, default=HERE / "results" / "peer_runs", help="where peers' answers are kept"
    )
    parser.add_argument("--results", type=Path, default=HERE / "results")
    parser.add_argument("--page", type=Path, default=PAGE)
    parser.add_argument("--picture", type=Path, default=ROOT / "docs" / "pictures" / "total_error.png")
    options = parser.parse_args(arguments)
    options.runs.mkdir(parents=True, exist_ok=True)
    for name in () if options.redraw else options.scenes or PLANS:
        reference = limit_reference(SCENES[name]())
        assert reference is not None, f"continuous.py makes the answer of {name}"
        if options.histories:
            for program in PEERS.values():
                for mesh, steps in PLANS[name].peers.items():
                    for dt in steps:
                        history(name, program, mesh, dt, options.peers, float(reference.times[-1]), options.runs)
            continue
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[-1:])
        points = ours(name, reference)
        if options.peers:
            points += theirs(name, reference, options.peers, options.runs)
        content = {
            "scene": name,
            "window": float(reference.times[-1]),
            "reference": reference.origin,
            "uncertainty": reference.uncertainty,
            "points": points,
            "machine": machine(),
        }
        (options.results / f"total_error_{name}.json").write_text(json.dumps(content, indent=1) + "\n")
    kept = {name: options.results / f"total_error_{name}.json" for name in PLANS}
    results = {name: json.loads(file.read_text()) for name, file in kept.items() if file.is_file()}
    if results and not options.histories:
        fill(options.page, {"total_error": report(results)})
        draw(results, options.picture)
        print(report(results))
    return 0


if __name__ == "__main__":
    sys.exit(main())
