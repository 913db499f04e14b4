"""Scenes written as TOML files, for the command line; `examples/cantilever.toml` shows every table.

    name, units ("SI" puts units on the pictures' axes)
    [mesh]         generator and its arguments (see `jaxshell.model.generators`), or file (whatever meshio reads) with
                   quads ("split", "error"), merge (a tolerance), orient (true), coincident ("allow"): see `Mesh.read`
    [section]      thickness, young_modulus, poisson_ratio, density; kind = "isotropic" where it is not left out
    [[supports]]   nodes; hold = "clamped", "pinned", "symmetry x" or list; displacement, history
    [[loads]]      kind = "force", "moment", "edge force", "gravity", "pressure" or "normal force"; nodes; its
                   force, moment, acceleration, pressure or magnitude; history
    [watch]        label = { nearest or node, component }, or of a stress or section force, as "von mises top" or "Mxx",
                   { nearest or element, component }
    [initial]      velocity, angular_velocity, about: a rigid motion
    [run]          how it is run: the keys of `jaxshell.files.run_keys.RunSettings`, method, dt, t_end, save_every,
                   step_tolerance (step control, started with dt), reactions, ...

Nodes are chosen by `nodes = [...]`, `nearest = [x, y, z]`, `plane = { x = 0.0 }`, `box = [[low], [high]]` or
`boundary = true`; several of these together choose what fulfils all. A history is `{ times, values }` or
`{ ramp = t }`; without one the load acts, whole, from the start.
"""

import contextlib
import dataclasses
import inspect
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from jaxshell.files.run_keys import RunSettings
from jaxshell.model.gauge import gauge_of
from jaxshell.model.generators import GENERATORS
from jaxshell.model.history import History
from jaxshell.model.loads import LOADS, Load
from jaxshell.model.mesh import Mesh
from jaxshell.model.mesh_file import is_file
from jaxshell.model.scene import Defaults, Initial, Scene
from jaxshell.model.sections import SECTIONS, AnySection, Section
from jaxshell.model.supports import ALL, Support, symmetry
from jaxshell.numerics.checks import check_finite, float_array, shown, whole_array

_READING = ("quads", "merge", "orient", "coincident")
_SELECTORS = ("nodes", "nearest", "plane", "box", "boundary")
_LOADS = {load.kind: load for load in LOADS}
_SECTIONS = {section.kind: section for section in SECTIONS}
_SYMMETRY = {f"symmetry {normal}": symmetry([0], normal).dofs for normal in "xyz"}
_HOLD = {"clamped": ALL, "pinned": ("ux", "uy", "uz"), **_SYMMETRY}


def read_scene_file(path) -> tuple[Scene, RunSettings]:
    """The scene of a TOML file, and what its [run] table says (method, dt, t_end, ...).

    A mesh file's path is relative to the scene file. Raises FileNotFoundError; ValueError naming the file and
    the table for whatever is wrong in it, unknown keys included.
    """
    path = Path(path)
    if not is_file(path):
        raise FileNotFoundError(f"There is no file {path}.")
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        reason = "it is nested too deeply" if isinstance(error, RecursionError) else error
        raise ValueError(f"{path} is not a valid TOML file: {reason}") from error
    try:
        return _scene(content, path)
    except (ValueError, TypeError) as error:
        raise ValueError(f"{path}: {error}") from error


def _scene(content: dict, path: Path) -> tuple[Scene, RunSettings]:
    top = _Table("the file", content)
    known = ("name", "units", "mesh", "section", "supports", "loads", "watch", "initial", "run")
    top.only(*known)
    mesh = _mesh(top.table("mesh"), path.parent)
    run = top.table("run", optional=True)
    settings = RunSettings.from_table(run.content)
    scene = Scene(
        mesh,
        _section(top.table("section")),
        [_support(table, mesh) for table in top.tables("supports")],
        [_load(table, mesh) for table in top.tables("loads")],
        initial=_initial(top.table("initial", optional=True), mesh),
        name=top.text("name", path.stem),
        watch=_watch(top.table("watch", optional=True), mesh),
        defaults=_defaults(settings, top.text("units", "")),
    )
    return scene, settings


def _mesh(table: "_Table", folder: Path) -> Mesh:
    if "file" in table.content:
        table.only("file", *_READING)
        file = folder / table.text("file")
        if not is_file(file):
            raise ValueError(f"[mesh] There is no file {shown(str(file))}.")
        return table.call(Mesh.read, file, **{key: table.get(key) for key in _READING if key in table.content})
    name = table.text("generator")
    if name not in GENERATORS:
        raise ValueError(f"[mesh] generator must be one of {', '.join(GENERATORS)}, but it is {name!r}.")
    generator = GENERATORS[name]
    arguments = inspect.signature(generator).parameters
    table.only("generator", *arguments)
    for argument in arguments.values():
        if argument.default is argument.empty:
            table.get(argument.name)
    return table.call(generator, **{key: value for key, value in table.content.items() if key != "generator"})


def _section(table: "_Table") -> AnySection:
    name = table.text("kind", Section.kind)
    if name not in _SECTIONS:
        choices = ", ".join(repr(choice) for choice in _SECTIONS)
        raise ValueError(f"{table.name} kind must be one of {choices}, but it is {name!r}.")
    section = _SECTIONS[name]
    fields = [field for field in dataclasses.fields(section) if field.init]
    table.only(*(field.name for field in fields), "kind")
    for field in fields:
        if field.default is dataclasses.MISSING:
            table.get(field.name)
    return table.call(section, **{key: value for key, value in table.content.items() if key != "kind"})


def _support(table: "_Table", mesh: Mesh) -> Support:
    table.only(*_SELECTORS, "hold", "displacement", "history")
    hold = table.get("hold")
    if isinstance(hold, str):
        if hold not in _HOLD:
            choices = ", ".join(repr(name) for name in _HOLD)
            raise ValueError(
                f"{table.name} hold must be one of {choices} or a list of degrees of freedom, but it is {shown(hold)}."
            )
        hold = _HOLD[hold]
    displacement = table.content.get("displacement")
    return table.call(Support, _nodes(table, mesh), hold, displacement, _history(table))


def _load(table: "_Table", mesh: Mesh) -> Load:
    name = table.text("kind")
    if name not in _LOADS:
        choices = ", ".join(repr(choice) for choice in _LOADS)
        raise ValueError(f"{table.name} kind must be one of {choices}, but it is {name!r}.")
    load = _LOADS[name]
    if load.acts_on == "shell":
        table.only("kind", load.value, "history")
        return table.call(load, table.get(load.value), _history(table))
    table.only("kind", *_SELECTORS, load.value, "history")
    where = _nodes(table, mesh)
    if load.acts_on == "edges":
        edges = mesh.boundary_edges()
        where = edges[np.isin(edges, where).all(axis=1)]
        if not len(where):
            raise ValueError(f"{table.name} No edge of the mesh's boundary has both its ends among the chosen nodes.")
    return table.call(load, where, table.get(load.value), _history(table))


def _history(table: "_Table") -> History | None:
    if "history" not in table.content:
        return None
    inner = table.table("history")
    inner.only("ramp", "times", "values")
    if "ramp" in inner.content:
        inner.only("ramp")
        return table.call(History.ramp, inner.get("ramp"))
    return table.call(History, inner.get("times"), inner.get("values"))


def _watch(table: "_Table", mesh: Mesh) -> dict[str, tuple[int, str]]:
    found = {}
    for label in table.content:
        inner = table.table(label)
        component = inner.text("component") if "component" in inner.content else ""
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


def _initial(table: "_Table", mesh: Mesh) -> Initial | None:
    table.only("velocity", "angular_velocity", "about")
    if not table.content:
        return None
    return table.call(Initial.rigid, mesh, **{name: table.vectors(name, (3,)) for name in table.content})


def _defaults(run: RunSettings, units: str) -> Defaults | None:
    if units not in ("", "SI"):
        raise ValueError(f'units must be "SI" or left out, but it is {units!r}.')
    if run.dt is None or run.t_end is None:
        return None
    times = tuple(float(t) for t in run.picture_times or ())
    return Defaults(run.dt, run.t_end, run.save_every or 1, times, units=units)


def _nodes(table: "_Table", mesh: Mesh) -> np.ndarray:
    """Indices of the nodes that fulfil all of the table's selectors."""
    x = np.asarray(mesh.nodes)
    tolerance = 1e-6 * np.ptp(x, axis=0).max()
    chosen = np.ones(len(x), bool)
    given = [name for name in _SELECTORS if name in table.content]
    if not given:
        raise ValueError(f"{table.name} chooses no nodes; give one of {', '.join(_SELECTORS)}.")
    for name in given:
        if name == "nodes":
            wanted = f"numbers from 0 to {len(x) - 1}"
            numbers = np.atleast_1d(table.call(whole_array, name, table.get(name), wanted))
            if numbers.ndim > 1 or np.any((numbers < 0) | (numbers >= len(x))):
                raise ValueError(f"{table.name} nodes must be {wanted}, but are {shown(table.get(name))}.")
            mask = np.isin(np.arange(len(x)), numbers)
        elif name == "nearest":
            mask = np.arange(len(x)) == mesh.nearest_node(table.vectors(name, (3,)))
        elif name == "plane":
            plane = table.table(name)
            plane.only("x", "y", "z")
            mask = np.ones(len(x), bool)
            for axis in plane.content:
                mask &= np.abs(x[:, "xyz".index(axis)] - plane.vectors(axis, ())) <= tolerance
        elif name == "box":
            low, high = table.vectors(name, (2, 3))
            mask = np.all((x >= low - tolerance) & (x <= high + tolerance), axis=1)
        else:
            if table.get(name) is not True:
                raise ValueError(f"{table.name} boundary must be true or left out, but it is {shown(table.get(name))}.")
            mask = np.isin(np.arange(len(x)), mesh.boundary_edges())
        chosen &= mask
    if not chosen.any():
        raise ValueError(f"{table.name} No node fulfils {' and '.join(given)}; the mesh spans {_span(x)}.")
    return np.flatnonzero(chosen)


def _span(x: np.ndarray) -> str:
    return ", ".join(f"{a} {low:g} to {high:g}" for a, low, high in zip("xyz", x.min(0), x.max(0), strict=True))


class _Table:
    """A table of the file with its name, for errors that say where they are."""

    def __init__(self, name: str, content):
        if not isinstance(content, dict):
            raise ValueError(f"{name} must be a table, but it is {shown(content)}.")
        self.name, self.content = name, content

    def only(self, *known: str) -> None:
        """Raise ValueError for a key that is not one of `known`."""
        for key in self.content:
            if key not in known:
                raise ValueError(f"{self.name} has the unknown key {key!r}. Known keys: {', '.join(known)}.")

    def get(self, key: str) -> Any:
        if key not in self.content:
            raise ValueError(f"{self.name} lacks {key!r}.")
        return self.content[key]

    def vectors(self, key: str, shape: tuple[int, ...]) -> np.ndarray:
        """A key's finite numbers as an array of the given shape."""
        value, array = self.get(key), None
        with contextlib.suppress(ValueError):
            array = np.asarray(float_array(value))
        if array is None or array.shape != shape:
            wanted = {(): "a number", (3,): "[x, y, z]"}.get(shape, "[[x, y, z], [x, y, z]]")
            raise ValueError(f"{self.name} {key} must be {wanted}, but it is {shown(value)}.")
        self.call(check_finite, key, array)
        return array

    def text(self, key: str, default: str | None = None) -> str:
        """A key that holds text; it may be left out where there is a default."""
        value = self.get(key) if default is None else self.content.get(key, default)
        if not isinstance(value, str):
            raise ValueError(f"{self.name} {key} must be a text, but it is {shown(value)}.")
        return value

    def table(self, key: str, optional: bool = False) -> "_Table":
        name = f"[{key}]" if self.name == "the file" else f"{self.name} {key}"
        return _Table(name, self.content.get(key, {}) if optional else self.get(key))

    def tables(self, key: str) -> list["_Table"]:
        """The tables of an array of tables, which may be absent; counted from 1 in messages."""
        found = self.content.get(key, [])
        if not isinstance(found, list):
            raise ValueError(f"{key} must be an array of tables: write [[{key}]] above each.")
        return [_Table(f"[[{key}]] number {i + 1}:", table) for i, table in enumerate(found)]

    def call(self, make, *arguments, **named):
        """What `make` returns; its errors say which table they come from."""
        try:
            return make(*arguments, **named)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{self.name} {error}") from error
