"""Loads that follow the surface and loads on its regions: what they are at rest, turned, wet, and what they do.

Their tangents, and the energy that they give to a shell, are in test_contributions.
"""

import equinox as eqx
import h5py
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from balance import imbalance
from scipy.spatial.transform import Rotation
from stated import same
from test_contributions import strip

import jaxshell as js
from jaxshell.analyses.statics import proportional
from jaxshell.files.scene_file import read_scene_file
from jaxshell.model import generators
from jaxshell.model.contribution import Contribution, Place, Surface
from jaxshell.model.loads.hydrostatic import HydrostaticPressure
from jaxshell.model.normals import area_vectors
from jaxshell.results.nodal_loads import nodal_loads
from jaxshell.results.tree import read_scene_of, write_scene

TURN = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()


def random(*shape) -> np.ndarray:
    return np.random.default_rng(3).normal(size=shape)


def forces(load: Contribution, mesh: js.Mesh, x, R=None, time=0.0) -> np.ndarray:
    """(n, 6) of a contribution with the nodes at x, all turned by R."""
    return np.asarray(_forces(load, mesh, jnp.asarray(x), jnp.eye(3) if R is None else jnp.asarray(R), jnp.array(time)))


@eqx.filter_jit
def _forces(load, mesh, x, R, time):
    vectors = area_vectors(mesh.nodes, mesh.triangles)
    area = jnp.linalg.norm(vectors, axis=1)
    surface = Surface(mesh.nodes, mesh.triangles, jnp.ones_like(area), area, vectors / area[:, None], jnp.array(1.0))
    groups = load.groups(mesh.triangles).array
    place = Place(x[groups], jnp.broadcast_to(R, (*groups.shape, 3, 3)), jnp.broadcast_to(time, groups.shape[:1]))
    each = jax.vmap(load.force)(load.data(surface), place)
    return jnp.zeros((len(x), 6)).at[groups].add(each)


@eqx.filter_jit
def _nodal(load, mesh, mass):
    return load.nodal(mesh.nodes, mesh.triangles, mass)


def plate() -> js.Mesh:
    return generators.rectangle(1.0, 0.5, (3, 2))


def box(top: float = 1.0) -> js.Mesh:
    """A closed tetrahedron with normals outwards."""
    return js.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.3, top]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


# --- point forces and edges -------------------------------------------------------------------------------


def test_a_follower_force_has_components_along_the_surface_or_globally():
    """On the plate the projected direction (1, 0, 2) is x, and so the axes are x, y and z; on a turned one, R times."""
    mesh = plate()
    turned = js.Mesh(np.asarray(mesh.nodes) @ TURN.T, mesh.triangles)
    given = [1.0, -2.0, 3.0]
    for load in (js.FollowerForce([4], given), js.FollowerForce([4], given, direction=[1.0, 0.0, 2.0])):
        found = forces(load, mesh, mesh.nodes)
        np.testing.assert_allclose(found[4, :3], given, atol=1e-14)
        assert not found[:4].any() and not found[5:].any()
        # With the node, whatever becomes of the places.
        np.testing.assert_allclose(forces(load, mesh, mesh.nodes, TURN)[4, :3], TURN @ given, atol=1e-14)
    along_surface = js.FollowerForce([4], given, direction=TURN @ [1.0, 0.0, 2.0])
    np.testing.assert_allclose(forces(along_surface, turned, turned.nodes)[4, :3], TURN @ given, atol=1e-14)


def test_an_edge_force_is_outwards_along_and_normal_to_the_deformed_edge():
    """The edge x = 1 of the plate, along +y: outwards is x. Turned with the surface, and on twice the length twice."""
    mesh = plate()
    edges = np.array([[9, 10], [11, 10]])
    for components in ([5.0, 0, 0], [0, 7.0, 0], [0, 0, -2.0]):
        load = js.FollowerEdgeForce(edges, components)
        found = forces(load, mesh, mesh.nodes)[:, :3]
        np.testing.assert_allclose(found[[9, 10, 11]], np.outer([0.125, 0.25, 0.125], components), atol=1e-14)
        np.testing.assert_allclose(found.sum(axis=0), 0.5 * np.array(components), atol=1e-14)
        deformed = 2.0 * np.asarray(mesh.nodes) @ TURN.T + [1.0, 2.0, 3.0]
        np.testing.assert_allclose(forces(load, mesh, deformed)[:, :3], 2.0 * found @ TURN.T, atol=1e-14)
        fixed = js.FollowerEdgeForce(edges, components, axes="global")
        np.testing.assert_allclose(forces(fixed, mesh, deformed)[:, :3], 2.0 * found, atol=1e-14)


def test_a_normal_edge_force_all_round_a_deformed_plate_has_no_resultant():
    """As a surface tension: the edges of a flat patch close, however it is deformed in its plane."""
    mesh = plate()
    x = np.asarray(mesh.nodes) + 0.05 * random(12, 3) * [1, 1, 0]
    found = forces(js.FollowerEdgeForce(mesh.boundary_edges(), [3.0, 0.0, 0.0]), mesh, x)[:, :3]
    assert np.abs(found.sum(axis=0)).max() < 1e-14 and np.abs(found).max() > 0.1
    assert np.abs(np.cross(x, found).sum(axis=0)).max() < 1e-14


# --- dead loads on regions --------------------------------------------------------------------------------


def test_loads_on_regions_have_the_resultants_of_their_areas():
    mesh = generators.cylinder(1.0, 2.0, (2, 6), 180.0)
    x0, triangles = mesh.nodes, mesh.triangles
    chosen, mass = np.array([1, 4, 7]), jnp.linspace(1.0, 2.0, mesh.n_elements)
    vectors = np.asarray(area_vectors(x0, triangles))[chosen]
    areas = np.linalg.norm(vectors, axis=1)
    g = np.array([0.0, -1.0, -9.0])
    expected = [
        (js.Gravity(g, elements=chosen), (areas * np.asarray(mass)[chosen]).sum() * g),
        (js.Traction(g, elements=chosen), areas.sum() * g),
        (js.Traction(np.outer([1, 2, 3], g), elements=chosen), (areas * [1, 2, 3]).sum() * g),
        (js.DeadPressure([1.0, 2.0, 3.0], elements=chosen), (vectors * [[1], [2], [3]]).sum(axis=0)),
    ]
    for load, resultant in expected:
        found = np.asarray(_nodal(load, mesh, mass))
        np.testing.assert_allclose(found[:, :3].sum(axis=0), resultant, rtol=1e-13)
        others = np.setdiff1d(np.arange(mesh.n_nodes), triangles[chosen])
        assert not found[others].any() and not found[:, 3:].any()
    whole = np.asarray(_nodal(js.DeadPressure(2.0), mesh, mass))[:, :3]
    np.testing.assert_allclose(whole, forces(js.Pressure(2.0), mesh, x0)[:, :3], atol=1e-14)  # before it moves


def test_an_edge_moment_is_shared_by_the_ends():
    found = np.asarray(js.EdgeMoment([[9, 10], [10, 11]], [0.0, 4.0, 1.0]).nodal(plate().nodes, None, None))
    np.testing.assert_allclose(found[[9, 10, 11], 3:], np.outer([0.5, 1.0, 0.5], [0.0, 1.0, 0.25]), atol=1e-15)
    assert not found[:, :3].any() and not found[:9].any()


# --- liquids ----------------------------------------------------------------------------------------------


def test_a_liquid_lifts_what_is_under_it_by_the_weight_of_its_volume():
    """Archimedes: -γV up, through the centre of the volume; the normals point into the liquid, so γ is negative."""
    mesh, up = box(), np.array([0.3, -0.2, 1.0])
    x = np.asarray(mesh.nodes) + 0.1 * random(4, 3)
    found = forces(js.HydrostaticPressure(-3.0, 5.0, up=up), mesh, x)[:, :3]
    volume = np.linalg.det(x[1:] - x[0]) / 6.0
    lift = 3.0 * volume * up / np.linalg.norm(up)
    np.testing.assert_allclose(found.sum(axis=0), lift, atol=1e-13)
    np.testing.assert_allclose(np.cross(x, found).sum(axis=0), np.cross(x.mean(axis=0), lift), atol=1e-13)


def test_a_wall_wet_to_a_line_of_nodes_carries_half_of_gamma_h_squared():
    """And its moment about the line γ h³/3, though nodes' forces lie where they lie; nothing above the level."""
    wall = js.Mesh(np.asarray(generators.rectangle(1.0, 2.0, (1, 4)).nodes)[:, [0, 2, 1]],
                   generators.rectangle(1.0, 2.0, (1, 4)).triangles)  # fmt: skip
    x = np.asarray(wall.nodes)
    found = forces(js.HydrostaticPressure(4.0, 1.5), wall, x)[:, :3]
    np.testing.assert_allclose(found.sum(axis=0), [0.0, -4.0 * 1.5**2 / 2, 0.0], atol=1e-14)
    np.testing.assert_allclose(np.sum(found[:, 1] * (1.5 - x[:, 2])), -4.0 * 1.5**3 / 3, rtol=1e-13)
    assert not forces(js.HydrostaticPressure(4.0, -0.1), wall, x).any()
    # Between two lines, h apart, the pressure falls to zero at the upper one: γ h²/8 too much, of second order.
    between = forces(js.HydrostaticPressure(4.0, 1.25), wall, x)[:, 1].sum()
    assert between == pytest.approx(-4.0 * (1.25**2 / 2 + 0.5**2 / 8), rel=1e-13)
    # A level that rises, halved by the history: 1.5 at time 2.
    rising = js.HydrostaticPressure(4.0, js.History([0.0, 2.0], [0.0, 1.5]), js.History.ramp(4.0))
    np.testing.assert_allclose(forces(rising, wall, x, time=2.0)[:, :3], 0.5 * found, atol=1e-14)


@pytest.mark.parametrize("rising", [False, True])
def test_the_mean_force_does_the_work_of_the_liquids_potential(rising):
    """∫ p dV of a tetrahedron, γ V (level - z of its centre): exact for a step of the box's size.

    A level that rises in the step is no potential's: there the work is of second order in the step.
    """
    mesh, up, errors = box(), jnp.array([0.0, 0.0, 1.0]), []
    x = np.asarray(mesh.nodes)
    u = 0.5 * random(4, 3)
    sizes = (1.0, 0.5) if rising else (1.0,)
    load = HydrostaticPressure(3.0, js.History([0.0, 1.0], [4.0, 4.0 + rising]), up=up)

    def potential(x, level):
        return 3.0 * np.linalg.det(x[1:] - x[0]) / 6.0 * (level - x[:, 2].mean())

    for size in sizes:
        corners = mesh.triangles
        R = jnp.broadcast_to(jnp.eye(3), (4, 3, 3, 3))
        start, end = (Place(jnp.asarray(y)[corners], R, jnp.full(4, t)) for y, t in ((x, 0.0), (x + size * u, size)))
        mean = jax.jit(jax.vmap(load.mean_force))(jnp.full(4, 3.0), start, end)
        work = float(jnp.sum(mean[:, :, :3] * (size * u)[corners]))
        middle = 4.0 + 0.5 * size * rising
        errors.append(abs(work - (potential(x + size * u, middle) - potential(x, middle))))
    assert abs(potential(x + u, 4.0) - potential(x, 4.0)) > 0.05
    if rising:
        assert errors[0] > 1e-4 and errors[0] / errors[1] > 3.0
    else:
        assert errors[0] < 1e-14


def test_in_statics_a_level_is_that_of_the_end_and_the_load_factor_scales_the_weight():
    load = js.HydrostaticPressure(4.0, js.History([0.0, 2.0], [0.1, 0.7]), js.History.ramp(3.0))
    scene = strip(load, js.Pressure(1.0))
    taken = proportional(scene).loads
    assert float(taken[0].level) == 0.7 and float(taken[0].history(0.25)) == 0.25
    assert float(jnp.sum(nodal_loads(scene)[0][1][:, 2])) == pytest.approx(4.0 * 0.7 * 0.5, rel=1e-12)


# --- with every method, gradients -------------------------------------------------------------------------


PARAMETERS = ("force", "turn", "edge", "weight", "level", "up", "traction", "dead pressure", "moment", "gravity")


def everything(p=None):
    """The kinds of loads of this file on one strip; `p` changes their numbers."""
    p = dict.fromkeys(PARAMETERS, 0.0) | ({} if p is None else p)
    ramp = js.History.ramp(0.05)
    return (
        js.FollowerForce([10], jnp.array([3.0, 1.0, -2.0]) * (1 + p["force"]), ramp, jnp.array([1.0, p["turn"], 0.2])),
        js.FollowerEdgeForce([[9, 10]], jnp.array([4.0, -3.0, 5.0]) * (1 + p["edge"]), ramp),
        js.HydrostaticPressure(
            90.0 * (1 + p["weight"]), 0.3 + p["level"], ramp, [1, 5], jnp.array([p["up"], 0.0, 1.0])
        ),
        js.Traction(jnp.array([1.0, 2.0, 5.0]) * (1 + p["traction"]), ramp, elements=[0, 3]),
        js.DeadPressure(6.0 * (1 + p["dead pressure"]), ramp, elements=[2]),
        js.EdgeMoment([[9, 10]], jnp.array([0.2, -0.5, 0.0]) * (1 + p["moment"]), ramp),
        js.Gravity(jnp.array([0.0, 0.3, -0.4]) * (1 + p["gravity"]), ramp, elements=[7, 8]),
    )


@pytest.mark.evidence
def test_methods_agree_and_account_for_the_work():
    """K + S - W: EnergyMomentum to round-off; Newmark's rule and central differences to the square of their steps.

    On so few elements the tip is not compared with that of central differences, whose masses are lumped.
    """
    scene, tips = strip(*everything()), {}
    for method, dt, within in (
        (js.EnergyMomentum(), 2e-3, 1e-12),
        (js.Newmark(), 2e-3, 1e-3),
        (js.CentralDifference(), 2.5e-4, 1e-3),
    ):
        found = js.simulate(scene, method, dt=dt, t_end=0.4, save_every=100, newton=js.Newton(tolerance=1e-12))
        gained = np.asarray(found.energy.total - found.energy.external_work)
        tips[type(method).__name__] = float(found.watched["tip"][-1])
        print(type(method).__name__, tips, np.ptp(gained) / np.max(found.energy.total))
        assert np.ptp(gained) < within * np.max(found.energy.total)
    assert abs(tips["EnergyMomentum"]) > 1e-2 and tips["Newmark"] == pytest.approx(tips["EnergyMomentum"], rel=1e-2)


@pytest.mark.evidence
def test_statics_and_arc_length_are_in_equilibrium_and_agree():
    scene = strip(*everything()[1:3])
    static = js.solve_static(scene, [0.5, 1.0])
    assert imbalance(static) < 1e-9
    path = js.solve_arc_length(scene)
    assert imbalance(path) < 1e-9
    tip = np.interp(1.0, np.asarray(path.times), np.asarray(path.watched["tip"]))
    assert tip == pytest.approx(float(static.watched["tip"][-1]), rel=1e-2)


@pytest.mark.slow
def test_gradients_of_a_static_solution():
    """Adjoint against forward mode and differences, in a direction in which all numbers of three follower loads change."""

    def tip(p):
        scene = strip(*everything(dict(zip(PARAMETERS, p, strict=True)))[:3])
        return js.solve_static(scene, [0.03]).watched["tip"][-1]

    p, along = jnp.zeros(len(PARAMETERS)), jnp.asarray(random(len(PARAMETERS)))
    slope = float(jax.grad(tip)(p) @ along)
    assert slope == pytest.approx(float(jax.jvp(tip, (p,), (along,))[1]), rel=1e-10)
    ends = [float(tip(s * along)) for s in (2e-3, 1e-3, -1e-3, -2e-3)]
    assert slope == pytest.approx((8 * (ends[1] - ends[2]) - (ends[0] - ends[3])) / 12e-3, rel=1e-6)


def test_forces_differentiate_by_every_number_of_the_loads():
    """Adjoint against forward mode, and one by one against differences."""
    mesh, weights = plate(), jnp.asarray(random(12, 6))
    x = mesh.nodes + 0.05 * jnp.asarray(random(12, 3))

    def measured(p):
        total = jnp.zeros((12, 6))
        for load in everything(dict(zip(PARAMETERS, p, strict=True))):
            if isinstance(load, Contribution):
                total = total + _forces(load, mesh, x, jnp.asarray(TURN), jnp.array(1.0))
            else:
                total = total + load.nodal(mesh.nodes, mesh.triangles, jnp.ones(12))
        return jnp.sum(weights * total)

    p, along, value = jnp.zeros(len(PARAMETERS)), jnp.asarray(random(len(PARAMETERS))), jax.jit(measured)
    gradient = np.asarray(jax.jit(jax.grad(measured))(p))
    assert gradient @ along == pytest.approx(float(jax.jvp(value, (p,), (along,))[1]), rel=1e-12)
    for i, name in enumerate(PARAMETERS):
        step = jnp.zeros(len(PARAMETERS)).at[i].set(1e-4)
        assert abs(gradient[i]) > 1e-3, name
        assert gradient[i] == pytest.approx(float(value(step) - value(-step)) / 2e-4, rel=1e-6), name


# --- files and refusals -----------------------------------------------------------------------------------


def test_a_scene_file_and_a_result_file_have_them_all(tmp_path):
    text = """
[mesh]
generator = "rectangle"
length = 1.0
width = 0.5
divisions = [3, 2]
[section]
thickness = 0.02
young_modulus = 1e6
poisson_ratio = 0.3
density = 1000.0
[[loads]]
kind = "follower force"
nodes = [10]
components = [0.3, 0.1, -0.2]
direction = [1, 0, 0.2]
[[loads]]
kind = "follower edge force"
edges = [[9, 10]]
components = [0.4, -0.3, 0.5]
[[loads]]
kind = "follower edge force"
plane = { x = 1.0 }
components = [0.4, -0.3, 0.5]
axes = "global"
history = { ramp = 2.0 }
[[loads]]
kind = "hydrostatic pressure"
weight = 9.0
level = { times = [0, 1], values = [0.1, 0.3] }
up = [0, 1, 1]
elements = [1, 5]
[[loads]]
kind = "hydrostatic pressure"
weight = 9.0
level = 0.3
[[loads]]
kind = "traction"
traction = [0.1, 0.2, 0.5]
elements = { box = [[0, 0, 0], [0.4, 0.5, 0]] }
[[loads]]
kind = "dead pressure"
pressure = 0.6
[[loads]]
kind = "edge moment"
plane = { x = 1.0 }
moment = [0.02, -0.05, 0.0]
[[loads]]
kind = "gravity"
acceleration = [0, 0, -9.81]
elements = [7, 8]
"""
    (tmp_path / "scene.toml").write_text(text)
    scene, _ = read_scene_file(tmp_path / "scene.toml")
    mesh, tip = plate(), [[9, 10], [10, 11]]
    expected = (
        js.FollowerForce([10], [0.3, 0.1, -0.2], direction=[1, 0, 0.2]),
        js.FollowerEdgeForce([[9, 10]], [0.4, -0.3, 0.5]),
        js.FollowerEdgeForce(tip, [0.4, -0.3, 0.5], js.History.ramp(2.0), "global"),
        js.HydrostaticPressure(9.0, js.History([0.0, 1.0], [0.1, 0.3]), elements=[1, 5], up=[0, 1, 1]),
        js.HydrostaticPressure(9.0, 0.3),
        js.Traction([0.1, 0.2, 0.5], elements=[0, 1, 2, 3]),
        js.DeadPressure(0.6),
        js.EdgeMoment(tip, [0.02, -0.05, 0.0]),
        js.Gravity([0, 0, -9.81], elements=[7, 8]),
    )
    assert same(scene, js.Scene(mesh, scene.section, (), expected, name="scene"))
    with h5py.File(tmp_path / "scene.h5", "w") as file:
        write_scene(file.create_group("scene"), scene)
        assert same(read_scene_of(file, "scene.h5"), scene)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: strip(js.FollowerForce([1], [1, 0, 0], direction=[0, 0, 2])), "load 0: The direction .* is normal to the"),
        (lambda: js.FollowerForce([1, 2], np.zeros((3, 3))), r"follower force must have shape \(3,\) or \(2, 3\)"),
        (lambda: js.FollowerForce([1], [1, 0, 0], direction=[0, 0, float("nan")]), "direction must be finite"),
        (lambda: strip(js.FollowerEdgeForce([[4, 7]], [1, 0, 0])), r"The edge \[4, 7\] is of 2 elements"),
        (lambda: strip(js.FollowerEdgeForce([[0, 7]], [1, 0, 0], axes="global")), r"\[0, 7\] is no edge of an element"),
        (lambda: js.FollowerEdgeForce([[0, 1]], [1, 0, 0], axes="local"), "axes must be"),
        (lambda: js.HydrostaticPressure([1.0, 2.0], 1.0), r"weight must have shape \(\)"),
        (lambda: js.HydrostaticPressure(1.0, float("inf")), "level must be finite"),
        (lambda: js.HydrostaticPressure(1.0, 1.0, up=[0, 0, 0]), "up must have a length"),
        (lambda: strip(js.HydrostaticPressure(1.0, 1.0, elements=[99])), "elements names element 99"),
        (lambda: strip(js.Traction(np.zeros((3, 3)), elements=[1])), r"traction must have shape \(3,\) or \(1, 3\)"),
        (lambda: strip(js.DeadPressure([1.0, 2.0])), "dead pressure must be one value or 12"),
        (lambda: js.EdgeMoment([[0, 1]], [0, 0]), "edge moment"),
        (lambda: strip(js.Gravity([0, 0, 1], elements=[12])), "elements names element 12"),
        (lambda: js.Scene(_folded(), js.Section(0.1, 1.0, 0.3, 1.0), (), [js.NormalForce([0], 1.0)]), "Node 0 has no normal"),
    ],
)  # fmt: skip
def test_bad_input(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def _folded() -> js.Mesh:
    """Two triangles that turn their backs on each other at node 0."""
    return js.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], [[0, 1, 2], [0, 4, 3]])
