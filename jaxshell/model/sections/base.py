"""What every section offers: the stiffnesses and masses of a unit of the shell's surface, for every element.

The elements know nothing else of a section. Its layers are for those who ask for stresses.
"""

import abc
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.mesh import Mesh
from jaxshell.numerics.checks import LARGEST, check_choice, is_concrete
from jaxshell.numerics.frozen import Frozen

BETA_0_MINIMUM = 0.01
"""Least factor of the membrane's higher-order stiffness, so that the element keeps its rank of 6."""

SHAPES = ("flat", "curved", "relaxed")
"""What an element is taken for: its triangle, or a part of a smooth surface through the nodes, in one way or another
(`jaxshell.elements.shape`)."""

_ROUND_OFF = 1e-9


class Resultants(eqx.Module):
    """A unit of the shell's surface, in the element's axes (e1, e2): N = A ε + B κ, M = B ε + D κ.

    Moments and z are counted from the surface of the nodes, z along the element's normal.
    """

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
    first_moment: Float[Array, "*m"] | None = None
    """∫ρ z dz [mass/length]; None where it vanishes."""

    @property
    def matrix(self) -> Float[Array, "*m 6 6"]:
        """[A B; B D]."""
        B = jnp.zeros_like(self.A) if self.B is None else self.B
        return jnp.concatenate(
            [jnp.concatenate([self.A, B], axis=-1), jnp.concatenate([jnp.swapaxes(B, -1, -2), self.D], axis=-1)],
            axis=-2,
        )


class Layers(eqx.Module):
    """The p layers of every element from the bottom (least z) to the top. Elements with fewer repeat their last one,
    with no thickness."""

    z: Float[Array, "m p 2"]
    """Bottom and top of each [length]."""
    C: Float[Array, "m p 3 3"]
    """Plane-stress stiffness in the element's axes [force/length²]."""
    angle: Float[Array, "m p"]
    """From e1 to the layer's axis 1 [rad], counter-clockwise about e3."""
    expansion: Float[Array, "m p 3"]
    """(εxx, εyy, γxy) of one degree in the element's axes [1/temperature]."""
    density: Float[Array, "m p"]
    """[mass/length³]."""

    def integral(self, values, power: int) -> Array:
        """∫ values zᵏ dz of values (m, p, ...) that are constant in each layer."""
        weight = (self.z[..., 1] ** (power + 1) - self.z[..., 0] ** (power + 1)) / (power + 1)
        return jnp.einsum("mp,mp...->m...", weight, values)


class Patch(eqx.Module):
    """Some triangles of a mesh, for the section of a region."""

    nodes: Float[Array, "n 3"]
    connectivity: Frozen = eqx.field(static=True)

    @property
    def triangles(self) -> np.ndarray:
        return self.connectivity.array

    @property
    def n_elements(self) -> int:
        return len(self.triangles)


class AnySection(eqx.Module):
    """What every kind of section offers. Its fields are its keys in scene files."""

    kind: ClassVar[str]
    """Its name in scene files."""

    @abc.abstractmethod
    def resultants(self, mesh: Mesh | Patch) -> Resultants:
        """Resultants (m, ...) of the elements of `mesh`, each in its own axes. Differentiable.

        Raises ValueError where the section does not fit the mesh.
        """

    def layers(self, mesh: Mesh | Patch) -> Layers | None:
        """The layers of the elements of `mesh`, for stresses; None of a section that has none."""
        return None

    def thermal_resultants(self, mesh: Mesh | Patch) -> Float[Array, "m 3 3"] | None:
        """∫ C α zᵏ dz for k = 0, 1, 2 (rows) in the elements' axes; None of a section that does not know it.

        N⁰ of a temperature T + g z is row 0 times T plus row 1 times g, and M⁰ row 1 times T plus row 2 times g.
        """
        layers = self.layers(mesh)
        if layers is None:
            return None
        heated = jnp.einsum("mpij,mpj->mpi", layers.C, layers.expansion)
        return jnp.stack([layers.integral(heated, power) for power in range(3)], axis=1)

    def expands(self, mesh: Mesh | Patch) -> bool | None:
        """False where all expansion is known to be zero; None of a section that does not know it."""
        found = self.thermal_resultants(mesh)
        return None if found is None else not is_concrete(found) or bool(np.any(np.asarray(found)))

    def direction_angles(self, mesh: Mesh | Patch) -> Float[Array, " m"] | None:
        """From e1 to the section's own direction [rad] in every element of `mesh`; None of one without direction."""
        return None

    def shapes(self, mesh: Mesh | Patch) -> np.ndarray:
        """(m,) the position in `SHAPES` of every element's shape; flat, unless a section says more."""
        return np.zeros(mesh.n_elements, int)

    def check(self, mesh: Mesh | Patch) -> None:
        """Raise ValueError where the section does not fit the mesh; called when the scene is made."""

    def has_first_moment(self, mesh: Mesh | Patch) -> bool:
        """Whether ∫ρz dz of some element is known to be more than round-off: its mass lies beside the nodes."""
        found = self.resultants(mesh)
        return found.first_moment is not None and off_centre(
            found.first_moment, found.mass_per_area, found.rotary_inertia
        )

    def area_masses(self, mesh: Mesh | Patch) -> Float[Array, " m"]:
        """ρh of every element [mass/length²]."""
        return self.resultants(mesh).mass_per_area


def optimal_beta0(C: Float[Array, "3 3"]) -> Float[Array, ""]:
    """β0 of a general membrane matrix, at least 0.01. It does not change under rotation.

    Source: C. A. Felippa, "A study of optimal membrane triangles with drilling freedoms", Comput. Methods Appl. Mech.
    Eng. 192 (2003) 2125-2168; (1 - 4ν²)/2 for isotropic C.
    """
    C = C / jnp.trace(C)
    c11, c22, c33, c12, c13, c23 = C[0, 0], C[1, 1], C[2, 2], C[0, 1], C[0, 2], C[1, 2]
    W = (
        -6 * c12**3
        + 5 * c11**2 * c22
        - 5 * c12**2 * c22
        - c22 * (75 * c13**2 + 14 * c13 * c23 + 3 * c23**2)
        + 2 * c12 * (7 * c13**2 + 46 * c13 * c23 + 7 * c23**2)
        - c11 * (5 * c12**2 + 3 * c13**2 - 6 * c12 * c22 - 5 * c22**2 + 14 * c13 * c23 + 75 * c23**2)
        + (3 * c11**2 + 82 * c11 * c22 + 3 * c22**2 - 4 * (6 * c12**2 + 5 * c13**2 - 6 * c13 * c23 + 5 * c23**2)) * c33
        + 4 * (5 * c11 - 6 * c12 + 5 * c22) * c33**2
    )
    return jnp.maximum(256.0 * jnp.linalg.det(C) / W - 1.5, BETA_0_MINIMUM)


def given_shape(shape) -> str:
    """A section's `shape`. Raises ValueError for any other than `SHAPES`."""
    check_choice("shape", shape, SHAPES)
    return shape


def off_centre(first_moment, mass_per_area, rotary_inertia) -> bool:
    """Whether known first moments are more than round-off."""
    values = first_moment, mass_per_area, rotary_inertia
    if not all(map(is_concrete, values)):
        return False
    first, mass, second = map(np.asarray, values)
    return bool(np.any(np.abs(first) > _ROUND_OFF * np.sqrt(mass * second)))


def check_bearable(what: str, value: Any) -> None:
    """Raise ValueError for a known positive figure that double precision does not bear."""
    if is_concrete(value):
        bad = ~((np.asarray(value) >= 1 / LARGEST) & (np.asarray(value) <= LARGEST))
        if bad.any():
            raise ValueError(
                f"The {what} is {np.asarray(value)[bad].flat[0]:.3g}, which double precision does not bear: thickness, "
                "young_modulus or density is far out of range, or in another unit than is meant."
            )
