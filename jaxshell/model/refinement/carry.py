"""Sections, loads, masses, connectors and obstacles on a mesh whose triangles are cut.

What is given by element goes to its children, by edge to its halves, at a node it stays there; values for each of
several elements or edges are those of their children and halves. Which fields hold one value for each, their shapes in
the classes say ("*m", "*k 3"). What joins or touches all that lies between its nodes takes new nodes in: rigid bodies,
ties, joints of two edges, obstacles. Springs, dashpots and point masses stay what and where they are.
"""

import dataclasses
import functools
import typing
from collections.abc import Iterator, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np

from jaxshell.model.connectors import EdgeTie, Hinge, RigidBody, Slider, Spherical, Tie
from jaxshell.model.connectors.base import Connector
from jaxshell.model.connectors.ends import Nodes
from jaxshell.model.connectors.joint import Joint
from jaxshell.model.damping import RayleighDamping
from jaxshell.model.edges import Edges
from jaxshell.model.loads import Load
from jaxshell.model.masses import PointMass
from jaxshell.model.obstacles import Obstacle
from jaxshell.model.refinement.split import Split
from jaxshell.model.sections import AnySection, Regions
from jaxshell.numerics.frozen import Frozen

_FIELDS = {"nodes": "node", "edges": "side", "elements": "element"}
"""What static numbers in a field of this name are, where a class does not say."""
_SEAMS = (Hinge, Slider, Spherical, Tie)
"""Joints that hold what lies between two pairs of nodes too, where these are the ends of edges."""


def carried_section(section: AnySection, split: Split) -> AnySection:
    """The section with values for each element on its children."""
    return _repeated(section, split, split.rows_of_elements())


def carried_damping(damping: RayleighDamping | None, split: Split) -> RayleighDamping | None:
    return None if damping is None else _repeated(damping, split, split.rows_of_elements())


def carried_load(load: Load, split: Split) -> Load:
    """The load with the same resultants. Raises ValueError for one that says numbers which are not known."""
    kinds = {field.name: kind_of(load, field.name) for field in dataclasses.fields(load)}
    rows = None
    for name, kind in kinds.items():
        value = getattr(load, name)
        if kind == "side":
            rows = split.rows_of_edges(value.array)
        elif name == "elements":
            rows = split.rows_of_elements(None if value is None else value.array)
    return _repeated(load, split, rows, **_numbers(load, kinds, split))


def carried_mass(mass: PointMass, split: Split) -> PointMass:
    return dataclasses.replace(mass, nodes=Frozen(split.nodes(mass.nodes.array)))


def carried_obstacle(obstacle: Obstacle, split: Split) -> Obstacle:
    if obstacle.nodes is None:
        return obstacle
    return dataclasses.replace(obstacle, nodes=with_between(obstacle.nodes.array, split))


def carried_connector(item: Connector, split: Split) -> list[Connector]:
    """The connector, and a second one where its options stay at its pairs of nodes and new ones have none."""
    kinds = {field.name: kind_of(item, field.name) for field in dataclasses.fields(item)}
    numbers = _numbers(item, kinds, split)
    for field in dataclasses.fields(item):
        value = getattr(item, field.name)
        if isinstance(value, Nodes):
            numbers[field.name] = Nodes(Frozen(split.nodes(value.nodes.array)))
    if isinstance(item, RigidBody | EdgeTie) and item.nodes.array.size:
        numbers["nodes"] = with_between(item.nodes.array, split)
    if isinstance(item, EdgeTie):
        numbers["edges"] = Frozen(split.halves(np.unique(item.edges.array, axis=0)))
    stays = dataclasses.replace(item, **numbers)
    if not isinstance(item, _SEAMS):
        return [stays]
    more = _pairs_between(item, split)
    if not len(more):
        return [stays]
    if isinstance(item, Hinge) and len(stays.parts()) > 2:
        return [stays, Hinge(Frozen(more[:, 0]), Frozen(more[:, 1]), item.axis)]
    both = np.concatenate([stays.pairs.array, more])  # pyright: ignore[reportAttributeAccessIssue]
    return [dataclasses.replace(stays, a=Frozen(both[:, 0]), b=Frozen(both[:, 1]))]


def with_between(nodes: np.ndarray, split: Split) -> Frozen:
    """A set of nodes, in their order, and the new ones that belong to it."""
    return Frozen(np.concatenate([split.nodes(nodes), split.middle[split.between(nodes)]]))


def _pairs_between(joint: Joint, split: Split) -> np.ndarray:
    """(p, 2) new nodes between pairs that are joined: the middles of edges on both sides, or a node common to two."""
    found = set()
    for edge, ends in _edges_across(joint, split.between(joint.pairs.array[:, 0]), split.edges):
        if ends[0] == ends[1]:
            found.add((int(split.middle[edge]), int(split.nodes(ends[0]))))
        elif (across := int(split.edges.numbers(ends[None])[0])) >= 0:
            found.add((int(split.middle[edge]), int(split.middle[across])))
    return np.array(sorted(found), np.int64).reshape(-1, 2)


def _edges_across(joint: Joint, numbers: np.ndarray, edges: Edges) -> Iterator[tuple[int, np.ndarray]]:
    """Each of the edges on a joint's first side with the two nodes that its ends are joined to."""
    a, b = joint.pairs.array.T
    at: dict[int, list[int]] = {}
    for pair, node in enumerate(a):
        at.setdefault(int(node), []).append(pair)
    for edge in numbers:
        first, second = edges.ends[edge].tolist()
        for one in at.get(first, []):
            for other in at.get(second, []):
                yield int(edge), b[[one, other]]


def joined_edges(connectors: Sequence[Connector], edges: Edges) -> np.ndarray:
    """(j, 2) pairs of edges that joints hold together: their middles must come together too."""
    found = []
    for joint in connectors:
        if isinstance(joint, _SEAMS):
            side = np.flatnonzero(np.all(np.isin(edges.ends, joint.pairs.array[:, 0]), axis=1))
            found += [(edge, int(edges.numbers(ends[None])[0])) for edge, ends in _edges_across(joint, side, edges)]
    pairs = np.array(found, np.int64).reshape(-1, 2)
    return pairs[pairs[:, 1] >= 0]


def kind_of(item: Any, name: str) -> str | None:
    """Whether the numbers of a field are of nodes, edges or elements; None of a field that holds none."""
    return getattr(item, "sets", {}).get(name, _FIELDS.get(name))


def _numbers(item: Any, kinds: dict[str, str | None], split: Split) -> dict[str, Any]:
    """The static numbers of its fields afterwards. Raises ValueError for numbers of what is not known."""
    found = {}
    for name, kind in kinds.items():
        value = getattr(item, name)
        if not isinstance(value, Frozen):
            continue
        if kind is None:
            raise ValueError(
                f"{type(item).__name__} keeps numbers in {name}, and whether they are of nodes, edges or elements is "
                "not known: state it in the class, as sets = {" + repr(name) + ': "node"}.'
            )
        carry = {"node": split.nodes, "side": split.halves, "element": split.elements}[kind]
        found[name] = Frozen(carry(value.array))
    return found


def _repeated(item: Any, split: Split, rows: np.ndarray | None, **changed: Any) -> Any:
    """With those `rows` (None: all) of values for each of several elements or edges, in all that it is made of."""
    if isinstance(item, Regions):
        parts = zip(item.sections, item.elements, strict=True)
        sections = [_repeated(part, split, split.rows_of_elements(numbers.array)) for part, numbers in parts]
        return Regions([Frozen(split.elements(numbers.array)) for numbers in item.elements], sections, item.names)
    for field in dataclasses.fields(item):
        value, axes = getattr(item, field.name), axes_of_one(type(item)).get(field.name)
        if isinstance(value, eqx.Module):
            changed[field.name] = _repeated(value, split, rows)
        elif isinstance(value, tuple) and any(isinstance(part, eqx.Module) for part in value):
            changed[field.name] = tuple(_repeated(part, split, rows) for part in value)
        elif rows is not None and axes is not None and isinstance(value, jax.Array) and value.ndim > axes:
            changed[field.name] = value[rows]
    return dataclasses.replace(item, **changed) if changed else item


@functools.cache
def axes_of_one(kind: type) -> dict[str, int]:
    """Fields that hold one value or one for each of several, and how many axes one has, as their shapes say."""
    found = {"direction": 1}
    for name, hint in typing.get_type_hints(kind).items():
        for part in (hint, *typing.get_args(hint)):
            axes = str(getattr(part, "dim_str", "")).split()
            if axes and axes[0].startswith("*"):
                found[name] = len(axes) - 1
    return found
