"""Whether an equilibrium is stable, and by which motion it is lost.

A static equilibrium is stable where the symmetric part of its exact tangent K is positive definite: no small motion
lets the potential energy fall. K is compared with the stiffness K₀ that the same shape would have without stresses,
the material part of eq. (85):

    K φ = μ K₀ φ,      stable where the smallest μ is positive.

Of springs and other elastic contributions K₀ has the positive part of the stiffness that they have.

μ has no unit: it is 1 for motions that the stresses do not touch, and 1 - P/P_cr for the mode of a column under the
load P. Nearly all μ are 1 or above, so that a few steps of Lanczos with K⁻¹K₀ find those that are below, whatever the
sizes of the stiffnesses are. A step is a substitution with the factorization that Newton's last iteration left. That is
of a matrix next to K; so the μ that counts is φᵀKφ/φᵀK₀φ for the motion φ found, with K itself.

No equilibrium is called unstable wrongly, since φ shows how the energy falls.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.assembly.discretised import Model
from jaxshell.elements import corotational
from jaxshell.methods.method import Solvers
from jaxshell.methods.static import Static, StaticState
from jaxshell.methods.turning import turning
from jaxshell.numerics import rotations
from jaxshell.solvers.iteration import Memory

_STATIC = Static()
_VECTORS = 8
"""Steps of Lanczos. A mode that is about to be lost, or just was, dominates K⁻¹K₀ and is found in two."""
_NOISE = 1e-10
"""Eigenvalues of K⁻¹K₀ below this part of the largest are round-off; and norms below its root are none."""
_NEARLY = 0.9
"""Entries of a mode that count as its largest: so the rule for its sign does not hang on round-off."""

_SIDEWAYS = 1e-3
"""A load that drives the critical motion less than this passes it by: a bifurcation."""


class Critical(NamedTuple):
    """The motion that an equilibrium resists least."""

    quotient: Float[Array, ""]
    """μ = φᵀKφ/φᵀK₀φ; the equilibrium is unstable where it is negative."""
    mode: Float[Array, "n 6"]
    """φ: nodal displacements, the largest entry about 1 and the first of those positive, and spins [1/length]."""
    push: Float[Array, ""]
    """The part of a growing load that drives the mode, 0 to 1: about 0 where a path branches, more at a limit point."""


class Path:
    """What is known of the stability along a path of equilibria, on the host."""

    def __init__(self):
        self.at, self.quotient, self.push = 0.0, 1.0, 1.0
        self.lost: list[float] = []
        self.branched: list[float] = []

    @property
    def stable(self) -> bool:
        """Of the last equilibrium; the start counts as stable."""
        return self.quotient > 0

    def sees(self, at: float, weakest: Critical) -> None:
        """The next equilibrium, at the load factor `at`."""
        quotient = float(weakest.quotient)
        if self.stable and not quotient > 0:
            self.lost.append(self.zero(at, weakest))
        self.at, self.quotient, self.push = at, quotient, float(weakest.push)

    def figures(self) -> dict:
        """For the stats of a solution."""
        return {"stability_lost": tuple(self.lost), "branched": tuple(self.branched)}

    def zero(self, at: float, weakest: Critical) -> float:
        """The load factor at which μ vanishes on the line from the last equilibrium to an unstable one at `at`."""
        quotient = float(weakest.quotient)
        part = self.quotient / (self.quotient - quotient) if np.isfinite(quotient) and self.stable else 1.0
        return float(self.at + part * (at - self.at))

    def advice(self, branch: str) -> str:
        """What to do where load steps go no further."""
        imperfect = "a small imperfection or load in the direction of buckling"
        dynamic = "simulate with a dissipative method finds where the shell comes to rest"
        if self.lost:
            return (
                f"The equilibrium is unstable from about load factor {self.lost[0]:.4g} on: try "
                f'branch="follow", or {imperfect}; {dynamic}.'
            )
        if self.at != 0 and self.push < _SIDEWAYS and branch == "straight":
            return f'A bifurcation is near: try branch="follow", or {imperfect}; {dynamic}.'
        if self.at != 0:
            return f"Past a limit point only solve_arc_length can go on; {dynamic}."
        return (
            f"No step from the start succeeded: where the unloaded shell has hardly any stiffness against its loads, "
            f"as a flat cushion under pressure has, {dynamic}; or give smaller load factors."
        )


def critical(model: Model, solvers: Solvers, before: StaticState, state: StaticState, memory: Memory | None):
    """(`Critical` of the equilibrium `state`, memory for the next step).

    A step led to `state` from `before`, and its iteration left `memory`. The factorization there is of K by the step's
    increments, whose rotations are rotation vectors; or of K + s K₀, which has the same motions. With
    `Newton(reuse=True)` it may be old: the state's own K is factored, and kept instead. It is factored without a memory
    too.
    """
    nodes = state.d.shape[0]
    begun, still = _STATIC.begin(model, state, jnp.zeros(())), jnp.zeros((nodes, 6))
    no_motion = jnp.zeros(model.tables.held.shape)
    linear = solvers.linear.posed(model)
    if memory is None or solvers.newton.reuse:
        values = _STATIC.tangent(model, state, begun, still, None, solvers.tangent)
        _, factorization, values = linear.factor_and_solve(values, jnp.zeros(linear.handle.size))
        if memory is not None:
            memory = linear.keeping(memory, factorization, values, turning(model, state.R))
        spin = jnp.broadcast_to(jnp.eye(3), (nodes, 3, 3))
    else:
        values, factorization = jnp.zeros(linear.handle.indices.shape), memory.factorization
        spin = jax.vmap(lambda new, old: rotations.H_inverse(rotations.log(new @ old.T)))(state.R, before.R)

    def inverse(b: Float[Array, " nf"]) -> Float[Array, " nf"]:
        """K⁻¹ b: displacements and spins for forces and moments."""
        x = model.spread(linear.solve(factorization, values, b), no_motion, state.R)
        return model.unknowns(x.at[:, 3:].set(jnp.einsum("nij,nj->ni", spin, x[:, 3:])))

    def residual(x):
        u = _STATIC.increments(model, state, x, no_motion)
        return model.free(_STATIC.balance(model, state, begun, u).residual)

    unloaded = _material_product(model, state)
    x = _softest(inverse, unloaded, _start(model))
    _, along = jax.jvp(residual, (jnp.zeros_like(x),), (x,))
    quotient = jnp.sum(x * along) / jnp.sum(x * unloaded(x))
    load = model.free(model.collected(model.external_load(model.x0 + state.d, state.R, 1.0), state.R))
    return Critical(quotient, _signed(model.spread(x, no_motion, state.R)), _cosine(x, load)), memory


def _start(model: Model) -> Float[Array, " nf"]:
    """Forces and moments that no mode is free of, the same in every run."""
    values = jax.random.normal(jax.random.key(0), model.tables.free.shape)
    values = values * jnp.where(model.tables.free % 6 >= 3, model.size / jnp.sqrt(model.x0.shape[0]), 1.0)
    # Nothing opens joints.
    return values if model.tables.constrained is None else values.at[model.tables.constrained].set(0.0)


def _material_product(model: Model, state: StaticState):
    """x (nf,) → K₀ x (nf,), displacements and spins to forces and moments, without the matrix."""
    x, R = model.gather((model.x0 + state.d, state.R))
    kin = jax.vmap(corotational.kinematics)(x, R, model.elements)
    Lambda = jax.vmap(corotational.deformation_gradient)(kin)

    stiffening = [(acting, _positive_part(K)) for acting, K in _elastic_stiffness(model, state)]

    def product(x):
        moves = model.spread(x, jnp.zeros(model.tables.held.shape), state.R)
        u = model.gather(moves).reshape(-1, 6, 3)
        local = jnp.einsum("mij,mkj->mki", kin.frame, u).reshape(-1, 18)
        stresses = jax.vmap(corotational.stresses)(jnp.einsum("mij,mj->mi", Lambda, local), model.elements)
        force = jnp.einsum("mij,mi->mj", Lambda, stresses).reshape(-1, 6, 3)
        nodal = model.assemble_vector(jnp.einsum("mij,mki->mkj", kin.frame, force).reshape(-1, 18))
        for acting, matrices in stiffening:
            groups = moves[acting.nodes].reshape(len(matrices), -1)
            resisted = jnp.einsum("kij,kj->ki", matrices, groups)
            nodal = nodal + model.sum_over_nodes(acting, resisted.reshape(len(matrices), -1, 6))
        return model.free(model.collected(nodal, state.R))

    return product


def _elastic_stiffness(model: Model, state: StaticState):
    return model.stiffness_of(model.elastic, model.x0 + state.d, state.R, state.time)


def _positive_part(K: Float[Array, "k d d"]) -> Float[Array, "k d d"]:
    """Of symmetric matrices what resists: the negative eigenvalues, of springs under pressure for one, are left out."""
    values, vectors = jnp.linalg.eigh(0.5 * (K + jnp.swapaxes(K, 1, 2)))
    return jnp.einsum("kij,kj,klj->kil", vectors, jnp.maximum(values, 0.0), vectors)


def _softest(inverse, product, start: Float[Array, " nf"]) -> Float[Array, " nf"]:
    """The motion of the smallest μ by Lanczos with K⁻¹K₀, in the inner product of K₀.

    Orthogonalised against all vectors: where K is not symmetric, the symmetric part of what is projected is the
    projection of the symmetric part of K⁻¹, and has negative eigenvalues only if that of K has.
    """

    def row(x, least):
        """x and K₀ x for xᵀK₀x = 1; zeros where that is below `least`: then all directions have been seen."""
        force = product(x)
        norm_sq = jnp.sum(x * force)
        fresh = norm_sq > least
        return jnp.where(fresh, jnp.stack([x, force]) / jnp.sqrt(jnp.where(fresh, norm_sq, 1.0)), 0.0)

    def step(j, carry):
        rows, H = carry
        x = inverse(rows[j, 1])
        least = _NOISE * jnp.sum(x * product(x))
        for _ in range(2):
            along = rows[:, 1] @ x
            x = x - along @ rows[:, 0]
            H = H.at[:, j].add(along)
        next_row = row(x, least)
        return rows.at[j + 1].set(next_row), H.at[j + 1, j].set(next_row[1] @ x)

    rows = jnp.zeros((_VECTORS + 1, 2, start.shape[0])).at[0].set(row(inverse(start), 0.0))
    rows, H = jax.lax.fori_loop(0, _VECTORS, step, (rows, jnp.zeros((_VECTORS + 1, _VECTORS))))
    values, vectors = jnp.linalg.eigh(0.5 * (H[:-1] + H[:-1].T))
    negative = values[0] < -_NOISE * jnp.max(jnp.abs(values))
    return jnp.where(negative, vectors[:, 0], vectors[:, -1]) @ rows[:-1, 0]


def _signed(mode: Float[Array, "n 6"]) -> Float[Array, "n 6"]:
    """Scaled to a largest displacement of 1; the first displacement within a tenth of the largest is positive."""
    moves = mode[:, :3].reshape(-1)
    largest = jnp.max(jnp.abs(moves))
    first = moves[jnp.argmax(jnp.abs(moves) >= _NEARLY * largest)]
    return mode * jnp.sign(first) / jnp.where(largest > 0, largest, 1.0)


def _cosine(mode, load) -> Float[Array, ""]:
    """Of the work of the load on the mode."""
    sizes = jnp.sqrt(jnp.sum(mode * mode) * jnp.sum(load * load))
    return jnp.abs(jnp.sum(mode * load)) / jnp.where(sizes > 0, sizes, 1.0)
