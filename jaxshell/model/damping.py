"""Rayleigh damping: forces α M v against the motion, and viscous stresses β K̂ ė in the material.

K̂ is the stiffness of the corotated deformations e: a rigid motion, however large, has no viscous stress. What a method
makes of it stands in `jaxshell.methods.damping`; docs/damping.md has the balances.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.mesh import Mesh
from jaxshell.numerics.checks import (
    check_count,
    check_for_each,
    check_one_or_each,
    check_positive,
    check_shape,
    float_array,
    for_each,
    is_concrete,
    shown,
)


class Damping(NamedTuple):
    """What the elements need: each (m,), None where the scene has no such part."""

    alpha: Float[Array, "*m"] | None
    beta: Float[Array, "*m"] | None


def _coefficient(name: str):
    def convert(value):
        is_zero = isinstance(value, int | float | np.number) and not isinstance(value, bool) and value == 0
        return None if value is None or is_zero else float_array(value, name)

    return convert


class RayleighDamping(eqx.Module):
    """Damping proportional to mass and to stiffness, f_d = α M v + β K̂ ė; a mode has the ratio ζ = α/2ω + βω/2.

    Arguments:
        alpha: α [1/time], against the motion itself, as a medium at rest would be: of the free motion as a rigid body
            too, whose momenta fall as e^{-αt}. Drilling rotations have no mass and none of it.
        beta: β [time], a viscous material: stresses K̂ (e + β ė) in the corotated deformations, which do no work in a
            rigid motion and leave the momenta alone.

    Each is one value or one per element (m,), and differentiable; so parts of a shell are damped differently. A plain
    number 0 (kept as None) leaves its part out of the compiled program. Raises ValueError for values that are negative
    or not finite.
    """

    alpha: Float[jax.Array, "*m"] | None = eqx.field(converter=_coefficient("alpha"), default=0.0)
    beta: Float[jax.Array, "*m"] | None = eqx.field(converter=_coefficient("beta"), default=0.0)

    def __check_init__(self):
        for name in ("alpha", "beta"):
            value = getattr(self, name)
            if value is not None:
                check_one_or_each(name, value)
                check_positive(name, value, allow_zero=True)

    def check(self, mesh: Mesh) -> None:
        """Raise ValueError for values per element of another number of elements; called when the scene is made."""
        for name in ("alpha", "beta"):
            if getattr(self, name) is not None:
                check_for_each(f"damping {name}", getattr(self, name), mesh.n_elements)

    def per_element(self, n_elements: int) -> Damping:
        """Both coefficients as arrays (n_elements,), or None. Raises ValueError for another length."""
        given = {"alpha": self.alpha, "beta": self.beta}
        return Damping(
            **{
                name: None if value is None else for_each(f"damping {name}", value, n_elements)
                for name, value in given.items()
            }
        )

    @classmethod
    def from_ratios(cls, scene, ratios, modes=None, *, frequencies=None) -> "RayleighDamping":
        """The damping that gives two modes their ratios ζ to critical damping: ζ = α/2ω + βω/2 for both.

        Arguments:
            scene: the shell, for its frequencies; None where `frequencies` are given. Differentiable in its floats.
            ratios: the two ζ.
            modes: the numbers of two modes, counted from 1, in the order of `jaxshell.natural_frequencies` (which for a
                shell that can move as a rigid body begins with these motions).
            frequencies: in place of `modes`, two frequencies [1/time].

        Raises ValueError for frequencies that are not positive or equal, and where the ratios need a negative
        coefficient: ζ₂/ζ₁ must lie between ω₁/ω₂ and ω₂/ω₁.
        """
        if (modes is None) == (frequencies is None):
            raise ValueError("from_ratios needs either modes, two numbers from 1 on, or frequencies.")
        zeta = float_array(ratios, "ratios")
        check_shape("ratios", zeta, (2,))
        check_positive("ratios", zeta)
        if modes is not None:
            frequencies = _frequencies_of(scene, modes)
        f = float_array(frequencies, "frequencies")
        check_shape("frequencies", f, (2,))
        if is_concrete(f):
            which = "" if modes is None else f" of modes {modes[0]} and {modes[1]}"
            if not np.all(np.asarray(f) > 0) or f[0] == f[1]:
                raise ValueError(
                    f"The frequencies{which} must be positive and different, but they are {f.tolist()}. A frequency "
                    "of 0 is a motion as a rigid body, a negative one that of an unstable state."
                )
        (first, second), (one, other) = 2.0 * jnp.pi * f, zeta
        spread = second**2 - first**2
        alpha = 2.0 * first * second * (one * second - other * first) / spread
        beta = 2.0 * (other * second - one * first) / spread
        for name, value in (("alpha", alpha), ("beta", beta)):
            if is_concrete(value) and value < 0:
                low, high = sorted((float(first / second), float(second / first)))
                raise ValueError(
                    f"The ratios {zeta.tolist()} at frequencies {f.tolist()} need {name} = {float(value):.4g} < 0, "
                    f"which feeds energy in: the second ratio over the first must lie in [{low:.4g}, {high:.4g}]."
                )
        return cls(alpha, beta)


def _frequencies_of(scene, modes) -> Float[Array, "2"]:
    """Of the modes with these two numbers, counted from 1."""
    # Through the public name: frequencies are found by a room above this one, which a model knows nothing of.
    import jaxshell as js

    if not isinstance(modes, list | tuple) or len(modes) != 2:
        raise ValueError(f"modes must be two numbers from 1 on, but it is {shown(modes)}.")
    for number in modes:
        check_count("A mode's number", number)
    found = js.natural_frequencies(scene, count=max(modes)).frequencies
    return jnp.stack([found[number - 1] for number in modes])
