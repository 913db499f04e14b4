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

In a curved element (`jaxshell.elements.shape`) Δe has the change of w̄ too, which is ½(J₀ + J₁) times that of the
bending deformations: f are then the forces conjugate to the twelve deformations through this mean.

Everything is written with spatial vectors: where s holds a material vector s_k against R_kᵀa, the formulas hold
p_k = R_km s_k. Index i = 0, 1 names the edges a, b, and k the nodes.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.elements import corotational
from jaxshell.elements.corotational import Kinematics
from jaxshell.elements.element import Element
from jaxshell.elements.shape import curvature_stiffness
from jaxshell.numerics import rotations
from jaxshell.numerics.fusion import formed
from jaxshell.numerics.products import cross, dot, product, scaled, transposed_product

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
    change: Float[Array, " d"]
    """Δe."""
    stresses: Float[Array, " d"]
    """The step's stresses."""
    f: Float[Array, "12"]
    """The forces conjugate to the twelve deformations: the same in a flat element."""
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
    return (jnp.eye(3) + 0.5 * rotations.skew(theta)) / (1.0 + 0.25 * dot(theta, theta))


def mid_matrix(theta: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """(I - ½~θ)⁻¹ = ½(I + cay(θ)) = (I + ½~θ + ¼θθᵀ)/(1 + ¼θ²)."""
    factor = 1.0 / (1.0 + 0.25 * dot(theta, theta))
    return rotations.compose(factor, 0.5 * factor, 0.25 * factor, theta)


def edges_of(x: Float[Array, "3 3"]) -> Float[Array, "2 3"]:
    """a, b from nodal positions or their increments."""
    return jnp.stack([x[1] - x[0], x[2] - x[0]])


def _weights(element: Element):
    """Weights of the metric and of R_kᵀ(edge) in |Δπ|², by the element's size: each entry becomes dimensionless."""
    size_sq = 2.0 * element.area
    return 1.0 / (size_sq * size_sq), 1.0 / size_sq


def _pull(kin: Kinematics, f) -> Float[Array, "3 3"]:
    """μ_k = H(θ̄_k)ᵀ m̄_k."""
    return dot(jnp.swapaxes(kin.H, 1, 2), corotational.moments_of(f)[:, None])


def _against_edges(coordinates, mu: Float[Array, "3 *c"]) -> Float[Array, "2 3 *c"]:
    """Local components of Gᵀf against R_kᵀ(edge i), linear in the moments μ_k against the spin ω̄_k.

    R̄_k has the rows ρ1 = R_kᵀa/l, ρ2 = (R_kᵀb - b̄x ρ1)/b̄y, ρ3 = ρ1 × ρ2, in local components e1, e2, e3, and
    δω̄_k = (-ρ3·δρ2, ρ3·δρ1, ½(ρ1·δρ2 - ρ2·δρ1)).
    """
    length, bx, by = coordinates
    x, y, z = mu
    slope = bx / (length * by)
    along_a = [-0.5 * slope * z, -0.5 / length * z, y / length + slope * x]
    along_b = [0.5 / by * z, jnp.zeros_like(z), -x / by]
    return jnp.stack([jnp.stack(along_a), jnp.stack(along_b)])


def _against_metric(coordinates, metric: Float[Array, "3 *c"], drill: Float[Array, " *c"]) -> Float[Array, "3 *c"]:
    """Gᵀf against ½a·a, a·b, ½b·b, linear in the stresses against l, b̄x, b̄y and in `drill` = ½Σ_k μ_kz."""
    length, bx, by = coordinates
    shear = metric[1] - drill / by - metric[2] * (bx / by)
    first = (metric[0] + drill * (bx / (length * by)) - shear * (bx / length)) / length
    return jnp.stack([first, shear / length, metric[2] / by])


def _gradient(coordinates, metric, mu):
    """Gᵀf at these l, b̄x, b̄y: (3,) by `_against_metric` and (3, 2, 3) by `_against_edges`."""
    drill = 0.5 * (mu[0, 2] + mu[1, 2] + mu[2, 2])
    return _against_metric(coordinates, metric, drill), jax.vmap(_against_edges, (None, 0))(coordinates, mu)


def _forces(s, p, edges):
    """Dπᵀ s at the given edges: (2, 3) forces against the edges and (3, 3) moments on the nodes."""
    F = jnp.stack([s[0] * edges[0] + s[1] * edges[1], s[1] * edges[0] + s[2] * edges[1]])
    moments = cross(p, edges[None])
    return F + p[0] + p[1] + p[2], moments[:, 0] + moments[:, 1]


def evaluate(start: StepStart, x, R, u: Float[Array, "3 6"], element: Element, dissipation, excess=None) -> StepState:
    """The step from its start to positions x (3, 3) and rotations R (3, 3, 3), with increments u = (Δx, θ).

    `excess` (d,), where given, is added to the deformations at the end in the stresses f.
    """
    kin = corotational.kinematics(x, R, element)
    change = kin.deformations - start.kin.deformations
    weighted = 0.5 * (kin.deformations + start.kin.deformations) + dissipation * change
    if excess is not None:
        weighted = weighted + (0.5 + dissipation) * excess
    stresses = corotational.stresses(weighted, element)
    f = corotational.conjugate(_mean_J(start, kin), stresses)
    increments, theta = edges_of(u[:, :3]), u[:, 3:]
    edges = start.edges + 0.5 * increments
    d_metric = jnp.stack(
        [
            2.0 * dot(edges[0], increments[0]),
            dot(edges[0], increments[1]) + dot(edges[1], increments[0]),
            2.0 * dot(edges[1], increments[1]),
        ]
    )
    A = jax.vmap(mid_matrix)(theta)
    y = increments[None] + cross(edges[None], theta[:, None])
    turned = _apply(A, y)

    mu = _pull(kin, f)
    s1, P1 = _gradient(kin.coordinates, f[:3], mu)
    s0, P0 = _gradient(start.kin.coordinates, f[:3], _pull(start.kin, f))
    s = 0.5 * (s0 + s1)
    p = 0.5 * (_apply(A, P0 @ start.kin.frame) + _apply_transposed(A, P1 @ kin.frame))

    w_metric, w = _weights(element)
    half = jnp.array([0.5, 1.0, 0.5])
    norm = w_metric * jnp.sum(half * d_metric * d_metric) + w * jnp.sum(turned * turned)
    missing = jnp.sum(f * change[:12]) - jnp.sum(half * s * d_metric) - jnp.sum(p * y)
    moves = norm > _NEGLIGIBLE
    per_norm = jnp.where(moves, 1.0 / jnp.where(moves, norm, 1.0), 0.0)
    c = missing * per_norm
    s = s + scaled(c * w_metric, d_metric)
    p = p + scaled(c * w, _apply_transposed(A, turned))
    s, p, f, mu, P1, A, turned = formed((s, p, f, mu, P1, A, turned))
    stresses = f if element.shape is None else formed(stresses)
    step = increments, edges, theta, A, turned, d_metric, change
    return StepState(kin, *step, stresses, f, mu, P1, s, p, c, per_norm)


def _mean_J(start: StepStart, kin: Kinematics) -> Float[Array, "3 6"] | None:
    """½(J₀ + J₁), by which w̄ changes exactly in the step; None of a flat element."""
    return None if kin.J is None or start.kin.J is None else 0.5 * (start.kin.J + kin.J)


def _apply(A, vectors) -> Float[Array, "3 2 3"]:
    """A_k v_ki."""
    return dot(A[:, None], vectors[:, :, None])


def _apply_transposed(A, vectors) -> Float[Array, "3 2 3"]:
    """A_kᵀ v_ki."""
    return _apply(jnp.swapaxes(A, 1, 2), vectors)


def elastic_forces(state: StepState) -> Float[Array, "18"]:
    """Nodal forces and moments Dπ(q_m)ᵀ s, which do the work ΔS + ξ ΔeᵀK̂Δe on (Δx, θ)."""
    F, M = _forces(state.s, state.p, state.edges)
    return jnp.stack([jnp.stack([-F[0] - F[1], F[0], F[1]]), M], axis=1).reshape(18)


# --- the tangent ------------------------------------------------------------------------------------------


def elastic_tangent(state: StepState, start: StepStart, element: Element, dissipation) -> Float[Array, "18 18"]:
    """Derivative of `elastic_forces` by u, in closed form.

    The stresses and G₁ depend on the twelve local variations e' = (l, b̄x, b̄y, ω̄_1, ω̄_2, ω̄_3) only, ω̄_k the
    local spin of node k less that of the frame. E (15, 12) collects that dependence, with that of c, and one
    product with ∂e'/∂(Δa, Δb, θ) completes it. What is left acts at fixed s and in the change of Δπ.
    """
    E = formed(_local_tangent(state, start, element, dissipation))
    u = jnp.concatenate([state.increments, state.theta]).reshape(15)
    f = state.stresses + (0.5 + dissipation) * corotational.stresses(state.change, element)
    f = corotational.conjugate(state.kin.J, f)
    pulled = jnp.concatenate([f[:3], _pull(state.kin, f).reshape(9)])
    w_metric, w = _weights(element)
    # What c Δπ adds: c's dependence on e' joins E, its dependence on Δπ is the row `by_change`.
    d_metric, turned, c = w_metric * state.d_metric, w * state.turned, state.c
    direction = _stacked(_forces(d_metric, _apply_transposed(state.A, turned), state.edges))
    direction, pulled = formed((direction, state.per_norm * (pulled - product(u, E))))
    E = E + direction[:, None] * pulled[None, :]

    end = state.edges + 0.5 * state.increments
    C = jax.vmap(spin_matrix)(state.theta)
    z = state.p + 0.5 * cross(state.theta[:, None], state.p)  # R_k1 R_km⁻¹ p_ki
    F, M = _forces(state.s + c * d_metric, z + c * turned, end)
    by_change = -state.per_norm * _stacked((F, jax.vmap(product)(M, C)))
    E, C, z, direction, by_change = formed((E, C, z, direction, by_change))
    # `jnp.dot`, which XLA does not form anew in the loop that adds the rest.
    rows = jnp.concatenate([_variations(state.kin, C), by_change[None]])
    K = jnp.dot(jnp.concatenate([E, direction[:, None]], axis=1), rows)

    # At fixed s: edges and mid-point rotations move, and Δπ changes with the end of the step.
    A_end = jnp.swapaxes(state.A, 1, 2)
    D = -0.5 * _skews(z.reshape(6, 3)).reshape(3, 2, 3, 3)
    D = D + (c * w) * jax.vmap(lambda A: jax.vmap(lambda e: product(A, rotations.skew(e)))(end))(A_end)
    D = jax.vmap(product)(D, C)  # (k, i, 3, 3): δp_ki by θ_k
    forces_theta = jnp.transpose(D, (1, 2, 0, 3))
    moments_theta = _times_edges(D, state.edges)
    S = jnp.stack([state.s[0], state.s[1], state.s[1], state.s[2]]).reshape(2, 2)
    eye = jnp.eye(3)
    outer = (c * w_metric) * state.edges[:, :, None, None] * end[None, None]  # (j, x, i, y): (e_j)_m ⊗ (e_i)_1
    same = outer[0, :, 0] + outer[1, :, 1] + (c * w) * (A_end[0] + A_end[1] + A_end[2])
    forces_edges = 0.5 * S[:, None, :, None] * eye[None, :, None, :] + jnp.transpose(outer, (2, 1, 0, 3))
    forces_edges = forces_edges + jnp.eye(2)[:, None, :, None] * same[None, :, None, :]
    moments_edges = 0.5 * _skews(state.p.reshape(6, 3)).reshape(3, 2, 3, 3)
    moments_edges = moments_edges + (c * w) * _crossed(A_end[:, None], state.edges)
    moments_theta = eye[:, None, :, None] * moments_theta[:, :, None, :]
    top = jnp.concatenate([forces_edges, forces_theta], axis=2)
    bottom = jnp.concatenate([jnp.transpose(moments_edges, (0, 2, 1, 3)), moments_theta], axis=2)
    return _to_nodes(formed(K.reshape(5, 3, 5, 3) + jnp.concatenate([top, bottom])))


def _crossed(vectors: Float[Array, "k i 3 c"], edges) -> Float[Array, "k 2 3 c"]:
    """Columns of (k, i) times edge i."""
    (x, y, z), (a, b, c) = jnp.moveaxis(vectors, 2, 0), edges.T[:, None, :, None]
    return jnp.stack([y * c - z * b, z * a - x * c, x * b - y * a], axis=2)


def _times_edges(vectors: Float[Array, "k 2 3 c"], edges) -> Float[Array, "k 3 c"]:
    """Σ_i of the columns of (k, i) times edge i: the moments of forces p_ki."""
    crossed = _crossed(vectors, edges)
    return crossed[:, 0] + crossed[:, 1]


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
    kin, began, factor = state.kin, start.kin, 0.5 + dissipation
    # Stresses by e': metric (3, 12) and moments (k, 3, 12).
    H_z, H_xy = kin.H[:, 2], kin.H[:, :2]
    if element.K_coupling is None and element.shape is None:
        membrane, tilt = _stress_derivatives(element, H_z, H_xy)
        membrane, tilt = factor * membrane, factor * tilt
    else:
        membrane, tilt = _coupled_derivatives(_moduli(element, start, state, factor), H_z, H_xy)
    metric, moments = membrane[:3], jnp.concatenate([tilt.reshape(3, 2, 12), membrane[3:, None]], axis=1)

    # p_ki by the moments (B), by the metric and by ω̄_k at fixed stresses.
    at_start = 0.5 * jax.vmap(lambda A: product(A, began.frame.T))(state.A)
    at_end = 0.5 * jax.vmap(lambda A: product(A.T, kin.frame.T))(state.A)
    corrections = corotational.moment_corrections(kin, state.f)
    s_metric, P_metric = jax.jacfwd(_gradient)(kin.coordinates, state.f[:3], state.mu)
    HT0, HT1 = jnp.swapaxes(began.H, 1, 2), jnp.swapaxes(kin.H, 1, 2)
    spread = jax.vmap(_against_edges, (None, 0))
    P_spins = spread(kin.coordinates, corrections) + _skews(state.P.reshape(6, 3)).reshape(3, 2, 3, 3)
    inner = jnp.concatenate([spread(kin.coordinates, HT1), P_metric, P_spins], axis=3)
    inner, at_end = formed((inner, at_end))
    placed = jax.vmap(lambda T, v: jax.vmap(lambda v: product(T, v))(v))
    outer = placed(at_end, inner)
    B = outer[..., :3] + placed(at_start, spread(began.coordinates, HT0))
    own = jnp.eye(3)[:, None, None, :, None] * outer[..., None, 6:]
    fixed = jnp.concatenate([outer[..., 3:6], own.reshape(3, 2, 3, 9)], axis=3)
    B, moments, fixed = formed((B, moments, fixed))
    p = jax.vmap(product)(B, moments) + fixed

    # s by e'
    rows = moments.reshape(9, 12)
    z0, z1 = product(began.H[:, :, 2].reshape(9), rows), product(kin.H[:, :, 2].reshape(9), rows)
    z1 = z1 + jnp.concatenate([jnp.zeros(3), corrections[:, 2].reshape(9)])
    s = _against_metric(began.coordinates, metric, 0.5 * z0) + _against_metric(kin.coordinates, metric, 0.5 * z1)
    s = 0.5 * (s + jnp.concatenate([s_metric, jnp.zeros((3, 9))], axis=1))

    p, s = formed((p, s))
    (a, b), total = state.edges[:, :, None], p[0] + p[1] + p[2]
    F = jnp.stack([a * s[0] + b * s[1] + total[0], a * s[1] + b * s[2] + total[1]])
    return jnp.concatenate([F.reshape(6, 12), _times_edges(p, state.edges).reshape(9, 12)])


def _stress_derivatives(element: Element, H_z: Float[Array, "3 3"], H_xy: Float[Array, "3 2 3"]):
    """K̂ ∂e/∂e' in its membrane and bending rows, (6, 12) each, where they are not coupled."""
    Km, Kb = element.K_membrane, element.K_bending.reshape(6, 3, 2)
    membrane = jnp.concatenate([Km[:, :3], (Km[:, 3:, None] * H_z[None]).reshape(6, 9)], axis=1)
    tilt = Kb[:, :, 0, None] * H_xy[:, 0] + Kb[:, :, 1, None] * H_xy[:, 1]
    return membrane, jnp.concatenate([jnp.zeros((6, 3)), tilt.reshape(6, 9)], axis=1)


def _moduli(element: Element, start: StepStart, state: StepState, factor) -> Float[Array, "12 12"]:
    """∂f/∂e of the forces conjugate to the twelve deformations, which are coupled."""
    stretched, bent, coupled = element.K_membrane, element.K_bending, element.K_coupling
    across = jnp.zeros((6, 6)) if coupled is None else coupled
    back = across.T
    shape, J, J_mean = element.shape, state.kin.J, _mean_J(start, state.kin)
    if shape is not None and J is not None and J_mean is not None:
        curving = product(shape.stiffness, J)
        if shape.by_bending is not None:
            bent = bent + transposed_product(shape.by_bending, J)
            curving = curving + shape.by_bending
        across = across + transposed_product(shape.by_membrane, J)
        back = back + transposed_product(J_mean, shape.by_membrane)
        bent = bent + transposed_product(J_mean, curving)
    bent = factor * bent
    if shape is not None:
        bent = bent + 0.5 * curvature_stiffness(shape, state.stresses[12:])
    rows = [jnp.concatenate([factor * stretched, factor * across], axis=1)]
    return jnp.concatenate([*rows, jnp.concatenate([factor * back, bent], axis=1)])


def _coupled_derivatives(K: Float[Array, "12 12"], H_z: Float[Array, "3 3"], H_xy: Float[Array, "3 2 3"]):
    """K ∂e/∂e' in its membrane and bending rows, (6, 12) each."""
    tilts = K[:, 6:].reshape(12, 3, 2)
    by_spins = K[:, 3:6, None] * H_z + tilts[:, :, 0, None] * H_xy[:, 0] + tilts[:, :, 1, None] * H_xy[:, 1]
    found = jnp.concatenate([K[:, :3], by_spins.reshape(12, 9)], axis=1)
    return found[:6], found[6:]


def _variations(kin: Kinematics, C) -> Float[Array, "12 15"]:
    """∂e'/∂(Δa, Δb, θ_1, θ_2, θ_3); the spin of the frame follows the edges, eq. (69)."""
    length, bx, by = kin.coordinates
    no, one = jnp.zeros_like(length), jnp.ones_like(length)
    metric = [one, no, no, no, no, no, no, by / length, no, one, no, no, no, -bx / length, no, no, one, no]
    tilt = [no, no, bx / (by * length), no, no, -1.0 / by, no, no, 1.0 / length, no, no, no]
    turn = [no, -1.0 / length, no, no, no, no]
    by_edges = product(jnp.stack(metric + tilt + turn).reshape(6, 2, 3), kin.frame).reshape(6, 6)
    by_edges = jnp.concatenate([by_edges, by_edges[3:], by_edges[3:]])
    own = jnp.transpose(jnp.dot(kin.frame, C), (1, 0, 2))
    own = (own[:, :, None] * jnp.eye(3)[:, None, :, None]).reshape(9, 9)
    return jnp.concatenate([by_edges, jnp.concatenate([jnp.zeros((3, 9)), own])], axis=1)
