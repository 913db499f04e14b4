"""Named sets of nodes, elements and sides: what they hold, and that a name is as good as the numbers."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import jaxshell as js
from jaxshell.assembly.discretised import Model
from jaxshell.assembly.structure import structure_of
from jaxshell.assembly.tables import analyse
from jaxshell.files.scene_file import read_scene_file
from jaxshell.model.generators import rectangle

PLAIN = rectangle(3.0, 1.0, [3, 1])
MESH = PLAIN.with_sets(
    node_sets={"clamp": [0, 1], "tip": [7], "end": [6, 7]},
    element_sets={"skin": [0, 1, 2], "rib": [3, 4, 5], "corner": [5]},
    side_sets={"edge": [[7, 6]], "seam": [[2, 3], [4, 5]]},
)
SECTION = js.Section(0.02, 1e6, 0.3, 1000.0)


def scene(mesh=MESH, **parts):
    return js.Scene(mesh, SECTION, **parts)


def forces(found: js.Scene):
    """(n, 6) forces at the nodes of the bent shell."""
    model = Model.build(found, analyse(structure_of(found))[0])
    bent = found.mesh.nodes + 0.1 * found.mesh.nodes**2
    return model.external_load(bent, jnp.broadcast_to(jnp.eye(3), (8, 3, 3)), 0.0)


def test_sets_are_sorted_and_found_by_name():
    assert MESH.node_set("clamp").tolist() == [0, 1] and list(MESH.node_sets) == ["clamp", "tip", "end"]
    assert MESH.element_set("rib").tolist() == [3, 4, 5]
    assert MESH.side_set("edge").tolist() == [[6, 7]]
    assert js.Mesh(PLAIN.nodes, PLAIN.triangles, node_sets={"a": [3, 1, 3]}).node_set("a").tolist() == [1, 3]


def test_further_sets_take_the_place_of_those_of_the_same_name():
    more = MESH.with_sets(node_sets={"tip": [6]}, element_sets={"all": range(6)})
    assert more.node_set("tip").tolist() == [6] and more.node_set("clamp").tolist() == [0, 1]
    assert len(more.element_set("all")) == 6 and more.side_sets == MESH.side_sets


@pytest.mark.parametrize(
    "by_name, by_number",
    [
        (js.Support("clamp", "uz"), js.Support([0, 1], "uz")),
        (js.Support("end", "uz", 0.1, js.History.ramp(1.0)), js.Support([6, 7], "uz", 0.1, js.History.ramp(1.0))),
        (js.clamped("clamp"), js.clamped([0, 1])),
        (js.symmetry("end", "x"), js.symmetry([6, 7], "x")),
        (js.NodalForce("tip", [0, 0, 1.0]), js.NodalForce([7], [0, 0, 1.0])),
        (js.NodalMoment("end", [[0, 0, 1.0], [1.0, 0, 0]]), js.NodalMoment([6, 7], [[0, 0, 1.0], [1.0, 0, 0]])),
        (js.NormalForce("end", [1.0, 2.0]), js.NormalForce([6, 7], [1.0, 2.0])),
        (js.EdgeForce("edge", [0, 1.0, 0]), js.EdgeForce([[6, 7]], [0, 1.0, 0])),
        (js.Pressure(2.0, elements="rib"), js.Pressure(2.0, elements=[3, 4, 5])),
        (js.InitialStrain([1e-3, 0, 0], elements="rib"), js.InitialStrain([1e-3, 0, 0], elements=[3, 4, 5])),
    ],
)
def test_a_name_stands_for_the_numbers(by_name, by_number):
    key = "supports" if isinstance(by_name, js.Support) else "loads"
    named, numbered = (getattr(scene(**{key: [item]}), key)[0] for item in (by_name, by_number))
    assert eqx.tree_equal(named, numbered)
    assert eqx.tree_equal(scene(**{key: [by_name]}), scene(**{key: [by_number]}))


@pytest.mark.parametrize(
    "wrong, words",
    [
        (lambda: scene(supports=[js.clamped("clmp")]), r"support 0: There is no set of nodes 'clmp': those .* 'clamp'"),
        (lambda: scene(loads=[js.EdgeForce("clamp", [0, 0, 1.0])]), "load 0: There is no set of sides 'clamp'"),
        (lambda: scene(loads=[js.Pressure(1.0, elements="web")]), "no set of elements 'web'"),
        (lambda: scene(PLAIN, supports=[js.clamped("a")]), "the mesh has none"),
        (
            lambda: scene(loads=[js.NodalForce("end", [[0, 0, 1.0]])]),
            r"load 0: force must have shape \(3,\) or \(2, 3\)",
        ),
        (lambda: scene(loads=[js.Pressure([1.0, 2.0], elements="rib")]), "pressure must be one value or 3"),
        (lambda: scene(loads=[js.Pressure(1.0, elements=[6])]), "elements names element 6"),
        (lambda: js.Pressure(1.0, elements=[1, 1]), "names an element twice"),
        (lambda: scene(watch={"a": ("end", "uz")}), "watch 'a' names the set 'end', which holds 2"),
        (lambda: scene(watch={"a": ("skin", "Mxx")}), "watch 'a' names the set 'skin', which holds 3"),
        (lambda: scene(watch={"a": ("clmp", "uz")}), "watch 'a': There is no set of nodes 'clmp'"),
        (lambda: js.clamped("clamp").dof_numbers, "numbers on a mesh only"),
        (lambda: MESH.with_sets(node_sets={"a": [8]}), "node_sets 'a' names node 8, but the mesh has 0 to 7"),
        (lambda: MESH.with_sets(node_sets={"a": []}), "node_sets 'a' is empty"),
        (lambda: MESH.with_sets(side_sets={"a": [[0, 7]]}), r"names the side \[0, 7\], which is no edge"),
        (lambda: MESH.with_sets(side_sets={"a": [[0, 99]]}), "names node 99"),
        (lambda: MESH.with_sets(side_sets={"a": [0, 1]}), r"pairs of nodes \(k, 2\)"),
    ],
)
def test_what_a_set_cannot_be(wrong, words):
    with pytest.raises(ValueError, match=words):
        wrong()


def test_a_set_of_one_is_watched_by_its_name():
    assert scene(watch={"tip": ("tip", "uz"), "stress": ("corner", "sxx top")}).watch == (
        ("tip", 7, "uz"),
        ("stress", 5, "sxx top"),
    )


def test_pressure_on_a_set_is_pressure_on_its_elements_only():
    whole = jnp.zeros(6).at[3:].set(jnp.array([1.0, 2.0, 3.0]))
    on_set = js.Pressure([1.0, 2.0, 3.0], elements="rib")
    expected = forces(scene(loads=[js.Pressure(whole)]))
    assert np.allclose(forces(scene(loads=[on_set])), expected, rtol=0, atol=1e-15) and np.abs(expected).max() > 0.1


def test_heat_on_a_set_strains_its_elements_only():
    section = js.Laminate([js.Ply(js.Isotropic(1e6, 0.3, 1000.0, expansion=1e-5), 0.02, 0.0)])
    whole = js.Thermal(jnp.zeros(6).at[3:].set(40.0), jnp.zeros(6).at[3:].set(5.0))
    on_set = js.Scene(MESH, section, loads=[js.Thermal(40.0, 5.0, elements="rib")]).loads[0]
    for one, other in zip(on_set.strains(section, MESH), whole.strains(section, MESH), strict=True):
        assert np.array_equal(one, other) and np.abs(other[3:]).max() > 0


@pytest.mark.slow
def test_energy_is_balanced_under_pressure_on_a_set_and_its_file_knows_the_set(tmp_path):
    loads = [js.Pressure(30.0, js.History.ramp(0.02), elements="rib")]
    found = scene(supports=[js.clamped("clamp")], loads=loads)
    run = js.simulate(found, js.EnergyMomentum(), dt=0.005, t_end=0.05, newton=js.Newton(tolerance=1e-12))
    balance = run.energy.total - run.energy.external_work
    assert np.abs(balance).max() <= 1e-12 * np.abs(run.energy.external_work).max()
    run.save(tmp_path / "a.h5")
    again = js.Solution.load(tmp_path / "a.h5").scene
    assert again.mesh.node_sets == MESH.node_sets and again.mesh.side_sets == MESH.side_sets
    assert eqx.tree_equal(again.loads, found.loads)


SCENE_FILE = """
[mesh]
generator = "rectangle"
length = 3.0
width = 1.0
divisions = [3, 1]
[mesh.node_sets]
clamp = { plane = { x = 0.0 } }
tip = [7]
[mesh.element_sets]
rib = { box = [[1.4, 0, 0], [3, 1, 0]] }
[mesh.side_sets]
end = { plane = { x = 3.0 } }
seam = [[2, 3]]
[section]
thickness = 0.02
young_modulus = 1e6
poisson_ratio = 0.3
density = 1000.0
[[supports]]
nodes = "clamp"
hold = "clamped"
[[loads]]
kind = "pressure"
pressure = 2.0
elements = "rib"
[[loads]]
kind = "edge force"
edges = "seam"
force = [0, 0, 1]
[[loads]]
kind = "edge force"
edges = "end"
force = [0, 0, 1]
[[loads]]
kind = "force"
nodes = "tip"
force = [0, 0, 1]
[[initial_strain]]
curvature = [0.01, 0, 0]
elements = "rib"
[watch]
tip = { node = "tip", component = "uz" }
"""


def test_scene_files_know_sets(tmp_path):
    (tmp_path / "a.toml").write_text(SCENE_FILE)
    found, _ = read_scene_file(tmp_path / "a.toml")
    assert found.supports[0].nodes.array.tolist() == [0, 1] and found.watch == (("tip", 7, "uz"),)
    pressure, seam, end, force, strain = found.loads
    assert pressure.elements.array.tolist() == strain.elements.array.tolist() == found.mesh.element_set("rib").tolist()
    assert seam.edges.array.tolist() == [[2, 3]] and end.edges.array.tolist() == [[6, 7]]
    assert force.nodes.array.tolist() == [7]


@pytest.mark.parametrize(
    "old, new, words",
    [
        ('nodes = "clamp"', 'nodes = "wall"', r"\[\[supports\]\] number 1: There is no set of nodes 'wall'"),
        ('edges = "seam"', 'edges = "clamp"', r"\[\[loads\]\] number 2: There is no set of sides 'clamp'"),
        ('edges = "seam"', "edges = [[0, 7]]\nboundary = true", "by edges or by boundary, not by both"),
        ("tip = [7]", "tip = [8]", r"\[mesh\] node_sets nodes must be numbers from 0 to 7"),
        ("tip = [7]", "tip = { sphere = 1 }", r"node_sets tip has the unknown key 'sphere'"),
        ("seam = [[2, 3]]", "seam = [[0, 7]]", r"side_sets 'seam' names the side \[0, 7\]"),
    ],
)
def test_errors_of_sets_in_scene_files_say_where(old, new, words, tmp_path):
    assert old in SCENE_FILE
    (tmp_path / "a.toml").write_text(SCENE_FILE.replace(old, new))
    with pytest.raises(ValueError, match=words):
        read_scene_file(tmp_path / "a.toml")
