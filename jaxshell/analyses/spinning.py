"""Vibrations of what is at rest in axes that spin: pairs ±iω of (λ²M + λG + K) φ = 0.

G = 2 ∫ρ ~ω is what turns moving masses aside (gyroscopic), skew-symmetric; K holds the stresses of the spin and takes
away what moves masses outwards (the stiffness of `jaxshell.Centrifugal`). Motions φ are complex: their parts have a
quarter of a period between them.

For given φ the frequency is the root of ω² φᴴMφ + ω φᴴ(-iG)φ - φᴴKφ = 0, which does not change with φ to first
order: it has the right first derivatives by K, G and M where φ is a constant.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.linalg import eig
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigs, splu

from jaxshell.analyses.eigen import DENSE
from jaxshell.assembly.discretised import Model
from jaxshell.assembly.sparsity import SparsityPattern
from jaxshell.elements.element import Element
from jaxshell.model.masses import euler_tensor
from jaxshell.model.scene import Scene
from jaxshell.numerics import rotations
from jaxshell.numerics.triangles import LINEAR_MASS

_STILL = 1e-6
"""A growth below this part of the frequency is round-off."""


def gyroscopic_matrix(spin: Float[Array, "3"], R: Float[Array, "3 3 3"], element: Element) -> Float[Array, "18 18"]:
    """2 ∫ρ (·)ᵀ ~ω (·) of the velocities and director rates of one element turned by the nodal rotations R."""
    mass, across = element.area * jnp.asarray(LINEAR_MASS), rotations.skew(spin)
    turn = -jax.vmap(rotations.skew)(R @ element.frame[2])
    turned = jnp.einsum("kl,blj->bkj", across, turn)
    translational = element.mass_per_area * mass[:, None, :, None] * across[None, :, None, :]
    rotational = element.rotary_inertia * jnp.einsum("ab,aki,bkj->aibj", mass, turn, turned)
    coupled = lever = jnp.zeros_like(rotational)
    if element.first_moment is not None:
        coupled = element.first_moment * jnp.einsum("ab,bij->aibj", mass, turned)
        lever = -jnp.transpose(coupled, (2, 3, 0, 1))
    rows = [jnp.stack([translational, coupled], axis=3), jnp.stack([lever, rotational], axis=3)]
    return 2.0 * jnp.stack(rows, axis=1).reshape(18, 18)


def gyroscopic(model: Model, scene: Scene, R: Float[Array, "n 3 3"], time) -> Float[Array, " nnz"]:
    """Values of G over the free degrees of freedom, in a state with the rotations R."""
    (load,) = scene.spins
    # The forces go with the square of the spin, and so does their history.
    factor = load.history(time)
    spin = jnp.sqrt(jnp.where(factor > 0, factor, 0.0)) * load.spin
    matrices = jax.vmap(gyroscopic_matrix, in_axes=(None, 0, 0))(spin, model.gather(R), model.elements)
    lumps = [] if model.lumps is None else [(model.lumps, _of_lumps(model.lumps, spin, R))]
    return model.matrix_at(R, matrices, lumps)


def _of_lumps(lumps: Any, spin, R: Float[Array, "n 3 3"]) -> Float[Array, "k 6 6"]:
    across, columns = rotations.skew(spin), jnp.swapaxes(R[lumps.at], 1, 2)
    turn = -jax.vmap(jax.vmap(rotations.skew))(columns)
    turned = jnp.einsum("kpq,kpai,ab,kqbj->kij", euler_tensor(lumps.inertia), turn, across, turn)
    found = jnp.zeros((len(lumps.mass), 6, 6)).at[:, :3, :3].set(lumps.mass[:, None, None] * across)
    return 2.0 * found.at[:, 3:, 3:].set(turned)


class _Inverse(LinearOperator):
    """Of the companion matrix: (z₁, z₂) → (-K⁻¹(M z₂ + G z₁), z₁), whose eigenvalues are 1/λ."""

    def __init__(self, K, G, M):
        size = K.shape[0]
        super().__init__(np.float64, (2 * size, 2 * size))
        self.factors, self.G, self.M, self.size = splu(K), G, M, size

    def _matvec(self, z):
        first, second = z[: self.size], z[self.size :]
        return np.concatenate([-self.factors.solve(self.M @ second + self.G @ first), first])


def pairs(K, G, M, count: int) -> np.ndarray:
    """(count, 3, n) of the pairs with the smallest |λ|: φ by its real and its imaginary part, and λ by growth and ω in
    the first two entries of the third row. `K`, `G`, `M` are sparse, of entries near 1."""
    size, inverse = K.shape[0], _Inverse(K, G, M)
    if size <= DENSE:
        found: Any = eig(np.stack([inverse._matvec(unit) for unit in np.eye(2 * size)], axis=1))
    else:
        start = np.random.default_rng(0).standard_normal(2 * size)
        try:
            found = eigs(inverse, k=min(2 * count + 2, 2 * size - 2), which="LM", v0=start)
        except ArpackNoConvergence as error:
            raise RuntimeError(f"Only {len(error.eigenvalues)} pairs converged; ask for fewer modes.") from error
    reciprocal, vectors = found
    keep = np.abs(reciprocal) > 0
    values = 1.0 / reciprocal[keep]
    vectors = vectors[:size, keep]
    # One of each conjugate pair; of growing motions without oscillation each.
    upper = values.imag >= -_STILL * np.abs(values)
    values, vectors = values[upper], vectors[:, upper]
    order = np.argsort(np.abs(values))[:count]
    rows = np.full((count, 3, size), np.nan)
    for row, at in enumerate(order):
        phi = vectors[:, at]
        norm = np.real(np.conj(phi) @ (M @ phi))
        phi = phi / np.sqrt(norm) * np.exp(-0.5j * np.angle(phi @ (M @ phi)))
        growth = values[at].real
        rows[row, 0], rows[row, 1], rows[row, 2] = phi.real, phi.imag, 0.0
        rows[row, 2, :2] = (0.0 if abs(growth) < _STILL * abs(values[at]) else growth), values[at].imag
    return rows


def frequencies(pattern: SparsityPattern, K, G, M, real, imaginary) -> Float[Array, " c"]:
    """ω of motions whose parts (c, n) are constants, by the quadratic equation at the top."""
    with jax.ensure_compile_time_eval():
        rows, columns = jnp.asarray(pattern.rows), jnp.asarray(pattern.indices.array)

    def product(values, a, b):
        return jnp.sum(a[:, rows] * values * b[:, columns], axis=1)

    m, k = (product(v, real, real) + product(v, imaginary, imaginary) for v in (M, K))
    g = product(G, real, imaginary) - product(G, imaginary, real)  # φᴴ(-iG)φ
    square = g * g + 4.0 * m * k
    return (jnp.sqrt(jnp.where(square > 0, square, 0.0)) - g) / (2.0 * m)
