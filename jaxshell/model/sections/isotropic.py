"""The homogeneous isotropic section: a thickness and an elastic material, each one value or one per element."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxshell.model.materials.checks import check_poisson_ratio
from jaxshell.model.materials.isotropic import plane_stress_matrix
from jaxshell.model.mesh import Mesh
from jaxshell.model.sections.base import (
    BETA_0_MINIMUM,
    SHAPES,
    AnySection,
    Layers,
    Patch,
    Resultants,
    check_bearable,
    given_shape,
)
from jaxshell.numerics.checks import (
    check_finite,
    check_one_or_each,
    check_positive,
    float_array,
    floats,
    for_each,
    is_concrete,
)

_VALUES = ("thickness", "young_modulus", "poisson_ratio", "density", "expansion")


class Section(AnySection):
    """Thickness and material, each a scalar or an array (m,) with one value per element; all differentiable.

    Arguments:
        thickness: h [length].
        young_modulus: E [force/length²].
        poisson_ratio: ν, in (-1, 1/2].
        density: ρ [mass/length³].
        expansion: thermal strain of one degree [1/temperature], for `jaxshell.Thermal`.
        shape: "flat" for the triangles as they are, the paper's element. "curved" and "relaxed" for elements that stand
            for a smooth surface through the nodes: the one nearer where the mesh resolves the waves of the shell, as in
            dynamics; the other where a thin shell on a coarse mesh bends almost without stretching (docs/accuracy.md).

    Units are the user's, consistently. Raises ValueError naming the value that is out of range.
    """

    kind: ClassVar[str] = "isotropic"

    thickness: Float[jax.Array, "*m"] = eqx.field(converter=floats("thickness"))
    young_modulus: Float[jax.Array, "*m"] = eqx.field(converter=floats("young_modulus"))
    poisson_ratio: Float[jax.Array, "*m"] = eqx.field(converter=floats("poisson_ratio"))
    density: Float[jax.Array, "*m"] = eqx.field(converter=floats("density"))
    expansion: Float[jax.Array, "*m"] = eqx.field(converter=floats("expansion"), default=0.0)
    shape: str = eqx.field(static=True, default="flat")

    def __check_init__(self):
        given_shape(self.shape)
        for name in _VALUES:
            check_one_or_each(name, getattr(self, name))
        check_positive("thickness", self.thickness)
        check_positive("young_modulus", self.young_modulus)
        check_positive("density", self.density)
        check_finite("expansion", self.expansion)
        check_poisson_ratio(self.poisson_ratio)
        self._check_range()

    def _check_range(self):
        """Raise ValueError where stiffness or mass overflows or vanishes in double precision."""
        values = [getattr(self, name) for name in _VALUES]
        if not all(map(is_concrete, values)) or len({value.shape for value in values if value.shape}) > 1:
            return
        h, young, ratio, density, _ = map(np.asarray, values)
        with np.errstate(all="ignore"):
            check_bearable("bending stiffness E h³/12(1-ν²)", young * h**3 / 12 / (1 - ratio**2))
            check_bearable("rotary inertia ρ h³/12", density * h**3 / 12)

    def shapes(self, mesh: Mesh | Patch) -> np.ndarray:
        return np.full(mesh.n_elements, SHAPES.index(self.shape))

    def check(self, mesh: Mesh | Patch) -> None:
        self.per_element(mesh.n_elements)
        check_finite("thickness", self.thickness)

    def resultants(self, mesh: Mesh | Patch) -> Resultants:
        each = self.per_element(mesh.n_elements)
        return jax.vmap(isotropic)(each.thickness, each.young_modulus, each.poisson_ratio, each.density)

    def has_first_moment(self, mesh: Mesh | Patch) -> bool:
        return False

    def expands(self, mesh: Mesh | Patch) -> bool:
        return not is_concrete(self.expansion) or bool(np.any(np.asarray(self.expansion)))

    def layers(self, mesh: Mesh | Patch) -> Layers:
        each = self.per_element(mesh.n_elements)
        half = 0.5 * each.thickness
        C = jax.vmap(plane_stress_matrix)(each.young_modulus, each.poisson_ratio)
        return Layers(
            z=jnp.stack([-half, half], axis=1)[:, None],
            C=C[:, None],
            angle=jnp.zeros((mesh.n_elements, 1)),
            expansion=(each.expansion[:, None] * jnp.array([[1.0, 1.0, 0.0]]))[:, None],
            density=each.density[:, None],
        )

    def per_element(self, n_elements: int) -> "Section":
        """The same section with every value as an array (n_elements,). Raises ValueError for another length."""
        if not n_elements:  # of a mesh of points alone
            return jax.tree.map(lambda value: jnp.zeros(0), self)
        values = {name: for_each(name, jnp.asarray(getattr(self, name)), n_elements) for name in _VALUES}
        return Section(**values, shape=self.shape)


def isotropic(thickness, young_modulus, poisson_ratio, density) -> Resultants:
    """Resultants of a homogeneous isotropic shell: A = h C, D = h³/12 C; from scalars.

    The optimal β0 is (1 - 4ν²)/2, but never less than 0.01 (the bound acts from ν = 0.495).
    """
    thickness, density = float_array(thickness), float_array(density)
    C = plane_stress_matrix(young_modulus, poisson_ratio)
    return Resultants(
        A=thickness * C,
        D=thickness**3 / 12.0 * C,
        mass_per_area=density * thickness,
        rotary_inertia=density * thickness**3 / 12.0,
        beta0=jnp.maximum(0.5 * (1.0 - 4.0 * jnp.asarray(poisson_ratio) ** 2), BETA_0_MINIMUM),
    )
