"""The surface that an element stands for, where that is not its triangle.

**curved.** A facet is flat, the surface is not. Let w0 be the quadratic surface over the triangle that vanishes at its
corners and has at mid-edge the height of the cubic whose slopes at the ends are those of the planes tangent to the
surface there. Bending turns the facet's fibres by the slopes s = (w,x, w,y) of DKT, and shallow-shell theory
(Marguerre; von Kármán's last term) gives the mean of the strain over the three mid-edges p

    w̄ = ⅓ Σ_p { (g_x + ½s_x) s_x,  (g_y + ½s_y) s_y,  g_x s_y + g_y s_x + s_x s_y },   g = grad w0 at p,

which is added to the constant part of the membrane strain. It is quadratic in the bending deformations, so that with
J = ∂w̄/∂e_b the change in a step is exactly Δw̄ = ½(J₀ + J₁) Δe_b: what exact conservation needs.

**relaxed.** On a curved surface a bending rotation θ_t of a node has a part in the planes of its facets, which the
membrane's higher-order strains take for a drilling rotation: that locks where a thin shell bends almost without
stretching. In the facet's plane the surface turns by θ̄z - ½ θ̄_t·g at a corner of tangent slope g (so that a field of
constant curvature changes has no hierarchical rotations at all where it does not stretch). Half of that, `_SHARE`, is
taken from the drilling rotations, and the higher-order strains are divided by (1 + `_RELIEF` x²)^½, x = 8 × height of
w0 at mid-edge / thickness, about h²/(R t): without effect where the mesh resolves √(R t). Both numbers are those that
were best over linear statics on coarse meshes (docs/accuracy.md has the figures). All of it is linear, and costs a full
K̂.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.elements.bending import EDGES, edge_function_gradients
from jaxshell.numerics.checks import Real
from jaxshell.numerics.products import dot, product, transposed_product

_SHARE = 0.25
_RELIEF = 0.05


class Tangents(NamedTuple):
    """The surface at the corners of an element, and what is made of it."""

    normals: Float[Array, "*m 3 3"]
    """(corner, 3) in space."""
    curved: Real | None
    """1 of a curved element, 0 of one among such; None where there is none in the scene."""
    relaxed: Real | None
    """The same of a relaxed element."""


class Shape(eqx.Module):
    """What one element needs of the curvature of its stress-free surface."""

    J: Float[Array, "3 6"]
    """∂w̄/∂e_b of the stress-free element: what the slopes of w0 make of the tilts θ̄x, θ̄y of the nodes."""
    P: Float[Array, "3 2 2"]
    """Slopes s_p = P_p (σ_i + σ_j) at mid-edges from those at the ends, σ = (-θ̄y, θ̄x)."""
    stiffness: Float[Array, "3 3"]
    """Area times A: forces conjugate to w̄ by w̄ itself."""
    by_membrane: Float[Array, "3 6"]
    """The same by the membrane deformations."""
    by_bending: Float[Array, "3 6"] | None
    """The same by the bending deformations, of a section that couples the two; else None."""

    @classmethod
    def build(cls, xy: Float[Array, "3 2"], slopes: Float[Array, "3 2"], curved) -> "Shape":
        """Without stiffness, from the corners and the slopes of the tangent planes there, in the element's axes.

        `curved` as in `Tangents`.
        """
        edges = jnp.stack([xy[j] - xy[i] for i, j in EDGES])
        length_sq = jnp.sum(edges * edges, axis=1)
        along = edges[:, :, None] * edges[:, None, :] / length_sq[:, None, None]
        P = curved * (0.5 * jnp.eye(2) - 0.75 * along)
        slopes_of_surface = jnp.einsum("pex,e->px", edge_function_gradients(xy), mid_edge_heights(xy, slopes))
        return cls(strain_gradient(slopes_of_surface, P), P, jnp.zeros((3, 3)), jnp.zeros((3, 6)), None)

    def stiffened(self, area, A, mean_strain, B, mean_curvature) -> "Shape":
        """The same with its stiffness. A and B (None where there is none) are the section's, `mean_strain` and
        `mean_curvature` (3, 6) those of the deformations."""
        by_bending = None if B is None else area * product(B, mean_curvature)
        return Shape(self.J, self.P, area * A, area * product(A, mean_strain), by_bending)


class Relief(eqx.Module):
    """What a relaxed element makes of its higher-order membrane strains."""

    factor: Float[Array, ""]
    drill: Float[Array, "3 6"]
    """What the tilts take from the drilling rotations of the nodes."""

    @classmethod
    def build(cls, xy: Float[Array, "3 2"], slopes: Float[Array, "3 2"], thickness, relaxed) -> "Relief":
        """From the corners and the slopes of the tangent planes there; `relaxed` as in `Tangents`."""
        heights = 8.0 * mid_edge_heights(xy, slopes) / thickness
        # Two of the three for a cylinder, all of them for a sphere: about the square of the largest.
        squares = dot(heights, heights) / 1.5
        slopes = -_SHARE * relaxed * slopes
        rows = [jnp.zeros(6).at[2 * a : 2 * a + 2].set(slopes[a]) for a in range(3)]
        return cls(1.0 / jnp.sqrt(1.0 + relaxed * _RELIEF * squares), jnp.stack(rows))


def mid_edge_heights(xy: Float[Array, "3 2"], slopes: Float[Array, "3 2"]) -> Float[Array, "3"]:
    """Heights of w0 at the middle of the edges 12, 23, 31: of the cubic, l/8 times the difference of its end slopes."""
    return jnp.stack([dot(slopes[i] - slopes[j], xy[j] - xy[i]) / 8.0 for i, j in EDGES])


def tangent_slopes(frame: Float[Array, "3 3"], normals: Float[Array, "3 3"]) -> Float[Array, "3 2"]:
    """Slopes of the planes normal to `normals` (corner, 3) over the plane of the element with the axes `frame`."""
    local = normals @ frame.T
    return -local[:, :2] / local[:, 2:]


def strain_gradient(slopes: Float[Array, "3 2"], P: Float[Array, "3 2 2"]) -> Float[Array, "3 6"]:
    """⅓ Σ_p of the derivatives by the tilts of { t_x s_x, t_y s_y, t_x s_y + t_y s_x } for slopes t = `slopes`."""
    x, y = slopes[:, 0] / 3.0, slopes[:, 1] / 3.0
    # (row, edge, component of σ)
    rows = [
        [[x[p] * P[p, 0, c] for c in range(2)] for p in range(3)],
        [[y[p] * P[p, 1, c] for c in range(2)] for p in range(3)],
        [[y[p] * P[p, 0, c] + x[p] * P[p, 1, c] for c in range(2)] for p in range(3)],
    ]
    found = []
    for row in rows:
        for p, q in _TOUCHING:
            found += [row[p][1] + row[q][1], -row[p][0] - row[q][0]]
    return jnp.stack(found).reshape(3, 6)


_TOUCHING = ((0, 2), (0, 1), (1, 2))
"""The edges at each node."""


def bent(shape: Shape, tilts: Float[Array, "6"]) -> tuple[Float[Array, "3"], Float[Array, "3 6"]]:
    """w̄ and J = ∂w̄/∂e_b at the bending deformations `tilts`."""
    sigma = [(-tilts[2 * a + 1], tilts[2 * a]) for a in range(3)]
    slopes = []
    for (i, j), P in zip(EDGES, shape.P, strict=True):
        x, y = sigma[i][0] + sigma[j][0], sigma[i][1] + sigma[j][1]
        slopes += [P[0, 0] * x + P[0, 1] * y, P[1, 0] * x + P[1, 1] * y]
    J = shape.J + strain_gradient(jnp.stack(slopes).reshape(3, 2), shape.P)
    return product(0.5 * (shape.J + J), tilts), J


def curvature_stiffness(shape: Shape, n: Float[Array, "3"]) -> Float[Array, "6 6"]:
    """Derivative of Jᵀn by the tilts at fixed forces n conjugate to w̄: symmetric."""
    N = jnp.stack([n[0], n[2], n[2], n[1]]).reshape(2, 2) / 3.0
    B = [transposed_product(P, product(N, P)) for P in shape.P]
    B = [jnp.stack([b[1, 1], -b[1, 0], -b[0, 1], b[0, 0]]).reshape(2, 2) for b in B]  # σ → θ̄x, θ̄y
    rows = [[B[0] + B[2], B[0], B[2]], [B[0], B[0] + B[1], B[1]], [B[2], B[1], B[1] + B[2]]]
    return jnp.concatenate([jnp.concatenate(row, axis=1) for row in rows])
