"""Cost against size: the cap refined from 1k to 60k unknowns, on one core and on two.

`python benchmarks/scaling.py` writes benchmarks/results/scaling.json: ms per step and iteration, compile time,
peak memory, and the exponent p of cost ~ n^p between the first and the last mesh. Each size runs in a process of
its own, so that its memory is its own.
"""

import argparse
import json
import math
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

from benchmarks.workers import HERE, Worker, machine, median

DIVISIONS = (13, 26, 52, 101)
"""About 1k, 4k, 16k and 60k free unknowns."""
STEPS = 10


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--divisions", type=int, nargs="+", default=DIVISIONS)
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2], help="cores")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--method", default="GeneralizedEnergyMomentum")
    parser.add_argument("--kernels", choices=("xla", "llvm"), default="xla")
    parser.add_argument("--output", type=Path, help="default: results/scaling.json, or scaling_llvm.json")
    options = parser.parse_args(arguments)
    if options.output is None:
        options.output = HERE / "results" / ("scaling.json" if options.kernels == "xla" else "scaling_llvm.json")
    found = {"machine": machine(), "method": options.method, "steps": options.steps, "results": []}
    for threads in options.threads:
        for divisions in options.divisions:
            worker = Worker("jaxshell", threads, elements=2 * divisions**2)
            request = {
                "scene": "cap", "divisions": divisions, "method": options.method, "dt": 2e-6,
                "steps": options.steps, "tolerance": 1e-8, "save_every": options.steps, "kernels": options.kernels,
            }  # fmt: skip
            first = worker(**request)
            runs = [worker(**request) for _ in range(options.rounds)]
            worker.close()
            seconds = median([run["seconds"] for run in runs])
            entry = {
                "threads": threads,
                "unknowns": first["unknowns"],
                "elements": first["elements"],
                "ms_per_step": 1e3 * seconds / options.steps,
                "ms_per_iteration": 1e3 * seconds / runs[-1]["iterations"],
                "us_per_element_and_iteration": 1e6 * seconds / runs[-1]["iterations"] / first["elements"],
                "first_call_seconds": round(first["seconds"], 2),
                "peak_rss_mb": round(runs[-1]["peak_rss"]),
                "converged": runs[-1]["converged"],
            }
            found["results"].append(entry)
            print(entry, flush=True)
            options.output.parent.mkdir(parents=True, exist_ok=True)
            own = [e for e in found["results"] if e["threads"] == threads]
            if len(own) > 1:
                found.setdefault("exponents", {})[threads] = round(
                    math.log(own[-1]["ms_per_step"] / own[0]["ms_per_step"])
                    / math.log(own[-1]["unknowns"] / own[0]["unknowns"]),
                    3,
                )
            options.output.write_text(json.dumps(found, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
