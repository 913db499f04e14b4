"""Regions: several sections on one mesh, each on elements of its own."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.mesh import Mesh
from jaxshell.model.sections.base import AnySection, Layers, Patch, Resultants
from jaxshell.model.sets import check_on_mesh, element_numbers
from jaxshell.numerics.checks import check_kind, shown
from jaxshell.numerics.frozen import Frozen


class Regions(AnySection):
    """Several sections, each on elements of its own; `Scene` makes it of a dict or a list.

    Arguments:
        elements: for each region the numbers of its elements.
        sections: for each region its section. Values for single elements follow the region's order.
        names: for messages and pictures; numbers where they are left out.

    Raises ValueError for elements in two regions or in none, by name.
    """

    kind: ClassVar[str] = "regions"

    elements: tuple[Frozen, ...] = eqx.field(static=True)
    sections: tuple[AnySection, ...]
    names: tuple[str, ...] = eqx.field(static=True)

    def __init__(self, elements: Sequence, sections: Sequence[AnySection], names: Sequence[str] | None = None):
        if not isinstance(elements, list | tuple) or not isinstance(sections, list | tuple) or not sections:
            raise ValueError("Regions need a list of elements and a list of sections, at least one.")
        names = tuple(str(k) for k in range(len(sections))) if names is None else tuple(names)
        if not len(elements) == len(sections) == len(names):
            raise ValueError(f"{len(elements)} lists of elements, {len(sections)} sections, {len(names)} names.")
        for name, section in zip(names, sections, strict=True):
            check_kind(f"section {name!r}", section, AnySection, "a section such as jaxshell.Section")
            if isinstance(section, Regions):
                raise ValueError(f"section {name!r} is made of regions itself: give them one by one.")
        self.elements = tuple(
            e if isinstance(e, Frozen) else element_numbers(f"elements of section {name!r}", e)
            for name, e in zip(names, elements, strict=True)
        )
        self.sections, self.names = tuple(sections), names

    @classmethod
    def of(cls, mesh: Mesh, given: Mapping | Sequence) -> "Regions":
        """From {name of an element set: section}, or [(elements or name, section), ...]. Raises ValueError naming a
        set that the mesh does not have."""
        pairs = list(given.items()) if isinstance(given, Mapping) else list(given)
        names, elements, sections = [], [], []
        for position, pair in enumerate(pairs):
            if not isinstance(pair, list | tuple) or len(pair) != 2:
                raise ValueError(f"section must list pairs (elements, section), but entry {position} is {shown(pair)}.")
            where, section = pair
            names.append(where if isinstance(where, str) else str(position))
            elements.append(mesh.element_set(where) if isinstance(where, str) else where)
            sections.append(section)
        return cls(elements, sections, names)

    def check(self, mesh: Mesh | Patch) -> None:
        self._order(mesh)
        for name, section, patch in zip(self.names, self.sections, self._patches(mesh), strict=True):
            try:
                section.check(patch)
            except ValueError as error:
                raise ValueError(f"section {name!r}: {error}") from error

    def resultants(self, mesh: Mesh | Patch) -> Resultants:
        found = [section.resultants(patch) for section, patch in self._parts(mesh)]
        for name, shape in (("B", (3, 3)), ("first_moment", ())):
            if any(getattr(r, name) is not None for r in found):
                found = [_with_zeros(r, name, shape) for r in found]
        return self._joined(mesh, found)

    def layers(self, mesh: Mesh | Patch) -> Layers | None:
        found = []
        for section, patch in self._parts(mesh):
            layers = section.layers(patch)
            if layers is None:
                return None
            found.append(layers)
        most = max(layers.z.shape[1] for layers in found)
        return self._joined(mesh, [_padded(layers, most) for layers in found])

    def thermal_resultants(self, mesh: Mesh | Patch) -> Float[Array, "m 3 3"] | None:
        found = [section.thermal_resultants(patch) for section, patch in self._parts(mesh)]
        return None if any(part is None for part in found) else self._joined(mesh, found)

    def direction_angles(self, mesh: Mesh | Patch) -> Float[Array, " m"] | None:
        found = [section.direction_angles(patch) for section, patch in self._parts(mesh)]
        return None if any(part is None for part in found) else self._joined(mesh, found)

    def shapes(self, mesh: Mesh | Patch) -> np.ndarray:
        return np.concatenate([section.shapes(patch) for section, patch in self._parts(mesh)])[self._order(mesh)]

    def has_first_moment(self, mesh: Mesh | Patch) -> bool:
        return any(section.has_first_moment(patch) for section, patch in self._parts(mesh))

    def expands(self, mesh: Mesh | Patch) -> bool | None:
        found = [section.expands(patch) for section, patch in self._parts(mesh)]
        return None if any(part is None for part in found) else any(found)

    def _patches(self, mesh: Mesh | Patch) -> list[Patch]:
        return [Patch(mesh.nodes, Frozen(mesh.triangles[e.array])) for e in self.elements]

    def _parts(self, mesh: Mesh | Patch):
        return list(zip(self.sections, self._patches(mesh), strict=True))

    def _joined(self, mesh: Mesh | Patch, parts: list) -> Any:
        """Values of the regions in the order of the mesh's elements."""
        order = self._order(mesh)
        return jax.tree.map(lambda *values: jnp.concatenate(values)[order], *parts)

    def _order(self, mesh: Mesh | Patch) -> np.ndarray:
        """(m,) where each element of the mesh stands in the regions, one after the other."""
        owner = np.full(mesh.n_elements, -1)
        for k, (name, elements) in enumerate(zip(self.names, self.elements, strict=True)):
            numbers = elements.array
            check_on_mesh(f"section {name!r}", "element", numbers, mesh.n_elements)
            both = numbers[owner[numbers] >= 0]
            if both.size:
                raise ValueError(
                    f"Element {both[0]} (and {both.size - 1} others) belongs to section "
                    f"{self.names[owner[both[0]]]!r} and to section {name!r}."
                )
            owner[numbers] = k
        if (owner < 0).any():
            raise ValueError(
                f"Element {int(np.argmax(owner < 0))} (and {int((owner < 0).sum()) - 1} others) belongs to no section."
            )
        return np.argsort(np.concatenate([e.array for e in self.elements]))


def region_of_elements(section: AnySection, mesh: Mesh | Patch) -> np.ndarray | None:
    """(m,) the number of the region that every element is in; None of a section that has none."""
    if not isinstance(section, Regions):
        return None
    region = np.zeros(mesh.n_elements, np.int64)
    for number, elements in enumerate(section.elements):
        region[elements.array] = number
    return region


def _with_zeros(resultants: Resultants, name: str, shape: tuple[int, ...]) -> Resultants:
    if getattr(resultants, name) is not None:
        return resultants
    zero = jnp.zeros((len(resultants.mass_per_area), *shape))
    return eqx.tree_at(lambda r: getattr(r, name), resultants, zero, is_leaf=lambda leaf: leaf is None)


def _padded(layers: Layers, most: int) -> Layers:
    """With `most` layers: the last one repeated, with no thickness."""
    spare = most - layers.z.shape[1]
    padded = jax.tree.map(lambda a: jnp.concatenate([a] + [a[:, -1:]] * spare, axis=1), layers)
    flat = padded.z.at[:, layers.z.shape[1] :, 0].set(padded.z[:, layers.z.shape[1] :, 1])
    return eqx.tree_at(lambda p: p.z, padded, flat)
