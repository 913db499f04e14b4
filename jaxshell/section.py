"""The shell's section: what a reference surface of the shell is made of.

A section gives its resultants, the stiffnesses and masses of a unit of surface, for every element; the elements know
nothing else of it. `Section` is the isotropic one.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.checks import check_finite, check_positive, float_array, is_concrete
from jaxshell.mesh import Mesh

BETA_0_MINIMUM = 0.01
"""Least factor of the membrane's higher-order stiffness, so that the element keeps its rank of 6."""


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
    """What every kind of section offers."""

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


class Section(AnySection):
    """Thickness and material, each a scalar or an array (m,) with one value per element; all differentiable.

    Arguments:
        thickness: h [length].
        young_modulus: E [force/length²].
        poisson_ratio: ν, in (-1, 1/2].
        density: ρ [mass/length³].

    Units are the user's, consistently. Raises ValueError naming the value that is out of range.
    """

    thickness: Float[jax.Array, "*m"] = eqx.field(converter=float_array)
    young_modulus: Float[jax.Array, "*m"] = eqx.field(converter=float_array)
    poisson_ratio: Float[jax.Array, "*m"] = eqx.field(converter=float_array)
    density: Float[jax.Array, "*m"] = eqx.field(converter=float_array)

    def __check_init__(self):
        check_positive("thickness", self.thickness)
        check_positive("young_modulus", self.young_modulus)
        check_positive("density", self.density)
        check_finite("poisson_ratio", self.poisson_ratio)
        if is_concrete(self.poisson_ratio):
            ratio = np.asarray(self.poisson_ratio)
            bad = (ratio <= -1) | (ratio > 0.5)
            if bad.any():
                raise ValueError(f"poisson_ratio must lie in (-1, 0.5], but it is {ratio[bad].flat[0]}.")

    def check(self, mesh: Mesh) -> None:
        self.per_element(mesh.n_elements)
        check_finite("thickness", self.thickness)

    def resultants(self, mesh: Mesh) -> Resultants:
        each = self.per_element(mesh.n_elements)
        return jax.vmap(isotropic)(each.thickness, each.young_modulus, each.poisson_ratio, each.density)

    def per_element(self, n_elements: int) -> "Section":
        """The same section with every value as an array (n_elements,). Raises ValueError for another length."""
        values = {}
        for name in ("thickness", "young_modulus", "poisson_ratio", "density"):
            value = jnp.asarray(getattr(self, name))
            if value.shape not in ((), (n_elements,)):
                raise ValueError(
                    f"{name} must be one value or one per element ({n_elements}), but it has shape {value.shape}."
                )
            values[name] = jnp.broadcast_to(value, (n_elements,))
        return Section(**values)


SECTIONS: tuple[type[AnySection], ...] = (Section,)
"""Every kind that result files know."""


def isotropic(thickness, young_modulus, poisson_ratio, density) -> Resultants:
    """Resultants of a homogeneous isotropic shell: A = h C, D = h³/12 C; from scalars.

    The optimal β0 is (1 - 4ν²)/2, but never less than 0.01 (the bound acts from ν = 0.495).
    """
    C = plane_stress_matrix(young_modulus, poisson_ratio)
    return Resultants(
        A=thickness * C,
        D=thickness**3 / 12.0 * C,
        mass_per_area=density * thickness,
        rotary_inertia=density * thickness**3 / 12.0,
        beta0=jnp.maximum(0.5 * (1.0 - 4.0 * jnp.asarray(poisson_ratio) ** 2), BETA_0_MINIMUM),
    )


def plane_stress_matrix(young_modulus, poisson_ratio) -> Float[Array, "3 3"]:
    """Isotropic plane-stress matrix C, (σxx, σyy, τxy) = C (εxx, εyy, γxy) [units of E]."""
    nu = jnp.asarray(poisson_ratio)
    zero, one = jnp.zeros_like(nu), jnp.ones_like(nu)
    rows = jnp.stack([one, nu, zero, nu, one, zero, zero, zero, 0.5 * (1.0 - nu)]).reshape(3, 3)
    return young_modulus / (1.0 - nu * nu) * rows
