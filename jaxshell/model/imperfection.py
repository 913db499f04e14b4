"""Geometric imperfections: shapes by which a mesh that was never perfect differs from the one that was drawn."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.normals import unit_normals
from jaxshell.numerics.checks import (
    check_count,
    check_finite,
    check_shape,
    float_array,
    floats,
    is_concrete,
)

_WAVES = 1024
"""Of a random field. The covariance over the seeds is exact for any number; the excess kurtosis is -1.5 over it."""
_AT_ONCE = 128
"""Waves that are summed together: what bounds the memory, to so many numbers at each node."""


class RandomField(eqx.Module):
    """A smooth Gaussian random field along the normals of a mesh, of mean 0, as an imperfection.

    Arguments:
        correlation_length: ℓ [length] in the covariance σ² exp(-r²/2ℓ²) of two nodes at a distance r in space, not
            along the surface. Differentiable.
        seed: a whole number from 0. The same one gives the same field, in space: a finer mesh meets the same bumps.

    The amplitude that `Mesh.with_imperfection` takes is the standard deviation σ of every node over the seeds, not a
    largest value, which is some three times that. The field is a sum of 1024 plane waves of random direction, length
    and phase (the spectral representation of Shinozuka and Deodatis, Applied Mechanics Reviews 44, 1991): work and
    memory grow with the number of nodes only. Over the seeds mean and covariance are exact; that it is a sum of so many
    shows in the fourth moment alone, as an excess kurtosis of -0.0015. Raises ValueError unless ℓ is positive.
    """

    correlation_length: Float[jax.Array, ""] = eqx.field(converter=floats("correlation_length"))
    seed: int = eqx.field(static=True, default=0)

    def __check_init__(self):
        check_shape("correlation_length", self.correlation_length, ())
        check_finite("correlation_length", self.correlation_length)
        if is_concrete(self.correlation_length) and not self.correlation_length > 0:
            raise ValueError(f"correlation_length must be positive, but it is {float(self.correlation_length):g}.")
        check_count("A random field's seed", self.seed, least=0)

    def at(self, points: Float[Array, "n 3"]) -> Float[Array, " n"]:
        """The field of standard deviation 1 at points in space."""
        random = np.random.default_rng(self.seed)
        waves = random.standard_normal((_WAVES // _AT_ONCE, _AT_ONCE, 3))
        phases = random.uniform(0.0, 2.0 * np.pi, (_WAVES // _AT_ONCE, _AT_ONCE))
        return _sum_of_waves(points, jnp.asarray(waves) / self.correlation_length, jnp.asarray(phases))


@jax.jit
def _sum_of_waves(points: Float[Array, "n 3"], waves: Float[Array, "l w 3"], phases: Float[Array, "l w"]):
    """√(2/N) Σ cos(k·x + φ) at the points, of N = l w waves."""

    def add(total, layer):
        k, phase = layer
        return total + jnp.sum(jnp.cos(points @ k.T + phase), axis=1), None

    total, _ = jax.lax.scan(add, jnp.zeros(len(points)), (waves, phases))
    return jnp.sqrt(2.0 / phases.size) * total


def moved(nodes: Float[Array, "n 3"], triangles: np.ndarray, mode, amplitude) -> Float[Array, "n 3"]:
    """The nodes of a mesh with the imperfections of `Mesh.with_imperfection`. Raises ValueError as it does."""
    several = isinstance(mode, list | tuple) or getattr(mode, "ndim", 0) == 3
    modes = list(mode) if several else [mode]
    amplitudes = float_array(amplitude, "amplitude")
    check_finite("amplitude", amplitudes)
    if not modes or amplitudes.shape != ((len(modes),) if several else ()):
        wanted = f"one number for each of {len(modes)} modes" if several else "a number"
        raise ValueError(f"amplitude must be {wanted}, but it has shape {amplitudes.shape}.")
    shapes = [_shape(each, nodes, triangles) for each in modes]
    return nodes + sum(
        (size * shape for size, shape in zip(jnp.atleast_1d(amplitudes), shapes, strict=True)), jnp.zeros_like(nodes)
    )


def _shape(mode: Any, nodes: Float[Array, "n 3"], triangles: np.ndarray) -> Float[Array, "n 3"]:
    """Displacements for amplitude 1."""
    if isinstance(mode, RandomField):
        return mode.at(nodes)[:, None] * unit_normals(nodes, triangles)
    shape = float_array(mode, "mode")
    if shape.shape not in ((len(nodes), 3), (len(nodes), 6)):
        raise ValueError(
            f"mode must be displacements ({len(nodes)}, 3) of the nodes, ({len(nodes)}, 6) with their rotations as in "
            f"modes.shapes[0], a RandomField, or a list of these, but it has shape {shape.shape}."
        )
    check_finite("mode", shape)
    displacements = shape[:, :3]
    largest = jnp.max(jnp.linalg.norm(displacements, axis=1))
    if is_concrete(largest) and not largest > 0:
        raise ValueError("mode moves no node: it cannot be scaled to an amplitude.")
    return displacements / largest
