"""Sections, loads, masses, connectors and obstacles on a mesh whose triangles are cut in four.

What is given by element goes to its children, by edge to its halves, at a node it stays there; values for each of
several elements or edges are those of their children and halves. Which fields hold one value for each, their shapes in
the classes say ("*m", "*k 3"). What joins or touches all that lies between its nodes takes new nodes in: rigid bodies,
ties, joints of two edges, obstacles. Springs, dashpots and point masses stay what and where they are.
"""

import dataclasses
import functools
import typing
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxshell.model.connectors import EdgeTie, Hinge, RigidBody, Slider, Spherical, Tie
from jaxshell.model.connectors.base import Connector
from jaxshell.model.connectors.ends import Nodes
from jaxshell.model.connectors.joint import Joint
from jaxshell.model.damping import RayleighDamping
from jaxshell.model.loads import Load
from jaxshell.model.masses import PointMass
from jaxshell.model.obstacles import Obstacle
from jaxshell.model.refinement.split import CHILDREN, Split
from jaxshell.model.sections import AnySection
from jaxshell.numerics.frozen import Frozen

_FIELDS = {"nodes": "node", "edges": "side", "elements": "element"}
"""What static numbers in a field of this name are, where a class does not say."""
_SEAMS = (Hinge, Slider, Spherical, Tie)
"""Joints that hold what lies between two pairs of nodes too, where these are the ends of edges."""


def carried_section(section: AnySection, split: Split) -> AnySection:
    """The section with values for each element on its children."""
    return _repeated(section, split, CHILDREN)


def carried_damping(damping: RayleighDamping | None, split: Split) -> RayleighDamping | None:
    return None if damping is None else _repeated(damping, split, CHILDREN)


def carried_load(load: Load, split: Split) -> Load:
    """The load with the same resultants. Raises ValueError for one that says numbers which are not known."""
    kinds = {field.name: kind_of(load, field.name) for field in dataclasses.fields(load)}
    times = 2 if "side" in kinds.values() else CHILDREN if "elements" in kinds else 1
    return _repeated(load, split, times, **_numbers(load, kinds, split))


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
    return Frozen(np.concatenate([split.nodes(nodes), split.n_shell + split.between(nodes)]))


def _pairs_between(joint: Joint, split: Split) -> np.ndarray:
    """(p, 2) new nodes between pairs that are joined: the middles of edges on both sides, or a node common to two."""
    (a, b), edges = joint.pairs.array.T, split.edges
    at: dict[int, list[int]] = {}
    for pair, node in enumerate(a):
        at.setdefault(int(node), []).append(pair)
    found = set()
    for edge in split.between(a):
        first, second = edges.ends[edge].tolist()
        for one in at[first]:
            for other in at[second]:
                ends = b[[one, other]]
                if ends[0] == ends[1]:
                    found.add((split.n_shell + int(edge), int(split.nodes(ends[0]))))
                elif (across := int(edges.numbers(ends[None])[0])) >= 0:
                    found.add((split.n_shell + int(edge), split.n_shell + across))
    return np.array(sorted(found), np.int64).reshape(-1, 2)


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


def _repeated(item: Any, split: Split, times: int, **changed: Any) -> Any:
    """With values for each of several elements or edges as often as these have children, in all that it is made of."""
    for field in dataclasses.fields(item):
        value, axes = getattr(item, field.name), axes_of_one(type(item)).get(field.name)
        if isinstance(value, eqx.Module):
            changed[field.name] = _repeated(value, split, times)
        elif isinstance(value, tuple) and any(isinstance(part, eqx.Module) for part in value):
            changed[field.name] = tuple(_repeated(part, split, times) for part in value)
        elif isinstance(item, AnySection) and isinstance(value, tuple) and field.name == "elements":
            changed[field.name] = tuple(Frozen(split.elements(numbers.array)) for numbers in value)
        elif axes is not None and isinstance(value, jax.Array) and value.ndim > axes:
            changed[field.name] = jnp.repeat(value, times, axis=0)
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
