"""Two rigid bodies without a shell, joined to a wall and to each other, against their equations of motion.

With the joints at the wall and at the elbow, c₁ = R₁ s₁ and e = R₁ l from the wall to the first body's centre and to the
elbow, and d = R₂ s₂ from there to the second's centre, the centres move by ω₁ × c₁ and ω₁ × e + ω₂ × d. D'Alembert's
principle for the spins ω = (ω₁, ω₂) gives M(R) ω̇ = f(R, ω), which spherical joints leave as it is. Hinges about n₁ at the
wall and about n₂, fixed in the first body, at the elbow have the angles q: ω = B q̇, and BᵀM B q̈ = Bᵀ(f - M Ḃ q̇).
"""

import functools

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import jaxshell as js

G = np.array([0.0, 0.0, -9.81])
MASSES = 1.0, 0.6
CENTRES, ELBOW = (np.array([0.3, 0.05, -0.1]), np.array([0.2, -0.1, 0.05])), np.array([0.6, 0.0, -0.1])
"""From the wall and from the elbow, at the start."""
INERTIAS = (
    np.array([[0.02, 0.003, 0.0], [0.003, 0.03, -0.004], [0.0, -0.004, 0.025]]),
    np.array([[0.01, 0.0, 0.002], [0.0, 0.012, 0.0], [0.002, 0.0, 0.008]]),
)
AXES = np.array([0.0, 1.0, 0.0]), np.array([0.48, 0.6, 0.64])
SPINS = {"spherical": np.array([[1.0, 2.0, -3.0], [4.0, -1.0, 2.0]]), "hinge": None}
RATES = np.array([2.0, -3.0])
END = 0.6


def skew(v):
    return np.cross(np.eye(3), v)


def equations(R, omega):
    """M (6, 6) and f (6,)."""
    (c1, e, d), spins = (R[0] @ CENTRES[0], R[0] @ ELBOW, R[1] @ CENTRES[1]), omega
    levers = np.hstack([-skew(c1), np.zeros((3, 3))]), np.hstack([-skew(e), -skew(d)])
    tensors = [R[k] @ INERTIAS[k] @ R[k].T for k in range(2)]
    inward = [np.cross(spins[k], np.cross(spins[k], arm)) for k, arm in ((0, c1), (0, e), (1, d))]
    bias = inward[0], inward[1] + inward[2]
    M = sum(m * J.T @ J for m, J in zip(MASSES, levers, strict=True))
    M[:3, :3] += tensors[0]
    M[3:, 3:] += tensors[1]
    f = sum(m * J.T @ (G - a) for m, J, a in zip(MASSES, levers, bias, strict=True))
    return M, f - np.concatenate([np.cross(w, E @ w) for w, E in zip(spins, tensors, strict=True)])


def turned(q):
    """R of both bodies, and B (6, 2), of the angles of the hinges."""
    first = Rotation.from_rotvec(q[0] * AXES[0]).as_matrix()
    second = first @ Rotation.from_rotvec(q[1] * AXES[1]).as_matrix()
    along, still = first @ AXES[1], np.zeros(3)
    return (first, second), np.stack([np.concatenate([AXES[0], AXES[0]]), np.concatenate([still, along])], axis=1)


def hinged(_, y):
    q, rates = y[:2], y[2:]
    R, B = turned(q)
    omega = (B @ rates).reshape(2, 3)
    M, f = equations(R, omega)
    swept = np.concatenate([np.zeros(3), rates[1] * np.cross(omega[0], B[3:, 1])])
    return np.concatenate([rates, np.linalg.solve(B.T @ M @ B, B.T @ (f - M @ swept))])


def free(_, y):
    R, omega = y[:18].reshape(2, 3, 3), y[18:].reshape(2, 3)
    M, f = equations(R, omega)
    return np.concatenate([*((skew(omega[k]) @ R[k]).ravel() for k in range(2)), np.linalg.solve(M, f)])


@functools.cache
def expected(joint: str):
    """Where the elbow and the second centre are at the end, from the wall; of hinges their angles too."""
    if joint == "hinge":
        y, rates = np.concatenate([np.zeros(2), RATES]), hinged
    else:
        y, rates = np.concatenate([np.tile(np.eye(3).ravel(), 2), SPINS[joint].ravel()]), free
    y = solve_ivp(rates, (0.0, END), y, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    R, angles = (turned(y[:2])[0], y[:2]) if joint == "hinge" else (y[:18].reshape(2, 3, 3), np.zeros(0))
    elbow = R[0] @ ELBOW
    return np.concatenate([elbow, elbow + R[1] @ CENTRES[1], angles])


def pendulum(joint: str) -> js.Scene:
    """Bodies by their references at the joints; what has mass is at the centres."""
    places = {"wall": np.zeros(3), "shoulder": np.zeros(3), "first": CENTRES[0], "elbow": ELBOW}
    places |= {"socket": ELBOW, "second": ELBOW + CENTRES[1]}
    omega = SPINS[joint] if joint == "spherical" else (turned(np.zeros(2))[1] @ RATES).reshape(2, 3)
    still, hand = np.zeros(3), np.cross(omega[0], ELBOW)
    velocities = [still, still, np.cross(omega[0], CENTRES[0]), hand, hand, hand + np.cross(omega[1], CENTRES[1])]
    make = js.Spherical if joint == "spherical" else js.Hinge
    given = [(), ()] if joint == "spherical" else [(AXES[0],), (AXES[1],)]
    watch = {f"{at} {axis}": (at, f"u{axis}") for at in ("elbow", "second") for axis in "xyz"}
    if joint == "hinge":
        watch |= {name: (name, "angle") for name in ("upper", "lower")}
    return js.Scene(
        js.Mesh.of_points(places),
        None,
        [js.clamped("wall")],
        [js.Gravity(G)],
        initial=js.Initial(np.stack(velocities), np.stack([still, *[omega[0]] * 3, *[omega[1]] * 2])),
        masses=[js.PointMass(at, m, J) for at, m, J in zip(("first", "second"), MASSES, INERTIAS, strict=True)],
        connectors=[
            js.RigidBody([2, 3], "shoulder"),
            js.RigidBody("second", "socket"),
            make("wall", "shoulder", *given[0], name="upper"),
            make("elbow", "socket", *given[1], name="lower"),
        ],
        watch=watch,
    )


@pytest.mark.parametrize("joint", ["hinge", pytest.param("spherical", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "method",
    [js.EnergyMomentum(), pytest.param(js.GeneralizedEnergyMomentum(), marks=pytest.mark.slow)],
    ids=["exact", "emc"],
)
def test_a_double_pendulum_follows_its_equations_with_second_order(method, joint):
    scene, at = pendulum(joint), np.concatenate([ELBOW, ELBOW + CENTRES[1]])
    errors = []
    for steps in (200, 400):
        solution = js.simulate(
            scene, method, dt=END / steps, t_end=END, save_every=100, newton=js.Newton(tolerance=1e-12)
        )
        found = np.array([solution.watched[label][-1] for label, _, _ in scene.watch])
        found[:6] += at
        errors.append(np.abs(found - expected(joint)).max())
        x = solution.displacements + scene.mesh.nodes
        assert jnp.max(jnp.abs(x[:, 3] - x[:, 4])) < 1e-13 and jnp.max(jnp.abs(x[:, 1])) < 1e-13
    print(f"{joint}: {errors[0]:.2e} and {errors[1]:.2e} with half the step")
    assert errors[1] < 1e-4 and 3.8 < errors[0] / errors[1] < 4.2
    if isinstance(method, js.EnergyMomentum):
        total = solution.energy.kinetic - solution.energy.external_work
        assert jnp.max(jnp.abs(total - total[0])) < 1e-12 * jnp.max(solution.energy.kinetic)
