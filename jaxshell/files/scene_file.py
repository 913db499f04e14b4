"""Scenes written as TOML files, for the command line; `examples/cantilever.toml` shows every table.

    name, units ("SI" puts units on the pictures' axes)
    [mesh]         generator and its arguments (see `jaxshell.model.generators`), or file (gmsh, Abaqus, ...), whose
                   sets come along, with quads and second_order ("split", "error"), merge (a tolerance), orient (true),
                   coincident ("allow"): see `Mesh.read`;
                   element_sets = { name = [numbers] or { plane, box } for the elements' centroids };
                   node_sets = { name = [numbers] or { nearest, plane, box, boundary } };
                   side_sets = { name = [[node, node], ...] or { ... } for the boundary's edges between such nodes };
                   refine, how often the whole scene is refined once it is read (docs/refinement.md);
                   imperfection: see `jaxshell.files.imperfection`
    [section]      thickness, young_modulus, poisson_ratio, density; kind = "isotropic" where it is not left out
    [materials.X], laminates, regions, [[thermal]], [[initial_strain]]: see `jaxshell.files.sections`
    [[supports]]   nodes; hold = "clamped", "pinned", "symmetry x" or list; displacement or acceleration, or rotation
                   with angle and about; history
    [[loads]]      kind, one of those that `jaxshell.model.loads.LOADS` lists; nodes, edges (or inner = true for inner
                   edges between the nodes), or elements of what acts on the surface; its value, such as force, moment,
                   acceleration, pressure, components; history; and what the kind takes besides
    [[masses]], [[connectors]], [[obstacles]]: see `jaxshell.files.items`
    [damping]      alpha, beta, or ratios with modes (counted from 1) or frequencies: see `RayleighDamping`
    [watch]        label = { nearest or node, component }, or of a stress or section force, as "von mises top" or "Mxx",
                   { nearest or element, component }; or { connector or obstacle = its name, component }
    [initial]      velocity, angular_velocity, about: a rigid motion; [[initial]]: of sets of nodes, see
                   `jaxshell.files.initial`
    [run]          how it is run: the keys of `jaxshell.files.run_keys.RunSettings`, method, dt, t_end, save_every,
                   step_tolerance (step control, started with dt), reactions, ...

Nodes are chosen by `nodes = [...]` or `nodes = "name of a set"`, `nearest = [x, y, z]`, `plane = { x = 0.0 }`,
`box = [[low], [high]]` or `boundary = true`; several of these together choose what fulfils all. A history is
`{ times, values }` or `{ ramp = t }`; without one the load acts, whole, from the start.
"""

import dataclasses
import inspect
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from jaxshell.files.history import read_history
from jaxshell.files.imperfection import IMPERFECTION, imperfect_mesh
from jaxshell.files.initial import read_initial
from jaxshell.files.items import ITEM_KINDS, read_items
from jaxshell.files.run_keys import RunSettings
from jaxshell.files.sections import chosen_kind, read_direction, read_materials, read_section
from jaxshell.files.selectors import NODE_SELECTORS, chosen_edges, chosen_elements, chosen_nodes
from jaxshell.files.tables import Table
from jaxshell.model.damping import RayleighDamping
from jaxshell.model.gauge import gauge_of
from jaxshell.model.generators import GENERATORS
from jaxshell.model.history import History
from jaxshell.model.loads import LOADS, InitialStrain, InitialStrains, Load, Thermal
from jaxshell.model.mesh import Mesh
from jaxshell.model.mesh_file import is_file
from jaxshell.model.refinement import refine
from jaxshell.model.scene import Defaults, Scene
from jaxshell.model.supports import ALL, Support, symmetry
from jaxshell.numerics.checks import shown
from jaxshell.numerics.nearest import meant

READING = ("quads", "second_order", "merge", "orient", "coincident")
LOAD_KINDS = {load.kind: load for load in LOADS if not issubclass(load, InitialStrains)}
_SYMMETRY = {f"symmetry {normal}": symmetry([0], normal).dofs for normal in "xyz"}
REFINE = "refine"
KNOWN = ("name", "units", "mesh", "materials", "section", "supports", "loads", "thermal", "initial_strain")
KNOWN += (*ITEM_KINDS, "damping", "watch", "initial", "run")
DIRECTIONS = ("axes", "normal")
MOTIONS = ("displacement", "rotation", "angle", "about", "acceleration")
"""Keys of a support that moves."""
HOLD = {"clamped": ALL, "pinned": ("ux", "uy", "uz"), **_SYMMETRY}


def read_scene_file(path) -> tuple[Scene, RunSettings]:
    """The scene of a TOML file, and what its [run] table says (method, dt, t_end, ...).

    A mesh file's path is relative to the scene file. Raises FileNotFoundError; ValueError naming the file and
    the table for whatever is wrong in it, unknown keys included.
    """
    return scene_of(read_content(path), path)


def read_content(path) -> dict:
    """What a scene file says, as tables and lists. Raises FileNotFoundError, or ValueError where it is no TOML."""
    path = Path(path)
    if not is_file(path):
        raise FileNotFoundError(f"There is no file {path}.")
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        reason = "it is nested too deeply" if isinstance(error, RecursionError) else error
        raise ValueError(f"{path} is not a valid TOML file: {reason}") from error


def scene_of(content: dict, path, mesh: Mesh | None = None) -> tuple[Scene, RunSettings]:
    """As `read_scene_file`, of the content of the file at `path`; its mesh is not made again where it is given, without
    imperfection."""
    try:
        return _scene(content, Path(path), mesh)
    except (ValueError, TypeError) as error:
        raise ValueError(f"{path}: {error}") from error


def _scene(content: dict, path: Path, mesh: Mesh | None) -> tuple[Scene, RunSettings]:
    top = Table.top(content)
    top.only(*KNOWN)
    mesh = _mesh(top.table("mesh"), path.parent) if mesh is None else mesh
    run = top.table("run", optional=True)
    settings = RunSettings.from_table(run.content)
    items: dict[str, Any] = {key: read_items(top, key, mesh) for key in ITEM_KINDS}
    scene = Scene(
        mesh,
        read_section(top, read_materials(top.table("materials", optional=True)), mesh),
        [_support(table, mesh) for table in top.tables("supports")],
        [_load(table, mesh) for table in top.tables("loads")] + _initial_strains(top, mesh),
        initial=read_initial(top, mesh),
        name=top.text("name", path.stem),
        watch=_watch(top.table("watch", optional=True), mesh),
        defaults=_defaults(settings, top.text("units", "")),
        **items,
    )
    given = top.table("mesh", optional=True)
    if REFINE in given.content:
        scene = given.call(refine, scene, given.get(REFINE))
    if IMPERFECTION in given.content:
        scene = given.call(dataclasses.replace, scene, mesh=imperfect_mesh(given, scene))
    if "damping" in content:
        scene = dataclasses.replace(scene, damping=_damping(top.table("damping"), scene))
    return scene, settings


def _mesh(table: Table, folder: Path) -> Mesh:
    made = {key: value for key, value in table.content.items() if key not in (*SETS, REFINE, IMPERFECTION)}
    mesh = _plain_mesh(Table(table.name, made), folder)
    given = {}
    for key, chosen in SETS.items():
        if key in table.content:
            inner = table.table(key)
            given[key] = {name: chosen(inner, name, mesh) for name in inner.content}
    return table.call(mesh.with_sets, **given) if given else mesh


def _set_of_nodes(table: Table, name: str, mesh: Mesh) -> np.ndarray:
    """A set of nodes by their numbers, or by a table of selectors."""
    inner = table.table(name) if isinstance(table.get(name), dict) else Table(table.name, {"nodes": table.get(name)})
    inner.only(*NODE_SELECTORS)
    return chosen_nodes(inner, mesh)


def _set_of_sides(table: Table, name: str, mesh: Mesh) -> Any:
    """A set of edges as pairs of nodes, or those of the boundary between nodes that a table of selectors chooses."""
    if not isinstance(table.get(name), dict):
        return table.get(name)
    inner = table.table(name)
    inner.only(*NODE_SELECTORS, "inner")
    return chosen_edges(inner, mesh)


SETS = {"node_sets": _set_of_nodes, "element_sets": chosen_elements, "side_sets": _set_of_sides}


def _plain_mesh(table: Table, folder: Path) -> Mesh:
    if "file" in table.content:
        table.only("file", *READING, *SETS, REFINE, IMPERFECTION)
        file = folder / table.text("file")
        if not is_file(file):
            raise ValueError(f"[mesh] There is no file {shown(str(file))}.")
        return table.call(Mesh.read, file, **{key: table.get(key) for key in READING if key in table.content})
    name = table.text("generator")
    if name not in GENERATORS:
        choices = ", ".join(GENERATORS)
        raise ValueError(f"[mesh] generator must be one of {choices}, but it is {name!r}.{meant(name, GENERATORS)}")
    generator = GENERATORS[name]
    arguments = inspect.signature(generator).parameters
    table.only("generator", *arguments, *SETS, REFINE, IMPERFECTION)
    for argument in arguments.values():
        if argument.default is argument.empty:
            table.get(argument.name)
    return table.call(generator, **{key: value for key, value in table.content.items() if key != "generator"})


def _support(table: Table, mesh: Mesh) -> Support:
    table.only(*NODE_SELECTORS, "hold", *MOTIONS, *DIRECTIONS, "history")
    # What a rotation prescribes follows from its other keys.
    hold = table.content.get("hold") if "rotation" in table.content else table.get("hold")
    if isinstance(hold, str):
        if hold not in HOLD:
            choices = ", ".join(repr(name) for name in HOLD)
            raise ValueError(
                f"{table.name} hold must be one of {choices} or a list of degrees of freedom, but it is {shown(hold)}."
                f"{meant(hold, HOLD)}"
            )
        hold = HOLD[hold]
    motion = {key: table.content[key] for key in (*MOTIONS, *DIRECTIONS) if key in table.content}
    return table.call(Support, chosen_nodes(table, mesh), hold, history=read_history(table), **motion)


def _load(table: Table, mesh: Mesh) -> Load:
    load = LOAD_KINDS[chosen_kind(table, LOAD_KINDS)]
    more = load_keys(load)
    where = {"shell": load.sets, "edges": (*NODE_SELECTORS, "edges", "inner"), "nodes": NODE_SELECTORS}[load.acts_on]
    table.only("kind", load.value, "history", *more, *where)
    given = {load.value: table.get(load.value), "history": read_history(table)}
    given |= {key: _value_or_history(table, key) for key, needed in more.items() if needed or key in table.content}
    if load.acts_on == "shell":
        given |= {key: chosen_elements(table, key, mesh) for key in load.sets if key in table.content}
        return table.call(load, **given)
    chosen = chosen_edges if load.acts_on == "edges" else chosen_nodes
    return table.call(load, chosen(table, mesh), **given)


def load_keys(load: type[Load]) -> dict[str, bool]:
    """The keys of a kind of load besides its value, its history and where it acts, and whether it needs them."""
    parameters = inspect.signature(load).parameters.values()
    known = {load.value, "history", *load.sets}
    return {each.name: each.default is each.empty for each in parameters if each.name not in known}


def _value_or_history(table: Table, key: str) -> Any:
    """A key's value, or where it is a table of times and values the history that these are."""
    if not isinstance(table.get(key), dict):
        return table.get(key)
    inner = table.table(key)
    inner.only("times", "values")
    return table.call(History, inner.get("times"), inner.get("values"))


def _initial_strains(top: Table, mesh: Mesh) -> list[Load]:
    kinds = {"thermal": Thermal, "initial_strain": InitialStrain}
    return [
        table.fields(
            kind,
            direction=read_direction,
            history=lambda table, _: read_history(table),
            elements=lambda table, key: chosen_elements(table, key, mesh),
        )
        for key, kind in kinds.items()
        for table in top.tables(key)
    ]


def _watch(table: Table, mesh: Mesh) -> dict[str, tuple[int | str, str]]:
    found = {}
    for label in table.content:
        inner = table.table(label)
        component = inner.text("component") if "component" in inner.content else ""
        if named := [key for key in ("connector", "obstacle") if key in inner.content]:
            inner.only(named[0], "component")
            found[label] = (inner.text(named[0]), inner.text("component"))
            continue
        where = "node" if gauge_of(component) is None else "element"
        inner.only("nearest", where, "component")
        if ("nearest" in inner.content) == (where in inner.content):
            raise ValueError(f"{inner.name} needs either nearest = [x, y, z] or {where} = number.")
        if where in inner.content:
            number = inner.get(where)
        else:
            nearest = mesh.nearest_node if where == "node" else mesh.nearest_element
            number = nearest(inner.vectors("nearest", (3,)))
        found[label] = (number, inner.text("component"))
    return found


def _damping(table: Table, scene: Scene) -> RayleighDamping:
    given = table.content
    if "ratios" not in given:
        table.only("alpha", "beta")
        damping = table.call(RayleighDamping, **given)
        table.call(damping.check, scene.mesh)
        return damping
    table.only("ratios", "modes", "frequencies")
    return table.call(
        RayleighDamping.from_ratios, scene, given["ratios"], given.get("modes"), frequencies=given.get("frequencies")
    )


def _defaults(run: RunSettings, units: str) -> Defaults | None:
    if units not in ("", "SI"):
        raise ValueError(f'units must be "SI" or left out, but it is {units!r}.')
    if not units and run.picture_times is None and (run.dt is None or run.t_end is None):
        return None
    times = tuple(float(t) for t in run.picture_times or ())
    return Defaults(run.dt, run.t_end, run.save_every or 1, times, units=units)
