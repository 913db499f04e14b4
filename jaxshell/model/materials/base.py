"""What every material offers to the plies of a laminate: plane-stress stiffness, density and thermal expansion."""

import abc
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class Material(eqx.Module):
    """What every kind of material offers, in its own axes 1, 2. Its fields are its keys in scene files."""

    kind: ClassVar[str]
    """Its name in scene files."""

    density: eqx.AbstractVar[Float[jax.Array, ""]]
    """ρ [mass/length³]."""

    @abc.abstractmethod
    def stiffness(self) -> Float[Array, "3 3"]:
        """Plane-stress matrix Q, (σ1, σ2, τ12) = Q (ε1, ε2, γ12) [force/length²]."""

    @abc.abstractmethod
    def expansions(self) -> Float[Array, "2"]:
        """Strains ε1, ε2 of one degree [1/temperature]."""


def rotated(Q: Float[Array, "3 3"], angle: Float[Array, ""]) -> Float[Array, "3 3"]:
    """Q̄ = T⁻¹ Q T⁻ᵀ: the matrix Q of axes 1, 2 in the axes x, y, from which axis 1 is turned by `angle` [rad].

    Source: R. M. Jones, Mechanics of Composite Materials (1999), eqs. (2.78)-(2.85).
    """
    strain = strain_rotation(angle)
    return strain.T @ Q @ strain


def strain_rotation(angle: Float[Array, ""]) -> Float[Array, "3 3"]:
    """(ε1, ε2, γ12) in axes turned by `angle` [rad] from (εx, εy, γxy). Its transpose takes stresses back."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    rows = jnp.stack([c * c, s * s, c * s, s * s, c * c, -c * s, -2 * c * s, 2 * c * s, c * c - s * s])
    return rows.reshape(3, 3)


def stress_rotation(angle: Float[Array, ""]) -> Float[Array, "3 3"]:
    """(σ1, σ2, τ12) in axes turned by `angle` [rad] from (σx, σy, τxy)."""
    return strain_rotation(-angle).T
