"""DKT: the discrete Kirchhoff plate triangle, for one element.

J.-L. Batoz, K.-J. Bathe & L.-W. Ho, "A study of three-node triangular plate bending elements", Int. J. Numer.
Methods Eng. 15 (1980) 1771-1812. The bending part of K̄_m in Yang & Xia 2014, eqs. (60)-(61).

The rotations β = -grad w are quadratic in the element: their corner values are nodal degrees of freedom, and at the
middle of an edge the component along it is that of the cubic w of the edge (Kirchhoff's constraint), the
one across it the mean of its ends.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

EDGES = ((0, 1), (1, 2), (2, 0))


def bending_stiffness(xy: Float[Array, "3 2"], D: Float[Array, "3 3"]) -> Float[Array, "9 9"]:
    """Stiffness of the DKT plate triangle, degrees of freedom (w1, θx1, θy1, w2, θx2, θy2, w3, θx3, θy3).

    Rotations are right-handed about the axes: θx = ∂w/∂y, θy = -∂w/∂x.

    Arguments:
        xy: coordinates of the corners in the plane of the element [length], counter-clockwise.
        D: bending stiffness of the section in the axes of xy, M = D κ [force·length].

    Returns the symmetric stiffness of rank 6 [force/length, force, force·length]; rotations in rad.
    Source: Batoz, Bathe & Ho 1980.
    """
    # The curvatures are linear, so that the rule of the three edge midpoints integrates BᵀDB exactly.
    stiffness = jnp.zeros((9, 9))
    for B in _curvatures(xy):
        stiffness = stiffness + B.T @ D @ B
    stiffness = _area(xy) / 3.0 * stiffness
    return 0.5 * (stiffness + stiffness.T)


def bending_strains(xy: Float[Array, "3 2"]) -> Float[Array, "3 3 9"]:
    """Curvatures (κxx, κyy, 2κxy) = (βx,x, βy,y, βx,y + βy,x), β = (θy, -θx), at the midpoints of the edges 12, 23, 31.

    A fibre at z is strained by z times these.
    """
    return jnp.stack(_curvatures(xy))


def edge_function_gradients(xy: Float[Array, "3 2"]) -> Float[Array, "3 3 2"]:
    """Gradients of 4 N_i N_j [1/length], which is 1 in the middle of edge ij: (mid-edge, edge, component)."""
    gradients, found = _gradients(xy), []
    for p, q in EDGES:
        N = [0.5 if a in (p, q) else 0.0 for a in range(3)]
        found.append(jnp.stack([4.0 * (N[i] * gradients[j] + N[j] * gradients[i]) for i, j in EDGES]))
    return jnp.stack(found)


def _gradients(xy: Float[Array, "3 2"]) -> Float[Array, "3 2"]:
    """Of N1, N2, N3."""
    opposite = xy[jnp.array([2, 0, 1])] - xy[jnp.array([1, 2, 0])]
    return jnp.stack([-opposite[:, 1], opposite[:, 0]], axis=1) / (2.0 * _area(xy))


def _area(xy: Float[Array, "3 2"]) -> Float[Array, ""]:
    first_edge, last_edge = xy[1] - xy[0], xy[2] - xy[0]
    return 0.5 * (first_edge[0] * last_edge[1] - first_edge[1] * last_edge[0])


def _curvatures(xy: Float[Array, "3 2"]) -> list[Float[Array, "3 9"]]:
    gradients = _gradients(xy)
    freedoms = jnp.eye(9)
    w = freedoms[0::3]
    beta = jnp.stack([freedoms[2::3], -freedoms[1::3]], axis=1)  # (3, 2, 9): β = (θy, -θx) at the corners

    # β = Σ N_a β_a + Σ_edges 4 N_i N_j Δ_ij, Δ_ij the excess over the mean of the ends at mid-edge. Along the
    # edge e = x_j - x_i, of length l, the cubic w has w_s = 3 (w_j - w_i)/(2l) - (w_s,i + w_s,j)/4 there.
    excess = []
    for i, j in EDGES:
        e = xy[j] - xy[i]
        along = 1.5 * (w[j] - w[i]) + 0.75 * (e @ (beta[i] + beta[j]))
        excess.append(-jnp.outer(e, along) / (e @ e))

    linear_part = jnp.einsum("ax,abf->xbf", gradients, beta)
    found = []
    for of_edges in edge_function_gradients(xy):
        slope = linear_part  # slope[x, b]: derivative by x of β_b
        for gradient, delta in zip(of_edges, excess, strict=True):
            slope = slope + jnp.einsum("x,bf->xbf", gradient, delta)
        found.append(jnp.stack([slope[0, 0], slope[1, 1], slope[0, 1] + slope[1, 0]]))
    return found
