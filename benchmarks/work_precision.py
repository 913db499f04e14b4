"""Error against time for every choice, peers beside them: `python benchmarks/work_precision.py --peers PYTHON`.

jaxshell's points are those of `jaxshell chart`, in a process pinned to one core. Peers have elements and inertia
of their own, so their error is taken against their own answer, refined in time and extrapolated (the lower curve
that they could reach), and their distance from jaxshell's converged answer is recorded as "model". They cover the first
part of the window only, since they take minutes; jaxshell's methods are measured on that part too ("beside"), for
figures that compare. The picture scales the peers' time to the whole window, which flatters them. Its third panel is the
number of elements: EMC at the scene's step, the distance from the finest mesh's answer. Writes
benchmarks/results/work_precision_SCENE.json, and the pictures to docs/pictures. `--beside` takes only the peers and what
stands beside them anew, `--only LABEL` only jaxshell's choices of that label.
"""

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))
# One core, before anything starts threads.
os.environ |= {"MKL_NUM_THREADS": "1", "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false"}
os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[-1:])

import jax  # noqa: E402
import numpy as np  # noqa: E402

jax.config.update("jax_enable_x64", True)

from benchmarks.cases import SCENES, write_case  # noqa: E402
from benchmarks.workers import HERE, Worker, machine  # noqa: E402
from jaxshell.advice import references  # noqa: E402
from jaxshell.advice.chart import Point, chart, configurations, mesh_points, plain, reference_of, write_points  # noqa: E402
from jaxshell.advice.references import Reference, agreement, extrapolate  # noqa: E402
from jaxshell.plotting.work_precision import draw  # noqa: E402

TITLES = {"cap": "Clamped cap", "opened_cap": "Top-opened cap", "plate": "Free plate", "tiny": "Tiny cap"}
# Steps of the peers over the scene's, coarse to fine; the last two make the peer's own reference. Kratos needs
# a second a step on the opened cap: few there. Windows of their own keep it affordable, and flatter them.
PEER_STEPS = {
    "cap": (4, 2, 1, 0.5, 0.25, 0.125, 0.0625),
    "opened_cap": (4, 2, 1),
    "plate": (4, 2, 1, 0.5),
    "tiny": (4, 2, 1),
}
PEER_WINDOW = {"cap": 5e-5, "opened_cap": 0.4}


def peer_points(scene, name: str, reference: Reference, python: str, window: float, folder: Path) -> list[dict]:
    """Kratos' and OpenSees' points: error against their own limit, and the model's distance from ours."""
    case = write_case(scene, folder / f"{name}.npz")
    found = []
    for program in ("kratos", "opensees"):
        worker = Worker(program, 1, python)
        runs = []
        for factor in PEER_STEPS[name]:
            dt = factor * scene.defaults.dt
            steps = max(4, round(window / dt))
            history = folder / f"{program}.npz"
            answer = worker(case=str(case), dt=dt, steps=steps, tolerance=1e-8, absolute=True, history=str(history))
            with np.load(history) as stored:
                times, displacements = stored["times"], stored["displacements"]
            print(f"  {program} dt = {dt:.3g}: {answer['seconds']:.2f} s", flush=True)
            runs.append((dt, answer, times, dict(references.signals(scene, displacements))))
        worker.close()
        label = {"kratos": "Kratos", "opensees": "OpenSees"}[program]
        good = [run for run in runs if run[1]["converged"]]
        if len(good) < 2:
            print(f"  {program} gives no answer: fewer than two of its runs converged", flush=True)
            failed = [(dt, *(answer[k] for k in ("seconds", "steps", "iterations"))) for dt, answer, *_ in runs]
            found += [Point("peer", label, dt, t, np.inf, steps, done)._asdict() for dt, t, steps, done in failed]
            continue
        # Richardson on the finer one's every second time, which is the coarser one's.
        fine = {key: value[::2] for key, value in good[-1][3].items()}
        times, coarse = good[-2][2], good[-2][3]
        limit = extrapolate(coarse, fine)
        own = Reference(times, limit, float(agreement(times, fine, limit)[-1]), f"{program}, extrapolated")
        for dt, answer, times, signals in runs:
            within = times <= own.times[-1] * (1 + 1e-9)
            cut = {key: value[within] for key, value in signals.items()}
            error = references.signal_error(own, times[within], cut) if answer["converged"] else np.inf
            seconds, steps, iterations = (answer[name] for name in ("seconds", "steps", "iterations"))
            found.append(Point("peer", label, dt, seconds, error, steps, iterations)._asdict())
        common = own.times <= reference.times[-1] * (1 + 1e-9)
        cut = {key: value[common] for key, value in own.signals.items()}
        model = references.signal_error(reference, own.times[common], cut)
        found.append({"label": f"{program} model", "error": model})
    return found


def beside(scene, name: str, reference: Reference, python: str, span: float) -> dict:
    """Peers and jaxshell's methods on the first `span` of the window."""
    with tempfile.TemporaryDirectory() as folder:
        peers = peer_points(scene, name, reference, python, span, Path(folder))
    return {"window": span, "points": plain(ours_beside(scene, reference, span) + peers)}


def ours_beside(scene, reference: Reference, span: float, only: str = "") -> list[dict]:
    """jaxshell's methods, of the label `only` if given, on the first `span` of the window."""
    within = reference.times <= span * (1 + 1e-9)
    cut = reference._replace(
        times=reference.times[within], signals={key: value[within] for key, value in reference.signals.items()}
    )
    dt = scene.defaults.dt
    tried = [c for c in configurations(scene, dt, span) if c.kind in ("method", "step control") and only in c.label]
    return [p._asdict() for p in chart(scene, dt, span, tried, reference=cut)[0]]


def renew(content: dict, scene, reference: Reference, only: str) -> None:
    """jaxshell's points of the label `only` in the file's `content`, measured again."""

    def instead(old: list[dict], new: list[dict]) -> list[dict]:
        return [p for p in old if only not in p["label"]] + plain(new)

    window, dt = float(reference.times[-1]), scene.defaults.dt
    tried = [c for c in configurations(scene, dt, window) if only in c.label]
    found = chart(scene, dt, window, tried, reference=reference)[0]
    content["points"] = instead(content["points"], [p._asdict() for p in found])
    if content["beside"]:
        span = content["beside"]["window"]
        content["beside"]["points"] = instead(content["beside"]["points"], ours_beside(scene, reference, span, only))


def measure(name: str, options: argparse.Namespace) -> None:
    """Points of one scene into its JSON file, and its picture."""
    scene = SCENES[name]()
    dt = scene.defaults.dt
    reference = reference_of(scene, dt, np.inf if options.window is None else options.window, 1e-4)
    window, file = float(reference.times[-1]), options.results / f"work_precision_{name}.json"
    content = json.loads(file.read_text()) if file.is_file() else {}
    if options.only:
        renew(content, scene, reference, options.only)
    elif not options.beside:
        points, reference = chart(scene, dt, window, reference=reference)
        write_points(file, scene, points + mesh_points(SCENES[name], dt, window), reference)
        content = {"beside": content.get("beside")} | json.loads(file.read_text()) | {"machine": machine()}
    if options.peers:
        span = min(PEER_WINDOW.get(name, np.inf), window)
        content["beside"] = beside(scene, name, reference, options.peers, span) | {"machine": machine()}
    file.write_text(json.dumps(content, indent=1) + "\n")

    def point(p: dict, factor: float = 1.0) -> Point:
        return Point(**p | {"error": np.inf if p["error"] is None else p["error"], "seconds": p["seconds"] * factor})

    points = [point(p) for p in content["points"]]
    peers = content["beside"]["points"] if content["beside"] else []
    shown = [point(p, window / content["beside"]["window"]) for p in peers if p.get("kind") == "peer"]
    title = f"{TITLES[name]}, {scene.mesh.n_elements} triangles, one core"
    picture = options.pictures / f"work_precision_{name}.png"
    draw(title, points, shown, reference.uncertainty).savefig(picture, bbox_inches="tight")
    print(f"{file}\n{picture}", flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=["cap", "plate", "opened_cap"])
    parser.add_argument("--peers", help="Python of the environment that has the peers; left out: jaxshell only")
    parser.add_argument("--beside", action="store_true", help="only peers and jaxshell beside them; keep the rest")
    parser.add_argument("--only", metavar="LABEL", help="only jaxshell's choices of this label; keep the rest")
    parser.add_argument("--window", type=float, help="time covered (default: the reference's)")
    parser.add_argument("--results", type=Path, default=HERE / "results")
    parser.add_argument("--pictures", type=Path, default=ROOT / "docs" / "pictures")
    options = parser.parse_args()
    for folder in (options.results, options.pictures):
        folder.mkdir(parents=True, exist_ok=True)
    for name in options.scenes:
        print(name, flush=True)
        measure(name, options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
