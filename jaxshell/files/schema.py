"""The JSON schema of scene files, from the tables that read them: what editors complete and check them by.

It says which keys there are and of which kind their values are; that numbers fit each other is for `jaxshell check`.
"""

import dataclasses
import inspect
import json
from collections.abc import Callable, Iterable
from typing import Any

from jaxshell.files.imperfection import IMPERFECTION, KEYS
from jaxshell.files.initial import MOTION
from jaxshell.files.items import ITEM_KINDS, POINT
from jaxshell.files.run_keys import ANALYSES, OF, RunSettings
from jaxshell.files.scene_file import HOLD, LOAD_KINDS, READING, REFINE, SETS, load_keys
from jaxshell.files.sections import MATERIAL_KINDS, SECTION_KINDS
from jaxshell.model.damping import RayleighDamping
from jaxshell.model.generators import GENERATORS
from jaxshell.model.loads import InitialStrain, Thermal
from jaxshell.model.loads.follower_edge import AXES
from jaxshell.model.sections import Laminate, Ply
from jaxshell.model.supports import DOFS

Schema = dict[str, Any]

NUMBER, COUNT, TEXT, SWITCH = (
    {"type": "number"},
    {"type": "integer", "minimum": 0},
    {"type": "string"},
    {"type": "boolean"},
)
NUMBERS = {"type": "array", "items": NUMBER}
ARRAYS = {"type": "array"}
"""Of numbers, of any depth."""
VECTOR = {"type": "array", "items": NUMBER, "minItems": 3, "maxItems": 3}


def _any(*schemas: Schema, **more) -> Schema:
    return {"anyOf": list(schemas), **more}


def _table(properties: Schema, required: Iterable[str] = (), **more) -> Schema:
    return {
        "type": "object",
        "properties": properties,
        "required": list(required),
        "additionalProperties": False,
        **more,
    }


def _list(items: Schema) -> Schema:
    return {"type": "array", "items": items}


def _said(schema: Schema, text: str) -> Schema:
    return {**schema, "description": text}


_ONE_OR_EACH = _any(NUMBER, NUMBERS)
_NUMBER_OF_MODE = {"type": "integer", "minimum": 1}
_PLACES = {
    "plane": _said(_table(dict.fromkeys("xyz", NUMBER)), "a plane of coordinates, such as { x = 0.0 }"),
    "box": _said(
        {**_list(VECTOR), "minItems": 2, "maxItems": 2}, "the corners [[low], [high]] of a box along the axes"
    ),
}
_NODES = {
    "nodes": _said(_any(TEXT, COUNT, _list(COUNT)), "the name of a set of nodes, or numbers"),
    "nearest": _said(VECTOR, "the node nearest to this point"),
    **_PLACES,
    "boundary": _said({"const": True}, "the nodes of the mesh's boundary"),
}
_PAIRS = _list({**_list(COUNT), "minItems": 2, "maxItems": 2})
_EDGES = {
    "edges": _said(_any(TEXT, _PAIRS), "the name of a set of sides, or pairs of nodes"),
    "inner": _said(SWITCH, "inner edges between the chosen nodes, in place of those of the boundary"),
}
_ELEMENTS = _said(_any(TEXT, COUNT, _list(COUNT), _table(_PLACES)), "a set's name, numbers, or the centroids' place")
_HISTORY = _said(
    _any(_table({"ramp": NUMBER}, ["ramp"]), _table({"times": NUMBERS, "values": NUMBERS}, ["times", "values"])),
    "how it varies in time, as a factor",
)
_DIRECTION = _any(
    VECTOR,
    _list(VECTOR),
    _table({"axis": VECTOR, "origin": VECTOR, "along": {"enum": ["axis", "circumference"]}}, ["axis"]),
)
_KNOWN: dict[str, Schema] = {
    "divisions": _any({"type": "integer"}, _list({"type": "integer"})),
    "elements": _ELEMENTS,
    "history": _HISTORY,
    "direction": _DIRECTION,
    "material": _said(TEXT, "the name of one of [materials]"),
    "layup": _said(TEXT, 'such as "[45/-45/0/90]s"'),
    "symmetric": SWITCH,
    "dofs": _any(TEXT, _list(TEXT)),
    **dict.fromkeys(("A", "B", "D", "thermal", "strain", "curvature"), ARRAYS),
}
"""Arguments that are more than a number, or one for each element."""
_OF_LOADS: dict[str, Schema] = {
    "centre": _said(VECTOR, "a point of the axis; default the origin"),
    "direction": _said(_any(VECTOR, _list(VECTOR)), "the first axis of the components, in the surface"),
    "axes": _said({"enum": list(AXES)}, "what the components are along"),
    "level": _said(
        _any(NUMBER, _table({"times": NUMBERS, "values": NUMBERS}, ["times", "values"])), "a height along up"
    ),
    "up": _said(VECTOR, "against gravity; default [0, 0, 1]"),
}
"""Keys of some kinds of loads."""


def schema() -> Schema:
    """The schema, as a table; what several tables have stands once, under "definitions"."""
    top = {
        "name": _said(TEXT, "for files and pictures; default: the file's name"),
        "units": _said({"enum": ["", "SI"]}, "SI puts units on the pictures' axes"),
        "mesh": _mesh(),
        "materials": {"type": "object", "additionalProperties": _any(*map(_material, MATERIAL_KINDS.values()))},
        "section": _any(_section(False), _list(_section(True))),
        "supports": _list(_support()),
        "loads": _list(_any(*map(_load, LOAD_KINDS.values()))),
        "thermal": _list(_arguments(Thermal)),
        "initial_strain": _list(_arguments(InitialStrain)),
        **{
            key: _list(_any(*(_item(kind, len(kinds) > 1) for kind in kinds.values())))
            for key, kinds in ITEM_KINDS.items()
            if kinds
        },
        "damping": _damping(),
        "watch": {"type": "object", "additionalProperties": _watch()},
        "initial": _any(_initial(), _list(_initial())),
        "run": _run(),
    }
    head = {"$schema": "http://json-schema.org/draft-07/schema#", "title": "A scene of jaxshell"}
    shared = _shared()
    definitions = {name: _referring(part, shared, whole=False) for name, part in shared.items()}
    return head | _referring(_table(top, ["mesh", "section"]), shared) | {"definitions": definitions}


def _shared() -> dict[str, Schema]:
    """What stands in several places, by name."""
    return {
        "imperfection": _any(_imperfection(), _list(_imperfection())),
        **{key: _sets(key) for key in SETS},
        "elements": _ELEMENTS,
        "history": _HISTORY,
        "direction": _DIRECTION,
        "place_of_nodes": _table(_NODES),
        **{f"{key}_of_nodes": found for key, found in _NODES.items()},
        "numbers_of_any_depth": _any(NUMBER, ARRAYS),
        "one_number_or_a_list": _ONE_OR_EACH,
        "vector": VECTOR,
    }


def _referring(part: Any, shared: dict[str, Schema], whole: bool = True) -> Any:
    """A part of the schema with references in place of what is shared; `whole` says whether itself may be one."""
    if isinstance(part, list):
        return [_referring(item, shared) for item in part]
    if not isinstance(part, dict):
        return part
    if whole:
        for name, found in shared.items():
            if part == found:
                return {"$ref": f"#/definitions/{name}"}
    return {key: _referring(item, shared) for key, item in part.items()}


def schema_text() -> str:
    """As a file."""
    return json.dumps(schema(), indent=1, ensure_ascii=False) + "\n"


def _arguments(make: Callable, **more: Schema) -> Schema:
    """The keys of a table whose keys are the arguments of `make`."""
    properties, required = dict(more), []
    for parameter in inspect.signature(make).parameters.values():
        properties[parameter.name] = _KNOWN.get(parameter.name, _ONE_OR_EACH)
        if parameter.default is parameter.empty:
            required.append(parameter.name)
    return _table(properties, required)


def _mesh() -> Schema:
    sets = {key: _sets(key) for key in SETS}
    sets[REFINE] = _said(COUNT, "how often every triangle is cut in four, the whole scene with it")
    sets[IMPERFECTION] = _any(_imperfection(), _list(_imperfection()))
    halves = {"enum": ["split", "error"]}
    reading = {"quads": halves, "second_order": halves, "merge": NUMBER, "orient": SWITCH}
    reading["coincident"] = {"enum": ["error", "allow"]}
    variants = [_table({"file": TEXT, **{key: reading[key] for key in READING}, **sets}, ["file"])]
    for name, generator in GENERATORS.items():
        made = _arguments(generator, generator={"const": name}, **sets)
        made["required"].insert(0, "generator")
        variants.append(made)
    return _said(_any(*variants), "a generator with its arguments, or a mesh file")


def _sets(key: str) -> Schema:
    """Named sets of nodes, elements or sides."""
    kinds = {
        "node_sets": _any(COUNT, _list(COUNT), _table(_NODES)),
        "element_sets": _ELEMENTS,
        "side_sets": _any(_PAIRS, _table(_NODES | {"inner": _EDGES["inner"]})),
    }
    return {"type": "object", "additionalProperties": kinds[key]}


def _imperfection() -> Schema:
    known = {
        "amplitude": _said(_ONE_OR_EACH, "the largest displacement, of a random field the standard deviation"),
        "mode": _said(_any(_NUMBER_OF_MODE, _list(_NUMBER_OF_MODE)), "counted from 1; default 1"),
        "correlation_length": NUMBER,
        "seed": COUNT,
    }
    variants = []
    for kind, keys in KEYS.items():
        needed = [key for key in keys if key not in ("mode", "seed")]
        variants.append(_table({"kind": {"const": kind}, **{key: known[key] for key in keys}}, ["kind", *needed]))
    return _any(*variants)


def _material(kind: Any) -> Schema:
    return _arguments(kind, kind={"const": kind.kind})


def _section(with_elements: bool) -> Schema:
    """One section, or one of several, which says its elements."""
    more: Schema = {"elements": _ELEMENTS} if with_elements else {}
    variants = []
    for name, kind in SECTION_KINDS.items():
        makers = [Laminate.from_layup, Laminate] if kind is Laminate else [kind]
        for make in makers:
            found = _arguments(make, kind={"const": name}, **more)
            if "plies" in found["properties"]:
                found["properties"]["plies"] = _list(_arguments(Ply))
            found["required"] += ["elements"] * with_elements + ["kind"] * (name != "isotropic")
            variants.append(found)
    return _any(*variants)


def _support() -> Schema:
    """Held or moved along; or turned, which says by itself what it holds."""
    hold = _any({"enum": list(HOLD)}, _list({"enum": list(DOFS)}))
    moves = "moves the degrees of freedom of the list, times the history; ux, uy, uz only"
    along = {
        "displacement": _any(NUMBER, _said(ARRAYS, moves)),
        "acceleration": _any(NUMBER, _said(ARRAYS, f"accelerates from rest: {moves}")),
    }
    turned = {
        "rotation": _said(VECTOR, "the axis about which the nodes turn"),
        "angle": _said(NUMBER, "in radians, times the history; default: 1"),
        "about": _said(VECTOR, "a point of the axis: the nodes move round it, as one rigid body"),
    }
    held = {**_NODES, "hold": hold, "history": _HISTORY}
    along["axes"] = _said(_list(VECTOR), "unit vectors along which the degrees of freedom are meant")
    along["normal"] = _said(VECTOR, "in place of axes: x is along it")
    return _any(_table({**held, **along}, ["hold"]), _table({**held, **turned}, ["rotation", "history"]))


def _load(load: Any) -> Schema:
    chosen = {"nodes": _NODES, "edges": _NODES | _EDGES, "shell": {"elements": _ELEMENTS} if load.sets else {}}
    more, value = load_keys(load), _any(NUMBER, ARRAYS)
    properties = {"kind": {"const": load.kind}, **chosen[load.acts_on], load.value: value, "history": _HISTORY}
    properties |= {key: _OF_LOADS[key] for key in more}
    return _table(properties, ["kind", load.value, *(key for key, needed in more.items() if needed)])


def _item(kind: Any, one_of_several: bool) -> Schema:
    """A connector, an obstacle or the like: the arguments of its class, and its kind where there are several."""
    found = _arguments(kind, kind={"const": kind.kind})
    of_nodes, of_sides = _any(TEXT, COUNT, _list(COUNT)), _table(_NODES | {"inner": _EDGES["inner"]})
    at_point = _table({POINT: ARRAYS}, [POINT])
    chosen = {"node": _any(of_nodes, _table(_NODES), at_point), "element": _ELEMENTS}
    chosen["side"] = _any(TEXT, _PAIRS, of_sides)
    for name, parameter in inspect.signature(kind).parameters.items():
        if name in kind.sets:
            found["properties"][name] = chosen[kind.sets[name]]
        elif isinstance(parameter.default, bool):
            found["properties"][name] = SWITCH
        elif name == "name":
            found["properties"][name] = _said(TEXT, "by which it is watched")
        elif name not in _KNOWN:
            found["properties"][name] = _any(NUMBER, ARRAYS)
    return found | {"required": ["kind"] * one_of_several + found["required"]}


def _damping() -> Schema:
    modes, numbers = _any(COUNT, _list(COUNT)), _any(NUMBER, NUMBERS)
    return _any(
        _arguments(RayleighDamping),
        _table({"ratios": numbers, "modes": modes, "frequencies": numbers}, ["ratios"]),
    )


def _watch() -> Schema:
    component = _said(
        TEXT, 'ux, uy, uz, vx, vy, vz of a node; "von mises top", "Mxx" of an element; "force" of a connector'
    )
    of = {"nearest": VECTOR, "node": _any(COUNT, TEXT), "element": _any(COUNT, TEXT)}
    of |= {what: _said(TEXT, "its name") for what in ("connector", "obstacle")}
    return _table({**of, "component": component}, ["component"])


def _initial() -> Schema:
    return _table({**dict.fromkeys(MOTION, VECTOR), **_NODES})


def _run() -> Schema:
    """The keys of the run, and which of them an analysis has."""
    kinds = {
        "number": NUMBER,
        "count": {"type": "integer", "minimum": 1},
        "switch": SWITCH,
        "names": _any(TEXT, _list(TEXT)),
        "numbers": NUMBERS,
        "label": {**TEXT, "minLength": 1},
    }
    properties = {}
    for field in dataclasses.fields(RunSettings):
        kind, choices = field.metadata["kind"], list(field.metadata["choices"])
        found = kinds.get(kind, {"enum": choices})
        properties[field.name] = _said(found, field.metadata["help"]) if field.metadata["help"] else found
    rules = []
    for analysis in ANALYSES:
        said = {"properties": {"analysis": {"const": analysis}}}
        if analysis != ANALYSES[0]:
            said["required"] = ["analysis"]  # pyright: ignore[reportArgumentType]
        rules.append({"if": said, "then": {"propertyNames": {"enum": [key for key in OF if analysis in OF[key]]}}})
    return _table(properties, allOf=rules)
