"""A section given by its stiffnesses: corrugated, stiffened and woven shells, and results of homogenisation."""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.materials.base import strain_rotation
from jaxshell.model.mesh import Mesh
from jaxshell.model.sections.base import SHAPES, AnySection, Patch, Resultants, given_shape, optimal_beta0
from jaxshell.model.sections.direction import angles, check_direction, given_direction
from jaxshell.numerics.checks import (
    check_finite,
    check_one_or_each,
    check_positive,
    float_array,
    for_each,
    is_concrete,
    optional_floats,
)

_SYMMETRIC = 1e-9
"""Of a matrix's largest entry: what may be lost where it was written with few digits."""


class GeneralSection(AnySection):
    """Stiffnesses of a unit of surface: N = A ε + B κ, M = Bᵀ ε + D κ, in axes x along `direction`, y, z the normal.

    Arguments:
        A, B, D: (3, 3) or (m, 3, 3), for (εxx, εyy, γxy) and (κxx, κyy, 2κxy) [force/length, force, force·length]. B
            None couples nothing, and is not compiled.
        mass_per_area: one value or one per element [mass/length²].
        rotary_inertia: ∫ρ z² dz [mass]; None is that of a homogeneous shell, mass_per_area · tr D / tr A.
        first_moment: ∫ρ z dz [mass/length]; None where it vanishes.
        thermal: (3, 3) or (m, 3, 3), rows ∫ C α zᵏ dz for k = 0, 1, 2 [force/length/temperature, ...], for
            `jaxshell.Thermal`; None where it does not expand.
        direction, shape: as in `jaxshell.Laminate`.

    It has no layers, and so no stresses, only section forces. All floats differentiate. Raises ValueError for matrices
    that are not symmetric, or not positive definite together.
    """

    kind: ClassVar[str] = "general"

    A: Float[jax.Array, "*m 3 3"]
    B: Float[jax.Array, "*m 3 3"] | None
    D: Float[jax.Array, "*m 3 3"]
    mass_per_area: Float[jax.Array, "*m"]
    rotary_inertia: Float[jax.Array, "*m"] | None
    first_moment: Float[jax.Array, "*m"] | None
    thermal: Float[jax.Array, "*m 3 3"] | None
    direction: object
    shape: str = eqx.field(static=True)

    def __init__(
        self,
        A,
        B,
        D,
        mass_per_area,
        rotary_inertia=None,
        first_moment=None,
        thermal=None,
        direction=(1.0, 0.0, 0.0),
        shape: str = "flat",
    ):
        self.A, self.D = float_array(A, "A"), float_array(D, "D")
        self.B = optional_floats("B")(B)
        self.mass_per_area = float_array(mass_per_area, "mass_per_area")
        self.rotary_inertia = optional_floats("rotary_inertia")(rotary_inertia)
        self.first_moment = optional_floats("first_moment")(first_moment)
        self.thermal = optional_floats("thermal")(thermal)
        self.direction = given_direction(direction)
        self.shape = given_shape(shape)

    def __check_init__(self):
        for name in ("A", "B", "D", "thermal"):
            value = getattr(self, name)
            if value is not None:
                check_finite(name, value)
                if value.shape[-2:] != (3, 3) or value.ndim not in (2, 3):
                    raise ValueError(f"{name} must have shape (3, 3) or (m, 3, 3), but it has shape {value.shape}.")
        for name in ("mass_per_area", "rotary_inertia", "first_moment"):
            value = getattr(self, name)
            if value is not None:
                check_one_or_each(name, value)
                (check_finite if name == "first_moment" else check_positive)(name, value)
        self._check_definite()

    def _check_definite(self):
        """Raise ValueError for known matrices that are not symmetric, or let a deformation gain energy."""
        matrices = [matrix for matrix in (self.A, self.B, self.D) if matrix is not None]
        if not all(map(is_concrete, matrices)):
            return
        for name in ("A", "B", "D"):
            matrix = getattr(self, name)
            if matrix is None:
                continue
            matrix = np.asarray(matrix)
            if np.abs(matrix - np.swapaxes(matrix, -1, -2)).max() > _SYMMETRIC * np.abs(matrix).max():
                raise ValueError(f"{name} must be symmetric, but it is {matrix.tolist()}.")
        if len({matrix.shape for matrix in matrices if matrix.ndim == 3}) > 1:
            return  # told when the mesh is known
        A, D = np.asarray(self.A), np.asarray(self.D)
        B = np.zeros_like(A) if self.B is None else np.asarray(self.B)
        # In a length in which A and D have entries of one size.
        length = np.sqrt(np.trace(D, axis1=-2, axis2=-1) / np.trace(A, axis1=-2, axis2=-1))[..., None, None]
        with np.errstate(invalid="ignore"):
            top, bottom = (
                np.concatenate(np.broadcast_arrays(A, B / length), -1),
                np.concatenate(np.broadcast_arrays(B / length, D / length**2), -1),
            )
            whole = np.concatenate(np.broadcast_arrays(top, bottom), -2)
        least = np.linalg.eigvalsh(np.nan_to_num(whole, nan=-1.0)).min()
        if not least > 0:
            raise ValueError(
                "[A B; B D] must be positive definite, or some deformation gains energy, but its least eigenvalue, in "
                f"a length that makes A and D alike, is {least:.3g}."
            )

    def shapes(self, mesh: Mesh | Patch) -> np.ndarray:
        return np.full(mesh.n_elements, SHAPES.index(self.shape))

    def check(self, mesh: Mesh | Patch) -> None:
        self._each(mesh.n_elements)
        check_direction(self.direction, mesh)

    def has_first_moment(self, mesh: Mesh | Patch) -> bool:
        return self.first_moment is not None and is_concrete(self.first_moment) and bool(np.any(self.first_moment))

    def expands(self, mesh: Mesh | Patch) -> bool | None:
        return None if self.thermal is None else not is_concrete(self.thermal) or bool(np.any(self.thermal))

    def direction_angles(self, mesh: Mesh | Patch) -> Float[Array, " m"]:
        return angles(self.direction, mesh)

    def resultants(self, mesh: Mesh | Patch) -> Resultants:
        given = self._each(mesh.n_elements)
        turn = jax.vmap(strain_rotation)(-self.direction_angles(mesh))  # strains from the direction's axes to e1, e2
        back = jnp.linalg.inv(turn)

        def turned(matrix) -> Any:
            return None if matrix is None else jnp.swapaxes(back, 1, 2) @ matrix @ back

        A, D, mass = turned(given["A"]), turned(given["D"]), given["mass_per_area"]
        rotary = given["rotary_inertia"]
        if rotary is None:
            rotary = mass * jnp.trace(given["D"], axis1=1, axis2=2) / jnp.trace(given["A"], axis1=1, axis2=2)
        return Resultants(
            A=A,
            D=D,
            mass_per_area=mass,
            rotary_inertia=rotary,
            beta0=jax.vmap(optimal_beta0)(A),
            B=turned(given["B"]),
            first_moment=given["first_moment"],
        )

    def thermal_resultants(self, mesh: Mesh | Patch) -> Float[Array, "m 3 3"] | None:
        thermal = self._each(mesh.n_elements)["thermal"]
        if thermal is None:
            return None
        # Forces, unlike strains, turn with the transpose.
        return thermal @ jax.vmap(strain_rotation)(self.direction_angles(mesh))

    def _each(self, n_elements: int) -> dict[str, Any]:
        """Every value with a leading axis over the elements, or None. Raises ValueError for another length."""
        found = {}
        for name in ("A", "B", "D", "thermal", "mass_per_area", "rotary_inertia", "first_moment"):
            value = getattr(self, name)
            if value is not None:
                value = for_each(name, value, n_elements, (3, 3) if name in ("A", "B", "D", "thermal") else ())
            found[name] = value
        return found
