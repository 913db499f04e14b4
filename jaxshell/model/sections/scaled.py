"""A section whose stiffness is that of another times a factor for every element: what sensitivities differentiate."""

from typing import ClassVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.mesh import Mesh
from jaxshell.model.sections.base import AnySection, Layers, Patch, Resultants
from jaxshell.model.sections.regions import Regions


class Scaled(AnySection):
    """Stiffnesses, and stresses with them, times a factor in every element; masses and free strains as they are."""

    kind: ClassVar[str] = "scaled"

    section: AnySection
    factors: Float[jax.Array, " m"]

    def resultants(self, mesh: Mesh | Patch) -> Resultants:
        found = self.section.resultants(mesh)
        names = ("A", "D") if found.B is None else ("A", "B", "D")
        scaled = [getattr(found, name) * self._factors for name in names]
        return eqx.tree_at(lambda r: [getattr(r, name) for name in names], found, scaled)

    def layers(self, mesh: Mesh | Patch) -> Layers | None:
        found = self.section.layers(mesh)
        return (
            None if found is None else eqx.tree_at(lambda layers: layers.C, found, found.C * self._factors[..., None])
        )

    def thermal_resultants(self, mesh: Mesh | Patch) -> Float[Array, "m 3 3"] | None:
        found = self.section.thermal_resultants(mesh)
        return None if found is None else found * self._factors

    def direction_angles(self, mesh: Mesh | Patch) -> Float[Array, " m"] | None:
        return self.section.direction_angles(mesh)

    def shapes(self, mesh: Mesh | Patch) -> np.ndarray:
        return self.section.shapes(mesh)

    def check(self, mesh: Mesh | Patch) -> None:
        self.section.check(mesh)

    @property
    def _factors(self) -> Float[Array, "m 1 1"]:
        return self.factors[:, None, None]


def scaled(section: AnySection, factors: Float[Array, " m"]) -> AnySection:
    """The section with its stiffness times factors (m,), in every region of it where it has some."""
    if not isinstance(section, Regions):
        return Scaled(section, factors)
    parts = zip(section.sections, section.elements, strict=True)
    return Regions(section.elements, [Scaled(part, factors[where.array]) for part, where in parts], section.names)
