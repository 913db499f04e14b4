"""Element-independent corotational triangle (Felippa & Haugen 2005; Yang & Xia 2014, eqs. (54)-(85)).

One element: nodal positions x (3, 3) and nodal rotations R (3, 3, 3) give local deformations, the strain
energy, the nodal forces and the closed-form tangents. Nothing here depends on time.

Of the 18 entries of p̄_d, eq. (59), six vanish or follow from the others, because the local frame passes
through the three nodes with e1 along edge 1-2: no node leaves the local plane, and a common translation
does not deform. The deformations kept are the 12 entries of

    e = { l - l⁰, b̄x - b̄x⁰, b̄y - b̄y⁰, θ̄z1, θ̄z2, θ̄z3 | θ̄x1, θ̄y1, θ̄x2, θ̄y2, θ̄x3, θ̄y3 },

with l the length of edge 1-2 and (b̄x, b̄y) node 3 seen from node 1. K̄_m loses the rows and columns of the
others and falls into a membrane and a bending block of 6 × 6; energy and forces are those of eqs. (60)-(70).
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell import rotations
from jaxshell.elements.bending import bending_stiffness
from jaxshell.elements.membrane import membrane_stiffness

# Rows of the 9×9 membrane (u, v, θz per node) and bending (w, θx, θy per node) stiffness that are kept.
_MEMBRANE_KEPT = np.array([3, 6, 7, 2, 5, 8])
_BENDING_KEPT = np.array([1, 2, 4, 5, 7, 8])


class Element(eqx.Module):
    """What one element needs of its stress-free shape and section."""

    coordinates: Float[Array, "3"]
    """l⁰, b̄x⁰, b̄y⁰ [length]."""
    frame: Float[Array, "3 3"]
    """T_GE0: rows e1⁰, e2⁰, e3⁰."""
    K_membrane: Float[Array, "6 6"]
    K_bending: Float[Array, "6 6"]
    area: Float[Array, ""]
    mass_per_area: Float[Array, ""]
    """M_ρ = ρh, eq. (30)."""
    rotary_inertia: Float[Array, ""]
    """ρh³/12, the two equal entries of I_ρ⁰, eq. (32)."""

    @classmethod
    def build(cls, x0, thickness, young_modulus, poisson_ratio, density) -> "Element":
        """From nodal positions x0 (3, 3) of the stress-free shape and the element's section (scalars)."""
        frame, coordinates = local_frame(x0)
        length, bx, by = coordinates
        zero = jnp.zeros_like(length)
        xy = jnp.stack([zero, zero, length, zero, bx, by]).reshape(3, 2)
        membrane = membrane_stiffness(xy, thickness, young_modulus, poisson_ratio)
        bending = bending_stiffness(xy, thickness, young_modulus, poisson_ratio)
        return cls(
            coordinates,
            frame,
            membrane[_MEMBRANE_KEPT][:, _MEMBRANE_KEPT],
            bending[_BENDING_KEPT][:, _BENDING_KEPT],
            0.5 * length * by,
            density * thickness,
            density * thickness**3 / 12.0,
        )


class Kinematics(NamedTuple):
    """The deformed element in its corotated frame."""

    frame: Float[Array, "3 3"]
    """T_GE: rows e1, e2, e3."""
    coordinates: Float[Array, "3"]
    """l, b̄x, b̄y."""
    theta: Float[Array, "3 3"]
    """θ̄_da, the local deformational rotation vector of node a."""
    H: Float[Array, "3 3 3"]
    """H(θ̄_da), eq. (9)."""
    deformations: Float[Array, "12"]
    """e, see the top of this file."""


def local_frame(x) -> tuple[Float[Array, "3 3"], Float[Array, "3"]]:
    """Rows e1 ∥ edge 1-2, e2, e3 normal, eq. (54), and the local coordinates (l, b̄x, b̄y), from x (3, 3)."""
    a, b = x[1] - x[0], x[2] - x[0]
    length = jnp.sqrt(jnp.sum(a * a))
    normal = jnp.cross(a, b)
    double_area = jnp.sqrt(jnp.sum(normal * normal))
    e1, e3 = a / length, normal / double_area
    frame = jnp.stack([e1, jnp.cross(e3, e1), e3])
    return frame, jnp.stack([length, jnp.sum(b * e1), double_area / length])


def kinematics(x, R, element: Element) -> Kinematics:
    """Local frame, deformational rotations and deformations, eqs. (54)-(59), from x (3, 3) and R (3, 3, 3)."""
    frame, coordinates = local_frame(x)
    # eq. (56); products of 3×3 matrices as sums, which XLA fuses with what stands around them
    to_local = jnp.sum(frame[None, :, :, None] * R[:, None, :, :], axis=2)
    R_local = jnp.sum(to_local[:, :, None, :] * element.frame[None, None, :, :], axis=3)
    theta = jax.vmap(rotations.log)(R_local)
    H = jax.vmap(rotations.H)(theta)
    deformations = jnp.concatenate([coordinates - element.coordinates, theta[:, 2], theta[:, :2].reshape(6)])
    return Kinematics(frame, coordinates, theta, H, deformations)


def stresses(deformations, element: Element) -> Float[Array, "12"]:
    """f̂ = K̂ e, the forces conjugate to the deformations: eq. (60) for the entries kept."""
    return jnp.concatenate([element.K_membrane @ deformations[:6], element.K_bending @ deformations[6:]])


def strain_energy(deformations, element: Element) -> Float[Array, ""]:
    """S = ½ eᵀ K̂ e, eq. (61) [force·length]."""
    return 0.5 * jnp.sum(deformations * stresses(deformations, element))


def _moments(f) -> Float[Array, "3 3"]:
    """(3, 3) moments conjugate to θ̄_a out of the 12 stresses."""
    return jnp.concatenate([f[6:].reshape(3, 2), f[3:6, None]], axis=1)


def spin_gradient(coordinates) -> Float[Array, "3 3 3"]:
    """Ḡ_b of eq. (69) for b = 1, 2, 3: the frame's local spin is ω̄_e = Σ_b Ḡ_b ū_b. Shape (b, 3, 3)."""
    length, bx, by = coordinates
    zero, half = jnp.zeros_like(length), 1.0 / (length * by)
    G1 = [zero, zero, (bx - length) * half, zero, zero, by * half, zero, -1.0 / length, zero]
    G2 = [zero, zero, -bx * half, zero, zero, -by * half, zero, 1.0 / length, zero]
    G3 = [zero, zero, length * half, zero, zero, zero, zero, zero, zero]
    return jnp.stack(G1 + G2 + G3).reshape(3, 3, 3)


def local_forces(kin: Kinematics, f) -> Float[Array, "3 2 3"]:
    """Projected nodal forces and moments n̄_a, m̄_a = P̄ᵀ H̄ᵀ f̄ in the corotated frame. Shape (a, force/moment, 3)."""
    _, bx, by = kin.coordinates
    moments = jnp.sum(kin.H * _moments(f)[:, :, None], axis=1)
    # What turns the frame: the nodal moments (-Ḡ_b in eq. (67)) and the membrane forces at node 3.
    turning = -jnp.sum(moments, axis=0) + jnp.stack([0.0 * bx, 0.0 * bx, by * f[1] - bx * f[2]])
    forces = jnp.sum(spin_gradient(kin.coordinates) * turning[None, :, None], axis=1)
    zero = jnp.zeros_like(bx)
    direct = jnp.stack([-f[0] - f[1], -f[2], zero, f[0], zero, zero, f[1], f[2], zero]).reshape(3, 3)
    return jnp.stack([forces + direct, moments], axis=1)


def to_global(local, kin: Kinematics) -> Float[Array, "18"]:
    """Tᵀ applied to (3, 2, 3) nodal forces and moments; entries ordered as δq = {δd_1, δω_1, δd_2, ...}."""
    return jnp.sum(local[:, :, :, None] * kin.frame[None, None, :, :], axis=2).reshape(18)


def internal_force(x, R, element: Element) -> Float[Array, "18"]:
    """f_int = Λᵀ K̄_m p̄_d, eq. (70): the gradient of the strain energy with respect to displacements and spins."""
    kin = kinematics(x, R, element)
    return to_global(local_forces(kin, stresses(kin.deformations, element)), kin)


# --- matrices in the corotated frame ----------------------------------------------------------------------


def frame_spin(kin: Kinematics) -> Float[Array, "3 18"]:
    """Ḡ, eq. (77): ω̄_e = Ḡ δq̄."""
    G = jnp.transpose(spin_gradient(kin.coordinates), (1, 0, 2))
    return jnp.concatenate([G, jnp.zeros_like(G)], axis=2).reshape(3, 18)


def deformation_gradient(kin: Kinematics) -> Float[Array, "12 18"]:
    """Λ = H̄ P̄ of eqs. (64)-(67) for the deformations kept, in the corotated frame: δe = Λ δq̄."""
    _, bx, by = kin.coordinates
    G = frame_spin(kin)
    metric = jnp.asarray(_METRIC) + jnp.stack([0.0 * by, by, -bx])[:, None] * G[2]
    relative = jnp.asarray(_SPINS) - G[None]  # δω̄_a - ω̄_e
    turn = jnp.sum(kin.H[:, :, :, None] * relative[:, None, :, :], axis=2)
    return jnp.concatenate([metric, turn[:, 2], turn[:, :2].reshape(6, 18)])


_METRIC = np.zeros((3, 18))
_METRIC[0, [6, 0]] = _METRIC[1, [12, 0]] = _METRIC[2, [13, 1]] = 1.0, -1.0
_SPINS = np.zeros((3, 3, 18))
for _a in range(3):
    _SPINS[_a, :, 6 * _a + 3 : 6 * _a + 6] = np.eye(3)


def _skews(vectors) -> Float[Array, "k 3 3"]:
    return jax.vmap(rotations.skew)(vectors)


def rotational_stiffness(kin: Kinematics, local) -> Float[Array, "18 18"]:
    """K_GR of eq. (75) in the corotated frame, -F̄_nm Ḡ; `local` (3, 2, 3) are the projected forces."""
    F_nm = _skews(local.reshape(6, 3)).reshape(18, 3)
    return -F_nm @ frame_spin(kin)


def projection_stiffness(kin: Kinematics, local) -> Float[Array, "18 18"]:
    """K_GP of eq. (78) in the corotated frame, -Ḡᵀ F̄_nᵀ P̄; `local` (3, 2, 3) are the projected forces.

    The translational rows of P̄, eq. (67), are U_ab + ~x̄_a Ḡ_b, and the forces sum to zero, which leaves
    F̄_nᵀ P̄ = -[~n̄_b] - (Σ_a ~n̄_a ~x̄_a) Ḡ.
    """
    length, bx, by = kin.coordinates
    zero = jnp.zeros_like(length)
    n = _skews(local[:, 0])
    positions = jnp.stack([zero, zero, zero, length, zero, zero, bx, by, zero]).reshape(3, 3)
    turned = jnp.sum(n[:, :, :, None] * _skews(positions)[:, None, :, :], axis=(0, 2))
    G = frame_spin(kin)
    spread = jnp.stack([n, jnp.zeros_like(n)], axis=1)
    return G.T @ (jnp.transpose(spread, (2, 0, 1, 3)).reshape(3, 18) + turned @ G)


def moment_corrections(kin: Kinematics, f) -> Float[Array, "3 3 3"]:
    """M̄_a of eq. (82) for the three nodes: the derivative of H(θ̄)ᵀ m̄ times H(θ̄); `f` are the 12 stresses."""

    def one(theta, m, H):
        theta_sq = jnp.sum(theta * theta)
        eta, mu = rotations.eta(theta_sq), rotations.mu(theta_sq)
        dot, skew = jnp.sum(theta * m), rotations.skew(theta)
        outer = theta[:, None] * m[None, :]
        twice = skew @ (skew @ m)
        D = eta * (dot * jnp.eye(3) + outer - 2.0 * outer.T) + mu * twice[:, None] * theta[None, :]
        return (D - 0.5 * rotations.skew(m)) @ H

    return jax.vmap(one)(kin.theta, _moments(f), kin.H)


def moment_correction_stiffness(kin: Kinematics, f) -> Float[Array, "18 18"]:
    """K_GM of eq. (80) in the corotated frame, P̄ᵀ M̄ P̄; `f` are the 12 stresses."""
    relative = jnp.asarray(_SPINS) - frame_spin(kin)[None]
    return jnp.einsum("aik,aij,ajl->kl", relative, moment_corrections(kin, f), relative)


def geometric_stiffness(kin: Kinematics, f, local) -> Float[Array, "18 18"]:
    """K_GR + K_GP + K_GM, eq. (74), in the corotated frame: the derivative of Λᵀ f̄ at fixed stresses `f`."""
    return (
        rotational_stiffness(kin, local) + projection_stiffness(kin, local) + moment_correction_stiffness(kin, f)
    )


def material_stiffness(gradient, left_gradient, element: Element) -> Float[Array, "18 18"]:
    """Λ_leftᵀ K̄ Λ, eq. (84), from the (12, 18) gradients; the two differ at the paper's generalised mid-point."""
    K_Lambda = jnp.concatenate([element.K_membrane @ gradient[:6], element.K_bending @ gradient[6:]])
    return left_gradient.T @ K_Lambda


def matrix_to_global(K, kin: Kinematics) -> Float[Array, "18 18"]:
    """Tᵀ K T for an (18, 18) matrix in the corotated frame."""
    blocks = K.reshape(6, 3, 6, 3)
    half = jnp.einsum("aibj,jn->aibn", blocks, kin.frame)
    return jnp.einsum("im,aibn->ambn", kin.frame, half).reshape(18, 18)


def tangent_stiffness(x, R, element: Element) -> Float[Array, "18 18"]:
    """K_Stat, eq. (85): the derivative of `internal_force` with respect to displacements and spins."""
    kin = kinematics(x, R, element)
    f = stresses(kin.deformations, element)
    Lambda = deformation_gradient(kin)
    K = material_stiffness(Lambda, Lambda, element) + geometric_stiffness(kin, f, local_forces(kin, f))
    return matrix_to_global(K, kin)
