"""MuJoCo on the harness's cases: a flex of triangles, `elastic2d="both"`, in a loop of explicit steps.

Vertices are bodies on slides, with a third of the mass of every triangle at them; they have no rotations, and bending is
of the angle between neighbours. Nothing touches and nothing damps.
"""

import time

import mujoco
import numpy as np
from serve import serve

_AXES = ("1 0 0", "0 1 0", "0 0 1")


def build(case, dt: float):
    """(model, for every node and axis its number among the velocities, -1 where it is held)."""
    nodes, triangles = case["nodes"], case["triangles"]
    E, nu, h, rho = (float(case[n]) for n in ("young_modulus", "poisson_ratio", "thickness", "density"))
    a, b, c = nodes[triangles].swapaxes(0, 1)
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    mass = np.bincount(triangles.ravel(), np.repeat(rho * h * area / 3.0, 3), minlength=len(nodes))
    held = np.zeros((len(nodes), 6), bool)
    held.reshape(-1)[case["held"]] = True
    numbers, bodies, count = np.full((len(nodes), 3), -1), [], 0
    for k, x in enumerate(nodes):
        slides = ""
        for axis in np.flatnonzero(~held[k, :3]):
            slides += f'<joint type="slide" axis="{_AXES[axis]}"/>'
            numbers[k, axis], count = count, count + 1
        place, inertia = " ".join(f"{v:.17g}" for v in x), f"{1e-3 * mass[k]:.17g}"
        bodies.append(
            f'<body name="v{k}" pos="{place}"><inertial pos="0 0 0" mass="{mass[k]:.17g}" '
            f'diaginertia="{inertia} {inertia} {inertia}"/>{slides}</body>'
        )
    names, corners = " ".join(f"v{k}" for k in range(len(nodes))), " ".join(map(str, triangles.ravel()))
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{dt:.17g}" gravity="0 0 0"><flag contact="disable"/>'
        f'</option><compiler autolimits="true"/><size memory="1G"/><worldbody>{"".join(bodies)}</worldbody>'
        f'<deformable><flex name="shell" dim="2" body="{names}" element="{corners}" radius="1e-6">'
        f'<contact selfcollide="none"/><elasticity young="{E:.17g}" poisson="{nu:.17g}" thickness="{h:.17g}" '
        f'elastic2d="both"/></flex></deformable></mujoco>'
    )
    return model, numbers


def run(request: dict) -> dict:
    begun = time.perf_counter()
    case, dt, steps = np.load(request["case"]), request["dt"], request["steps"]
    model, numbers = build(case, dt)
    data = mujoco.MjData(model)
    moves = numbers >= 0
    patterns = [p[:, :3][moves] for p in case["load_patterns"]]
    histories = [(case[f"history_{k}_times"], case[f"history_{k}_values"]) for k in range(len(patterns))]
    times = dt * np.arange(steps)
    factors = np.array([np.interp(times, *h) if len(h[0]) > 1 else np.full(steps, h[1][0]) for h in histories]).T
    loaded = numbers[moves]
    positions = np.zeros((steps + 1, model.nq))
    setup, begun = time.perf_counter() - begun, time.perf_counter()
    for step in range(steps):
        data.qfrc_applied[loaded] = sum(f * p for f, p in zip(factors[step], patterns, strict=True))
        mujoco.mj_step(model, data)
        positions[step + 1] = data.qpos
    spent = time.perf_counter() - begun
    history = np.zeros((steps + 1, len(case["nodes"]), 3))
    history[:, moves] = positions[:, loaded]
    if request.get("history"):
        np.savez(request["history"], times=dt * np.arange(steps + 1), displacements=history)
    good = bool(np.isfinite(positions).all() and not data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number)
    return {
        "seconds": spent, "setup": setup, "iterations": steps, "steps": steps, "converged": good,
        "version": mujoco.__version__,
    }  # fmt: skip


if __name__ == "__main__":
    # A step too large is told by the answer, and not by a file in the folder of the caller.
    mujoco.set_mju_user_warning(lambda _: None)
    serve(run)
