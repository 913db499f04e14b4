"""From the shell: how long `jaxshell run cap` takes without and with a compilation cache, by both kinds of kernels.

`python benchmarks/cold_start.py` writes benchmarks/results/cold_start.json. Cold: the cache's folder is empty.
Warm: the same command again, medians of several. The command keeps its cache under the user's cache folder; here
XDG_CACHE_HOME points into a folder that is thrown away.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

from benchmarks.workers import HERE, machine, median


def times(command: list[str], rounds: int) -> dict:
    """Seconds of a command of jaxshell's, with an empty cache and with a full one."""
    with tempfile.TemporaryDirectory() as folder:
        kept = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
        environment = {**kept, "PYTHONPATH": str(HERE.parent), "XDG_CACHE_HOME": f"{folder}/cache"}

        def once() -> float:
            begun = time.perf_counter()
            subprocess.run([sys.executable, "-m", "jaxshell", *command], cwd=folder, env=environment, check=True)
            return round(time.perf_counter() - begun, 2)

        cold = once()
        warm = [once() for _ in range(rounds)]
    words = "jaxshell " + " ".join(command)
    return {"command": words, "cold_seconds": cold, "warm_seconds": median(warm), "warm_rounds": warm}


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", nargs="*", default=["run", "cap", "--quiet"])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--output", type=Path, default=HERE / "results" / "cold_start.json")
    options = parser.parse_args(arguments)
    found = {"machine": machine(), "runs": []}
    for kernels in ([], ["--kernels", "llvm"]):
        run = times([*options.command, *kernels], options.rounds)
        found["runs"].append(run)
        print(f"{run['command']}: cold {run['cold_seconds']} s, warm {run['warm_seconds']} s", flush=True)
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(json.dumps(found, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
