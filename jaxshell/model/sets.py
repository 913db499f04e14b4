"""Named sets of nodes, elements and sides (edges), as static data, and what is stated of a set by its name."""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

import equinox as eqx
import numpy as np

from jaxshell.numerics.checks import node_indices, shown, whole_array
from jaxshell.numerics.frozen import Frozen
from jaxshell.numerics.nearest import meant


class Sets(Mapping):
    """Name → numbers (k,), ascending, each once; of sides the pairs (k, 2) of their ends."""

    def __init__(self, what: str, given: Mapping | None, count: int, ends: int = 1):
        """`what` (such as "element") and how many there are, for messages; sides have two `ends`, out of the nodes.

        Raises ValueError for numbers out of range, empty sets, and names that are no text.
        """
        if given is not None and not isinstance(given, Mapping):
            raise ValueError(f"{what}_sets must be {{name: numbers}}, but it is {shown(given)}.")
        self.what = what
        self._sets: dict[str, Frozen] = {}
        for name, numbers in ({} if given is None else given).items():
            if not isinstance(name, str) or not name:
                raise ValueError(f"The name of a set of {what}s must be a text, but it is {shown(name)}.")
            array = whole_array(f"{what}_sets {name!r}", getattr(numbers, "array", numbers))
            if not array.size:
                raise ValueError(f"{what}_sets {name!r} is empty.")
            if array.min() < 0 or array.max() >= count:
                bad = array.min() if array.min() < 0 else array.max()
                of = what if ends == 1 else "node"
                raise ValueError(f"{what}_sets {name!r} names {of} {bad}, but the mesh has 0 to {count - 1}.")
            if ends == 1:
                self._sets[name] = Frozen(np.unique(array))
            elif array.ndim == 2 and array.shape[1] == ends:
                self._sets[name] = Frozen(np.unique(np.sort(array, axis=1), axis=0))
            else:
                raise ValueError(f"{what}_sets {name!r} must be pairs of nodes (k, 2), but has shape {array.shape}.")

    def __getitem__(self, name: str) -> np.ndarray:
        return self._sets[name].array

    def __iter__(self) -> Iterator[str]:
        return iter(self._sets)

    def __len__(self) -> int:
        return len(self._sets)

    def __hash__(self) -> int:
        return hash(tuple(self._sets.items()))

    def __eq__(self, other) -> bool:
        return isinstance(other, Sets) and list(self._sets.items()) == list(other._sets.items())

    def __repr__(self) -> str:
        return f"Sets({', '.join(f'{name}: {len(array)}' for name, array in self.items())})"

    def chosen(self, name: str) -> np.ndarray:
        """A set by its name. Raises ValueError that lists those that there are."""
        if name not in self._sets:
            known = f"those of the mesh are {', '.join(map(repr, self))}" if self else "the mesh has none"
            raise ValueError(f"There is no set of {self.what}s {shown(name)}: {known}.{meant(name, self)}")
        return self[name]


class SetName(str):
    """The name of a set, in place of the numbers that a mesh has under it."""

    @property
    def array(self) -> np.ndarray:
        raise ValueError(f"The set {str(self)!r} has numbers on a mesh only: a Scene looks them up.")


class OfSets(eqx.Module):
    """What acts on nodes, elements or sides, which a set's name may stand for until it is in a scene."""

    sets: ClassVar[dict[str, str]] = {}
    """Fields that a name may stand in, with the kind of set: "node", "element" or "side"."""

    def on(self, mesh: Any) -> "OfSets":
        """The same with numbers in place of names. Raises ValueError for a set that the mesh does not have."""
        names = {field: getattr(self, field) for field in self.sets}
        found = {
            field: getattr(mesh, f"{self.sets[field]}_sets").chosen(str(name))
            for field, name in names.items()
            if isinstance(name, SetName)
        }
        return dataclasses.replace(self, **found) if found else self


def nodes_or_name(name: str, nodes) -> Frozen | SetName:
    """Indices of nodes, or the name of a set of them. Raises ValueError calling it `name` for anything else."""
    if isinstance(nodes, str):
        return SetName(nodes)
    return Frozen(node_indices(name, nodes))


def elements_or_name(elements) -> Frozen | SetName | None:
    """Numbers of elements, each once, or the name of a set; None is all. Raises ValueError for anything else."""
    if elements is None or isinstance(elements, Frozen):
        return elements
    return SetName(elements) if isinstance(elements, str) else element_numbers("elements", elements)


def element_numbers(name: str, elements) -> Frozen:
    """Numbers of elements, each once. Raises ValueError calling them `name` for anything else."""
    numbers = np.atleast_1d(whole_array(name, elements))
    if numbers.ndim != 1 or not numbers.size:
        raise ValueError(f"{name} must be a list of numbers, at least one, but is {shown(elements)}.")
    if len(np.unique(numbers)) < len(numbers):
        raise ValueError(f"{name} names an element twice.")
    return Frozen(numbers)


def check_on_mesh(what: str, kind: str, numbers: np.ndarray, count: int) -> None:
    """Raise ValueError where `what` names a node or an element (`kind`) beyond the `count` that the mesh has."""
    outside = (numbers < 0) | (numbers >= count)
    if outside.any():
        raise ValueError(f"{what} names {kind} {numbers[outside][0]}, but the mesh has {kind}s 0 to {count - 1}.")


def size_of(where: Frozen | SetName) -> int | None:
    """How many there are; None of a set that is known by its name only."""
    return None if isinstance(where, SetName) else len(where.array)
