"""OPT: the optimal three-node membrane triangle with drilling degrees of freedom, for one element.

C. A. Felippa, "A study of optimal membrane triangles with drilling freedoms", Comput. Methods Appl. Mech.
Eng. 192 (2003) 2125-2168. The membrane part of K̄_m in Yang & Xia 2014, eqs. (60)-(61).

K = L A Lᵀ/A_e + ¾ β0 T_θuᵀ K_θ T_θu. The first term is the basic stiffness, which alone passes the patch
test; the second is the higher-order stiffness, tuned so that in-plane bending is exact at any aspect ratio.
Formulated in the element's own coordinates, it can be evaluated once, before the motion starts.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

ALPHA_B = 1.5  # lumping of the edge tractions to the drilling degrees of freedom


class _Parts(NamedTuple):
    """The matrices that both the stiffness and the strains are made of."""

    area: Float[Array, ""]
    L: Float[Array, "9 3"]
    """Nodal forces of a constant membrane force; Lᵀ/area is the mean strain."""
    T_theta_u: Float[Array, "3 9"]
    """Hierarchical corner rotations: drilling rotations less the mean rotation of the corners' displacements."""
    T_e: Float[Array, "3 3"]
    """Cartesian strains from the natural strains along the edges 21, 32, 13."""
    Q: tuple[Float[Array, "3 3"], ...]
    """Natural strains from the hierarchical rotations, at the midpoints of the edges 12, 23, 31."""


def membrane_stiffness(xy: Float[Array, "3 2"], A: Float[Array, "3 3"], beta0: Float[Array, ""]) -> Float[Array, "9 9"]:
    """Stiffness of the OPT membrane triangle, degrees of freedom (u1, v1, θz1, u2, v2, θz2, u3, v3, θz3).

    Arguments:
        xy: coordinates of the corners in the plane of the element [length], counter-clockwise.
        A: membrane stiffness of the section in the axes of xy, N = A ε [force/length].
        beta0: factor of the higher-order stiffness, see `jaxshell.model.sections.Resultants`.

    Returns the symmetric stiffness of rank 6 [force/length, force, force·length]; rotations in rad.
    Source: Felippa 2003, template with αb = 3/2 and β1..9 = 1, 2, 1, 0, 1, -1, -1, -1, -2.
    """
    area, L, T_theta_u, T_e, (Q4, Q5, Q6) = _parts(xy)
    basic = L @ A @ L.T / area
    A_natural = T_e.T @ A @ T_e
    K_theta = area * (Q4.T @ A_natural @ Q4 + Q5.T @ A_natural @ Q5 + Q6.T @ A_natural @ Q6)
    higher = 0.75 * beta0 * (T_theta_u.T @ K_theta @ T_theta_u)

    stiffness = basic + higher
    return 0.5 * (stiffness + stiffness.T)


def membrane_strains(xy: Float[Array, "3 2"], beta0: Float[Array, ""]) -> Float[Array, "3 3 9"]:
    """(εxx, εyy, γxy) at the midpoints of the edges 12, 23, 31, from the nine degrees of freedom.

    With their products by a membrane stiffness, integrated by the rule of these points, they give the element's
    stiffness exactly: the mean strain Lᵀ/A_e, and the higher-order part (3/2)√β0 T_e Q T_θu, whose mean is zero.
    """
    area, L, T_theta_u, T_e, Q = _parts(xy)
    higher = jnp.stack([T_e @ at_point @ T_theta_u for at_point in Q])
    return (L.T / area)[None] + 1.5 * jnp.sqrt(beta0) * higher


def _parts(xy: Float[Array, "3 2"]) -> _Parts:
    (x1, y1), (x2, y2), (x3, y3) = xy
    x12, x23, x31, y12, y23, y31 = x1 - x2, x2 - x3, x3 - x1, y1 - y2, y2 - y3, y3 - y1
    x21, x32, x13, y21, y32, y13 = -x12, -x23, -x31, -y12, -y23, -y31
    zero = jnp.zeros_like(x12)
    area = 0.5 * (x21 * y31 - x31 * y21)

    # Basic stiffness: L gives the nodal forces of a constant membrane force, L A Lᵀ/A_e their stiffness.
    def lumping(xij, yij, xjk, yjk, xki, yki):
        """Rows of L for the corner that edge ij faces; jk follows it, ki precedes it."""
        drill = [
            ALPHA_B / 6.0 * yij * (yki - yjk),
            ALPHA_B / 6.0 * xij * (xki - xjk),
            ALPHA_B / 3.0 * (xki * yki - xjk * yjk),
        ]
        return [[yij, zero, -xij], [zero, -xij, yij], drill]

    rows = lumping(x23, y23, x31, y31, x12, y12)
    rows += lumping(x31, y31, x12, y12, x23, y23)
    rows += lumping(x12, y12, x23, y23, x31, y31)
    L = 0.5 * jnp.array(rows)

    # Hierarchical corner rotations: drilling rotations less the mean rotation of the corners' displacements.
    mean_rotation = jnp.array([x23, y23, zero, x31, y31, zero, x12, y12, zero]) / (4.0 * area)
    T_theta_u = jnp.eye(9)[2::3] - mean_rotation[None, :]

    # Cartesian strains from the natural strains along the edges 21, 32, 13.
    edge_sq = jnp.array([x21**2 + y21**2, x32**2 + y32**2, x13**2 + y13**2])
    T_e = jnp.array(
        [
            [y23 * y13, y31 * y21, y12 * y32],
            [x23 * x13, x31 * x21, x12 * x32],
            [y23 * x31 + x32 * y13, y31 * x12 + x13 * y21, y12 * x23 + x21 * y32],
        ]
    )
    T_e = T_e * edge_sq[None, :] / (4.0 * area**2)
    # Natural strains from the hierarchical rotations, at the corners (Q1, Q2, Q3; they add to zero, where the
    # third row of Felippa's Q3 is misprinted) and from there at the midpoints of the edges.
    scale = (2.0 * area / 3.0) / edge_sq[:, None]
    Q1 = scale * jnp.array([[1.0, 2.0, 1.0], [0.0, 1.0, -1.0], [-1.0, -1.0, -2.0]])
    Q2 = scale * jnp.array([[-2.0, -1.0, -1.0], [1.0, 1.0, 2.0], [-1.0, 0.0, 1.0]])
    Q3 = scale * jnp.array([[1.0, -1.0, 0.0], [-1.0, -2.0, -1.0], [2.0, 1.0, 1.0]])
    Q4, Q5, Q6 = 0.5 * (Q1 + Q2), 0.5 * (Q2 + Q3), 0.5 * (Q3 + Q1)
    return _Parts(area, L, T_theta_u, T_e, (Q4, Q5, Q6))
