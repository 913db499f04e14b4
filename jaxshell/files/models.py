"""Models of Abaqus and CalculiX (.inp) and of Nastran (.bdf, .dat, .nas) as scenes and as scene files."""

import os
import warnings
from pathlib import Path

import numpy as np

from jaxshell.files.draft import Draft
from jaxshell.files.mesh_text import mesh_text
from jaxshell.files.scene_file import scene_of
from jaxshell.files.toml_text import toml_text
from jaxshell.model.mesh import Mesh
from jaxshell.model.mesh_files.files import is_file
from jaxshell.model.scene import Scene
from jaxshell.numerics.checks import check_choice, check_switch, shown

ABAQUS = (".inp",)
NASTRAN = (".bdf", ".dat", ".nas")


def read_model(path, *, partial: bool = False, second_order: str = "error") -> Scene:
    """The scene of an Abaqus or CalculiX input file, or of a Nastran bulk data file.

    Mesh, sets, materials, sections, supports, loads with their histories, damping and initial velocities are carried
    over, of the first step or subcase; `scene.defaults` has dt and t_end where a dynamic step says them. docs/import.md
    lists what each card becomes. Warns, a line for each, of what has no counterpart.

    Arguments:
        path: .inp, .bdf, .dat or .nas.
        partial: leave out also what the answer depends on, such as elements that are no shells or rigid bodies.
        second_order: "split" cuts elements of second order as `Mesh.read` does, "error" refuses them.

    Raises FileNotFoundError, and ValueError that names the file, its line and what is wrong; one that lists all that
    the answer depends on, unless `partial`.
    """
    draft = draft_of(path, partial=partial, second_order=second_order)
    scene, _ = scene_of(draft.tables, draft.path, draft.mesh)
    for line in draft.notes.lines():
        warnings.warn(f"{path}: {line}", stacklevel=2)
    return scene


def draft_of(path, *, partial: bool = False, second_order: str = "error") -> Draft:
    """The tables of the scene file that `path` becomes, with its mesh and notes. Raises as `read_model`."""
    check_switch("partial", partial)
    check_choice("second_order", second_order, ("split", "error"))
    if not isinstance(path, str | Path):
        raise ValueError(f"The model file must be given by its path, but it is {shown(path)}.")
    path = Path(path)
    if not is_file(path):
        raise FileNotFoundError(f"There is no model file {path}.")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        if path.suffix.lower() in ABAQUS:
            from jaxshell.files.abaqus.model import read_abaqus

            draft = read_abaqus(path, second_order)
        elif path.suffix.lower() in NASTRAN:
            from jaxshell.files.nastran.model import read_nastran

            draft = read_nastran(path, second_order)
        else:
            known = ", ".join((*ABAQUS, *NASTRAN))
            raise ValueError(f"{path} is of no kind that models are read from, which its name's end tells ({known}).")
    draft.notes.left_out += [str(warning.message).removeprefix(f"{path}: ") for warning in caught]
    draft.notes.settle(path, partial)
    if second_order == "split":
        draft.reading["second_order"] = "split"
    return draft


def write_scene_file(draft: Draft, path, *, overwrite: bool = False) -> list[Path]:
    """Write a draft as a scene file; returns the files written.

    The scene names the model file as its mesh where `Mesh.read` finds the same nodes, triangles and sets in it, without
    a warning, and else a file beside the scene, NAME_mesh.inp. Raises ValueError for a name that does not end in .toml,
    and for files that exist, unless `overwrite`.
    """
    path = Path(path)
    if path.suffix != ".toml":
        raise ValueError(f"A scene file's name ends in .toml, but it is {path}.")
    beside = path.with_name(f"{path.stem}_mesh.inp")
    own = _reads_alike(draft.path, draft)
    made = [path] if own else [path, beside]
    there = [file for file in made if file.exists()]
    if there and not overwrite:
        raise ValueError(f"{there[0]} exists; overwrite=True (--overwrite on the command line) replaces it.")
    reading = draft.reading if own else {}
    file = _from(path.parent, draft.path) if own else beside.name
    tables = dict(draft.tables)
    text = toml_text({"name": tables.pop("name"), "mesh": {"file": file, **reading}, **tables})
    scene_of(draft.tables, draft.path, draft.mesh)  # what is wrong with it is told before anything is written
    if not own:
        beside.write_text(mesh_text(draft.mesh), encoding="utf-8")
    path.write_text(_head(draft, path) + text, encoding="utf-8")
    return made


def _reads_alike(path: Path, draft: Draft) -> bool:
    """Whether `Mesh.read` has the draft's mesh, with all its sets, of the file, and nothing to warn of: every run of
    the scene would warn of masses, say, which are no cells of the mesh but are in the scene."""
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            return _same(Mesh.read(path, **draft.reading), draft.mesh) and not caught
    except ValueError:
        return False


def _same(one: Mesh, other: Mesh) -> bool:
    return (
        np.array_equal(one.nodes, other.nodes)
        and np.array_equal(one.triangles, other.triangles)
        and one.node_sets == other.node_sets
        and one.element_sets == other.element_sets
    )


def _from(folder: Path, file: Path) -> str:
    """The file's path relative to a folder, as a scene file has it."""
    return Path(os.path.relpath(file.resolve(), folder.resolve())).as_posix()


def _head(draft: Draft, path: Path) -> str:
    """Comments at the top of the file: where it is from, and what is not in it."""
    lines = [
        f"# {draft.path.name}, carried over by `jaxshell import`: run it with",
        "#",
        f"#     jaxshell run {path.name}",
    ]
    lines += ["#", "# Units are those of the model.", "#"]
    lines += [f"# {line}" for line in draft.notes.lines()]
    return "\n".join(lines).rstrip("#\n") + "\n\n"
