"""Materials, laminates, regions, heat and initial strains in scene files; the example examples/laminate.toml."""

from pathlib import Path

import jax
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)

import jaxshell as js  # noqa: E402
from jaxshell.files.scene_file import read_scene_file  # noqa: E402

EXAMPLE = Path(__file__).parents[1] / "examples" / "laminate.toml"
MESH = '[mesh]\ngenerator = "rectangle"\nlength = 4.0\nwidth = 2.0\ndivisions = [4, 2]\n'
CARBON = """[materials.carbon]
young_modulus_1 = 140e9
young_modulus_2 = 10e9
poisson_ratio_12 = 0.3
shear_modulus_12 = 5e9
density = 1600
expansion_2 = 30e-6
"""
STEEL = "[materials.steel]\nyoung_modulus = 210e9\npoisson_ratio = 0.3\ndensity = 7850\nexpansion = 12e-6\n"
LAYUP = '[section]\nkind = "laminate"\nlayup = "[45/-45/0/90]s"\nmaterial = "carbon"\nply_thickness = 1e-4\n'
BASE = MESH + CARBON + STEEL
PLAIN = "thickness = 0.1\nyoung_modulus = 1.0e6\npoisson_ratio = 0.3\ndensity = 1.0\n"


def read(tmp_path, text: str) -> js.Scene:
    file = tmp_path / "scene.toml"
    file.write_text(text, encoding="utf-8")
    return read_scene_file(file)[0]


def same(one, other) -> bool:
    (a, structure), (b, again) = jax.tree.flatten(one), jax.tree.flatten(other)
    return structure == again and all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


CARBON_PLY = js.Orthotropic(140e9, 10e9, 0.3, 5e9, 1600.0, 0.0, 30e-6)
STEEL_PLY = js.Isotropic(210e9, 0.3, 7850.0, 12e-6)


def test_laminates(tmp_path):
    """As a script writes them: by layup, by plies, about a cylinder."""
    scene = read(tmp_path, BASE + LAYUP + "offset = 1e-4\ndirection = [0, 1, 0]\n")
    assert same(scene.section, js.Laminate.from_layup("[45/-45/0/90]s", CARBON_PLY, 1e-4, [0.0, 1.0, 0.0], 1e-4))
    scene = read(
        tmp_path,
        BASE
        + """[section]
kind = "laminate"
symmetric = true
direction = { axis = [1, 0, 0], origin = [0, 0, 5], along = "circumference" }
plies = [{ material = "carbon", thickness = 1e-4, angle = 45 }, { material = "steel", thickness = 2e-4 }]
""",
    )
    plies = [js.Ply(CARBON_PLY, 1e-4, 45.0), js.Ply(STEEL_PLY, 2e-4)]
    around = js.Cylindrical([1.0, 0.0, 0.0], [0.0, 0.0, 5.0], "circumference")
    assert same(scene.section, js.Laminate(plies, around, symmetric=True))


def test_general_section(tmp_path):
    eye = "[[1, 0, 0], [0, 1, 0], [0, 0, 1]]"
    text = f'[section]\nkind = "general"\nA = {eye}\nD = {eye}\nmass_per_area = 2\ndirection = [0, 1, 0]\n'
    scene = read(
        tmp_path,
        MESH + text + f"B = [[0.1, 0, 0], [0, 0, 0], [0, 0, 0]]\nthermal = {eye}\n[[thermal]]\ntemperature = 1",
    )
    B = np.diag([0.1, 0, 0])
    assert same(
        scene.section, js.GeneralSection(np.eye(3), B, np.eye(3), 2.0, thermal=np.eye(3), direction=[0.0, 1.0, 0.0])
    )


def test_regions_and_initial_strains(tmp_path):
    text = MESH.replace(
        "[4, 2]\n", "[4, 2]\n[mesh.element_sets]\nskin = { box = [[0, 0, 0], [2, 2, 0]] }\nodd = [1, 3]\n"
    )
    text += CARBON + LAYUP.replace("[section]", '[[section]]\nelements = "skin"')
    text += "[[section]]\nelements = { box = [[2, 0, 0], [3, 2, 0]] }\nexpansion = 1e-5\n" + PLAIN
    text += '[[section]]\nelements = "others"\n' + PLAIN
    text += "[[thermal]]\ntemperature = 10\ngradient = 2\nhistory = { ramp = 3 }\n"
    text += (
        "[[initial_strain]]\nstrain = [1e-3, 0, 0]\ndirection = [0, 1, 0]\n[[initial_strain]]\ncurvature = [0, 1, 0]\n"
    )
    scene = read(tmp_path, text)
    assert scene.mesh.element_set("odd").tolist() == [1, 3] and len(scene.mesh.element_set("skin")) == 8
    numbers = [list(e.array) for e in scene.section.elements]
    assert [len(e) for e in numbers] == [8, 4, 4] and np.unique(np.concatenate(numbers)).size == 16
    x = np.asarray(scene.mesh.nodes)[scene.mesh.triangles].mean(axis=1)
    assert np.all(x[numbers[0], 0] < 2) and np.all(x[numbers[2], 0] > 3)
    assert scene.section.names == ("skin", "2", "others")
    thermal, strain, curvature = scene.loads
    assert same(thermal, js.Thermal(10.0, 2.0, js.History.ramp(3.0)))
    assert same(strain, js.InitialStrain([1e-3, 0.0, 0.0], direction=[0.0, 1.0, 0.0]))
    assert same(curvature, js.InitialStrain(curvature=[0.0, 1.0, 0.0]))


@pytest.mark.wrong_types
@pytest.mark.parametrize(
    ("text", "message"),
    [
        (BASE + LAYUP.replace("carbon", "wood"), r"\[section\] There is no material 'wood': those .* 'carbon', 'steel'"),
        (MESH + LAYUP, r"\[section\] There is no material 'carbon': the file has none"),
        (BASE + LAYUP.replace("0/90]", "0/x]"), r"\[section\] The layup .* cannot be read: 'x\]s' is no angle"),
        (BASE + LAYUP + "symmetric = true", r"\[section\] has the unknown key 'symmetric'. Known keys: layup, material"),
        (BASE + LAYUP + "plies = []", "needs either plies, or layup with material and ply_thickness"),
        (BASE + LAYUP + "direction = [0, 0, 1]", "The direction .* is normal to element 0"),
        (BASE + LAYUP + "direction = { axis = [1, 0, 0], about = 1 }", r"\[section\] direction has the unknown key 'about'"),
        (BASE + '[section]\nkind = "laminate"\nplies = 3', r"\[section\] plies must be a list of tables"),
        (BASE + '[section]\nkind = "laminate"\nplies = []', r"\[section\] plies must be a list of jaxshell.Ply, at least one"),
        (
            BASE + '[section]\nkind = "laminate"\nplies = [{ material = "steel", thickness = 1, angel = 3 }]',
            r"\[section\] plies number 1: has the unknown key 'angel'",
        ),
        (
            BASE + '[section]\nkind = "laminate"\nplies = [{ material = "steel", thickness = -1 }]',
            r"\[section\] plies number 1: thickness must be positive",
        ),
        (BASE + '[section]\nkind = "regions"', "kind must be one of 'isotropic', 'laminate', 'general', but it is 'regions'"),
        (MESH + CARBON.replace("140e9", "-1"), r"\[materials.carbon\] young_modulus_1 must be positive"),
        (MESH + CARBON.replace("= 0.3", "= 4"), r"\[materials.carbon\] poisson_ratio_12 must lie within"),
        (MESH + STEEL + "colour = 1", r"\[materials.steel\] has the unknown key 'colour'"),
        (MESH + STEEL + 'kind = "wood"', r"\[materials.steel\] kind must be one of 'isotropic', 'orthotropic'"),
        (MESH + '[[section]]\nelements = "rib"\n' + PLAIN, r"number 1: There is no set of elements 'rib'"),
        (MESH + "[[section]]\nelements = [0, 99]\n" + PLAIN, r"number 1: elements must be numbers from 0 to 15"),
        (MESH + "[[section]]\n" + PLAIN, r"\[\[section\]\] number 1: lacks 'elements'"),
        (MESH + "[[section]]\nelements = { box = [[9, 9, 9], [9, 9, 9]] }\n" + PLAIN, "No element's centroid fulfils box"),
        (MESH + "[[section]]\nelements = { sphere = 1 }\n" + PLAIN, "elements has the unknown key 'sphere'"),
        (MESH + "[[section]]\nelements = [0]\n" + PLAIN, "Element 1 .* belongs to no section"),
        (MESH.replace("[4, 2]\n", "[4, 2]\nelement_sets = { a = [77] }\n"), r"\[mesh\] element_sets a must be numbers from 0"),
        (MESH + "[section]\n" + PLAIN + "[[thermal]]\ntemperature = 1", "load 0: Thermal needs a material with an expansion"),
        (MESH + "[section]\n" + PLAIN + "[[thermal]]\ngradient = 1", r"\[\[thermal\]\] number 1: lacks 'temperature'"),
        (MESH + "[section]\n" + PLAIN + '[[thermal]]\ntemperature = 1\nkind = "a"', "number 1: has the unknown key 'kind'"),
        (MESH + "[section]\n" + PLAIN + '[[loads]]\nkind = "thermal"', "kind must be one of 'force', .* but it is 'thermal'"),
        (MESH + "[section]\n" + PLAIN + "[[initial_strain]]\nstrain = [1, 2]", r"number 1: strain must have shape"),
    ],
)  # fmt: skip
def test_bad_tables(text, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        read(tmp_path, text)


def test_example():
    scene, run = read_scene_file(EXAMPLE)
    assert scene.section.names == ("root", "others") and run.method == ("exact",)
    assert scene.section.sections[0].symmetric and len(scene.loads) == 2


@pytest.mark.slow
def test_example_runs(tmp_path, monkeypatch):
    """It bends upwards as it cools, by what the curvature of its blade is, and the force then takes it down."""
    from jaxshell.command.cli import main

    monkeypatch.chdir(tmp_path)
    main(["run", str(EXAMPLE)])
    found = js.Solution.load(tmp_path / "laminate.h5")
    _, curvature = js.Thermal(-120.0).strains(found.scene.section.sections[1], found.scene.mesh)
    radius = -1 / float(curvature[-2, 0])  # of an element whose e1 is x
    bent = np.asarray(found.watched["tip"])[np.asarray(found.times) < 0.3]
    assert 0.85 < bent.max() / (radius * (1 - np.cos(0.15 / radius))) < 1.1
    assert found.watched["tip"][-1] < 0 and (tmp_path / "laminate_shapes.png").exists()
