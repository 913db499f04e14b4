"""The shell's section: thickness and an isotropic elastic material, each one value or one per element."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxshell.checks import check_finite, check_positive, float_array, is_concrete


class Section(eqx.Module):
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
