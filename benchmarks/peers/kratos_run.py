"""Kratos Multiphysics on the harness's cases: ShellThinElementCorotational3D3N, Newmark or Bossak, sparse_lu.

Set up as `structural_mechanics_implicit_dynamic_solver` does it: MixedGenericCriteria on displacement and rotation,
consistent tangent in every iteration, equation numbers kept over the steps. Driven step by step from Python, which
costs some 20 µs a step.
"""

import time

import KratosMultiphysics as KM
import KratosMultiphysics.LinearSolversApplication as LSA
import KratosMultiphysics.StructuralMechanicsApplication as SMA
import numpy as np
from serve import serve

_DOFS = [
    (KM.DISPLACEMENT_X, KM.REACTION_X), (KM.DISPLACEMENT_Y, KM.REACTION_Y), (KM.DISPLACEMENT_Z, KM.REACTION_Z),
    (KM.ROTATION_X, KM.REACTION_MOMENT_X), (KM.ROTATION_Y, KM.REACTION_MOMENT_Y),
    (KM.ROTATION_Z, KM.REACTION_MOMENT_Z),
]  # fmt: skip
_VARIABLES = (
    KM.DISPLACEMENT, KM.VELOCITY, KM.ACCELERATION, KM.ROTATION, KM.ANGULAR_VELOCITY, KM.ANGULAR_ACCELERATION,
    KM.REACTION, KM.REACTION_MOMENT, SMA.POINT_LOAD, KM.VOLUME_ACCELERATION,
)  # fmt: skip


def build(case, scheme: str, tolerance: float, max_iterations: int, absolute: bool):
    """(model, model part, strategy, load conditions by node)."""
    model = KM.Model()
    part = model.CreateModelPart("shell", 2)
    for variable in _VARIABLES:
        part.AddNodalSolutionStepVariable(variable)
    part.ProcessInfo[KM.DOMAIN_SIZE] = 3
    properties = part.CreateNewProperties(1)
    for variable, name in (
        (KM.THICKNESS, "thickness"), (KM.YOUNG_MODULUS, "young_modulus"),
        (KM.POISSON_RATIO, "poisson_ratio"), (KM.DENSITY, "density"),
    ):  # fmt: skip
        properties[variable] = float(case[name])
    properties[KM.CONSTITUTIVE_LAW] = SMA.LinearElasticPlaneStress2DLaw()
    for k, x in enumerate(case["nodes"]):
        part.CreateNewNode(k + 1, *map(float, x))
    for k, triangle in enumerate(case["triangles"]):
        part.CreateNewElement("ShellThinElementCorotational3D3N", k + 1, [int(n) + 1 for n in triangle], properties)
    for variable, reaction in _DOFS:
        KM.VariableUtils().AddDof(variable, reaction, part)
    for dof in case["held"]:
        part.GetNode(int(dof) // 6 + 1).Fix(_DOFS[int(dof) % 6][0])
    loaded = np.flatnonzero(np.abs(case["load_patterns"][:, :, :3]).sum(axis=(0, 2)))
    for k, node in enumerate(loaded):
        part.CreateNewCondition("PointLoadCondition3D1N", k + 1, [int(node) + 1], properties)

    settings = KM.Parameters("""{"damp_factor_m": 0.0, "newmark_beta": 0.25, "projection_variables_list": []}""")
    settings["damp_factor_m"].SetDouble({"newmark": 0.0, "bossak": -0.05}[scheme])
    # Relative to the step's total displacements, as its users set it; or on our scale, the shell's size and radians.
    size = float(np.linalg.norm(np.ptp(case["nodes"], axis=0))) if absolute else 0.0
    criterion = KM.MixedGenericCriteria(
        [(KM.DISPLACEMENT, tolerance, tolerance * size), (KM.ROTATION, tolerance, tolerance * (size > 0))]
    )
    strategy = KM.ResidualBasedNewtonRaphsonStrategy(
        part,
        SMA.StructuralMechanicsBossakScheme(settings),
        criterion,
        KM.ResidualBasedBlockBuilderAndSolver(LSA.SparseLUSolver()),
        max_iterations, False, False, True,
    )  # fmt: skip
    strategy.SetEchoLevel(0)
    criterion.SetEchoLevel(0)
    part.SetBufferSize(2)
    strategy.Initialize()
    strategy.Check()
    return model, part, strategy, loaded


def run(request: dict) -> dict:
    begun = time.perf_counter()
    KM.ParallelUtilities.SetNumThreads(request.get("threads", 1))
    case = np.load(request["case"])
    # The model owns the part: it must live as long.
    _model, part, strategy, loaded = build(
        case,
        request.get("variant", "newmark"),
        request["tolerance"],
        request.get("max_iterations", 25),
        request.get("absolute", False),
    )
    patterns = case["load_patterns"]
    histories = [(case[f"history_{k}_times"], case[f"history_{k}_values"]) for k in range(len(patterns))]
    nodes = [part.GetNode(int(n) + 1) for n in loaded]
    conditions = [(part.GetCondition(k + 1), loaded[k]) for k in range(len(loaded))]
    dt, steps, converged, iterations = request["dt"], request["steps"], True, 0
    history = np.zeros((steps + 1, len(case["nodes"]), 3))
    setup = time.perf_counter() - begun
    spent = 0.0
    step_iterations = []
    for step in range(1, steps + 1):
        begun = time.perf_counter()
        now = dt * step
        part.CloneTimeStep(now)
        part.ProcessInfo[KM.STEP] = step
        part.ProcessInfo[KM.DELTA_TIME] = dt
        force = sum(np.interp(now, *h) * p[:, :3] for h, p in zip(histories, patterns, strict=True))
        for (condition, node), _ in zip(conditions, nodes, strict=True):
            condition.SetValue(SMA.POINT_LOAD, KM.Array3(force[node].tolist()))
        strategy.InitializeSolutionStep()
        strategy.Predict()
        converged = strategy.SolveSolutionStep() and converged
        strategy.FinalizeSolutionStep()
        step_iterations.append(int(part.ProcessInfo[KM.NL_ITERATION_NUMBER]))
        iterations += step_iterations[-1]
        spent += time.perf_counter() - begun
        if request.get("history"):
            values = KM.VariableUtils().GetSolutionStepValuesVector(part.Nodes, KM.DISPLACEMENT, 0, 3)
            history[step] = np.array(values).reshape(-1, 3)
    if request.get("history"):
        np.savez(request["history"], times=dt * np.arange(steps + 1), displacements=history)
    return {
        "seconds": spent, "setup": setup, "iterations": iterations, "steps": steps,
        "step_iterations": step_iterations, "converged": bool(converged), "version": KM.KratosGlobals.Kernel.Version(),
    }  # fmt: skip


if __name__ == "__main__":
    KM.Logger.GetDefaultOutput().SetSeverity(KM.Logger.Severity.WARNING)
    serve(run)
