"""docs/scene_files.md and docs/result_files.md name all that the code has; inner edges and motions of sets."""

import argparse
import dataclasses
import inspect
import itertools
from pathlib import Path

import h5py
import jax
import jax.numpy as jnp
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)

from test_scene_file import BASE, read  # noqa: E402

from jaxshell.command import check, completion, init, plot, run, schema  # noqa: E402
from jaxshell.files import imperfection, scene_file, sections  # noqa: E402
from jaxshell.files.initial import MOTION  # noqa: E402
from jaxshell.files.items import ITEM_KINDS  # noqa: E402
from jaxshell.files.run_keys import ANALYSES, KEYS  # noqa: E402
from jaxshell.files.selectors import NODE_SELECTORS  # noqa: E402
from jaxshell.methods import EnergyMomentum  # noqa: E402
from jaxshell.model.damping import RayleighDamping  # noqa: E402
from jaxshell.model.generators import GENERATORS  # noqa: E402
from jaxshell.model.loads import InitialStrain, Thermal  # noqa: E402
from jaxshell.model.sections import Cylindrical, Laminate, Ply  # noqa: E402

DOCS = Path(__file__).parents[1] / "docs"
PAGE = (DOCS / "scene_files.md").read_text(encoding="utf-8")


def arguments(*functions):
    return {name for function in functions for name in inspect.signature(function).parameters}


def test_the_page_names_every_key():
    """Between backquotes, alone or with what stands there."""
    kinds = [*sections.SECTION_KINDS.values(), *sections.MATERIAL_KINDS.values()]
    keys = {*KEYS, *NODE_SELECTORS, *MOTION, *scene_file.READING, *scene_file.SETS, "edges", "inner", "elements"}
    keys |= arguments(*GENERATORS.values(), *kinds, Ply, Laminate.from_layup, Thermal, InitialStrain, RayleighDamping)
    keys |= {load.value for load in scene_file.LOAD_KINDS.values()} | {"ratios", "modes", "frequencies", "hold"}
    keys |= {"point", *(key for kinds in ITEM_KINDS.values() for key in arguments(*kinds.values()))}
    keys |= {key for load in scene_file.LOAD_KINDS.values() for key in scene_file.load_keys(load)}
    keys |= {imperfection.IMPERFECTION, *itertools.chain(*imperfection.KEYS.values())}
    absent = {key for key in keys if f"`{key}`" not in PAGE and f"`{key} " not in PAGE}
    absent -= {key for key in ("angle", "axis", "origin", "along", "times", "values") if f"{key}," in PAGE}
    assert not absent
    assert arguments(Cylindrical) <= {"axis", "origin", "along"} and "{ axis, origin, along" in PAGE


def test_the_page_names_every_kind():
    kinds = [
        *imperfection.KEYS,
        *GENERATORS,
        *scene_file.LOAD_KINDS,
        *sections.SECTION_KINDS,
        *sections.MATERIAL_KINDS,
        *scene_file.HOLD,
    ]
    kinds += [kind for items in ITEM_KINDS.values() for kind in items]
    assert not [kind for kind in (*kinds, *ANALYSES) if f'"{kind}"' not in PAGE]
    assert not [table for table in scene_file.KNOWN if f"[{table}" not in PAGE and f"`{table}`" not in PAGE]


def test_the_page_names_every_option_of_these_commands():
    parser = argparse.ArgumentParser()
    commands = parser.add_subparsers()
    for command in (init, check, run, plot, schema, completion):
        command.add(commands)
    of_run = {"--" + key.replace("_", "-") for key in KEYS}
    for name, command in commands.choices.items():
        assert f"jaxshell {name}" in PAGE
        options = {option for action in command._actions for option in action.option_strings}
        options -= of_run | {option.replace("--", "--no-", 1) for option in of_run} | {"-h", "--help"}
        assert not [option for option in options if f"`{option}" not in PAGE], name


def test_the_page_of_result_files_names_what_a_file_holds(tmp_path):
    import jaxshell as js

    scene, _ = read(tmp_path, BASE + '[[supports]]\nplane = { x = 0.0 }\nhold = "clamped"\n')
    js.Modes(jnp.ones(1), jnp.zeros((1, scene.mesh.n_nodes, 6))).save(tmp_path / "modes.h5", scene)
    page, names = (DOCS / "result_files.md").read_text(encoding="utf-8"), []
    with h5py.File(tmp_path / "modes.h5") as file:
        file.visit(names.append)
        names += list(file.attrs)
    parts = {part for name in names for part in name.split("/")} - {"0", "density", "expansion", "poisson_ratio"}
    parts -= {"thickness", "young_modulus"}
    assert not [part for part in parts if part not in page]
    fields = {field.name for kind in (js.Energy, js.Momentum) for field in dataclasses.fields(kind)}
    assert not [name for name in fields if name not in page] and EnergyMomentum


# --- inner edges, motions of sets ------------------------------------------------------------------------


def test_forces_on_inner_edges(tmp_path):
    load = '[[loads]]\nkind = "edge force"\nplane = { x = 2.0 }\nforce = [0, 0, 3]\n'
    scene, _ = read(tmp_path, BASE + load + "inner = true\n")
    assert scene.loads[0].edges.array.tolist() == [[6, 7], [7, 8]]
    with pytest.raises(ValueError, match=r"boundary has both its ends among the chosen nodes \(inner = true looks for"):
        read(tmp_path, BASE + load)
    with pytest.raises(ValueError, match="number 1: inner must be true or false, but it is 1"):
        read(tmp_path, BASE + load + "inner = 1\n")
    with pytest.raises(ValueError, match="chooses edges by edges or by inner, not by both"):
        read(tmp_path, BASE + '[[loads]]\nkind = "edge force"\nedges = [[6, 7]]\ninner = true\nforce = [0, 0, 3]\n')


def test_inner_edges_are_those_that_are_not_the_boundarys():
    mesh = GENERATORS["rectangle"](2.0, 1.0, [3, 2])
    edges = {tuple(edge) for edge in np.sort(mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)).tolist()}
    inner, outer = ({tuple(edge) for edge in part.tolist()} for part in (mesh.inner_edges(), mesh.boundary_edges()))
    assert inner | outer == edges and not inner & outer and len(outer) == 10


def test_motions_of_sets_of_nodes(tmp_path):
    moving = """
[[initial]]
plane = { x = 4.0 }
velocity = [0, 0, 2]
[[initial]]
plane = { x = 0.0 }
velocity = [1, 0, 0]
angular_velocity = [0, 0, 3]
"""
    scene, _ = read(tmp_path, BASE + moving)
    assert scene.initial is not None
    v, w = np.asarray(scene.initial.velocities), np.asarray(scene.initial.angular_velocities)
    assert v[12:].tolist() == [[0, 0, 2]] * 3 and not w[12:].any() and not v[3:12].any()
    # About the mean of the set, (0, 1, 0): v = (1, 0, 0) + (0, 0, 3) × (0, y - 1, 0).
    assert v[:3].tolist() == [[4, 0, 0], [1, 0, 0], [-2, 0, 0]] and w[:3].tolist() == [[0, 0, 3]] * 3
    one, _ = read(tmp_path, BASE + "[initial]\nnodes = [3]\nvelocity = [0, 1, 0]\n")
    assert np.flatnonzero(np.asarray(one.initial.velocities).any(axis=1)).tolist() == [3]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[[initial]]\nvelocity = [1, 0, 0]\n[[initial]]\nnodes = [2]\nvelocity = [0, 1, 0]\n",
         r"\[\[initial\]\] motion number 2: moves node 2 \(and 0 others\), which number 1 moves already"),
        ("[[initial]]\nnodes = [2]\n", r"\[\[initial\]\] motion number 1: says no motion: give velocity or angular_velocity"),
        ("[[initial]]\nnodes = [2]\nspeed = 1\n", "number 1: has the unknown key 'speed'"),
        ("[initial]\nplane = { x = 9.0 }\nvelocity = [1, 0, 0]\n", r"\[initial\] No node fulfils plane"),
    ],
)  # fmt: skip
def test_motions_that_are_refused(text, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        read(tmp_path, BASE + text)
