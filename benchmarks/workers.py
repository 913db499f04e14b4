"""Programs under measurement: started on a stated number of cores, asked in turn, so that noise falls on all alike."""

import json
import math
import os
import platform
import subprocess
import sys
import tempfile
import time
from importlib import metadata
from pathlib import Path

from jaxshell.command.run_settings import SMALL

HERE = Path(__file__).parent
SCRIPTS = {
    "jaxshell": HERE / "jaxshell_run.py",
    "kratos": HERE / "peers" / "kratos_run.py",
    "opensees": HERE / "peers" / "opensees_run.py",
    "mujoco": HERE / "peers" / "mujoco_run.py",
}
_THREAD_VARIABLES = ("MKL_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")


class Worker:
    """A program on as many cores as `threads`, its libraries limited to as many threads.

    With `elements`, jaxshell's XLA gets one thread for small meshes, as the command line has it.
    """

    def __init__(self, program: str, threads: int, python: str = sys.executable, elements: float = math.inf):
        self.program, self.threads = program, threads
        environment = {
            **os.environ,
            **dict.fromkeys(_THREAD_VARIABLES, str(threads)),
            "PYTHONPATH": str(HERE.parent),
        }
        if threads == 1:
            environment["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false"
        if elements < SMALL:
            environment["NPROC"] = "1"
        cores = sorted(os.sched_getaffinity(0))[-threads:]
        self.log = tempfile.TemporaryFile("w+")  # noqa: SIM115 (open as long as the worker)
        self.process = subprocess.Popen(
            ["taskset", "-c", ",".join(map(str, cores)), python, str(SCRIPTS[program])],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.log,
            text=True,
            env=environment,
        )

    def __call__(self, **request) -> dict:
        """Run a request. Raises RuntimeError with the program's own words when it fails."""
        assert self.process.stdin and self.process.stdout
        self.process.stdin.write(json.dumps(request | {"threads": self.threads}) + "\n")
        self.process.stdin.flush()
        for line in self.process.stdout:
            if line.startswith("{"):  # before its first answer a program may print a banner
                answer = json.loads(line)
                if "error" in answer:
                    raise RuntimeError(f"{self.program} failed:\n{answer['error']}")
                return answer
        self.log.seek(0)
        raise RuntimeError(f"{self.program} ended:\n{self.log.read()[-3000:]}")

    def close(self) -> None:
        assert self.process.stdin
        self.process.stdin.close()
        self.process.wait()


def median(values):
    """The middle value, the lower of two."""
    return sorted(values)[(len(values) - 1) // 2]


def machine() -> dict:
    """What the figures were taken on."""
    model = "unknown"
    if Path("/proc/cpuinfo").is_file():
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), model)
    versions = {}
    for name in ("jaxshell", "jax", "jaxlib", "pardiso-mkl-jax", "mkl", "klujax", "numpy", "equinox"):
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return {
        "processor": model,
        "cores": os.cpu_count(),
        "load": [round(x, 2) for x in os.getloadavg()],
        "system": platform.platform(),
        "python": platform.python_version(),
        "versions": versions,
        "commit": _commit(),
        "date": time.strftime("%Y-%m-%d %H:%M"),
    }


def _commit() -> str:
    done = subprocess.run(
        ["git", "describe", "--always", "--dirty"], cwd=HERE, capture_output=True, text=True, check=False
    )
    return done.stdout.strip()
