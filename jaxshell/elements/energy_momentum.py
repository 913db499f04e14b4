"""Elastic forces of one element that do the exact work of its strain energy over a step, and their tangent.

Let a, b be the edges from node 1 to nodes 2 and 3. The 21 quadratic invariants

    π = { a·a, a·b, b·b, R_kᵀa, R_kᵀb },   k = 1, 2, 3,

determine the deformations e (see `jaxshell.elements.corotational`) and do not change in a rigid motion. With
mid-points (·)_m = ½(start + end), and θ_k the Cayley vector that turns node k, R_k1 - R_k0 = ~θ_k R_km,

    Dπ(q_m)·(Δx, θ) = π₁ - π₀   exactly.

Averaging G = ∂e/∂π over the ends of the step and adding what is missing along Δπ (Gonzalez 1996) gives

    s = ½(G₀ + G₁)ᵀ f + c Δπ,   f = K̂ (½(e₀ + e₁) + ξ Δe),   c = [f·Δe - fᵀ½(G₀ + G₁) Δπ]/|Δπ|²,

so that s·Δπ = f·Δe = S₁ - S₀ + ξ ΔeᵀK̂Δe. The nodal forces Dπ(q_m)ᵀ s therefore do exactly that work, and they
have no resultant and no moment, because Dπ vanishes for rigid variations. docs/energy_momentum.md derives it.

Everything is written with spatial vectors: where s holds a material vector s_k against R_kᵀa, the formulas hold
p_k = R_km s_k. Index i = 0, 1 names the edges a, b, and k the nodes.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell import rotations
from jaxshell.elements import corotational
from jaxshell.elements.corotational import Element, Kinematics

_NEGLIGIBLE = 1e-12
"""|Δπ|², dimensionless, below which f·Δe - f·½(G₀+G₁)Δπ = O(|Δπ|³) is lost in the rounding of e."""

_skews = jax.vmap(rotations.skew)


class StepStart(NamedTuple):
    """One element at the start of the step."""

    edges: Float[Array, "2 3"]
    """a, b [length]."""
    kin: Kinematics


class StepState(NamedTuple):
    """One element's step for given increments: what the forces and their tangent are made of."""

    kin: Kinematics
    """At the end."""
    increments: Float[Array, "2 3"]
    """Δa, Δb."""
    edges: Float[Array, "2 3"]
    """a_m, b_m."""
    theta: Float[Array, "3 3"]
    """Cayley vectors of the nodes."""
    A: Float[Array, "3 3 3"]
    """A_k = (I - ½~θ_k)⁻¹ = R_km R_k0ᵀ; its transpose is R_km R_k1ᵀ."""
    turned: Float[Array, "3 2 3"]
    """A_k y_ki with y_ki = Δ(edge i) + (edge i)_m × θ_k, so that Δ(R_kᵀ edge i) = R_kmᵀ y_ki."""
    d_metric: Float[Array, "3"]
    """Δ(a·a), Δ(a·b), Δ(b·b)."""
    change: Float[Array, "12"]
    """Δe."""
    f: Float[Array, "12"]
    """The step's stresses."""
    mu: Float[Array, "3 3"]
    """H(θ̄_k)ᵀ m̄_k at the end."""
    P: Float[Array, "3 2 3"]
    """Local components at the end of G₁ᵀf against R_kᵀ(edge i)."""
    s: Float[Array, "3"]
    """s against ½a·a, a·b, ½b·b."""
    p: Float[Array, "3 2 3"]
    """p_ki, s against R_kᵀ(edge i)."""
    c: Float[Array, ""]
    per_norm: Float[Array, ""]
    """1/|Δπ|², 0 where Δπ is negligible."""


def spin_matrix(theta: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """C with δω = C δθ for R₁ = cay(θ) R₀, δR₁ = ~δω R₁: (I + ½~θ)/(1 + ¼θ²)."""
    return (jnp.eye(3) + 0.5 * rotations.skew(theta)) / (1.0 + 0.25 * jnp.sum(theta * theta))


def mid_matrix(theta: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """(I - ½~θ)⁻¹ = ½(I + cay(θ)) = (I + ½~θ + ¼θθᵀ)/(1 + ¼θ²)."""
    outer = theta[:, None] * theta[None, :]
    return (jnp.eye(3) + 0.5 * rotations.skew(theta) + 0.25 * outer) / (1.0 + 0.25 * jnp.sum(theta * theta))


def edges_of(x: Float[Array, "3 3"]) -> Float[Array, "2 3"]:
    """a, b from nodal positions or their increments."""
    return jnp.stack([x[1] - x[0], x[2] - x[0]])


def _weights(element: Element):
    """Weights of the metric and of R_kᵀ(edge) in |Δπ|², by the element's size: each entry becomes dimensionless."""
    size_sq = 2.0 * element.area
    return 1.0 / (size_sq * size_sq), 1.0 / size_sq


def _moments(f) -> Float[Array, "3 3"]:
    """m̄_k, the entries of the 12 stresses that are conjugate to θ̄_k."""
    return jnp.concatenate([f[6:].reshape(3, 2), f[3:6, None]], axis=1)


def _pull(kin: Kinematics, f) -> Float[Array, "3 3"]:
    """μ_k = H(θ̄_k)ᵀ m̄_k."""
    return jnp.sum(kin.H * _moments(f)[:, :, None], axis=1)


def _gradient(coordinates, metric, mu):
    """Gᵀf in local components, linear in f: (3,) against ½a·a, a·b, ½b·b and (3, 2, 3) against R_kᵀ(edge i).

    R̄_k has the rows ρ1 = R_kᵀa/l, ρ2 = (R_kᵀb - b̄x ρ1)/b̄y, ρ3 = ρ1 × ρ2, in local components e1, e2, e3, and
    δω̄_k = (-ρ3·δρ2, ρ3·δρ1, ½(ρ1·δρ2 - ρ2·δρ1)). `metric` (3,) are the stresses against l, b̄x, b̄y, and `mu`
    (3, 3) the moments against the spins ω̄_k.
    """
    length, bx, by = coordinates
    x, y, z = mu.T
    slope, zero = bx / (length * by), jnp.zeros_like(x)
    along_a = [-0.5 * slope * z, -0.5 * z / length, y / length + slope * x]
    P = jnp.stack([*along_a, 0.5 * z / by, zero, -x / by], axis=1).reshape(3, 2, 3)
    drill = 0.5 * jnp.sum(z)
    shear = metric[1] - drill / by - metric[2] * bx / by
    s = [(metric[0] + drill * slope - shear * bx / length) / length, shear / length, metric[2] / by]
    return jnp.stack(s), P


def _forces(s, p, edges):
    """Dπᵀ s at the given edges: (2, 3) forces against the edges and (3, 3) moments on the nodes."""
    F = jnp.stack([s[0] * edges[0] + s[1] * edges[1], s[1] * edges[0] + s[2] * edges[1]])
    return F + jnp.sum(p, axis=0), jnp.sum(jnp.cross(p, edges[None]), axis=1)


def evaluate(start: StepStart, x, R, u: Float[Array, "3 6"], element: Element, dissipation, excess=None) -> StepState:
    """The step from its start to positions x (3, 3) and rotations R (3, 3, 3), with increments u = (Δx, θ).

    `excess` (12,), where given, is added to the deformations at the end in the stresses f.
    """
    kin = corotational.kinematics(x, R, element)
    change = kin.deformations - start.kin.deformations
    weighted = 0.5 * (kin.deformations + start.kin.deformations) + dissipation * change
    if excess is not None:
        weighted = weighted + (0.5 + dissipation) * excess
    f = corotational.stresses(weighted, element)
    increments, theta = edges_of(u[:, :3]), u[:, 3:]
    edges = start.edges + 0.5 * increments
    d_metric = jnp.stack(
        [
            2.0 * jnp.sum(edges[0] * increments[0]),
            jnp.sum(edges[0] * increments[1]) + jnp.sum(edges[1] * increments[0]),
            2.0 * jnp.sum(edges[1] * increments[1]),
        ]
    )
    A = jax.vmap(mid_matrix)(theta)
    y = increments[None] + jnp.cross(edges[None], theta[:, None])
    turned = _apply(A, y)

    mu = _pull(kin, f)
    s1, P1 = _gradient(kin.coordinates, f[:3], mu)
    s0, P0 = _gradient(start.kin.coordinates, f[:3], _pull(start.kin, f))
    s = 0.5 * (s0 + s1)
    p = 0.5 * (_apply(A, P0 @ start.kin.frame) + _apply_transposed(A, P1 @ kin.frame))

    w_metric, w = _weights(element)
    half = jnp.array([0.5, 1.0, 0.5])
    norm = w_metric * jnp.sum(half * d_metric * d_metric) + w * jnp.sum(turned * turned)
    missing = jnp.sum(f * change) - jnp.sum(half * s * d_metric) - jnp.sum(p * y)
    moves = norm > _NEGLIGIBLE
    per_norm = jnp.where(moves, 1.0 / jnp.where(moves, norm, 1.0), 0.0)
    c = missing * per_norm
    s = s + c * w_metric * d_metric
    p = p + c * w * _apply_transposed(A, turned)
    return StepState(kin, increments, edges, theta, A, turned, d_metric, change, f, mu, P1, s, p, c, per_norm)


def _apply(A, vectors) -> Float[Array, "3 2 3"]:
    """A_k v_ki."""
    return jnp.sum(A[:, None] * vectors[:, :, None, :], axis=3)


def _apply_transposed(A, vectors) -> Float[Array, "3 2 3"]:
    """A_kᵀ v_ki."""
    return jnp.sum(A[:, None] * vectors[:, :, :, None], axis=2)


def elastic_forces(state: StepState) -> Float[Array, "18"]:
    """Nodal forces and moments Dπ(q_m)ᵀ s, which do the work ΔS + ξ ΔeᵀK̂Δe on (Δx, θ)."""
    F, M = _forces(state.s, state.p, state.edges)
    return jnp.stack([jnp.stack([-F[0] - F[1], F[0], F[1]]), M], axis=1).reshape(18)


# --- the tangent ------------------------------------------------------------------------------------------


def _moment_map(coordinates) -> Float[Array, "2 3 3"]:
    """Derivative of the P of `_gradient` by μ_k, the same for every node: axes (edge, component, μ)."""
    length, bx, by = coordinates
    slope, zero = bx / (length * by), jnp.zeros_like(length)
    a = [zero, zero, -0.5 * slope, zero, zero, -0.5 / length, slope, 1.0 / length, zero]
    b = [zero, zero, 0.5 / by, zero, zero, zero, -1.0 / by, zero, zero]
    return jnp.stack(a + b).reshape(2, 3, 3)


def _metric_map(coordinates) -> Float[Array, "3 4"]:
    """Derivative of the s of `_gradient` by the metric stresses and Σ_k μ_kz."""
    length, bx, by = coordinates
    zero, slope = jnp.zeros_like(length), bx / by
    first = [1.0 / length, -bx / length**2, slope * bx / length**2, slope / length**2]
    second = [zero, 1.0 / length, -slope / length, -0.5 / (length * by)]
    return jnp.stack([*first, *second, zero, zero, 1.0 / by, zero]).reshape(3, 4)


def elastic_tangent(state: StepState, start: StepStart, element: Element, dissipation) -> Float[Array, "18 18"]:
    """Derivative of `elastic_forces` by u, in closed form.

    The stresses and G₁ depend on the twelve local variations e' = (l, b̄x, b̄y, ω̄_1, ω̄_2, ω̄_3) only, ω̄_k the
    local spin of node k less that of the frame. E (15, 12) collects that dependence, with that of c, and one
    product with ∂e'/∂(Δa, Δb, θ) completes it. What is left acts at fixed s and in the change of Δπ.
    """
    E = _local_tangent(state, start, element, dissipation)
    u = jnp.concatenate([state.increments, state.theta]).reshape(15)
    f = state.f + (0.5 + dissipation) * corotational.stresses(state.change, element)
    pulled = jnp.concatenate([f[:3], _pull(state.kin, f).reshape(9)])
    w_metric, w = _weights(element)
    # What c Δπ adds: c's dependence on e' joins E, its dependence on Δπ is the row `by_change`.
    d_metric, turned, c = w_metric * state.d_metric, w * state.turned, state.c
    direction = _stacked(_forces(d_metric, _apply_transposed(state.A, turned), state.edges))
    E = E + direction[:, None] * (state.per_norm * (pulled - u @ E))[None, :]

    end = state.edges + 0.5 * state.increments
    C = jax.vmap(spin_matrix)(state.theta)
    z = state.p + 0.5 * jnp.cross(state.theta[:, None], state.p)  # R_k1 R_km⁻¹ p_ki
    F, M = _forces(state.s + c * d_metric, z + c * turned, end)
    by_change = -state.per_norm * _stacked((F, jnp.sum(M[:, :, None] * C, axis=1)))
    K = _from_local(E, state, C) + direction[:, None] * by_change[None, :]

    # At fixed s: edges and mid-point rotations move, and Δπ changes with the end of the step.
    minus_skew = -_skews(state.edges)
    A_end = jnp.swapaxes(state.A, 1, 2)
    D = -0.5 * _skews(z.reshape(6, 3)).reshape(3, 2, 3, 3)
    D = D + (c * w) * (A_end[:, None] @ _skews(end)[None])
    D = jnp.sum(D[..., None] * C[:, None, None], axis=3)  # (k, i, 3, 3): δp_ki by θ_k
    forces_theta = jnp.transpose(D, (1, 2, 0, 3))
    moments_theta = jnp.sum(minus_skew[None, :, :, :, None] * D[:, :, None], axis=(1, 3))
    S = jnp.stack([state.s[0], state.s[1], state.s[1], state.s[2]]).reshape(2, 2)
    eye = jnp.eye(3)
    outer = (c * w_metric) * state.edges[:, :, None, None] * end[None, None]  # (j, x, i, y): (e_j)_m ⊗ (e_i)_1
    same = outer[0, :, 0] + outer[1, :, 1] + (c * w) * jnp.sum(A_end, axis=0)
    forces_edges = 0.5 * S[:, None, :, None] * eye[None, :, None, :] + jnp.transpose(outer, (2, 1, 0, 3))
    forces_edges = forces_edges + jnp.eye(2)[:, None, :, None] * same[None, :, None, :]
    moments_edges = 0.5 * _skews(state.p.reshape(6, 3)).reshape(3, 2, 3, 3)
    moments_edges = moments_edges + (c * w) * (minus_skew[None] @ A_end[:, None])
    moments_theta = eye[:, None, :, None] * moments_theta[:, :, None, :]
    top = jnp.concatenate([forces_edges, forces_theta], axis=2)
    bottom = jnp.concatenate([jnp.transpose(moments_edges, (0, 2, 1, 3)), moments_theta], axis=2)
    return _to_nodes(K.reshape(5, 3, 5, 3) + jnp.concatenate([top, bottom]))


def _to_nodes(K: Float[Array, "5 3 5 3"]) -> Float[Array, "18 18"]:
    """Rows and columns for (a, b, θ_1, θ_2, θ_3) → u: node 2 moves a, node 3 b, and node 1 both, backwards."""

    def spread(K):
        K = jnp.concatenate([-K[:1] - K[1:2], K])
        return jnp.stack([K[:3], K[3:]], axis=1)

    K = jnp.transpose(spread(K), (3, 4, 0, 1, 2))
    return jnp.transpose(spread(K), (3, 4, 5, 0, 1, 2)).reshape(18, 18)


def _stacked(forces_and_moments) -> Float[Array, "15"]:
    F, M = forces_and_moments
    return jnp.concatenate([F, M]).reshape(15)


def _local_tangent(state: StepState, start: StepStart, element: Element, dissipation) -> Float[Array, "15 12"]:
    """Derivative of the forces by e' without that of c."""
    kin = state.kin
    # Stresses by e': metric (3, 12) and moments (k, 3, 12).
    Km, Kb = element.K_membrane, element.K_bending.reshape(3, 2, 3, 2)
    H_z, H_xy = kin.H[:, 2], kin.H[:, :2]
    metric = jnp.concatenate([Km[:3, :3], (Km[:3, 3:, None] * H_z[None]).reshape(3, 9)], axis=1)
    drill = jnp.concatenate([Km[3:, :3], (Km[3:, 3:, None] * H_z[None]).reshape(3, 9)], axis=1)
    tilt = jnp.sum(Kb[:, :, :, :, None] * H_xy[None, None], axis=3).reshape(3, 2, 9)
    tilt = jnp.concatenate([jnp.zeros((3, 2, 3)), tilt], axis=2)
    factor = 0.5 + dissipation
    metric, moments = factor * metric, factor * jnp.concatenate([tilt, drill[:, None]], axis=1)

    # p_ki by the moments (B), by the metric and by ω̄_k at fixed stresses.
    at_start = 0.5 * jnp.sum(state.A[:, :, None, :] * start.kin.frame[None, None], axis=3)
    at_end = 0.5 * jnp.sum(jnp.swapaxes(state.A, 1, 2)[:, :, None, :] * kin.frame[None, None], axis=3)
    V0, V1 = _moment_map(start.kin.coordinates), _moment_map(kin.coordinates)
    corrections = corotational.moment_corrections(kin, state.f)
    by_metric = jax.jacfwd(_gradient)(kin.coordinates, state.f[:3], state.mu)
    HT0, HT1 = jnp.swapaxes(start.kin.H, 1, 2), jnp.swapaxes(kin.H, 1, 2)
    inner = jnp.concatenate(
        [
            V1[None] @ HT1[:, None],
            by_metric[1],
            V1[None] @ corrections[:, None] + _skews(state.P.reshape(6, 3)).reshape(3, 2, 3, 3),
        ],
        axis=3,
    )
    outer = at_end[:, None] @ inner
    B = outer[..., :3] + at_start[:, None] @ (V0[None] @ HT0[:, None])
    B, fixed = B.reshape(3, 6, 3), outer[..., 3:].reshape(3, 6, 6)

    # s by e'
    Q0, Q1 = _metric_map(start.kin.coordinates), _metric_map(kin.coordinates)
    z0 = jnp.sum(start.kin.H[:, :, 2, None] * moments, axis=(0, 1))
    z1 = jnp.sum(kin.H[:, :, 2, None] * moments, axis=(0, 1))
    z1 = z1 + jnp.concatenate([jnp.zeros(3), corrections[:, 2].reshape(9)])
    s = 0.5 * ((Q0 + Q1)[:, :3] @ metric + Q0[:, 3:] * z0 + Q1[:, 3:] * z1)
    s = s + 0.5 * jnp.concatenate([by_metric[0], jnp.zeros((3, 9))], axis=1)

    edges = state.edges
    zero = jnp.zeros(3)
    spread = jnp.stack([jnp.stack([edges[0], edges[1], zero]), jnp.stack([zero, edges[0], edges[1]])])
    F = jnp.einsum("isx,sc->ixc", spread, s).reshape(6, 12)
    F = F + jnp.einsum("kpm,kmc->pc", B, moments)
    own = jnp.transpose(fixed[:, :, 3:], (1, 0, 2)).reshape(6, 9)
    F = F + jnp.concatenate([jnp.sum(fixed[:, :, :3], axis=0), own], axis=1)
    arm = jnp.transpose(-_skews(edges), (1, 0, 2)).reshape(3, 6)
    M = (arm[None] @ B) @ moments
    turned = arm[None] @ fixed
    own = (jnp.eye(3)[:, None, :, None] * turned[:, :, None, 3:]).reshape(3, 3, 9)
    M = M + jnp.concatenate([turned[:, :, :3], own], axis=2)
    return jnp.concatenate([F, M.reshape(9, 12)])


def _from_local(E: Float[Array, "15 12"], state: StepState, C) -> Float[Array, "15 15"]:
    """E ∂e'/∂(Δa, Δb, θ_1, θ_2, θ_3)."""
    length, bx, by = state.kin.coordinates
    frame = state.kin.frame
    by_spin = E[:, 3:].reshape(15, 3, 3)
    total = -jnp.sum(by_spin, axis=1)  # by the spin of the frame
    El, Ex, Ey = E[:, 0], E[:, 1], E[:, 2]
    local = jnp.stack(
        [
            El,
            (by * Ex - bx * Ey + total[:, 2]) / length,
            -(total[:, 1] + total[:, 0] * bx / by) / length,
            Ex,
            Ey,
            total[:, 0] / by,
        ],
        axis=1,
    )
    by_edges = local.reshape(15, 2, 3) @ frame
    turn = jnp.sum(frame[None, :, :, None] * C[:, None], axis=2)
    by_theta = jnp.sum(by_spin[..., None] * turn[None], axis=2)
    return jnp.concatenate([by_edges.reshape(15, 6), by_theta.reshape(15, 9)], axis=1)
