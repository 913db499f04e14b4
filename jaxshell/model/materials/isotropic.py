"""The isotropic elastic material."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.model.materials.base import Material
from jaxshell.model.materials.checks import check_modulus, check_poisson_ratio, check_scalar
from jaxshell.numerics.checks import floats


class Isotropic(Material):
    """An isotropic elastic material; all values are scalars and differentiable.

    Arguments:
        young_modulus: E [force/length²].
        poisson_ratio: ν, in (-1, 1/2].
        density: ρ [mass/length³].
        expansion: thermal strain of one degree [1/temperature].

    Raises ValueError naming the value that is out of range.
    """

    kind: ClassVar[str] = "isotropic"

    young_modulus: Float[jax.Array, ""] = eqx.field(converter=floats("young_modulus"))
    poisson_ratio: Float[jax.Array, ""] = eqx.field(converter=floats("poisson_ratio"))
    density: Float[jax.Array, ""] = eqx.field(converter=floats("density"))
    expansion: Float[jax.Array, ""] = eqx.field(converter=floats("expansion"), default=0.0)

    def __check_init__(self):
        for name in ("young_modulus", "density"):
            check_modulus(name, getattr(self, name))
        check_scalar("expansion", self.expansion)
        check_scalar("poisson_ratio", self.poisson_ratio)
        check_poisson_ratio(self.poisson_ratio)

    def stiffness(self) -> Float[Array, "3 3"]:
        return plane_stress_matrix(self.young_modulus, self.poisson_ratio)

    def expansions(self) -> Float[Array, "2"]:
        return jnp.stack([self.expansion, self.expansion])


def plane_stress_matrix(young_modulus, poisson_ratio) -> Float[Array, "3 3"]:
    """Isotropic plane-stress matrix C, (σxx, σyy, τxy) = C (εxx, εyy, γxy) [units of E]."""
    nu = jnp.asarray(poisson_ratio)
    zero, one = jnp.zeros_like(nu), jnp.ones_like(nu)
    rows = jnp.stack([one, nu, zero, nu, one, zero, zero, zero, 0.5 * (1.0 - nu)]).reshape(3, 3)
    return young_modulus / (1.0 - nu * nu) * rows
