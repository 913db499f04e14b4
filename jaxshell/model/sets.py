"""Named sets of elements, as static data: a mapping that hashes and compares by content."""

from collections.abc import Iterator, Mapping

import numpy as np

from jaxshell.numerics.checks import shown, whole_array
from jaxshell.numerics.frozen import Frozen


class Sets(Mapping):
    """Name → numbers (k,), ascending, each once."""

    def __init__(self, what: str, given: Mapping | None, count: int):
        """`what` (such as "element") and how many there are, for messages. Raises ValueError for numbers out of range,
        empty sets, and names that are no text."""
        if given is not None and not isinstance(given, Mapping):
            raise ValueError(f"{what}_sets must be {{name: numbers}}, but it is {shown(given)}.")
        self._sets: dict[str, Frozen] = {}
        for name, numbers in ({} if given is None else given).items():
            if not isinstance(name, str) or not name:
                raise ValueError(f"The name of a set of {what}s must be a text, but it is {shown(name)}.")
            array = np.unique(whole_array(f"{what}_sets {name!r}", getattr(numbers, "array", numbers)))
            if not array.size:
                raise ValueError(f"{what}_sets {name!r} is empty.")
            if array[0] < 0 or array[-1] >= count:
                bad = array[0] if array[0] < 0 else array[-1]
                raise ValueError(f"{what}_sets {name!r} names {what} {bad}, but the mesh has 0 to {count - 1}.")
            self._sets[name] = Frozen(array)

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

    def chosen(self, what: str, name: str) -> np.ndarray:
        """A set by its name. Raises ValueError that lists those that there are."""
        if name not in self._sets:
            known = f"those of the mesh are {', '.join(map(repr, self))}" if self else "the mesh has none"
            raise ValueError(f"There is no set of {what}s {name!r}: {known}.")
        return self[name]
