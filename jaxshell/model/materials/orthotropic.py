"""The orthotropic elastic material: a ply of fibres in one direction, or a fabric."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.materials.base import Material
from jaxshell.model.materials.checks import check_modulus, check_scalar
from jaxshell.numerics.checks import floats, is_concrete


class Orthotropic(Material):
    """An orthotropic elastic material in plane stress, axis 1 along the fibres; all values differentiable scalars.

    Arguments:
        young_modulus_1, young_modulus_2: E1, E2 [force/length²].
        poisson_ratio_12: ν12 = -ε2/ε1 under σ1 alone; ν12² < E1/E2, or the material would gain energy.
        shear_modulus_12: G12 [force/length²].
        density: ρ [mass/length³].
        expansion_1, expansion_2: thermal strains of one degree [1/temperature].

    Raises ValueError naming the value that is out of range.
    """

    kind: ClassVar[str] = "orthotropic"

    young_modulus_1: Float[jax.Array, ""] = eqx.field(converter=floats("young_modulus_1"))
    young_modulus_2: Float[jax.Array, ""] = eqx.field(converter=floats("young_modulus_2"))
    poisson_ratio_12: Float[jax.Array, ""] = eqx.field(converter=floats("poisson_ratio_12"))
    shear_modulus_12: Float[jax.Array, ""] = eqx.field(converter=floats("shear_modulus_12"))
    density: Float[jax.Array, ""] = eqx.field(converter=floats("density"))
    expansion_1: Float[jax.Array, ""] = eqx.field(converter=floats("expansion_1"), default=0.0)
    expansion_2: Float[jax.Array, ""] = eqx.field(converter=floats("expansion_2"), default=0.0)

    def __check_init__(self):
        for name in ("young_modulus_1", "young_modulus_2", "shear_modulus_12", "density"):
            check_modulus(name, getattr(self, name))
        for name in ("poisson_ratio_12", "expansion_1", "expansion_2"):
            check_scalar(name, getattr(self, name))
        values = self.young_modulus_1, self.young_modulus_2, self.poisson_ratio_12
        if all(map(is_concrete, values)):
            E1, E2, ratio = map(float, values)
            if not ratio * ratio * E2 < E1:
                raise ValueError(
                    f"poisson_ratio_12 must lie within ±sqrt(E1/E2) = ±{np.sqrt(E1 / E2):.4g}, or the stiffness is not "
                    f"positive definite, but it is {ratio:g}. (ν12 belongs to σ1; ν21 = ν12 E2/E1 is the smaller one.)"
                )

    def stiffness(self) -> Float[Array, "3 3"]:
        E1, E2, nu = self.young_modulus_1, self.young_modulus_2, self.poisson_ratio_12
        factor = 1.0 / (1.0 - nu * nu * E2 / E1)
        zero, coupled = jnp.zeros_like(E1), factor * nu * E2
        rows = [factor * E1, coupled, zero, coupled, factor * E2, zero, zero, zero, self.shear_modulus_12]
        return jnp.stack(rows).reshape(3, 3)

    def expansions(self) -> Float[Array, "2"]:
        return jnp.stack([self.expansion_1, self.expansion_2])
