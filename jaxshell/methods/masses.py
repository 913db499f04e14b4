"""Inertia of point masses, in the exact method and in those of Newmark's kind: forces, energies and momenta.

`EnergyMomentum` keeps Ṙ of every node. With Euler's tensor E = ½ tr(J) I - J of the inertia tensor J, in the axes of
the stress-free shape, T = ½ tr(Ṙ E Ṙᵀ), and the moment is the axial vector of R̄ E Aᵀ with the mean R̄ and the rate A of
Ṙ over the step. On Cayley vectors it does the work ΔT, and it is the rate of the angular momentum, the axial vector of
R E Ṙᵀ.

The others integrate J Ω̇ + Ω × J Ω in the node's own axes, with Newmark's formulas and R averaged as eq. (91) does.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.assembly.lumps import Lumps
from jaxshell.elements.energy_momentum import mid_matrix
from jaxshell.elements.inertia import Spins, StepFactors, end_of_step
from jaxshell.model.masses import euler_tensor
from jaxshell.numerics.products import product
from jaxshell.numerics.rotations import exp


class Momentum(NamedTuple):
    """Of all point masses."""

    kinetic: Float[Array, ""]
    linear: Float[Array, "3"]
    angular: Float[Array, "3"]


def axial(matrix: Float[Array, "*k 3 3"]) -> Float[Array, "*k 3"]:
    """Σ ε_ipq M_pq: of a bᵀ it is a × b."""
    M = matrix
    return jnp.stack([M[..., 1, 2] - M[..., 2, 1], M[..., 2, 0] - M[..., 0, 2], M[..., 0, 1] - M[..., 1, 0]], axis=-1)


# --- the exact method ----------------------------------------------------------------------------------------


class ExactStart(NamedTuple):
    """Masses at the start of a step, each leaf with a leading axis k."""

    mass: Float[Array, ""]
    euler: Float[Array, "3 3"]
    v: Float[Array, "3"]
    R: Float[Array, "3 3"]
    W: Float[Array, "3 3"]


def exact_start(lumps: Lumps, v, R, W) -> ExactStart:
    """From v, R, Ṙ of all nodes."""
    return ExactStart(lumps.mass, euler_tensor(lumps.inertia), v[lumps.at], R[lumps.at], W[lumps.at])


def exact_force(u: Float[Array, "6"], start: ExactStart, dt) -> Float[Array, "6"]:
    """m (v₁ - v₀)/Δt where Δt ½(v₁ + v₀) is the increment, and the moment; of one node."""
    theta = u[3:]
    middle = product(mid_matrix(theta), start.R)
    changed = jnp.cross(theta[None, :], middle.T).T  # R₁ - R₀, column by column
    rate = 2.0 * (changed / dt - start.W) / dt
    force = 2.0 * start.mass * (u[:3] / dt - start.v) / dt
    return jnp.concatenate([force, axial(middle @ start.euler @ rate.T)])


def exact_momentum(lumps: Lumps, x, v, R, W) -> Momentum:
    """Kinetic energy and momenta; x, v, R, Ṙ of all nodes."""
    linear = lumps.mass[:, None] * v[lumps.at]
    R, W = R[lumps.at], W[lumps.at]
    spin = W @ euler_tensor(lumps.inertia)
    kinetic = 0.5 * jnp.sum(v[lumps.at] * linear) + 0.5 * jnp.sum(W * spin)
    angular = jnp.cross(x[lumps.at], linear) + axial(R @ jnp.swapaxes(spin, 1, 2))
    return Momentum(kinetic, jnp.sum(linear, axis=0), jnp.sum(angular, axis=0))


# --- Newmark's kind ------------------------------------------------------------------------------------------


class Start(NamedTuple):
    """Masses at the start of a step, each leaf with a leading axis k."""

    mass: Float[Array, ""]
    inertia: Float[Array, "3 3"]
    v: Float[Array, "3"]
    a: Float[Array, "3"]
    spins: Spins


def initial_spins(lumps: Lumps | None, R: Float[Array, "n 3 3"], omega, alpha) -> Spins | None:
    """Of the nodes with masses, from angular velocities and accelerations (n, 3) in space."""
    if lumps is None:
        return None
    R = R[lumps.at]
    Omega, Omega_dot = (jnp.einsum("kij,ki->kj", R, vectors[lumps.at]) for vectors in (omega, alpha))
    return Spins(R, Omega, Omega_dot)


def start(lumps: Lumps | None, v, a, spins: Spins | None) -> Start | None:
    """From v, a of all nodes and the spins of those with masses."""
    if lumps is None or spins is None:
        return None
    return Start(lumps.mass, lumps.inertia, v[lumps.at], a[lumps.at], spins)


def force(u: Float[Array, "6"], start: Start, factors: StepFactors) -> Float[Array, "6"]:
    """m a and R (J Ω̇ + Ω × J Ω) at the generalised mid-point, of one node."""
    theta, J, spins = u[3:], start.inertia, start.spins
    turn = theta @ spins.R
    rate = factors.mid(factors.first(turn, spins.Omega, spins.Omega_dot), spins.Omega, factors.alpha_f)
    second = factors.mid_acceleration(turn, spins.Omega, spins.Omega_dot)
    averaged = product(factors.mid(exp(theta), jnp.eye(3), factors.alpha_f), spins.R)
    moment = product(averaged, product(J, second) + jnp.cross(rate, product(J, rate)))
    return jnp.concatenate([start.mass * factors.mid_acceleration(u[:3], start.v, start.a), moment])


def turned(lumps: Lumps | None, u: Float[Array, "n 6"], spins: Spins | None, factors: StepFactors) -> Spins | None:
    """At the end of the step."""
    if lumps is None or spins is None:
        return None
    return jax.vmap(end_of_step, (0, 0, None))(u[lumps.at, 3:], spins, factors)


def momentum(lumps: Lumps, x, v, spins: Spins) -> Momentum:
    """Kinetic energy and momenta; x, v of all nodes."""
    linear = lumps.mass[:, None] * v[lumps.at]
    spin = jnp.einsum("kij,kj->ki", lumps.inertia, spins.Omega)
    kinetic = 0.5 * jnp.sum(v[lumps.at] * linear) + 0.5 * jnp.sum(spins.Omega * spin)
    angular = jnp.cross(x[lumps.at], linear) + jnp.einsum("kij,kj->ki", spins.R, spin)
    return Momentum(kinetic, jnp.sum(linear, axis=0), jnp.sum(angular, axis=0))
