"""Element-independent corotational triangle (Felippa & Haugen 2005; Yang & Xia 2014, eqs. (54)-(85)).

One element: nodal positions x (3, 3) and nodal rotations R (3, 3, 3) give local deformations, the strain
energy, the nodal forces and the closed-form tangents. Nothing here depends on time.

Of the 18 entries of p̄_d, eq. (59), six vanish or follow from the others, because the local frame passes
through the three nodes with e1 along edge 1-2: no node leaves the local plane, and a common translation
does not deform. The deformations kept are the 12 entries of

    e = { l - l⁰, b̄x - b̄x⁰, b̄y - b̄y⁰, θ̄z1, θ̄z2, θ̄z3 | θ̄x1, θ̄y1, θ̄x2, θ̄y2, θ̄x3, θ̄y3 },

with l the length of edge 1-2 and (b̄x, b̄y) node 3 seen from node 1. K̄_m loses the rows and columns of the
others and falls into a membrane and a bending block of 6 × 6; energy and forces are those of eqs. (60)-(70).

An element with the curvature of its surface (`jaxshell.elements.shape`) has three more, the mean membrane strain w̄ that
bending causes there. They are counted among the deformations, and the forces conjugate to them among the stresses:
`conjugate` makes of the 15 the twelve conjugate to e.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.elements.element import Element
from jaxshell.elements.shape import bent, curvature_stiffness
from jaxshell.numerics import rotations
from jaxshell.numerics.checks import Real
from jaxshell.numerics.fusion import formed
from jaxshell.numerics.products import columns_times, dot, product, transposed_product
from jaxshell.numerics.triangles import local_frame


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
    deformations: Float[Array, " d"]
    """e, see the top of this file, less those of the element's stress-free state where initial strains act: (12,), and
    (15,) where it is curved."""
    J: Float[Array, "3 6"] | None = None
    """∂w̄/∂e_b of a curved element."""


def kinematics(x: Float[Array, "3 3"], R: Float[Array, "3 3 3"], element: Element) -> Kinematics:
    """Local frame, deformational rotations and deformations, eqs. (54)-(59), from x (3, 3) and R (3, 3, 3)."""
    frame, coordinates = local_frame(x)

    def deformational_rotation(R):  # eq. (56)
        return rotations.log(product(product(frame, R), element.frame.T))

    theta = jax.vmap(deformational_rotation)(R)
    H = jax.vmap(rotations.H)(theta)
    deformations = jnp.concatenate([coordinates - element.coordinates, theta[:, 2], theta[:, :2].reshape(6)])
    J = curving = None
    if element.shape is not None:  # by all of the bending, free of stress or not
        curving, J = bent(element.shape, deformations[6:])
    if element.rest is not None:
        deformations = deformations - element.rest
    if curving is not None:
        deformations = jnp.concatenate([deformations, curving])
    return Kinematics(frame, coordinates, theta, H, deformations, J)


def total_deformations(kin: Kinematics, element: Element) -> Float[Array, " d"]:
    """The deformations counted from the mesh, whatever is free of stress."""
    if element.rest is None:
        return kin.deformations
    return kin.deformations + jnp.pad(element.rest, (0, len(kin.deformations) - 12))


def stresses(deformations, element: Element) -> Float[Array, " d"]:
    """f̂ = K̂ e, the forces conjugate to the deformations: eq. (60) for the entries kept."""
    return jnp.concatenate(times_stiffness(element, deformations))


def times_stiffness(element: Element, columns: Float[Array, "d *c"]) -> list[Array]:
    """K̂ times columns, in its membrane and bending rows, and those of w̄ where the element is curved."""
    membrane, bending = columns[:6], columns[6:12]
    rows = [product(element.K_membrane, membrane), product(element.K_bending, bending)]
    if element.K_coupling is not None:
        coupled = product(element.K_coupling, bending), product(element.K_coupling.T, membrane)
        rows = [rows[0] + coupled[0], rows[1] + coupled[1]]
    if element.shape is None:
        return rows
    shape, curving = element.shape, columns[12:]
    rows = [rows[0] + product(shape.by_membrane.T, curving), rows[1]]
    last = product(shape.by_membrane, membrane) + product(shape.stiffness, curving)
    if shape.by_bending is not None:
        rows[1] = rows[1] + product(shape.by_bending.T, curving)
        last = last + product(shape.by_bending, bending)
    return [*rows, last]


def conjugate(J: Float[Array, "3 6"] | None, f: Float[Array, " d"]) -> Float[Array, "12"]:
    """The forces conjugate to e of all stresses: those of a curved element bend it by the slopes J = ∂w̄/∂e_b."""
    if J is None or f.shape[0] == 12:
        return f
    return jnp.concatenate([f[:6], f[6:12] + product(f[12:], J)])


def strain_energy(deformations, element: Element) -> Float[Array, ""]:
    """S = ½ eᵀ K̂ e, eq. (61) [force·length]."""
    return 0.5 * dot(deformations, stresses(deformations, element))


def moments_of(f) -> Float[Array, "3 3"]:
    """(3, 3) moments conjugate to θ̄_a out of the 12 forces conjugate to e."""
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
    f = conjugate(kin.J, f)
    _, bx, by = kin.coordinates
    moments = jax.vmap(lambda H, m: product(m, H))(kin.H, moments_of(f))
    # What turns the frame: the nodal moments (-Ḡ_b in eq. (67)) and the membrane forces at node 3.
    turning = -(moments[0] + moments[1] + moments[2]) + jnp.stack([0.0 * bx, 0.0 * bx, by * f[1] - bx * f[2]])
    forces = jax.vmap(lambda G: product(turning, G))(spin_gradient(kin.coordinates))
    zero = jnp.zeros_like(bx)
    direct = jnp.stack([-f[0] - f[1], -f[2], zero, f[0], zero, zero, f[1], f[2], zero]).reshape(3, 3)
    return jnp.stack([forces + direct, moments], axis=1)


def to_global(local, kin: Kinematics) -> Float[Array, "18"]:
    """Tᵀ applied to (3, 2, 3) nodal forces and moments; entries ordered as δq = {δd_1, δω_1, δd_2, ...}."""
    return product(local, kin.frame).reshape(18)


def internal_force(x: Float[Array, "3 3"], R: Float[Array, "3 3 3"], element: Element) -> Float[Array, "18"]:
    """f_int = Λᵀ K̄_m p̄_d, eq. (70): the gradient of the strain energy with respect to displacements and spins."""
    kin = kinematics(x, R, element)
    return to_global(local_forces(kin, stresses(kin.deformations, element)), kin)


# --- matrices ---------------------------------------------------------------------------------------------


def frame_spin(kin: Kinematics) -> Float[Array, "3 18"]:
    """Ḡ, eq. (77): ω̄_e = Ḡ δq̄, in the corotated frame."""
    G = jnp.transpose(spin_gradient(kin.coordinates), (1, 0, 2))
    return jnp.concatenate([G, jnp.zeros_like(G)], axis=2).reshape(3, 18)


def deformation_gradient(kin: Kinematics) -> Float[Array, "d 18"]:
    """Λ = H̄ P̄ of eqs. (64)-(67) for the deformations kept, in the corotated frame: δe = Λ δq̄. (15, 18) if curved."""
    _, bx, by = kin.coordinates
    G = frame_spin(kin)
    metric = jnp.asarray(_METRIC) + jnp.stack([0.0 * by, by, -bx])[:, None] * G[2][None]
    # H(θ̄_a) (δω̄_a - ω̄_e)
    turn = jax.vmap(lambda H, spin: product(H, spin - G))(kin.H, jnp.asarray(_SPINS))
    tilts = turn[:, :2].reshape(6, 18)
    rows = [metric, turn[:, 2], tilts]
    return jnp.concatenate(rows if kin.J is None else [*rows, product(kin.J, tilts)])


_METRIC = np.zeros((3, 18))
_METRIC[0, [6, 0]] = _METRIC[1, [12, 0]] = _METRIC[2, [13, 1]] = 1.0, -1.0
_SPINS = np.zeros((3, 3, 18))
for _a in range(3):
    _SPINS[_a, :, 6 * _a + 3 : 6 * _a + 6] = np.eye(3)


class GeometricParts(NamedTuple):
    """A geometric stiffness in the corotated frame as X Ḡ + Ḡᵀ Y + diag(D at the rotations of each node).

    All three terms of eq. (74) have this form, and cost little in it.
    """

    X: Float[Array, "18 3"]
    Y: Float[Array, "3 18"]
    D: Float[Array, "3 3 3"]

    def matrix(self, kin: Kinematics) -> Float[Array, "18 18"]:
        """The matrix itself, in global axes."""
        G = frame_spin(kin)
        K = product(self.X, G) + transposed_product(G, self.Y) + on_rotations(_OWN, self.D)
        rows = gradient_to_global(K, kin)
        return gradient_to_global(rows.T, kin).T


def _skews(vectors) -> Float[Array, "k 3 3"]:
    return jax.vmap(rotations.skew)(vectors)


def _columns(forces, moments) -> Float[Array, "3 18"]:
    """(3, 18) from the (a, 3, 3) blocks at the displacements and at the rotations of the nodes."""
    return jnp.transpose(jnp.stack([forces, moments], axis=1), (2, 0, 1, 3)).reshape(3, 18)


def rotational_stiffness(local) -> GeometricParts:
    """K_GR of eq. (75), -F̄_nm Ḡ; `local` (3, 2, 3) are the projected forces."""
    F_nm = _skews(local.reshape(6, 3)).reshape(18, 3)
    return GeometricParts(-F_nm, jnp.zeros((3, 18)), jnp.zeros((3, 3, 3)))


def projection_stiffness(kin: Kinematics, local) -> GeometricParts:
    """K_GP of eq. (78), -Ḡᵀ F̄_nᵀ P̄; `local` (3, 2, 3) are the projected forces.

    The translational rows of P̄, eq. (67), are U_ab + ~x̄_a Ḡ_b, and the forces sum to zero, which leaves
    F̄_nᵀ P̄ = -[~n̄_b] - (Σ_a ~n̄_a ~x̄_a) Ḡ.
    """
    length, bx, by = kin.coordinates
    zero = jnp.zeros_like(length)
    n = _skews(local[:, 0])
    # ~n ~x = x nᵀ - (n·x) I; node 1 is the origin.
    x2, x3 = jnp.stack([length, zero, zero]), jnp.stack([bx, by, zero])
    n2, n3 = local[1, 0], local[2, 0]
    turned = x2[:, None] * n2[None] + x3[:, None] * n3[None] - (dot(n2, x2) + dot(n3, x3)) * jnp.eye(3)
    Y = _columns(n, jnp.zeros_like(n)) + product(turned, frame_spin(kin))
    return GeometricParts(jnp.zeros((18, 3)), Y, jnp.zeros((3, 3, 3)))


def moment_corrections(kin: Kinematics, f) -> Float[Array, "3 3 3"]:
    """M̄_a of eq. (82) for the three nodes: the derivative of H(θ̄)ᵀ m̄ times H(θ̄); `f` are the stresses."""

    def one(theta, m, H):
        theta_sq = dot(theta, theta)
        eta, mu = rotations.eta(theta_sq), rotations.mu(theta_sq)
        along = dot(theta, m)
        outer = theta[:, None] * m[None, :]
        twice = along * theta - theta_sq * m  # ~θ~θ m
        D = eta * (along * jnp.eye(3) + outer - 2.0 * outer.T) + mu * twice[:, None] * theta[None, :]
        return product(D - 0.5 * rotations.skew(m), H)

    return jax.vmap(one)(kin.theta, moments_of(conjugate(kin.J, f)), kin.H)


def moment_correction_stiffness(kin: Kinematics, f) -> GeometricParts:
    """K_GM of eq. (80), P̄ᵀ M̄ P̄, whose rotational rows of P̄ are δω̄_a - ω̄_e; `f` are the stresses."""
    M = moment_corrections(kin, f)
    zero = jnp.zeros_like(M)
    X = -jnp.stack([zero, M], axis=1).reshape(18, 3)
    Y = product(M[0] + M[1] + M[2], frame_spin(kin)) - _columns(zero, M)
    return GeometricParts(X, Y, M)


def geometric_parts(kin: Kinematics, f, local) -> GeometricParts:
    """K_GR + K_GP + K_GM, eq. (74): the derivative of Λᵀ f̄ at fixed stresses `f`, in the corotated frame."""
    terms = rotational_stiffness(local), projection_stiffness(kin, local), moment_correction_stiffness(kin, f)
    return GeometricParts(*(a + b + c for a, b, c in zip(*terms, strict=True)))


def gradient_to_global(Lambda, kin: Kinematics) -> Float[Array, "r 18"]:
    """Λ T for the (r, 18) rows of a gradient in the corotated frame."""
    return product(Lambda.reshape(-1, 6, 3), kin.frame).reshape(-1, 18)


def stiffness(
    kin: Kinematics, f, element: Element, spin, material: Real = 1.0, geometric: Real = 1.0, average=None
) -> Float[Array, "18 18"]:
    """Tangent stiffness in global axes, (18, 18), eq. (85), or eq. (97) at the generalised mid-point.

    Arguments:
        f: stresses of the geometric part, (12,) or (15,).
        spin: (3, 3, 3) derivatives of the nodal spins by the unknown rotations; None for the spins themselves.
        material, geometric: factors of the two parts.
        average: what to do with Λ (12, 18) in global axes where it stands on the left; None leaves it.

    One product of 18 terms: twelve deformations, and three of each of Ḡ and Ḡᵀ, see `GeometricParts`. A curved element
    has three terms more, and the six of what its slopes change.
    """
    # The factors of a product are formed once, and not anew in each of its entries.
    kin, f = formed((kin, f))
    Lambda, G, parts = formed(
        (deformation_gradient(kin), frame_spin(kin), geometric_parts(kin, f, local_forces(kin, f)))
    )
    d = Lambda.shape[0]
    K_Lambda = times_stiffness(element, Lambda)
    left = [Lambda, parts.X.T, G]
    right = [material * jnp.concatenate(K_Lambda), geometric * G, geometric * parts.Y]
    if element.shape is not None:
        left.append(Lambda[6:12])
        right.append(geometric * product(curvature_stiffness(element.shape, f[12:]), Lambda[6:12]))
    left, right = formed((jnp.concatenate(left), jnp.concatenate(right)))
    left = gradient_to_global(left, kin)
    if average is not None:
        left = jnp.concatenate([average(left[:d]), left[d:]])
    frames = jnp.broadcast_to(kin.frame, (3, 3, 3))
    turns = frames if spin is None else jax.vmap(lambda S: product(kin.frame, S))(spin)
    turns = jnp.stack([frames, turns], axis=1)
    right = columns_times(right.reshape(-1, 6, 3), turns.reshape(6, 3, 3)).reshape(-1, 18)
    D = jax.vmap(lambda D, T: transposed_product(kin.frame, product(geometric * D, T)))(parts.D, turns[:, 1])
    # `jnp.dot`, whose result XLA does not form anew in the loop that adds the blocks: see `on_rotations`.
    return jnp.dot(left.T, right) + on_rotations(_OWN, D)


def on_rotations(weights, blocks: Float[Array, "k 3 3"]) -> Float[Array, "18 18"]:
    """Σ_k weights[a, b, k] blocks[k] at the rotations of nodes a and b; `weights` (3, 3, k).

    XLA fuses what it can into the loop over the 324 entries, where the blocks' own formulas would be evaluated entry
    by entry; a `dot` stays outside: 3.2 instead of 4.7 µs for the tangent of an element with seven-point inertia.
    """
    summed = jnp.dot(weights.reshape(9, -1), blocks.reshape(-1, 9)).reshape(3, 3, 3, 3)
    return jnp.pad(jnp.transpose(summed, (0, 2, 1, 3)), [(0, 0), (3, 0)] * 2).reshape(18, 18)


_OWN = np.zeros((3, 3, 3))
_OWN[range(3), range(3), range(3)] = 1.0
"""Weights of one block a node, between its own rotations."""


def tangent_stiffness(x: Float[Array, "3 3"], R: Float[Array, "3 3 3"], element: Element) -> Float[Array, "18 18"]:
    """K_Stat, eq. (85): the derivative of `internal_force` with respect to displacements and spins."""
    kin = kinematics(x, R, element)
    return stiffness(kin, stresses(kin.deformations, element), element, None)
