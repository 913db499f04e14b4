"""OpenSees on the harness's cases: ASDShellT3 -corotational, Newmark 1/2 1/4 (or HHT), UmfPack.

Its convergence test is the plain norm of the correction, metres and radians together. The program is sequential.
"""

import time

import numpy as np
import openseespy.opensees as ops
from serve import serve


def build(case, variant: str, tolerance: float, max_iterations: int) -> None:
    ops.wipe()
    ops.model("basic", "-ndm", 3, "-ndf", 6)
    for k, x in enumerate(case["nodes"]):
        ops.node(k + 1, *map(float, x))
    E, nu, h, rho = (float(case[n]) for n in ("young_modulus", "poisson_ratio", "thickness", "density"))
    ops.section("ElasticMembranePlateSection", 1, E, nu, h, rho)
    for k, triangle in enumerate(case["triangles"]):
        ops.element("ASDShellT3", k + 1, *(int(n) + 1 for n in triangle), 1, "-corotational")
    fixed = np.zeros((len(case["nodes"]), 6), int)
    fixed.reshape(-1)[case["held"]] = 1
    for k in np.flatnonzero(fixed.any(axis=1)):
        ops.fix(int(k) + 1, *map(int, fixed[k]))
    for k, pattern in enumerate(case["load_patterns"]):
        times, values = (case[f"history_{k}_{what}"].tolist() for what in ("times", "values"))
        if len(times) == 1:
            ops.timeSeries("Constant", k + 1, "-factor", values[0])
        else:
            ops.timeSeries("Path", k + 1, "-time", *times, "-values", *values, "-useLast")
        ops.pattern("Plain", k + 1, k + 1)
        for node in np.flatnonzero(np.abs(pattern).sum(axis=1)):
            ops.load(int(node) + 1, *map(float, pattern[node]))
    ops.constraints("Plain")
    ops.numberer("RCM")
    ops.system("UmfPack")
    ops.test("NormDispIncr", tolerance, max_iterations, 0)
    ops.algorithm("Newton")
    if variant == "newmark":
        ops.integrator("Newmark", 0.5, 0.25)
    else:
        ops.integrator("HHT", 0.95)
    ops.analysis("Transient", "-noWarnings")


def run(request: dict) -> dict:
    begun = time.perf_counter()
    case = np.load(request["case"])
    build(case, request.get("variant", "newmark"), request["tolerance"], request.get("max_iterations", 25))
    dt, steps = request["dt"], request["steps"]
    n = len(case["nodes"])
    history = np.zeros((steps + 1, n, 3))
    setup = time.perf_counter() - begun
    spent, step_iterations, converged = 0.0, [], True
    for step in range(1, steps + 1):
        begun = time.perf_counter()
        converged = ops.analyze(1, dt) == 0 and converged
        step_iterations.append(ops.testIter())
        spent += time.perf_counter() - begun
        if not converged:
            break
        if request.get("history"):
            history[step] = [ops.nodeDisp(k + 1)[:3] for k in range(n)]
    if request.get("history"):
        np.savez(request["history"], times=dt * np.arange(steps + 1), displacements=history)
    return {
        "seconds": spent, "setup": setup, "iterations": sum(step_iterations), "steps": len(step_iterations),
        "step_iterations": step_iterations, "converged": converged, "version": ops.version(),
    }  # fmt: skip


if __name__ == "__main__":
    serve(run)
