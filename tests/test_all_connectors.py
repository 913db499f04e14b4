"""Every kind of connector, point masses and a floor with friction in one scene, over ten thousand steps.

Two plates of two triangles each, and points: a bead that slides along the first plate, a bob on a bar and a cable, a
pod on the middle of an edge, a twin tied to a corner, a grip at the mean of the first plate, and the hub that the far
edge of the second is rigid with. The plates are soft: what is left of the energy is the round-off of places times the
membrane's forces, a random walk that ten times the modulus makes three times as wide.
"""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxshell as js
from jaxshell.model import generators
from jaxshell.model.connectors import CONNECTORS

pytestmark = [pytest.mark.slow, pytest.mark.optimised]

DT, STEPS = 2e-5, 10_000
PANEL = js.Section(thickness=2e-3, young_modulus=7e9, poisson_ratio=0.3, density=2700.0)
Y = np.array([0.0, 1.0, 0.0])
POINTS = {"bead": (0.0, 0.1, 0.0), "bob": (0.0, 0.0, 0.1), "pod": (0.0, 0.05, 0.0), "twin": (0.2, 0.1, 0.0)}
GRIP = (0.1, 0.05, 0.05)
FAR = -1e3
"""The floor's height where nothing is to reach it."""


def mesh() -> js.Mesh:
    one = generators.rectangle(0.2, 0.1, (1, 1))
    nodes = jnp.concatenate([one.nodes, one.nodes + jnp.array([0.2, 0.0, 0.0])])
    return js.Mesh(nodes, np.concatenate([one.triangles, one.triangles + 4]), coincident="allow").with_points(POINTS)


def scene(floor=FAR, gravity=0.0, ground=0.0) -> js.Scene:
    """Thrown, spinning and folding; `ground` is the stiffness of what holds a corner from outside."""
    ball = 2e-6 * np.eye(3)
    connectors = [
        js.Hinge(
            2, 4, Y, stiffness=0.5, angle=0.1, damping=1e-3, friction=2e-3, friction_rate=1.0, stops=(-0.4, 0.4),
            stop_stiffness=5.0, name="hinge",
        ),
        js.Spherical(3, 5),
        js.RigidBody([6, 7], mass=0.02, inertia=np.diag([2e-5, 1e-5, 2.5e-5]), name="hub"),
        js.Distributed([0, 1, 2, 3], GRIP, name="grip"),
        js.Slider(1, "bead", (1.0, 0.0, 0.0)),
        js.RigidBar(0, "bob"),
        js.EdgeTie("pod", [[0, 1]]),
        js.Tie(3, "twin"),
        js.Spring("bead", 3, 300.0),
        js.Spring("bob", 2, 2e3, length=0.23, tension_only=True, name="cable"),
        js.Dashpot([0, 4], [3, 7], 2.0),
        js.TorsionSpring(0, 2, (1.0, 0.2, 0.0), 3.0, 0.1, damping=1e-4),
        js.ElasticSupport(1, (ground, 0.0, 2.0 * ground)),
    ]  # fmt: skip
    masses = [
        js.PointMass("bead", 0.02, ball),
        js.PointMass("bob", 0.01),
        js.PointMass("pod", 0.01, ball),
        js.PointMass("twin", 0.005, ball),
        js.PointMass("grip", 0.02, ball),
        js.PointMass(4, 0.01),
    ]
    bob = int(mesh().node_sets["bob"][0])
    plane = js.Plane(
        [0.0, 0.0, floor], [0.0, 0.0, 1.0], nodes=[*range(8), bob], stiffness=5e8, area=1e-3, offset=1e-3,
        friction=0.2, slip=0.01, name="floor",
    )  # fmt: skip
    given = {"masses": masses, "connectors": connectors, "obstacles": [plane], "loads": [js.Gravity((0, 0, -gravity))]}
    still = js.Scene(mesh(), PANEL, **given)
    start = js.Initial.rigid(still.mesh, velocity=(0.5, 0.0, 1.0), angular_velocity=(10.0, 3.0, 5.0))
    first = np.setdiff1d(np.arange(still.mesh.n_nodes), [4, 5, 6, 7, still.connectors[2].master])
    fold = jnp.array([0.0, 40.0, 0.0])
    turning = jnp.cross(fold, still.mesh.nodes[first] - jnp.array([0.2, 0.0, 0.0]))  # about the hinge
    start = js.Initial(start.velocities.at[first].add(turning), start.angular_velocities.at[first].add(fold))
    watch = {"opening": ("hinge", "angle"), "tension": ("cable", "force"), "depth": ("floor", "penetration")}
    return js.Scene(mesh(), PANEL, initial=start, watch=watch, **given)


def openings(solution) -> dict[str, float]:
    """By how much [m] the joints are open at most, in any step."""
    made = solution.scene
    points = {name: int(made.mesh.node_sets[name][0]) for name in (*POINTS, "grip", "hub")}
    x0 = np.asarray(made.mesh.nodes)
    x, R = np.asarray(solution.displacements) + x0, np.asarray(solution.rotations)
    bead, bob, pod, twin, grip, hub = (points[name] for name in ("bead", "bob", "pod", "twin", "grip", "hub"))

    def against(frame, node):  # where a node is, seen from another
        return np.einsum("fij,fi->fj", R[:, frame], x[:, node] - x[:, frame])

    def twist(one, other):
        return 0.5 * np.sum(np.cross(R[:, one], R[:, other], axis=1), axis=2)

    arms = x0[:4] - x0[:4].mean(axis=0)
    turned = np.einsum("fij,kj->fki", R[:, grip], arms)
    found = {
        "hinge": [x[:, 2] - x[:, 4], 0.4 * (R[:, 2] @ Y - R[:, 4] @ Y)],
        "spherical": [x[:, 3] - x[:, 5]],
        "body": [against(hub, k) - (x0[k] - x0[hub]) for k in (6, 7)] + [R[:, 6] - R[:, hub]],
        "slider": [against(1, bead)[:, 1:], 0.4 * (R[:, 1] - R[:, bead])],
        "bar": [np.linalg.norm(x[:, bob] - x[:, 0], axis=1) - 0.1],
        "edge tie": [x[:, pod] - 0.5 * (x[:, 0] + x[:, 1]), 0.4 * (twist(0, pod) + twist(1, pod))],
        "tie": [x[:, 3] - x[:, twin], 0.4 * (R[:, 3] - R[:, twin])],
        "distributed": [
            x[:, grip] - R[:, grip] @ (x0[grip] - x0[:4].mean(axis=0)) - x[:, :4].mean(axis=1),
            np.cross(turned, x[:, :4]).sum(axis=1),
        ],
    }
    return {joint: max(float(np.abs(gap).max()) for gap in gaps) for joint, gaps in found.items()}


def run(factor: int, steps: int, **of) -> js.Solution:
    dt = factor * DT
    return js.simulate(scene(**of), js.EnergyMomentum(), dt=dt, t_end=steps * dt, newton=js.Newton(tolerance=1e-14))


def left(solution) -> float:
    """The largest change of energy that work and dissipation do not explain, over the largest energy."""
    energy = solution.energy
    change = energy.total - energy.total[0] - energy.external_work + energy.dissipated
    return float(jnp.max(jnp.abs(change)) / jnp.max(energy.total))


def check(solution) -> None:
    opened = openings(solution)
    print(f"energy {left(solution):.1e}; joints " + ", ".join(f"{k} {v:.1e}" for k, v in opened.items()))
    assert left(solution) < 1e-12 and max(opened.values()) < 1e-12
    energy, watched = solution.energy, solution.watched
    assert energy.dissipated[-1] > 0.01 * energy.total[0]
    assert jnp.max(watched["tension"]) > 0.0 and jnp.min(watched["tension"]) == 0.0
    assert jnp.max(jnp.abs(watched["opening"])) > 0.4


def test_all_kinds_are_in_the_scene():
    assert {type(item) for item in scene().connectors} == set(CONNECTORS)


@pytest.mark.parametrize(
    ("factor", "steps"),
    [(4, 2000), *(pytest.param(k, STEPS, marks=pytest.mark.evidence) for k in (1, 4))],
)
def test_in_free_flight(factor, steps):
    solution = run(factor, steps)
    check(solution)
    momenta = solution.momentum.linear, solution.momentum.angular
    changes = [float(jnp.max(jnp.abs(p - p[0])) / jnp.linalg.norm(p[0])) for p in momenta]
    print(f"momenta {changes}")
    assert max(changes) < 1e-12 and jnp.max(solution.watched["depth"]) == 0.0


@pytest.mark.parametrize(
    ("factor", "steps"),
    [(4, 4000), *(pytest.param(k, STEPS, marks=pytest.mark.evidence) for k in (1, 4))],
)
def test_on_springs_over_a_floor(factor, steps):
    solution = run(factor, steps, floor=-0.05, gravity=50.0, ground=30.0)
    check(solution)
    touching = np.asarray(solution.watched["depth"]) > 0
    assert np.sum(np.diff(touching.astype(int)) == 1) > 5
