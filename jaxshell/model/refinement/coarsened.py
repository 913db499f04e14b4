"""`coarsen`: four triangles in one, and the scene on the coarser mesh."""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxshell.model.connectors import RigidBody
from jaxshell.model.gauge import gauge_of
from jaxshell.model.initial import Initial
from jaxshell.model.loads import NodalForce, NodalMoment
from jaxshell.model.mesh import Mesh
from jaxshell.model.refinement.carry import axes_of_one, kind_of, with_between
from jaxshell.model.refinement.family import Family
from jaxshell.model.refinement.refined import MeshOrScene
from jaxshell.model.refinement.split import Split
from jaxshell.model.scene import Scene
from jaxshell.model.sections import AnySection
from jaxshell.numerics.checks import check_kind
from jaxshell.numerics.frozen import Frozen


def coarsen(of: MeshOrScene) -> MeshOrScene:
    """A scene, or a mesh, with every four triangles made one: the way back of `refine`.

    For meshes that were refined, and for grids of generated triangles with even divisions, which these then are halves
    of. Loads keep their resultant forces: forces and moments on nodes that go are shared by their neighbours. Values of
    four elements or two edges become their mean. Raises ValueError for other meshes, and naming what a coarser mesh can
    not say: sets, supports, elements and edges that are not whole on it, and whatever else is on a node that goes.
    """
    check_kind("coarsen's argument", of, Mesh | Scene, "a jaxshell.Scene or a jaxshell.Mesh")
    if isinstance(of, Mesh):
        return _Coarse(of).mesh
    return _scene(of, _Coarse(of.mesh))


class _Coarse:
    """The coarse mesh, and what numbers of the fine one are there."""

    def __init__(self, fine: Mesh):
        self.family = Family(fine)
        nodes = fine.nodes[self.family.kept]
        plain = Mesh(nodes, self.family.triangles, coincident="allow", points=fine.points)
        self.split = Split(plain)
        sets = {name: _named(f"node_sets {name!r}", self.closed, of) for name, of in fine.node_sets.items()}
        elements = {name: _named(f"element_sets {name!r}", self.whole, of) for name, of in fine.element_sets.items()}
        sides = {name: _named(f"side_sets {name!r}", self.joined, of) for name, of in fine.side_sets.items()}
        self.mesh = Mesh(
            nodes,
            self.family.triangles,
            coincident="allow",
            node_sets=sets,
            element_sets={name: found for name, (found, _) in elements.items()},
            side_sets={name: found for name, (found, _) in sides.items()},
            points=fine.points,
            surface=fine.surface,
        )

    def nodes(self, numbers: np.ndarray) -> np.ndarray:
        """Of nodes that stay. Raises ValueError for one that goes."""
        gone = numbers[self.family.number[numbers] < 0]
        if gone.size:
            raise ValueError(f"node {gone[0]} is in the middle of an edge, and the coarser mesh does not have it.")
        return self.family.number[numbers]

    def closed(self, numbers: np.ndarray) -> np.ndarray:
        """A set of nodes that refined is this one. Raises ValueError where there is none."""
        kept = self.family.number[numbers]
        kept = kept[kept >= 0]
        again = self.family.fine(self.split, with_between(kept, self.split).array) if kept.size else kept
        if not np.array_equal(np.unique(again), np.unique(numbers)):
            raise ValueError("no nodes of the coarser mesh say the same, with what lies between them.")
        return kept

    def whole(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Elements of which all four are there, and (p, 4) where they stand. Raises ValueError for others."""
        found = np.unique(self.family.parent[numbers])
        return found, _places(numbers, self.family.children[found], "elements")

    def joined(self, pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Edges (p, 2) of which both halves are there, and where they stand. Raises ValueError for others."""
        order = np.argsort(self.family.number[pairs] >= 0, axis=1, kind="stable")
        middle, kept = np.take_along_axis(pairs, order, axis=1).T
        alone = self.family.ends[middle][:, 0] < 0
        if alone.any():
            raise ValueError(f"the edge {pairs[np.argmax(alone)].tolist()} is half of none.")
        middles = np.unique(middle)
        ends = self.family.ends[middles]
        key = middle * len(self.family.number) + kept
        wanted = middles[:, None] * len(self.family.number) + self.family.kept[ends]
        return ends, _places(key, wanted, "edges")


def _named(what: str, function, numbers: np.ndarray):
    """What a function makes of a set. Raises its ValueError with the set's name."""
    try:
        return function(numbers)
    except ValueError as error:
        raise ValueError(f"{what}: {error}") from error


def _places(numbers: np.ndarray, wanted: np.ndarray, what: str) -> np.ndarray:
    """Where the `wanted` (p, c) stand among numbers. Raises ValueError unless every one is there, and once."""
    order = np.argsort(numbers)
    at = order[np.minimum(np.searchsorted(numbers[order], wanted), len(numbers) - 1)]
    if len(numbers) != wanted.size or not np.array_equal(numbers[at], wanted):
        raise ValueError(f"some of the {what} that are one on the coarser mesh are not among them.")
    return at


def _scene(scene: Scene, coarse: _Coarse) -> Scene:
    def each(what: str, items, change) -> list:
        found = []
        for position, item in enumerate(items):
            try:
                found.append(change(item, coarse))
            except ValueError as error:
                raise ValueError(f"{what} {position}: {error}") from error
        return found

    everything = np.arange(scene.mesh.n_elements)
    return Scene(
        coarse.mesh,
        _meaned(scene.section, coarse, coarse.whole(everything)[1]),
        each("support", scene.supports, _support),
        each("load", scene.loads, _item),
        initial=_initial(scene.initial, coarse),
        name=scene.name,
        watch=each("watch", scene.watch, _watch),
        defaults=scene.defaults,
        damping=None if scene.damping is None else _meaned(scene.damping, coarse, coarse.whole(everything)[1]),
        masses=each("mass", scene.masses, _item),
        connectors=each("connector", scene.connectors, _connector),
        obstacles=each("obstacle", scene.obstacles, _obstacle),
    )


def _support(support, coarse: _Coarse):
    nodes, rows = coarse.closed(support.nodes.array), coarse.family.number[support.nodes.array] >= 0
    values = {name: getattr(support, name) for name in ("displacement", "acceleration")}
    values = {name: value[rows] for name, value in values.items() if value is not None and value.ndim == 2}
    return dataclasses.replace(support, nodes=Frozen(nodes), **values)


def _item(item: Any, coarse: _Coarse) -> Any:
    """A load or a mass."""
    if isinstance(item, NodalForce | NodalMoment):
        return _shared(item, coarse)
    changed, places = {}, None
    for field in dataclasses.fields(item):
        value, kind = getattr(item, field.name), kind_of(item, field.name)
        if field.name == "elements" and value is None:
            places = coarse.whole(np.arange(len(coarse.family.parent)))[1]
        if not isinstance(value, Frozen):
            continue
        if kind == "node":
            changed[field.name] = Frozen(coarse.nodes(value.array))
        else:
            found, places = (coarse.whole if kind == "element" else coarse.joined)(value.array)
            changed[field.name] = Frozen(found)
    return dataclasses.replace(item, **changed) if places is None else _meaned(item, coarse, places, **changed)


def _shared(load: NodalForce | NodalMoment, coarse: _Coarse):
    """Forces on nodes that go, by halves on the ends of their edges."""
    family, numbers = coarse.family, load.nodes.array
    values = jnp.broadcast_to(getattr(load, load.value), (len(numbers), 3))
    stays = family.number[numbers] >= 0
    if stays.all():
        return dataclasses.replace(load, nodes=Frozen(family.number[numbers]))
    to = np.where(stays[:, None], family.number[numbers][:, None], family.ends[numbers])
    nodes, at = np.unique(to, return_inverse=True)
    shares = jnp.zeros((len(nodes), 3)).at[at.reshape(to.shape)].add(0.5 * values[:, None])
    return dataclasses.replace(load, **{"nodes": Frozen(nodes), load.value: shares})


def _connector(item, coarse: _Coarse):
    if isinstance(item, RigidBody):
        reference = item.reference if item.reference is None else Frozen(coarse.nodes(item.reference.array))
        return dataclasses.replace(item, nodes=Frozen(coarse.closed(item.nodes.array)), reference=reference)
    changed = {}
    for field in dataclasses.fields(item):
        value = getattr(item, field.name)
        if isinstance(value, Frozen):
            if kind_of(item, field.name) != "node":
                raise ValueError(f"{item.kind} is not coarsened: state it on the coarser mesh.")
            changed[field.name] = Frozen(coarse.nodes(value.array))
        elif isinstance(getattr(value, "nodes", None), Frozen):
            changed[field.name] = type(value)(Frozen(coarse.nodes(value.nodes.array)))
    return dataclasses.replace(item, **changed)


def _obstacle(obstacle, coarse: _Coarse):
    if obstacle.nodes is None:
        return obstacle
    return dataclasses.replace(obstacle, nodes=Frozen(coarse.closed(obstacle.nodes.array)))


def _watch(entry: tuple, coarse: _Coarse) -> tuple:
    label, number, component = entry
    if isinstance(number, str):
        return entry
    if gauge_of(component) is not None:
        return label, int(coarse.family.parent[number]), component
    return label, int(coarse.nodes(np.array([number]))[0]), component


def _initial(initial: Initial | None, coarse: _Coarse) -> Initial | None:
    if initial is None:
        return None
    given = {field.name: getattr(initial, field.name) for field in dataclasses.fields(initial)}
    return Initial(**{name: None if value is None else value[coarse.family.kept] for name, value in given.items()})


def _meaned(item: Any, coarse: _Coarse, places: np.ndarray, **changed: Any) -> Any:
    """With the mean of the values that stand at `places` (p, c) for each, in all that it is made of."""
    for field in dataclasses.fields(item):
        value, axes = getattr(item, field.name), axes_of_one(type(item)).get(field.name)
        if isinstance(value, tuple) and isinstance(item, AnySection) and field.name == "elements":
            found = [coarse.whole(numbers.array) for numbers in value]
            changed["elements"] = tuple(Frozen(numbers) for numbers, _ in found)
            pairs = zip(item.sections, (at for _, at in found), strict=True)  # pyright: ignore[reportAttributeAccessIssue]
            changed["sections"] = tuple(_meaned(part, coarse, at) for part, at in pairs)
        elif field.name in changed:
            continue
        elif dataclasses.is_dataclass(value):
            changed[field.name] = _meaned(value, coarse, places)
        elif isinstance(value, tuple) and any(dataclasses.is_dataclass(part) for part in value):
            changed[field.name] = tuple(_meaned(part, coarse, places) for part in value)
        elif axes is not None and getattr(value, "ndim", 0) > axes:
            changed[field.name] = value[places].mean(axis=1)
    return dataclasses.replace(item, **changed) if changed else item
