"""Bad input: a clear error that names the value, where the object is made or before a run is compiled."""

import os
import subprocess
import sys

import jax
import numpy as np
import pytest

import jaxshell as js
from jaxshell.analyses import program
from jaxshell.analyses.statics import solve_static
from jaxshell.model.generators import rectangle

pytestmark = pytest.mark.wrong_types

NODES = [[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
TRIANGLES = [[0, 1, 2], [0, 2, 3]]
MESH = js.Mesh(NODES, TRIANGLES)
GOOD = {"thickness": 0.1, "young_modulus": 1e4, "poisson_ratio": 0.3, "density": 5.0}
SECTION = js.Section(**GOOD)
SCENE = js.Scene(MESH, SECTION, [js.clamped([0, 3])], [js.NodalForce([1], [0.0, 0.0, 1.0])])
NAN, INF = float("nan"), float("inf")


def moved(node, position):
    return [position if i == node else p for i, p in enumerate(NODES)]


MESHES = {
    "degenerate": (moved(2, [2, 0, 0]), TRIANGLES, r"Triangle 0 \[0, 1, 2\] is degenerate: its area 0 "),
    "repeated corner": (NODES, [[0, 1, 1], [0, 2, 3]], r"Triangle 0 names a node twice: \[0, 1, 1\]"),
    "inverted": (NODES, [[0, 1, 2], [0, 3, 2]], "Triangles 0 and 1 have opposite normals"),
    "repeated": (NODES, [[0, 1, 2], [0, 2, 3], [1, 2, 0]], "Triangles 0 and 2 are the same"),
    "index too large": (NODES, [[0, 1, 2], [0, 2, 4]], "Triangle 1 names node 4, .* has nodes 0 to 3"),
    "negative index": (NODES, [[0, 1, 2], [0, 2, -1]], "Triangle 1 names node -1"),
    "unused node": ([*NODES, [5.0, 5, 5]], TRIANGLES, "Node 4 belongs to no triangle"),
    "not a number": (moved(1, [1, NAN, 0]), TRIANGLES, r"nodes must be finite.* nan at index \(1, 1\)"),
    "no triangle": (NODES, np.zeros((0, 3), int), "The mesh has no triangle"),
    "indices not whole": (NODES, [[0.0, 1.0, 2.0]], "triangles must be integers"),
    "nodes in a plane": ([[0.0, 0], [1, 0], [0, 1]], [[0, 1, 2]], r"nodes must have shape .*\(3, 2\)"),
    "quads": (NODES, [[0, 1, 2, 3]], r"triangles must have shape \(any, 3\).*\(1, 4\)"),
}


@pytest.mark.parametrize(("nodes", "triangles", "message"), MESHES.values(), ids=MESHES)
def test_meshes(nodes, triangles, message):
    with pytest.raises(ValueError, match=message):
        js.Mesh(nodes, triangles)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"thickness": 0.0}, "thickness must be positive, but it is 0.0"),
        ({"thickness": [0.1, -0.2]}, r"thickness must be positive, but it is -0.2 at index \(1,\)"),
        ({"thickness": NAN}, "thickness must be finite, but it is nan"),
        ({"young_modulus": -1.0}, "young_modulus must be positive, but it is -1.0"),
        ({"young_modulus": INF}, "young_modulus must be finite, but it is inf"),
        ({"density": 0.0}, "density must be positive, but it is 0.0"),
        ({"poisson_ratio": 0.51}, r"poisson_ratio must lie in \(-1, 0.5\], but it is 0.51"),
        ({"poisson_ratio": -1.0}, r"poisson_ratio must lie in \(-1, 0.5\], but it is -1.0"),
        ({"poisson_ratio": NAN}, "poisson_ratio must be finite, but it is nan"),
        ({"thickness": "0.1"}, "thickness must be a number or an array of numbers, but it is '0.1'"),
        ({"thickness": True}, "thickness must be a number .*but it is True"),
        ({"thickness": [0.1, True]}, r"thickness must be a number .*but it is \[0.1, True\]"),
        ({"thickness": [[0.1], [0.1, 0.2]]}, "thickness must be .*all rows of one length"),
        ({"thickness": []}, r"thickness must be one value or a list of them, but it has shape \(0,\)"),
        ({"thickness": [[0.1]]}, r"thickness must be one value or a list of them, but it has shape \(1, 1\)"),
        ({"thickness": 10**400}, "thickness must be finite, but it holds an integer too large"),
        ({"density": 1e200}, "density must be at most 1e.100 in size, but it is 1e.200"),
        ({"density": 5e-324}, "density must be at least 1e-100, but it is 5e-324"),
        ({"density": np.float32(INF)}, "density must be finite, but it is inf"),
        ({"thickness": 1e-60}, "The bending stiffness .* is 9.16e-178, which double precision does not bear"),
    ],
)
def test_sections(values, message):
    with pytest.raises(ValueError, match=message):
        js.Section(**(GOOD | values))


FORCE, UP = js.NodalForce, [0.0, 0.0, 1.0]
RAMP = js.History.ramp(1.0)
PARTS = {
    "support of an unknown freedom": (lambda: js.Support([0], "uw"), "holds 'uw', which does not exist"),
    "support of nothing": (lambda: js.Support([0], ()), "must hold at least one of"),
    "support of no node": (lambda: js.clamped([]), "support nodes is empty"),
    "nodes by coordinates": (lambda: js.clamped([0.5]), r"nodes must be a list of node indices.*\[0.5\]"),
    "symmetry about an unknown axis": (lambda: js.symmetry([0], "xy"), "normal must be .*'xy'"),
    "rotation prescribed": (
        lambda: js.Support([0], ("uz", "rx"), 1.0, js.History.ramp(1.0)),
        "Only displacements can be prescribed, but the support names rx",
    ),
    "support that jumps": (
        lambda: js.Support([0], "uz", 1.0, js.History.constant()),
        "must be zero at time 0, but it is 1",
    ),
    "prescribed without a history": (lambda: js.Support([0], "uz", 1.0), "needs a history"),
    "force of a wrong shape": (lambda: FORCE([0, 1], [[0.0, 0, 1]] * 3), r"force must have shape .*\(3, 3\)"),
    "force not a number": (lambda: FORCE([0], [0.0, NAN, 0.0]), r"must be finite.* nan at index \(1,\)"),
    "moment infinite": (lambda: js.NodalMoment([0], [INF, 0.0, 0.0]), "moment must be finite, but it is inf"),
    "edge of three nodes": (lambda: js.EdgeForce([[0, 1, 2]], UP), r"edges must have shape \(any, 2\)"),
    "gravity as a number": (lambda: js.Gravity(-9.81), r"acceleration must have shape \(3,\)"),
    "pressure not a number": (lambda: js.Pressure(NAN), "pressure must be finite, but it is nan"),
    "history going back": (lambda: js.History([0.0, 2.0, 1.0], [0, 1, 2]), r"increase.*\[0.0, 2.0, 1.0\]"),
    "history of two lengths": (lambda: js.History([0.0, 1.0], [1.0]), r"values must have shape \(2,\)"),
    "initial velocity not a number": (lambda: js.Initial([[NAN, 0, 0]]), "initial velocities must be finite"),
    "initial rotation that is none": (
        lambda: js.Initial(rotations=np.stack([np.eye(3), 2 * np.eye(3)])),
        "initial rotations: the matrix of node 1 is no rotation",
    ),
    "pressure on nothing": (lambda: js.Pressure([]), r"pressure must be one value or a list of them.*\(0,\)"),
    "pressure as text": (lambda: js.Pressure("1"), "pressure must be a number .*but it is '1'"),
    "history of nothing": (lambda: js.History([], []), "A history needs at least one sample"),
    "history not a number": (lambda: js.History([0.0, 1.0], [0.0, NAN]), "history values must be finite"),
    "ramp that ends nowhere": (lambda: js.History.ramp(INF), "The end of a ramp must be finite, but it is inf"),
    "ramp over no time": (lambda: js.History.ramp(0.0), "The end of a ramp must be positive"),
    "history that is none": (lambda: js.Support([0], "uz", 1.0, ""), "history must be a jaxshell.History or None.*''"),
    "history of a load that is none": (lambda: FORCE([0], UP, 1.0), "history must be a jaxshell.History or None"),
    "history without a displacement": (lambda: js.Support([0], "uz", None, RAMP), "needs the displacement"),
    "displacement of a wrong shape": (
        lambda: js.Support([0, 1], ("ux", "uz"), [1.0, 2.0, 3.0], RAMP),
        r"one value or one for each of ux, uz, but it has shape \(3,\)",
    ),
    "support by a number": (lambda: js.Support([0], 3), "dofs must be names out of .*but are 3"),
    "support twice": (lambda: js.Support([0], ("uz", "uz")), "names a degree of freedom twice"),
    "nodes that are true": (lambda: js.clamped([True]), r"list of node indices \(integers\), but it is \[True\]"),
    "nodes beyond counting": (lambda: js.clamped([10**30]), "list of node indices"),
    "velocity of a wrong shape": (lambda: js.Initial.rigid(MESH, 5.0), r"velocity must have shape \(3,\)"),
    "point not a number": (lambda: MESH.nearest_node([NAN, 0, 0]), "point must be finite, but it is nan"),
    "condition that is none": (lambda: MESH.nodes_where([0]), "nodes_where needs a function"),
    "condition of other nodes": (lambda: MESH.nodes_where(lambda x: x[0, :2] == 0), "true or false for 4 nodes"),
    "no node where asked": (lambda: MESH.nodes_where(lambda x: x[0] > 9), "no node fulfils the condition"),
}  # fmt: skip


@pytest.mark.parametrize(("make", "message"), PARTS.values(), ids=PARTS)
def test_supports_loads_and_initial_states(make, message):
    with pytest.raises(ValueError, match=message):
        make()


SCENES = {
    "no mesh": ({"mesh": 1}, r"mesh must be a jaxshell\.Mesh, but it is 1"),
    "no section": ({"section": 0.1}, r"section must be a section such as jaxshell\.Section, but it is 0.1"),
    "support that is none": ({"supports": [1.0]}, r"supports\[0\] must be one of jaxshell\.Support, but it is 1.0"),
    "load that is none": ({"loads": [RAMP]}, r"loads\[0\] must be one of loads such as jaxshell\.NodalForce"),
    "initial state that is none": ({"initial": [1.0]}, r"initial must be a jaxshell\.Initial or None"),
    "name that is none": ({"name": 3}, "A scene's name must be a text, but it is 3"),
    "watch that is none": ({"watch": {"tip": 1}}, r"watch must be \{label: \(node, component\)\}"),
    "watch on half a node": ({"watch": {"tip": (1.5, "uz")}}, "watch 'tip' names node 1.5, which is no whole number"),
    "load on a missing node": ({"loads": [FORCE([1, 7], UP)]}, "load 0 names node 7.* has nodes 0 to 3"),
    "edge load on a missing node": ({"loads": [js.EdgeForce([[1, 4]], UP)]}, "load 0 names node 4"),
    "support on a missing node": ({"supports": [js.clamped(0), js.pinned(-1)]}, "support 1 names node -1"),
    "watch on a missing node": ({"watch": {"tip": (4, "uz")}}, "watch 'tip' names node 4"),
    "watch of an unknown component": ({"watch": {"tip": (1, "rz")}}, "watch 'tip' names 'rz'; choose"),
    "pressure for other elements": ({"loads": [js.Pressure([1.0, 2.0, 3.0])]}, r"load 0: pressure .* \(3,\)"),
    "thickness for other elements": (
        {"section": js.Section([0.1] * 3, 1e4, 0.3, 5.0)},
        r"thickness must be one value or one per element \(2\), but it has shape \(3,\)",
    ),
    "velocities for other nodes": (
        {"initial": js.Initial(np.zeros((3, 3)))},
        r"initial velocities must have shape \(4, 3\), but it has shape \(3, 3\)",
    ),
    "freedom prescribed twice": (
        {"supports": [js.clamped([0]), js.Support([0], "uz", 1.0, RAMP)]},
        "Degree of freedom uz of node 0 is prescribed by two supports",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("values", "message"), SCENES.values(), ids=SCENES)
def test_scenes(values, message):
    with pytest.raises(ValueError, match=message):
        js.Scene(**({"mesh": MESH, "section": SECTION} | values))


@pytest.fixture
def nothing_compiles(monkeypatch):
    def compiled(*_):
        raise AssertionError("the run was compiled")

    monkeypatch.setattr(program, "prepare", compiled)


EMC = js.GeneralizedEnergyMomentum()
RUNS = {
    "no step": ({"dt": 0.0}, "dt must be positive, but it is 0.0"),
    "negative step": ({"dt": -0.1}, "dt must be positive, but it is -0.1"),
    "step not a number": ({"dt": NAN}, "dt must be finite, but it is nan"),
    "negative step in an array": ({"dt": [0.1, -0.2], "t_end": None}, r"dt .*-0.2 at index \(1,\)"),
    "no duration": ({"t_end": 0.0}, "t_end must be positive, but it is 0.0"),
    "duration missing": ({"t_end": None}, "t_end, the duration of the run, is missing"),
    "duration and steps": ({"dt": np.array([0.1, 0.2])}, "leave t_end out"),
    "no frames": ({"save_every": 0}, "save_every must be a whole number of at least 1, but it is 0"),
    "half a frame": ({"save_every": 1.5}, "save_every must be a whole number of at least 1, but it is 1.5"),
    "unknown tangent": ({"tangent": "secant"}, "tangent must be .* but it is 'secant'"),
    "step as text": ({"dt": "0.1"}, "dt must be a number .*but it is '0.1'"),
    "steps beyond counting": ({"dt": 1e-12}, r"t_end = 1 with dt = 1e-12 asks for 1e\+12 steps, and at most 1e\+08"),
    "duration beyond counting": ({"t_end": 1e308}, "t_end must be at most 1e.100 in size"),
    "duration of nothing": ({"t_end": 5e-324}, "t_end must be at least 1e-100"),
    "duration far below a step": ({"t_end": 1e-20}, "t_end = 1e-20 is nothing beside dt = 0.1"),
    "no steps": ({"dt": [], "t_end": None}, r"dt must be one step size or a list of them, but it has shape \(0,\)"),
    "outputs beyond counting": (
        {"dt": js.StepControl(1e-3, 0.1, output_interval=1e-12)},
        "t_end = 1 with output_interval = 1e-12 asks for",
    ),
    "not a Newton": ({"newton": 1e-6}, "newton must be a jaxshell.Newton, but it is 1e-06"),
}  # fmt: skip


@pytest.mark.parametrize(("values", "message"), RUNS.values(), ids=RUNS)
def test_runs(values, message, nothing_compiles):
    with pytest.raises(ValueError, match=message):
        js.simulate(SCENE, EMC, **({"dt": 0.1, "t_end": 1.0} | values))


METHODS = {
    "list for a number": (lambda: js.GeneralizedAlpha([NAN]), r"spectral_radius must be one number, but it is \[nan\]"),
    "tolerance in a list": (lambda: js.Newton(tolerance=[NAN]), "Newton tolerance must be one number"),
    "reuse as text": (lambda: js.Newton(reuse="a"), "Newton reuse must be True or False, but it is 'a'"),
    "half an iteration": (lambda: js.Newton(max_iterations=2.5), "max_iterations must be a whole number"),
    "criterion of none": (lambda: js.Newton(criterion=["norm"]), "Newton criterion must be one of predicted, norm"),
    "first step in a list": (lambda: js.StepControl(1e-3, [[NAN]]), "StepControl initial must be one number"),
    "largest not a number": (lambda: js.StepControl(1e-3, 0.1, largest=NAN), "StepControl largest must be finite"),
    "beta that is true": (lambda: js.Newmark(beta=True), "beta must be one number, but it is True"),
    "dissipation that is false": (lambda: js.EnergyMomentum(False), "dissipation must be one number, but it is False"),
    "inertia in a list": (lambda: js.GeneralizedEnergyMomentum(inertia=["none"]), "inertia must be one of seven_point"),
    "safety as text": (lambda: js.CentralDifference("0.9"), "safety must be one number, but it is '0.9'"),
}  # fmt: skip


@pytest.mark.parametrize(("make", "message"), METHODS.values(), ids=METHODS)
def test_methods_and_settings(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_what_is_traced_passes():
    """Numbers that JAX traces cannot be looked at; lists of them are arrays."""

    def thickness(h, force):
        section = js.Section(h, 1e4, 0.3, 5.0)
        load = js.NodalForce([1], [0.0, force, 0.0], js.History([0.0, 1.0], [0.0, force]))
        scene = js.Scene(MESH, section, [js.clamped([0, 3])], [load])
        method = js.GeneralizedAlpha(force)
        control = js.StepControl(1e-3, force)
        return scene.section.thickness + scene.loads[0].force[1] + method.spectral_radius + control.smallest

    assert float(jax.grad(thickness, argnums=1)(0.1, 0.5)) == pytest.approx(2 + 1e-6)


def test_things_that_are_no_scene_and_no_method(nothing_compiles):
    with pytest.raises(ValueError, match=r"scene must be a jaxshell\.Scene"):
        js.simulate(MESH, EMC, dt=0.1, t_end=1.0)
    with pytest.raises(ValueError, match=r"method must be a jaxshell\.Method"):
        js.simulate(SCENE, "EMC", dt=0.1, t_end=1.0)


@pytest.mark.parametrize(
    ("supports", "message"),
    [
        ((), "rigid body: rotation about the axis"),
        ((js.pinned([0, 3]),), r"rotation about the axis \(0, 1, 0\)"),
        ((js.Support([0, 3], ("ux", "uz", "ry", "rz")),), r"translation along \(0, 1, 0\)"),
    ],
    ids=["free", "hinged", "sliding"],
)
def test_a_mechanism_has_no_static_answer(supports, message, nothing_compiles):
    """In dynamics every motion without strain has inertia, so that only statics can meet a mechanism."""
    scene = js.Scene(rectangle(1.0, 1.0, [2, 2]), SECTION, supports, [FORCE([4], UP)])
    if supports:
        edge = scene.mesh.nodes_where(lambda x: x[0] == 0)
        scene = js.Scene(scene.mesh, SECTION, [js.Support(edge, supports[0].dofs)], scene.loads)
    with pytest.raises(ValueError, match=message):
        solve_static(scene)


def test_single_precision_is_refused_and_importing_changes_nothing():
    code = """
import jax
import jaxshell
from jaxshell import *
assert not jax.config.jax_enable_x64
try:
    jaxshell.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
except RuntimeError as error:
    print(error)
"""
    environment = {k: v for k, v in os.environ.items() if k != "JAX_ENABLE_X64"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert "jaxshell needs float64" in done.stdout
    assert 'jax.config.update("jax_enable_x64", True)' in done.stdout
