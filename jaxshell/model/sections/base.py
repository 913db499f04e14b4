"""What every section offers: the stiffnesses and masses of a unit of the shell's surface, for every element.

The elements know nothing else of a section.
"""

import abc
from typing import ClassVar

import equinox as eqx
from jaxtyping import Array, Float

from jaxshell.model.mesh import Mesh


class Resultants(eqx.Module):
    """A unit of the shell's surface, in the element's axes (e1, e2): N = A ε + B κ, M = B ε + D κ."""

    A: Float[Array, "*m 3 3"]
    """Membrane stiffness [force/length]."""
    D: Float[Array, "*m 3 3"]
    """Bending stiffness [force·length]."""
    mass_per_area: Float[Array, "*m"]
    """M_ρ = ∫ρ dz, eq. (30) of Yang & Xia 2014 [mass/length²]."""
    rotary_inertia: Float[Array, "*m"]
    """∫ρ z² dz, the two equal entries of I_ρ⁰, eq. (32) [mass]."""
    beta0: Float[Array, "*m"]
    """Factor of the membrane's higher-order (drilling) stiffness, Felippa 2003."""
    B: Float[Array, "*m 3 3"] | None = None
    """Coupling of membrane and bending [force]; None where there is none."""


class AnySection(eqx.Module):
    """What every kind of section offers. Its fields are its keys in scene files."""

    kind: ClassVar[str]
    """Its name in scene files."""

    @abc.abstractmethod
    def resultants(self, mesh: Mesh) -> Resultants:
        """Resultants (m, ...) of the elements of `mesh`, each in its own axes. Differentiable.

        Raises ValueError where the section does not fit the mesh.
        """

    def check(self, mesh: Mesh) -> None:
        """Raise ValueError where the section does not fit the mesh; called when the scene is made."""

    def mass_per_area(self, mesh: Mesh) -> Float[Array, " m"]:
        """ρh of every element [mass/length²]."""
        return self.resultants(mesh).mass_per_area
