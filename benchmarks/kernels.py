"""Kernels by XLA and by LLVM side by side: `python benchmarks/kernels.py`.

One core. Every scene and method by both, each in a process of its own, asked in turn; medians of the rounds. The first
call compiles, and is of a process that has compiled nothing. Explicit steps are 99 % of the largest that are
allowed. Writes benchmarks/results/kernels.json, whose table tables.py puts into docs/performance.md.
"""

import argparse
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import jax

jax.config.update("jax_enable_x64", True)

import jaxshell as js  # noqa: E402
from benchmarks.cases import SCENES  # noqa: E402
from benchmarks.workers import HERE, Worker, machine, median  # noqa: E402

METHODS = {"EMC": "GeneralizedEnergyMomentum", "exact": "EnergyMomentum", "explicit": "CentralDifference"}
STEPS, EXPLICIT_STEPS = 50, 2000


def compare(scene: str, method: str, rounds: int) -> list[dict]:
    """Figures of XLA's kernels and of LLVM's."""
    made, explicit = SCENES[scene](), method == "explicit"
    steps = EXPLICIT_STEPS if explicit else STEPS
    dt = 0.99 * js.CentralDifference().critical_step(made) if explicit else made.defaults.dt
    request = {"scene": scene, "method": METHODS[method], "dt": dt, "steps": steps, "save_every": steps}
    request["tolerance"] = 1e-8
    workers = {kernels: Worker("jaxshell", 1, elements=made.mesh.n_elements) for kernels in ("xla", "llvm")}
    first = {kernels: worker(**request, kernels=kernels) for kernels, worker in workers.items()}
    seconds = {kernels: [] for kernels in workers}
    for _ in range(rounds):
        for kernels, worker in workers.items():
            seconds[kernels].append(worker(**request, kernels=kernels)["seconds"])
    for worker in workers.values():
        worker.close()
    return [
        {"kernels": k, "ms_per_step": 1e3 * median(seconds[k]) / steps, "first_call_seconds": first[k]["seconds"]}
        for k in workers
    ]


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--output", type=Path, default=HERE / "results" / "kernels.json")
    options = parser.parse_args(arguments)
    found = {"machine": machine(), "rounds": options.rounds, "results": {}}
    for scene in ("cap", "plate", "opened_cap"):
        for method in METHODS:
            found["results"][f"{scene}, {method}"] = both = compare(scene, method, options.rounds)
            print(scene, method, both, flush=True)
    options.output.write_text(json.dumps(found, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
