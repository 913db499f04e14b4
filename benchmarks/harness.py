"""Speed beside Kratos and OpenSees: `python benchmarks/harness.py --peers PYTHON_OF_PEERS`.

Same mesh, same Δt, same window from the start, tolerance 1e-8. Every round asks each program once, in turn, and
the median of the rounds counts: on a noisy machine the ratios hold. Each figure says how many cores the program
was pinned to. The result, JSON, goes to benchmarks/results/speed.json; `--smoke` tries all of it on a tiny scene.
Peers live in an environment of their own: `pip install '.[peers]'`.

What the tolerance means: for jaxshell the next correction, over the shell's size and in radians. For Kratos the
correction over the displacements so far (its users' way; "kratos") or on our scale ("kratos, our scale"). For
OpenSees the plain norm of the correction.
"""

import argparse
import json
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import jax

jax.config.update("jax_enable_x64", True)

from benchmarks.cases import SCENES, write_case  # noqa: E402
from benchmarks.workers import HERE, Worker, machine, median  # noqa: E402

STEPS = {"cap": 50, "plate": 50, "opened_cap": 20, "tiny": 4}
TOLERANCE = 1e-8
JAXSHELL = {
    "jaxshell EMC": {"method": "GeneralizedEnergyMomentum"},
    "jaxshell exact": {"method": "EnergyMomentum"},
    "jaxshell EMC, kernels by LLVM": {"method": "GeneralizedEnergyMomentum", "kernels": "llvm"},
    "jaxshell exact, kernels by LLVM": {"method": "EnergyMomentum", "kernels": "llvm"},
    "jaxshell Newmark": {"method": "Newmark"},
    "jaxshell EMC, full Newton": {"method": "GeneralizedEnergyMomentum", "newton": {"reuse": False}},
    "jaxshell exact, full Newton": {"method": "EnergyMomentum", "newton": {"reuse": False}},
}
PEERS = {
    "kratos": ("kratos", {}),
    "kratos, our scale": ("kratos", {"absolute": True}),
    "kratos, Bossak": ("kratos", {"variant": "bossak"}),
    "opensees": ("opensees", {}),
}


def compare(scene: str, threads: int, rounds: int, steps: int, peers: str | None, folder: Path) -> dict:
    """Figures of every program on a scene: {name: {...}}."""
    made = SCENES[scene]()
    request = {
        "case": str(write_case(made, folder / f"{scene}.npz")),
        "scene": scene,
        "dt": made.defaults.dt,
        "steps": steps,
        "tolerance": TOLERANCE,
    }
    entries = {name: ("jaxshell", extra) for name, extra in JAXSHELL.items()}
    if peers:
        entries |= PEERS
    workers = {
        name: Worker(program, threads, peers)
        if program in ("kratos", "opensees")
        else Worker(program, threads, elements=made.mesh.n_elements)
        for name, (program, _) in entries.items()
    }
    # Compiles; for the peers a first look at the disk.
    first = {name: worker(**request | entries[name][1]) for name, worker in workers.items()}
    answers = {name: [] for name in workers}
    for _ in range(rounds):
        for name, worker in workers.items():
            answers[name].append(worker(**request | entries[name][1]))
    for worker in workers.values():
        worker.close()
    return {name: summary(first[name], runs) for name, runs in answers.items()}


def summary(first: dict, runs: list[dict]) -> dict:
    """Medians over the rounds."""
    last, seconds = runs[-1], median([run["seconds"] for run in runs])
    found = {
        "ms_per_step": 1e3 * seconds / last["steps"],
        "ms_per_iteration": 1e3 * seconds / max(1, last["iterations"]),
        "iterations_per_step": last["iterations"] / last["steps"],
        "seconds": [round(run["seconds"], 5) for run in runs],
        "steps": last["steps"],
        "converged": last["converged"],
        "peak_rss_mb": round(last["peak_rss"]),
        "version": last["version"],
    }
    if "factorizations" in last:
        found["compile_seconds"] = round(first["seconds"] - seconds, 2)
        found["factorizations_per_step"] = last["factorizations"] / last["steps"]
        found["unknowns"], found["elements"] = last["unknowns"], last["elements"]
    return found


def report(results: dict) -> str:
    """The figures as a table in Markdown."""
    lines = [
        "| scene | cores | program | ms/step | iterations/step | ms/iteration | against EMC | memory, MB |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for key, programs in results.items():
        scene, threads = key.split(", ")
        ours = programs["jaxshell EMC"]["ms_per_step"]
        for name, f in programs.items():
            lines.append(
                f"| {scene} | {threads.split()[0]} | {name} | {f['ms_per_step']:.2f} | {f['iterations_per_step']:.2f} "
                f"| {f['ms_per_iteration']:.2f} | {f['ms_per_step'] / ours:.1f} | {f['peak_rss_mb']} |"
            )
    return "\n".join(lines)


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", choices=[*STEPS, []], help="default: cap plate opened_cap")
    parser.add_argument("--peers", help="Python of the environment that has the peers; left out: jaxshell only")
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--steps", type=int, help="in place of each scene's")
    parser.add_argument("--output", type=Path, default=HERE / "results" / "speed.json")
    parser.add_argument("--smoke", action="store_true", help="one round on a tiny scene")
    options = parser.parse_args(arguments)
    scenes = ["tiny"] if options.smoke else options.scenes or ["cap", "plate", "opened_cap"]
    rounds, threads = (1, [1]) if options.smoke else (options.rounds, options.threads)
    found = {"machine": machine(), "tolerance": TOLERANCE, "rounds": rounds, "results": {}}
    options.output.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        for scene in scenes:
            for count in threads:
                steps = options.steps or STEPS[scene]
                figures = compare(scene, count, rounds, steps, options.peers, Path(folder))
                found["results"][f"{scene}, {count} cores"] = figures
                options.output.write_text(json.dumps(found, indent=1) + "\n")
    print(report(found["results"]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
