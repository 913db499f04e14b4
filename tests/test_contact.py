"""Contact with rigid obstacles: exact work, closed forms of bouncing, sliding and sticking, and what is refused."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxshell as js
from jaxshell.files.scene_file import read_scene_file
from jaxshell.model import generators
from jaxshell.model.contribution import Contribution, Place, Surface
from jaxshell.model.obstacles import OBSTACLES
from jaxshell.model.obstacles.contact import NormalContact, Touch, touch_of
from jaxshell.model.sections import AnySection

TILTED = [[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]]
KINDS = {
    "plane": js.Plane([0.1, 0, 0], [1, 2, 2], motion=[0.1, 0.2, 0.0], history=js.History.ramp(1.0)),
    "sphere": js.Sphere([0.1, 0, 0.2], 0.7),
    "container": js.Sphere([0.1, 0, 0.2], 0.7, inside=True),
    "pipe": js.Cylinder([0.1, 0, 0.1], [1, 1, 0.0], 0.6, inside=True),
    "drum": js.Cylinder([0.1, 0, 0.1], [1, 1, 0.0], 0.6, 1.1),
    "box": js.Box([0, 0.1, 0], [1, 1.2, 0.8], axes=TILTED),
}
H, RHO, G = 2e-3, 2700.0, 1000.0
DT, SLIP = 1e-4, 0.01
SECTION = js.Section(thickness=H, young_modulus=70e9, poisson_ratio=0.3, density=RHO)
MESH = generators.rectangle(0.2, 0.1, (2, 1))


# --- one node ---------------------------------------------------------------------------------------------


def place(x, time):
    return Place(x[None], jnp.eye(3)[None], jnp.asarray(time))


@pytest.mark.parametrize("kind", KINDS)
def test_the_force_does_exactly_the_work_of_the_energy_on_steps_of_any_size(kind):
    obstacle, rng = KINDS[kind], np.random.default_rng(1)
    contact, data = NormalContact(obstacle), Touch(jnp.array(3.0), jnp.array(0.05))

    @jax.jit
    @jax.vmap
    def errors(x, y):
        start, end = place(x, 0.2), place(y, 0.7)
        force = contact.mean_force(data, start, end)[0, :3]
        drive = (obstacle.moved(0.7) - obstacle.moved(0.2)) * jnp.ones(3)
        change = contact.energy(data, end) - contact.energy(data, start)
        reversal = force - contact.mean_force(data, end, start)[0, :3]
        gradient = contact.force(data, end)[0, :3] + jax.grad(lambda y: contact.energy(data, place(y, 0.7)))(y)
        return jnp.stack([force @ (y - x - drive) + change, *reversal, *gradient]), change

    x, way = rng.uniform(-1.0, 1.0, (2, 500, 3))
    if isinstance(obstacle, js.Sphere):
        x[0], way[0] = obstacle.centre, 0.0  # where no direction is the nearest
    for scale in (1.0, 1e-3, 1e-9):
        found, changes = errors(x, x + scale * way)
        assert jnp.max(jnp.abs(found)) < 1e-13
        assert jnp.max(jnp.abs(changes)) > 1e-3 * scale


def test_the_tangent_of_a_node_is_that_of_all_its_degrees_of_freedom():
    contact, data = NormalContact(KINDS["pipe"]), Touch(jnp.array(3.0), jnp.array(0.05))

    @jax.jit
    def tangents(x, y):
        start, end = place(x, 0.2), place(y, 0.7)
        own = contact.mean_stiffness(data, start, end), contact.stiffness(data, end)
        by_jacfwd = (
            Contribution.mean_stiffness(contact, data, start, end),
            Contribution.stiffness(contact, data, end),
        )
        return own, by_jacfwd

    own, by_jacfwd = tangents(jnp.array([0.9, 0.1, 0.6]), jnp.array([0.8, 0.0, 0.9]))
    for found, expected in zip(own, by_jacfwd, strict=True):
        assert jnp.max(jnp.abs(expected)) > 1.0
        assert jnp.max(jnp.abs(found - expected)) < 1e-13


def test_the_default_stiffness_is_that_of_the_membrane():
    floor = js.Plane([0, 0, -1], [0, 0, 1], friction=0.1)
    found, area = SECTION.resultants(MESH), jnp.full(4, 0.005)
    normals, triangles = jnp.tile(jnp.array([0.0, 0.0, 1.0]), (4, 1)), MESH.triangles
    layers = functools.partial(SECTION.layers, MESH)
    surface = Surface(
        MESH.nodes, triangles, found.mass_per_area, area, normals, jnp.ones(()), found.A, layers, triangles
    )
    touch, A = touch_of(floor, surface), found.A[0, 0, 0]
    around = np.bincount(MESH.triangles.ravel())
    np.testing.assert_allclose(touch.stiffness, around * A / 3.0, rtol=1e-14)
    np.testing.assert_allclose(touch.offset, 0.5 * H, rtol=1e-14)
    np.testing.assert_allclose(touch.slip, 1e-6 * np.sqrt(A / (RHO * H)), rtol=1e-14)


# --- a plate ----------------------------------------------------------------------------------------------


STIFFNESS = float(SECTION.resultants(MESH).A[0, 0, 0]) / 0.005  # the default one: elements are all of one area


def plate(friction=0.0, slope=0.0, gap=0.01, g=G, velocity=(0.0, 0.0, -1.0), spin=(0.0, 0.0, 0.0), k=STIFFNESS):
    """A plate over a floor, in a field that is tilted by the slope. Friction is traced, also where it is zero."""
    floor = js.Plane(
        [0, 0, -0.5 * H - gap], [0, 0, 3.0], stiffness=k, friction=jnp.array(friction), slip=SLIP, name="floor"
    )
    pull = js.Gravity([g * np.sin(slope), 0.0, -g * np.cos(slope)])
    start = js.Initial.rigid(MESH, velocity=velocity, angular_velocity=spin)
    watch = {"floor force": ("floor", "fz"), "depth": ("floor", "penetration")}
    return js.Scene(MESH, SECTION, loads=[pull], initial=start, obstacles=[floor], watch=watch)


@functools.cache
def run(method=None, steps=1000, dt=DT, **of):
    method = js.EnergyMomentum() if method is None else method
    return js.simulate(plate(**of), method, dt=dt, t_end=steps * dt, newton=js.Newton(tolerance=1e-14))


def left(solution) -> float:
    """The largest change of energy that work and dissipation do not explain, over the largest energy."""
    energy = solution.energy
    change = energy.total - energy.total[0] - energy.external_work + energy.dissipated
    return float(jnp.max(jnp.abs(change)) / jnp.max(energy.total))


def bounces(solution) -> int:
    touching = js.penetration(solution)[0].depth > 0
    return int(np.sum(np.diff(touching.astype(int)) == 1))


def test_a_plate_bounces_many_times_and_keeps_its_energy():
    tumbling = run(steps=500, spin=(3.0, 2.0, 0.0))
    assert bounces(tumbling) > 10
    assert left(tumbling) < 1e-10
    # What it has gained in momentum is the impulse of the floor, less that of gravity.
    mass = float(js.mass_properties(tumbling.scene).mass)
    gained = tumbling.momentum.linear[:, 2] - tumbling.momentum.linear[0, 2]
    impulse = np.append(0.0, np.cumsum(tumbling.watched["floor force"][1:])) * DT
    np.testing.assert_allclose(gained, impulse - mass * G * tumbling.times, atol=1e-10 * float(impulse[-1]))
    np.testing.assert_array_equal(tumbling.watched["depth"], js.penetration(tumbling)[0].depth)


def test_a_flat_plate_rises_as_high_as_it_fell():
    flat = run(steps=120)
    assert bounces(flat) == 1 and left(flat) < 1e-12
    # From z = 0 with v = -1: up to v²/2g, the parabola's top lying between two steps.
    rises = np.asarray(flat.displacements[20:, :, 2]).max(axis=0)
    assert np.all(np.abs(0.5 / G - rises) < 0.25 * G * DT**2)


def test_the_deepest_penetration_is_that_of_a_mass_on_a_spring():
    k = 1e9  # √(k/ρh) of 13.6 kHz·rad, resolved by the step
    speed = np.sqrt(1.0 + 2 * G * 0.01)
    omega = np.sqrt(k / (RHO * H))
    static = G / omega**2
    exact = static + np.sqrt(static**2 + (speed / omega) ** 2)
    resolved = run(steps=150, k=k, dt=4e-5)
    assert abs(js.penetration(resolved)[0].depth.max() / exact - 1.0) < 0.05
    assert js.penetration(resolved)[0].thickness[0] == H


def test_friction_slows_a_sliding_plate_and_holds_one_that_is_not_steep():
    slope, g, dt, steps = 0.5, 9.81, 2e-4, 250
    slides = run(friction=0.2, slope=slope, gap=0.0, g=g, velocity=(1.0, 0.0, 0.0), dt=dt, steps=steps)
    end = float(jnp.mean(slides.velocities[-1][:, 0]))
    exact = g * (np.sin(slope) - 0.2 * np.cos(slope)) * dt * steps
    assert abs((end - 1.0) / exact - 1.0) < 1e-3
    assert left(slides) < 1e-8 and float(slides.energy.dissipated[-1]) > 0
    # Viscous below the slip velocity: it creeps where μ N v/√(v² + v₀²) carries the weight's part.
    part = np.tan(slope) / 0.8
    sticks = run(friction=0.8, slope=slope, gap=0.0, g=g, velocity=(0.0, 0.0, 0.0), dt=dt, steps=steps)
    creep = float(jnp.mean(sticks.velocities[-1][:, 0]))
    assert abs(creep / (SLIP * part / np.sqrt(1 - part**2)) - 1.0) < 0.05
    assert creep < SLIP


def test_a_result_file_knows_the_obstacles(tmp_path):
    solution = run(steps=500, spin=(3.0, 2.0, 0.0))
    solution.save(tmp_path / "run.h5")
    again = js.Solution.load(tmp_path / "run.h5")
    floor, back = solution.scene.obstacles[0], again.scene.obstacles[0]
    assert isinstance(floor, js.Plane) and isinstance(back, js.Plane) and back.name == "floor"
    assert jnp.all(back.point == floor.point) and back.friction == floor.friction
    assert np.all(js.penetration(again)[0].depth == js.penetration(solution)[0].depth)


OF_FILE = """
[mesh]
generator = "rectangle"
length = 0.2
width = 0.1
divisions = [2, 1]
[section]
thickness = 2e-3
young_modulus = 70e9
poisson_ratio = 0.3
density = 2700.0
[watch]
weight = { obstacle = "floor", component = "fz" }
[[obstacles]]
kind = "plane"
name = "floor"
point = [0, 0, -1]
normal = [0, 0, 1]
friction = 0.3
[[obstacles]]
kind = "cylinder"
point = [0, 0, 0]
axis = [1, 0, 0]
radius = 0.5
inside = true
nodes = { box = [[0, 0, 0], [0.1, 0.1, 0]] }
motion = [0, 0, 0.1]
history = { ramp = 0.1 }
"""


def test_a_scene_file_states_obstacles(tmp_path):
    (tmp_path / "scene.toml").write_text(OF_FILE, encoding="utf-8")
    scene, _ = read_scene_file(tmp_path / "scene.toml")
    floor, pipe = scene.obstacles
    assert isinstance(floor, js.Plane) and isinstance(pipe, js.Cylinder)
    assert floor.friction == 0.3 and scene.watch == (("weight", "floor", "fz"),)
    assert pipe.inside and pipe.length is None and float(pipe.moved(0.05)[2]) == 0.05
    assert pipe.touching(scene.mesh.triangles).size == 4


# --- what is refused --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: js.Plane([0, 0, 0], [0, 0, 0]), "plane normal must be a direction"),
        (lambda: js.Cylinder([0, 0, 0], [0, 0, 0], 1.0), "cylinder axis must be a direction"),
        (lambda: js.Cylinder([0, 0, 0], [0, 0, 1], 1.0, -1.0), "cylinder length must be positive"),
        (lambda: js.Sphere([0, 0, 0], 0.0), "sphere radius must be positive"),
        (lambda: js.Box([0, 0, 0], [1, 0, 1]), "box sizes must be positive"),
        (lambda: js.Box([0, 0, 0], [1, 1, 1], axes=2 * np.eye(3)), "box axes must be of unit length"),
        (lambda: js.Plane([0, 0, 0], [0, 0, 1], friction=-0.1), "plane friction must be zero or positive"),
        (lambda: js.Plane([0, 0, 0], [0, 0, 1], stiffness=0.0), "plane stiffness must be positive"),
        (lambda: js.Plane([0, 0, 0], [0, 0, 1], slip=0.1), "slip is of friction"),
        (lambda: js.Plane([0, 0, 0], [0, 0, 1], motion=[0, 0, 1]), "needs both: motion"),
        (lambda: js.Plane([0, 0, 0], [0, 0, 1], nodes=[]), "obstacle nodes is empty"),
    ],
)
def test_bad_obstacles_are_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_a_shell_that_starts_inside_is_refused_by_node_and_depth():
    def scene(obstacle, section: AnySection = SECTION):
        return js.Scene(MESH, section, obstacles=[obstacle])

    with pytest.raises(ValueError, match=r"obstacle 0: the shell starts inside this plane: node 0 by 0\.001"):
        scene(js.Plane([0, 0, 0], [0, 0, 1]))
    scene(js.Plane([0, 0, 0], [0, 0, 1], offset=0.0))
    scene(js.Plane([0, 0, -0.5 * H], [0, 0, 1]))
    with pytest.raises(ValueError, match=r"starts inside this sphere: node \d by 0\.1"):
        scene(js.Sphere([0.1, 0.05, 0], 0.01, inside=True))
    with pytest.raises(ValueError, match="names node 99"):
        scene(js.Plane([0, 0, -1], [0, 0, 1], nodes=[99]))
    general = js.GeneralSection(A=1e8 * np.eye(3), B=None, D=1e2 * np.eye(3), mass_per_area=5.0, rotary_inertia=1e-6)
    with pytest.raises(ValueError, match="no thickness that is known: give the offset"):
        scene(js.Plane([0, 0, -1], [0, 0, 1]), general)
    scene(js.Plane([0, 0, -1], [0, 0, 1], offset=0.001), general)


def ball(points=None, **touching) -> js.Scene:
    """A mass of 2 without a shell, thrown down at the floor from where its skin is 0.01 above it."""
    mesh = js.Mesh.of_points({"ball": (0.0, 0.0, 0.06)} if points is None else points)
    velocities = np.zeros((mesh.n_nodes, 3))
    velocities[0] = [0.6, 0.0, -2.0]
    return js.Scene(
        mesh,
        None,
        initial=js.Initial(velocities),
        masses=[js.PointMass("ball", 2.0)],
        obstacles=[js.Plane([0, 0, 0], [0, 0, 1], name="floor", **touching)],
        watch={"depth": ("floor", "penetration"), "height": ("ball", "uz")},
    )


OF_BALL = {"nodes": "ball", "area": 1e-2, "stiffness": 5e6, "offset": 0.05, "friction": 0.1, "slip": 1e-4}


def test_a_mass_without_a_shell_bounces():
    """As on a spring k A, with √(kA/m) = 158 /s: in by v √(m/kA), out as fast; friction takes μ of that impulse."""
    newton = js.Newton(tolerance=1e-12, reuse=False)
    thrown = js.simulate(ball(**OF_BALL), js.EnergyMomentum(), dt=1e-4, t_end=0.04, newton=newton)
    np.testing.assert_allclose(jnp.max(thrown.watched["depth"]), 2.0 / np.sqrt(5e4 / 2.0), rtol=1e-3)
    np.testing.assert_allclose(thrown.momentum.linear[-1], [1.2 - 0.1 * 8.0, 0.0, 4.0], rtol=1e-6)
    assert left(thrown) < 1e-12 and thrown.energy.dissipated[-1] > 0
    found = js.penetration(thrown)[0]
    assert found.thickness[0] == 0.1 and found.node[found.worst] == 0


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ball(), "no elements, whose nodes touch it where none are named: give its nodes"),
        (lambda: ball(nodes="ball", offset=0.05), "node 0 belongs to no element.*give area, stiffness"),
        (lambda: ball(**(OF_BALL | {"slip": None})), "give slip"),
        (lambda: ball(**(OF_BALL | {"offset": 0.07})), r"starts inside this plane: node 0 by 0\.01"),
        (lambda: js.Scene(MESH, SECTION, obstacles=[js.Plane([0, 0, -1], [0, 0, 1], area=1.0)]), "area is of points"),
    ],
)
def test_points_that_touch_say_how(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_a_mass_beside_the_shell_does_not_pass_through_unasked():
    mesh = MESH.with_points({"bob": (0.1, 0.05, 0.1)})
    masses, floor, where = [js.PointMass("bob", 1.0)], js.Plane([0, 0, -1], [0, 0, 1]), np.arange(6)
    with pytest.raises(
        ValueError, match=r"obstacle 0: node 6 has a mass and hangs on no element.*pass through this plane"
    ):
        js.Scene(mesh, SECTION, masses=masses, obstacles=[floor])
    js.Scene(mesh, SECTION, masses=masses, obstacles=[js.Plane([0, 0, -1], [0, 0, 1], nodes=where)])
    js.Scene(mesh, SECTION, masses=masses, connectors=[js.RigidBody([5, 6])], obstacles=[floor])


def test_all_kinds_are_listed():
    assert {type(obstacle) for obstacle in KINDS.values()} == set(OBSTACLES)
