"""A ply of a laminate."""

import equinox as eqx
import jax
from jaxtyping import Float

from jaxshell.model.materials import Material
from jaxshell.numerics.checks import (
    check_finite,
    check_kind,
    check_one_or_each,
    check_positive,
    floats,
)


class Ply(eqx.Module):
    """A ply of a laminate.

    Arguments:
        material: `jaxshell.Orthotropic` or `jaxshell.Isotropic`.
        thickness: one value or one per element [length].
        angle: from the laminate's direction to the material's axis 1 [degrees], counter-clockwise seen from the tip of
            the element's normal; one value or one per element.

    Raises ValueError naming the value that is out of range.
    """

    material: Material
    thickness: Float[jax.Array, "*m"] = eqx.field(converter=floats("thickness"))
    angle: Float[jax.Array, "*m"] = eqx.field(converter=floats("angle"), default=0.0)

    def __check_init__(self):
        check_kind("material", self.material, Material, "a material such as jaxshell.Orthotropic")
        for name in ("thickness", "angle"):
            check_one_or_each(name, getattr(self, name))
        check_positive("thickness", self.thickness)
        check_finite("angle", self.angle)
