"""jaxshell on the harness's cases, by the same protocol as its peers: see `peers/serve.py`.

Seconds are of the whole `simulate` call, its set-up included. The first call of a configuration compiles; the
request's "warm" says that the harness has made it already. `python benchmarks/jaxshell_run.py` reads stdin.
"""

import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "peers"))
import jax
import numpy as np
from serve import serve

jax.config.update("jax_enable_x64", True)

import jaxshell as js  # noqa: E402
from benchmarks.cases import SCENES  # noqa: E402


def run(request: dict) -> dict:
    with js.kernels(request.get("kernels", "xla")):
        return simulated(request)


def simulated(request: dict) -> dict:
    divisions = request.get("divisions")
    divisions = tuple(divisions) if isinstance(divisions, list) else divisions
    make = SCENES[request["scene"]]
    scene = make() if divisions is None else make(divisions)
    method = getattr(js, request.get("method", "GeneralizedEnergyMomentum"))(**request.get("parameters", {}))
    newton = js.Newton(request["tolerance"], **request.get("newton", {}))
    begun = time.perf_counter()
    solution = js.simulate(
        scene,
        method,
        dt=request["dt"],
        t_end=request["dt"] * request["steps"],
        newton=newton,
        save_every=request.get("save_every", 1),
        tangent=request.get("tangent", "closed_form"),
        throw=False,
    )
    seconds = time.perf_counter() - begun
    if request.get("history"):
        np.savez(request["history"], times=solution.frame_times, displacements=solution.displacements)
    return {
        "seconds": seconds,
        "iterations": int(solution.stats["iterations"]),
        "factorizations": int(solution.stats["factorizations"]),
        "steps": int(solution.stats["steps"]),
        "step_iterations": np.asarray(solution.iterations)[1:].tolist(),
        "converged": not solution.message,
        "unknowns": 6 * scene.mesh.n_nodes - len(scene.held_dofs),
        "elements": scene.mesh.n_elements,
        "version": jax.__version__,
    }


if __name__ == "__main__":
    serve(run)
