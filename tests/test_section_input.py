"""Layups as text, bad input of sections, materials, regions and initial strains; regions and result files."""

import h5py
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from layups import CARBON, GLASS, SQUARE, STEEL, UNSYMMETRIC

import jaxshell as js
from jaxshell.model.generators import rectangle
from jaxshell.model.sections import Regions
from jaxshell.model.sections.layup import read_layup
from jaxshell.results.tree import read_scene_of, write_scene

# --- layups as text ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "angles", "symmetric"),
    [
        ("[45/-45/0/90]s", [45, -45, 0, 90], True),
        ("[0/90]2s", [0, 90, 0, 90], True),
        ("[0,90]", [0, 90], False),
        ("[±45/0_2]", [45, -45, 0, 0], False),
        ("[+-45/02]T", [45, -45, 0, 0], False),
        ("[∓22.5]", [-22.5, 22.5], False),
        ("[0/90*]s", [0, 90, 0], False),
        ("[0/[45/-45]2]s", [0, 45, -45, 45, -45], True),
        ("[±22.5/0₂/-22.5/0₂/22.5/0₂]s", [22.5, -22.5, 0, 0, -22.5, 0, 0, 22.5, 0, 0], True),
        ("(30°/−30°)_2", [30, -30, 30, -30], False),
    ],
)
def test_layups(text, angles, symmetric):
    assert read_layup(text) == (angles, symmetric)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[]", "'\\]' stands where an angle belongs"),
        ("45/-45", "'\\[' is missing before '45'"),
        ("[45/-45", "'\\]' is missing at the end"),
        ("[45//0]", "'/' stands where an angle belongs"),
        ("[45/]", "'\\]' stands where an angle belongs"),
        ("[45/x]", "'x\\]' is no angle"),
        ("[45]s s", "'s' follows after its end"),
        ("[0/90*]", "needs a symmetric layup"),
        ("[0*/90]s", "only the last ply can lie in the middle"),
        ("[400]", "above 360 degrees"),
        ("[0/90]2000s", "is no count of plies"),
        ("[0_900/90_900]", "more than 1000 plies"),
        ("[" * 5000 + "0", "nested"),
        ("[0/" * 10 + "0" + "]9" * 10, "more than 1000 plies"),
    ],
)
def test_layups_that_are_none(text, reason):
    with pytest.raises(ValueError, match=f"(?s)cannot be read.*{reason}"):
        js.Laminate.from_layup(text, CARBON, 1e-3)


# --- bad input --------------------------------------------------------------------------------------------

PLY = js.Ply(CARBON, 1e-3)
SETS = js.Mesh(SQUARE.nodes, SQUARE.triangles, element_sets={"left": [0], "right": [1], "all": [0, 1]})
S = js.Section(0.1, 1.0, 0.3, 1.0)
EYE = np.eye(3)


@pytest.mark.wrong_types
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: js.Isotropic(-1.0, 0.3, 1.0), "young_modulus must be positive, but it is -1"),
        (lambda: js.Isotropic(1.0, 0.6, 1.0), r"poisson_ratio must lie in \(-1, 0.5\], but it is 0.6"),
        (lambda: js.Orthotropic(1.0, 0.0, 0.3, 1.0, 1.0), "young_modulus_2 must be positive, but it is 0"),
        (lambda: js.Orthotropic(1.0, 1.0, 0.3, -2.0, 1.0), "shear_modulus_12 must be positive, but it is -2"),
        (lambda: js.Orthotropic(1.0, 4.0, 0.6, 1.0, 1.0), r"poisson_ratio_12 must lie within .* = ±0.5, .* but it is 0.6"),
        (lambda: js.Orthotropic([1.0, 2.0], 1.0, 0.3, 1.0, 1.0), "young_modulus_1 must have shape"),
        (lambda: js.Ply("carbon", 1e-3), "material must be a material such as jaxshell.Orthotropic, but it is 'carbon'"),
        (lambda: js.Ply(CARBON, -1e-3), "thickness must be positive"),
        (lambda: js.Ply(CARBON, 1e-3, np.nan), "angle must be finite"),
        (lambda: js.Laminate([]), "plies must be a list of jaxshell.Ply, at least one"),
        (lambda: js.Laminate([PLY, STEEL]), r"plies\[1\] must be a jaxshell.Ply"),
        (lambda: js.Laminate([PLY], direction=[1.0, 0.0]), r"direction must have shape \(3,\) or \(m, 3\)"),
        (lambda: js.Laminate([PLY], offset=[1.0, 2.0]), "offset must have shape"),
        (lambda: js.Scene(SQUARE, js.Laminate([PLY], direction=[0, 0, 1.0])), "is normal to element 0 .and to 1 others"),
        (lambda: js.Scene(SQUARE, js.Laminate([PLY], direction=np.ones((3, 3)))), r"one per element \(2\)"),
        (lambda: js.Scene(SQUARE, js.Laminate([js.Ply(CARBON, [1.0, 2.0, 3.0])])), r"ply 0: thickness must be one value"),
        (lambda: js.Cylindrical([0, 0, 0]), "axis must have a length"),
        (lambda: js.Cylindrical([0, 0, 1], along="radius"), "along must be"),
        (lambda: js.GeneralSection(EYE, 2 * EYE, EYE, 1.0), "must be positive definite"),
        (lambda: js.GeneralSection(np.triu(np.ones((3, 3))) + EYE, None, EYE, 1.0), "A must be symmetric"),
        (lambda: js.GeneralSection(np.eye(2), None, EYE, 1.0), r"A must have shape \(3, 3\)"),
        (lambda: js.Scene(SQUARE, js.GeneralSection(EYE, None, np.stack([EYE] * 3), 1.0)), r"D must be one value or one per"),
        (lambda: js.Scene(SETS, {"left": S}), r"Element 1 \(and 0 others\) belongs to no section"),
        (lambda: js.Scene(SETS, {"left": S, "all": S}), "Element 0 .* belongs to section 'left' and to section 'all'"),
        (lambda: js.Scene(SETS, {"left": S, "top": S}), "There is no set of elements 'top': .* 'left', 'right', 'all'"),
        (lambda: js.Scene(SQUARE, {"left": S}), "There is no set of elements 'left': the mesh has none"),
        (lambda: js.Scene(SQUARE, [([0, 7], S)]), "section '0' names element 7, but the mesh has elements 0 to 1"),
        (lambda: js.Scene(SQUARE, [([0, 0], S), ([1], S)]), "names an element twice"),
        (lambda: js.Scene(SQUARE, [S]), r"section must list pairs \(elements, section\)"),
        (lambda: js.Scene(SETS, {"left": S, "right": 3.0}), "section 'right' must be a section such as"),
        (lambda: js.Scene(SETS, {"left": S, "right": js.Section([1.0, 2.0], 1.0, 0.3, 1.0)}), "section 'right': thickness"),
        (lambda: js.Mesh(SQUARE.nodes, SQUARE.triangles, element_sets={"a": [2]}), "element_sets 'a' names element 2"),
        (lambda: js.Scene(SQUARE, S, loads=[js.Thermal(1.0)]), "load 0: Thermal needs a material with an expansion"),
        (lambda: js.Scene(SQUARE, js.GeneralSection(EYE, None, EYE, 1.0), loads=[js.Thermal(1.0)]), "has thermal= for it"),
        (lambda: js.Scene(SQUARE, S, loads=[js.InitialStrain(np.ones((3, 3)))]), r"load 0: strain must be one \(3,\) or 2"),
        (lambda: js.InitialStrain([1.0, 2.0]), r"strain must have shape \(3,\) or \(m, 3\)"),
        (lambda: js.Scene(SQUARE, S, loads=[js.InitialStrain(direction=[0, 0, 1])]), "load 0: The direction .* is normal"),
        (lambda: js.Thermal(np.inf), "temperature must be finite"),
    ],
)  # fmt: skip
def test_bad_input(make, message):
    with pytest.raises(ValueError, match=message):
        make()


# --- regions and files ------------------------------------------------------------------------------------


def test_regions_put_each_section_where_it_belongs():
    mesh = js.Mesh(*(lambda m: (m.nodes, m.triangles))(rectangle(3.0, 1.0, [3, 1])), element_sets={"rib": [4, 1]})
    thin = js.Section([1.0, 2.0, 3.0, 4.0], 1e6, 0.3, 1.0)
    scene = js.Scene(mesh, [("rib", js.Laminate(UNSYMMETRIC.plies)), ([5, 0, 2, 3], thin)])
    assert isinstance(scene.section, Regions)
    found, coupled = scene.section.resultants(mesh), UNSYMMETRIC.resultants(mesh)
    np.testing.assert_array_equal(found.mass_per_area[jnp.array([5, 0, 2, 3])], [1.0, 2.0, 3.0, 4.0])
    np.testing.assert_allclose(found.B[jnp.array([1, 4])], coupled.B[jnp.array([1, 4])], rtol=1e-13)
    assert not np.any(np.asarray(found.B)[[0, 2, 3, 5]])
    layers = scene.section.layers(mesh)
    assert layers.z.shape == (6, 4, 2)
    np.testing.assert_allclose(layers.integral(layers.density, 0), found.mass_per_area, rtol=1e-13)


def test_result_files_hold_every_kind(tmp_path):
    """What is read equals what was written, to the last bit."""
    history = js.History.ramp(2.0)
    strains = (
        js.Thermal([1.0, 2.0], 0.5, history),
        js.InitialStrain([[1e-3, 0, 0]] * 2, [0, 1, 0], history, js.Cylindrical([0, 1, 0], [5, 0, 0], "axis")),
    )
    whole = js.GeneralSection(2 * EYE, 0.1 * EYE, EYE, [1.0, 2.0], first_moment=0.1, thermal=EYE, direction=[0, 1, 0])
    mixed = js.Laminate([js.Ply(STEEL, [1e-3]), js.Ply(CARBON, 1e-3, 30.0)], np.array([[1.0, 0, 0]]), 0.01)
    sections = (
        js.Section(0.1, 1.0, 0.3, 1.0, 1e-5),
        whole,
        js.Laminate.from_layup("[0/90]s", GLASS, 1e-3, js.Cylindrical([1, 0, 0])),
        {"left": mixed, "right": js.Section(0.1, 1.0, 0.3, 1.0)},
    )
    for number, section in enumerate(sections):
        scene = js.Scene(SETS, section, loads=strains if number < 2 else strains[1:])
        with h5py.File(tmp_path / f"{number}.h5", "w") as file:
            write_scene(file.create_group("scene"), scene)
            again = read_scene_of(file, "the file")
        (one, structure), (other, same) = (jax.tree.flatten(s) for s in (scene, again))
        assert structure == same
        assert all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))
        assert again.mesh.element_sets == SETS.element_sets
