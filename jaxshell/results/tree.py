"""A scene as a tree of HDF5 groups: a group per object with its class in `kind`, a dataset per array or text."""

import dataclasses
import json
from typing import Any

import equinox as eqx
import h5py
import jax.numpy as jnp
import numpy as np

from jaxshell.model.connectors import CONNECTORS
from jaxshell.model.connectors.ends import Nodes, Point, Space
from jaxshell.model.damping import RayleighDamping
from jaxshell.model.history import History
from jaxshell.model.initial import Initial
from jaxshell.model.loads import LOADS
from jaxshell.model.masses import PointMass
from jaxshell.model.materials import MATERIALS
from jaxshell.model.mesh import Mesh
from jaxshell.model.obstacles import OBSTACLES
from jaxshell.model.scene import Defaults, Scene
from jaxshell.model.sections import SECTIONS, Cylindrical, Ply
from jaxshell.model.sets import Sets
from jaxshell.model.supports import Support
from jaxshell.model.surface import SURFACES
from jaxshell.numerics.frozen import Frozen
from jaxshell.results.checked import has, read_text, write_array, write_attribute, write_text

_PARTS = (Mesh, PointMass, Ply, Cylindrical, Support, History, Initial, RayleighDamping, Nodes, Point, Space)
_KINDS = {kind.__name__: kind for kind in (*_PARTS, *SECTIONS, *MATERIALS, *LOADS, *CONNECTORS, *OBSTACLES, *SURFACES)}
_ITEMS = ("supports", "loads", "masses", "connectors", "obstacles")
"""What a scene has several of. Of the last three nothing is written where there are none: older files have none."""
_LIST, _SETS = "list", "sets"
"""The kinds of groups that hold a tuple of objects or arrays, and named sets."""
_TEXT = "json:"
"""Before the name of a dataset that holds JSON."""


def to_json(value) -> str:
    """A setting, a figure or a list of them as text; NumPy's and JAX's numbers as plain ones."""

    def other(item):
        return item.item() if np.ndim(item) == 0 and hasattr(item, "item") else np.asarray(item).tolist()

    return json.dumps(value, default=other, ensure_ascii=False)


def tuples(value) -> Any:
    """JSON's lists as the tuples that they were."""
    if isinstance(value, dict):
        return {name: tuples(item) for name, item in value.items()}
    return tuple(tuples(item) for item in value) if isinstance(value, list) else value


def write_scene(group, scene: Scene) -> None:
    """Store a scene, which must be concrete, in an empty group."""
    for name in ("mesh", "section", "initial", "damping"):
        _write_field(group, name, getattr(scene, name))
    for name in _ITEMS:
        if getattr(scene, name) or name in _ITEMS[:2]:
            items = group.create_group(name)
            for position, item in enumerate(getattr(scene, name)):
                _write_field(items, str(position), item)
    write_text(group, "name", scene.name)
    write_text(group, "watch", to_json(scene.watch))
    if scene.defaults is not None:
        write_text(group, "defaults", to_json(scene.defaults._asdict()))


def read_scene_of(file, path) -> Scene:
    """The scene that `write_scene` stored in the group `scene`. Raises ValueError where it is none."""
    try:
        return _scene(file["scene"])
    except (KeyError, OSError, TypeError, AttributeError, RuntimeError, IndexError, ValueError) as error:
        text = " ".join(str(error.args[0] if error.args else error).split()).rstrip(".")
        raise ValueError(f"The scene in {path} is damaged: {text}.") from error


def _scene(group) -> Scene:
    items = {
        name: tuple(_read_object(group[name][str(position)]) for position in range(len(group[name])))
        for name in _ITEMS
        if name in group or name in _ITEMS[:2]
    }
    defaults = json.loads(read_text(group, "defaults")) if has(group, "defaults") else None
    return Scene(
        _read_object(group["mesh"]),
        _read_object(group["section"]),
        **items,
        initial=_read_object(group["initial"]) if "initial" in group else None,
        name=read_text(group, "name"),
        watch={label: (node, component) for label, node, component in json.loads(read_text(group, "watch"))},
        defaults=None if defaults is None else Defaults(**tuples(defaults)),
        damping=_read_object(group["damping"]) if "damping" in group else None,
    )


def _write_field(group, name: str, value) -> None:
    if value is None:
        return
    if isinstance(value, eqx.Module):
        inner = group.create_group(name)
        write_attribute(inner, "kind", type(value).__name__)
        for field in dataclasses.fields(value):
            _write_field(inner, field.name, getattr(value, field.name))
    elif isinstance(value, Frozen):
        write_array(group, name, value.array)
    elif isinstance(value, Sets):
        if value:
            inner = group.create_group(name)
            write_attribute(inner, "kind", _SETS)
            for position, (label, numbers) in enumerate(value.items()):  # a label may hold a slash
                write_text(inner, f"{position} name", label)
                write_array(inner, f"{position}", numbers)
    elif isinstance(value, tuple) and any(isinstance(item, eqx.Module | Frozen) for item in value):
        inner = group.create_group(name)
        write_attribute(inner, "kind", _LIST)
        for position, item in enumerate(value):
            _write_field(inner, str(position), item)
    elif isinstance(value, str | tuple | bool | int):
        write_text(group, _TEXT + name, to_json(value))
    else:
        write_array(group, name, value)


def _read_object(group) -> Any:
    name = read_text(group, "kind")
    if name == _LIST:
        return tuple(_read_item(group[str(position)]) for position in range(len(group)))
    if name == _SETS:
        return {read_text(group, f"{k} name"): group[str(k)][()] for k in range(len(group) // 2)}
    kind = _KINDS[name]
    # Version 0.1 kept texts in attributes.
    fields = {name: tuples(json.loads(group.attrs[name])) for name in group.attrs if name != "kind"}
    for name, item in group.items():
        if name.startswith(_TEXT):
            fields[name.removeprefix(_TEXT)] = tuples(json.loads(read_text(group, name)))
        else:
            fields[name] = _read_item(item)
    if kind is Mesh:  # as it was when it was stored
        nodes, triangles = fields.pop("nodes"), fields.pop("connectivity")
        points = int(fields.pop("points", 0))
        return Mesh(nodes, triangles, coincident="allow", points=points, **fields)
    return kind(**fields)


def _read_item(item) -> Any:
    if isinstance(item, h5py.Group):
        return _read_object(item)
    if item.dtype.kind == "f":
        return jnp.asarray(item[()])
    return item[()] if item.shape else item[()].item()
