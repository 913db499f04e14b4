"""Springs in statics, frequencies, buckling and stability; what holds a shell; gradients, methods, files and pictures."""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_energies import closed
from test_springs import DT, MESH, SECTION, fly, flying

import jaxshell as js
from jaxshell.files.scene_file import read_scene_file
from jaxshell.model import generators
from jaxshell.model.mechanisms import check_supported
from jaxshell.model.scene import Defaults
from jaxshell.plotting import scene_figure
from jaxshell.plotting.histories import watched_axis
from jaxshell.results.export.units import watched_quantity

SQUARE = js.Mesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
THICK = js.Section(thickness=0.05, young_modulus=70e9, poisson_ratio=0.3, density=2700.0)
MASS = 0.05 * 2700.0


def held_by(*connectors, mesh=SQUARE, **more) -> js.Scene:
    return js.Scene(mesh, THICK, connectors=list(connectors), **more)


def free_motions(*connectors, mesh=SQUARE, **more) -> str:
    with pytest.raises(ValueError, match="free to move as a rigid body") as error:
        check_supported(held_by(*connectors, mesh=mesh, **more))
    return str(error.value).split(": ", 1)[1]


def test_springs_hold_a_shell_and_what_they_leave_free_is_named():
    check_supported(held_by(js.ElasticSupport([0, 1, 2], 1.0)))
    three = js.TorsionSpring(0, None, (1.0, 0.0, 0.0), 1.0), js.TorsionSpring(0, None, (0.0, 1.0, 0.0), 1.0)
    check_supported(held_by(js.ElasticSupport(0, 1.0), *three, js.TorsionSpring(3, "space", (0.0, 0.0, 2.0), 1.0)))
    left = free_motions(js.ElasticSupport([0, 1, 2], (0.0, 0.0, 1.0)))
    assert "translation along (1, 0, 0)" in left and "about the axis (0, 0, 1)" in left and left.count(";") == 3
    pinned = [js.pinned([0])]
    assert free_motions(*three, supports=pinned).startswith("rotation about the axis (0, 0, 1) through (0, 0, 0)")
    grounded = js.Spring([1, 2, 3], [(1.0, 0.0, 9.0), (9.0, 1.0, 0.0), (0.0, 1.0, 9.0)], 1.0)
    check_supported(held_by(grounded, supports=pinned))
    assert free_motions(dataclasses.replace(grounded, tension_only=True), supports=pinned)  # slack cables
    check_supported(held_by(dataclasses.replace(grounded, tension_only=True, length=jnp.array(7.9)), supports=pinned))
    assert free_motions(dataclasses.replace(grounded, stiffness=jnp.array([1.0, 0.0, 1.0])), supports=pinned)


def test_parts_that_springs_join_are_held_by_each_other():
    nodes = np.concatenate([SQUARE.nodes, SQUARE.nodes + np.array([0.0, 0.0, 1.0])])
    both = js.Mesh(nodes, np.concatenate([SQUARE.triangles, SQUARE.triangles + 4]))
    clamped, join = [js.clamped([0, 1, 2])], js.Spring([0, 1, 3], [4, 5, 7], 1.0)
    left = free_motions(join, mesh=both, supports=clamped)
    assert "part of the shell with node 4" in left or "translation along" in left
    across = js.Spring([0, 0, 1], [5, 7, 6], 1.0)
    check_supported(held_by(join, across, mesh=both, supports=clamped))
    assert free_motions(join, across, mesh=both).count("translation") >= 3


def test_joints_hold_parts_too():
    nodes = np.concatenate([SQUARE.nodes, SQUARE.nodes + np.array([1.0, 0.0, 0.0])])
    panels = js.Mesh(nodes, np.concatenate([SQUARE.triangles, SQUARE.triangles + 4]), coincident="allow")
    hinge, clamped = js.Hinge([1], [4], (0, 1, 0)), [js.clamped([0, 3])]
    left = free_motions(hinge, mesh=panels, supports=clamped)
    assert left.startswith("rotation about the axis (0, 1, 0) through (1, 0.5, 0). Hold")
    check_supported(held_by(hinge, js.TorsionSpring(1, 4, (0, 1, 0), 1.0), mesh=panels, supports=clamped))


def test_bad_input_is_named():
    for make, words in (
        (lambda: js.Spring(0, 0, 1.0), "node 0 with itself"),
        (lambda: js.Spring([0, 1], [2], 1.0), "a names 2 nodes and b 1"),
        (lambda: js.Spring(0, (0.0, 0.0, 0.0), 1.0), "no direction"),
        (lambda: js.Spring(0, 9, 1.0), "names node 9"),
        (lambda: js.Spring(0, 1, -1.0), "zero or positive"),
        (lambda: js.Spring(0, (0.0, 0.0), 1.0), "floats"),
        (lambda: js.Spring(0, 1, 1.0, motion=(0, 0, 1), history=js.History.ramp(1.0)), "moves points of space"),
        (lambda: js.Spring(0, (0.0, 0.0, 1.0), 1.0, motion=(0, 0, 1)), "the history"),
        (lambda: js.Dashpot("rim", 1, 1.0), "no set of nodes 'rim'"),
        (lambda: js.TorsionSpring(0, 1, (0, 0, 0), 1.0), "axis must have a length"),
        (lambda: js.TorsionSpring(0, 1, (0, 0, 1), 1.0, angle=3.5), "within 3.1"),
        (lambda: js.ElasticSupport([0, 1], (1.0, 2.0)), "shape"),
    ):
        with pytest.raises(ValueError, match=words):
            held_by(make())
    check_supported(held_by(js.Spring(0, (0.0, 0.0, 0.0), 1.0, length=0.0), supports=[js.clamped([1])]))


def test_what_is_watched_of_connectors_is_checked_by_name():
    springs = [js.Spring([0, 1], [2, 3], 1.0, name="both"), js.ElasticSupport([0, 1], 1.0, name="ground")]
    for watch, words in (
        ({"f": ("cable", "force")}, "no connector or obstacle 'cable'"),
        ({"f": ("both", "force")}, "is 2 of its kind"),
        ({"f": ("ground", "force")}, "has no 'force'; what can be watched of it is fx, fy, fz, energy"),
        ({"f": (0, "force")}, "of a connector or an obstacle, by its name"),
    ):
        with pytest.raises(ValueError, match=words):
            held_by(*springs, watch=watch)
    assert held_by(*springs, watch={"f": ("both", "energy")}).watch == (("f", "both", "energy"),)
    with pytest.raises(ValueError, match="Two connectors or obstacles have the name 'both'"):
        held_by(springs[0], springs[0])


def test_a_plate_on_springs_heaves_with_the_frequency_of_a_mass_on_them():
    stiffness = jnp.array([1.0, 1.0, 4.0])
    scene = held_by(js.ElasticSupport([0, 1, 2, 3], stiffness))
    found = js.natural_frequencies(scene, 6).frequencies
    for k in (1.0, 4.0):  # along x and y, and along z
        exact = np.sqrt(4.0 * k / MASS) / (2.0 * np.pi)
        assert np.min(np.abs(np.asarray(found) / exact - 1.0)) < 1e-5


@pytest.mark.slow
def test_statics_of_springs_is_that_of_closed_form():
    ramp = js.History.ramp(1.0)
    springs = [
        js.ElasticSupport([0, 1, 2, 3], (1e3, 1e3, 1e4), motion=(0.02, 0, 0.01), history=ramp, name="ground"),
        js.Spring(0, (0.0, 0.0, 2.0), 5e2, name="cable", length=2.0, tension_only=True),
        js.Dashpot(0, 2, 1e3, name="dashpot"),
        js.Spring([1, 2, 3], [(1.0, 0.0, 2.0), (1.0, 1.0, 2.0), (0.0, 1.0, 2.0)], 5e2, length=2.0, tension_only=True),
    ]
    watch = {"lift": ("ground", "fz"), "pull": ("cable", "force"), "drag": ("dashpot", "force"), "z": (0, "uz")}
    scene = held_by(*springs, loads=[js.Gravity([0, 0, -9.81])], watch=watch)
    found = js.solve_static(scene, [0.5, 1.0])
    r = np.array([0.0, 0.0, 2.0]) - np.asarray(found.displacements[-1])  # along the cables, which are taut
    length = np.linalg.norm(r, axis=1)
    pulls = 5e2 * (length - 2.0)
    assert np.all(pulls > 0)
    np.testing.assert_allclose(found.watched["pull"][-1], pulls[0], rtol=1e-9)
    lift = -1e4 * np.sum(np.asarray(found.displacements[-1][:, 2]) - 0.01)
    np.testing.assert_allclose(found.watched["lift"][-1], lift, rtol=1e-9)
    np.testing.assert_allclose(lift + np.sum(pulls * r[:, 2] / length), MASS * 9.81, rtol=1e-9)
    np.testing.assert_allclose(found.displacements[-1][:, 0], 0.02, rtol=1e-2)
    assert jnp.all(found.watched["drag"] == 0.0)


STRUT = generators.rectangle(1.0, 0.2, (2, 1))


def strut(load: float = 1.0) -> js.Scene:
    """A stiff strut on a hinge along its edge x = 0, which two torsion springs of 500 hold upright."""
    base, top = STRUT.nodes_where(lambda x: x[0] == 0.0), STRUT.nodes_where(lambda x: x[0] == 1.0)
    springs = js.TorsionSpring(base, None, (0.0, 1.0, 0.0), 500.0)
    force = js.NodalForce(top, [-load / len(top), 0.0, 0.0])
    return js.Scene(STRUT, THICK, [js.pinned(base), js.Support(top, ["uy"])], [force], connectors=[springs])


@pytest.mark.slow
def test_a_rigid_strut_on_torsion_springs_buckles_at_their_stiffness_over_its_length():
    np.testing.assert_allclose(js.linear_buckling(strut(), 1).load_factors[0], 1000.0, rtol=1e-2)
    with pytest.warns(UserWarning, match="unstable from about load factor"):
        found = js.solve_static(strut(), [500.0, 900.0, 1100.0])
    assert found.stable.tolist() == [True, True, True, False]
    np.testing.assert_allclose(found.stats["stability_lost"][0], 1000.0, rtol=2e-2)


@pytest.mark.slow
def test_gradients_by_all_their_numbers_are_exact():
    names = ("spring", "coefficient", "anchor", "torsion", "angle", "ground")
    values = {
        "spring": jnp.array(1e5),
        "coefficient": jnp.array(5.0),
        "anchor": jnp.array([0.3, 0.2, 0.1]),
        "torsion": jnp.array(3.0),
        "angle": jnp.array(0.4),
        "ground": jnp.array(2e4),
    }

    def measured(values):
        run = fly(flying(**values), steps=10, newton=js.Newton(tolerance=1e-12))
        return run.watched["corner"][-1] + 1e-3 * run.watched["tension"][-1] + run.watched["angle"][-1]

    adjoint = jax.grad(measured)(values)
    for name in names:
        way = jax.tree.map(jnp.zeros_like, values) | {name: jnp.ones_like(values[name])}
        _, forward = jax.jvp(measured, (values,), (way,))
        np.testing.assert_allclose(jnp.sum(adjoint[name]), forward, rtol=1e-10)
        step = 1e-5 * float(jnp.max(jnp.abs(values[name])))
        above, below = (measured(values | {name: values[name] + sign * step}) for sign in (1, -1))
        np.testing.assert_allclose(forward, (above - below) / (2 * step), rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    "method",
    [js.GeneralizedEnergyMomentum(), pytest.param(js.Newmark(), marks=pytest.mark.evidence)],
    ids=["emc", "newmark"],
)
def test_other_methods_keep_the_balance_to_second_order(method):
    coarse = fly(flying(), method, steps=20)
    fine = js.simulate(flying(), method, dt=DT / 2, t_end=20 * DT, save_every=40)
    assert closed(fine) < 0.3 * closed(coarse) < 0.1


@pytest.mark.slow
def test_the_critical_step_of_central_differences_counts_springs_and_dashpots():
    explicit = js.CentralDifference()
    free = js.Scene(MESH, SECTION)
    alone = explicit.critical_step(free)
    stiff = js.Scene(MESH, SECTION, connectors=[js.Spring(0, 5, 1e12)])
    slow = explicit.critical_step(stiff)
    mass = SECTION.density * SECTION.thickness * 0.1 * 0.1 / 6.0  # of node 0, in one triangle or two
    assert slow < 0.9 * np.sqrt(2.0 * 2.0 * mass / 1e12) < alone
    assert explicit.critical_step(js.Scene(MESH, SECTION, connectors=[js.Dashpot(0, 5, 1e9)])) < 0.1 * alone
    start = js.Initial.rigid(MESH, angular_velocity=(40.0, 10.0, 0.0))
    run = js.simulate(dataclasses.replace(stiff, initial=start), explicit, dt=slow, t_end=100 * slow, save_every=100)
    assert closed(run) < 1e-2


FILE = """
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
[[connectors]]
kind = "spring"
name = "cable"
a = { nearest = [0.0, 0.0, 0.0] }
b = { point = [0, 0, 1] }
stiffness = 1e4
tension_only = true
motion = [0, 0, 0.1]
history = { ramp = 1.0 }
[[connectors]]
kind = "spring"
a = [5, 2]
b = [0, 3]
stiffness = [1e4, 2e4]
[[connectors]]
kind = "elastic support"
nodes = "corners"
stiffness = [1e3, 1e3, 1e4]
[[connectors]]
kind = "torsion spring"
a = 1
b = "space"
axis = [0, 1, 0]
stiffness = 3.0
[[connectors]]
kind = "dashpot"
a = 1
b = 4
coefficient = 2.0
[watch]
tension = { connector = "cable", component = "force" }
"""


def read(path: Path, text: str = FILE):
    path = path / "scene.toml"
    path.write_text(text.replace("[section]", "node_sets = { corners = [0, 2, 3, 5] }\n[section]", 1))
    return read_scene_file(path)[0]


def test_scene_files_state_them_and_what_is_watched(tmp_path):
    scene = read(tmp_path)
    cable, pair, ground, torsion, dashpot = scene.connectors
    assert cable.nodes.array.tolist() == [[0]] and cable.tension_only and cable.name == "cable"
    np.testing.assert_array_equal(cable.points, [[0.0, 0.0, 1.0]])
    assert pair.nodes.array.tolist() == [[5, 0], [2, 3]]  # in the order of the lists
    assert ground.nodes.array.tolist() == [0, 2, 3, 5] and torsion.nodes.array.tolist() == [[1]]
    assert dashpot.nodes.array.tolist() == [[1, 4]]
    assert scene.watch == (("tension", "cable", "force"),)
    for old, new, words in (
        ("stiffness = 1e4", "stifness = 1e4", r"\[\[connectors\]\] number 1: .*stifness"),
        ("point = [0, 0, 1]", "point = [0, 0]", "number 1: b point must be"),
        ('kind = "dashpot"', 'kind = "damper"', "number 5: kind must be one of"),
        ('nodes = "corners"', 'nodes = "corner"', "no set of nodes 'corner'"),
        ('"cable", component', '"rope", component', "no connector or obstacle 'rope'"),
    ):
        with pytest.raises(ValueError, match=words):
            read(tmp_path, FILE.replace(old, new, 1))


def test_a_picture_of_the_scene_draws_them(tmp_path):
    figure = scene_figure(read(tmp_path), renderer_name="matplotlib")
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert {"spring cable: 1", "spring: 2", "elastic support: 4", "dashpot: 1"} <= set(texts)
    assert figure.axes[0].get_ylim()[1] - figure.axes[0].get_ylim()[0] > 0.9  # the point of space is in it


def test_curves_have_the_units_of_what_they_show():
    scene = dataclasses.replace(flying(), defaults=Defaults(units="SI"))
    for label, _, component in scene.watch:
        text = watched_axis(scene, label, component, 1.0)[1]
        assert text.endswith(
            {"tension": "force in N", "rope": "elongation in m", "angle": "angle in rad"}.get(label, "")
        )
    assert watched_axis(scene, "moment", "moment", 1.0)[1] == "moment, moment in N m"
    assert watched_quantity("fz") == "force" and watched_quantity("uz") == "length"
