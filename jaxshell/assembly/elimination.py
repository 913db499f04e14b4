"""Degrees of freedom that are no unknowns: nodes of rigid bodies, which follow a master; axes of slanted supports.

A follower s of a master m has θ_s = θ_m and Δx_s = Δx_m + (R_m1 - R_m0) r, with the arm r of the stress-free shape. In
a step R_m1 - R_m0 = ~θ A R_m0, where A(θ) is the method's mean of the turn: (I - ½~θ)⁻¹ of Cayley vectors, ∫exp(s~θ)ds
of rotation vectors. The master's balance receives the follower's force n and m + ℓ × n with the lever ℓ at the place of
the balance, the weighted mean of R_m0 r and R_m1 r. With the mean of both, as `EnergyMomentum` has it, the works on the
increments are equal and momenta kept, exactly.

At a node with axes of its own displacements and rotations are u = Q û, and unknown are the û that no support holds.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxshell.assembly.tables import Dependent
from jaxshell.numerics.rotations import skew


class Blocks(NamedTuple):
    """What turns matrices of nodal degrees of freedom into those of the unknowns: rowsᵀ K columns, node by node."""

    rows: Float[Array, "n 6 6"]
    columns: Float[Array, "n 6 6"]

    def of(self, nodes: Int[Array, "k c"], matrices: Float[Array, "k d d"]) -> Float[Array, "k d d"]:
        """Matrices of groups of nodes."""
        k, c = nodes.shape
        found = matrices.reshape(k, c, 6, c, 6)
        found = jnp.einsum("kaij,kaibl->kajbl", self.rows[nodes], found)
        found = jnp.einsum("kajbl,kblm->kajbm", found, self.columns[nodes])
        return found.reshape(matrices.shape)


class Elimination(eqx.Module):
    """The followers and the axes of a scene."""

    dependent: Dependent
    arms: Float[Array, "k 3"]
    """From the master to the follower in the stress-free shape."""
    axes: Float[Array, "s 3 3"]
    """Q, with the axes as columns."""

    @property
    def followers(self) -> Int[Array, " k"]:
        return self.dependent.followers

    @property
    def masters(self) -> Int[Array, " k"]:
        return self.dependent.masters

    @property
    def turned(self) -> Int[Array, " s"]:
        return self.dependent.turned

    def nodal(self, unknown: Float[Array, "n 6"], R: Float[Array, "n 3 3"], turn: Callable) -> Float[Array, "n 6"]:
        """Increments of all nodes from those along the unknowns, followers with those of their masters."""
        u = self._rotated(unknown, self.axes)
        if not self.followers.size:
            return u
        theta = u[self.followers, 3:]
        change, _ = self._change(theta, R, turn)
        return u.at[self.followers, :3].add(change)

    def along(self, nodal: Float[Array, "n 6"]) -> Float[Array, "n 6"]:
        """Nodal increments, or forces, along the nodes' own axes."""
        return self._rotated(nodal, jnp.swapaxes(self.axes, 1, 2))

    def nodal_forces(self, along: Float[Array, "n 6"]) -> Float[Array, "n 6"]:
        """Forces at nodes from those along the nodes' own axes."""
        return self._rotated(along, self.axes)

    def levers(self, u: Float[Array, "n 6"], R: Float[Array, "n 3 3"], turn: Callable, weight):
        """(k, 3) arms at the place of the balance, and at the end of the step."""
        change, start = self._change(u[self.followers, 3:], R, turn)
        return start + weight * change, start + change

    def collected(self, nodal: Float[Array, "n 6"], levers: Float[Array, "k 3"]) -> Float[Array, "n 6"]:
        """Forces and moments at the unknowns: those of followers at their masters, and along the nodes' axes."""
        if self.followers.size:
            force, moment = nodal[self.followers, :3], nodal[self.followers, 3:]
            moved = jnp.concatenate([force, moment + jnp.cross(levers, force)], axis=1)
            nodal = nodal.at[self.followers].set(0.0).at[self.masters].add(moved)
        return self.along(nodal)

    def blocks(self, levers, ends: Float[Array, "k 3"], spin: Float[Array, "n 3 3"]) -> Blocks:
        """For matrices by the nodes' increments; `spin` with δω = spin δθ, the master's at a follower."""
        eye = jnp.broadcast_to(jnp.eye(6), (spin.shape[0], 6, 6))
        rows = columns = eye
        if self.followers.size:
            # Force rows: B with r̂ = Bᵀ r; displacements: D.
            rows = rows.at[self.followers, :3, 3:].set(-jax.vmap(skew)(levers))
            by_turn = -jax.vmap(skew)(ends) @ spin[self.followers]
            columns = columns.at[self.followers, :3, 3:].set(by_turn)
        if self.turned.size:
            both = jnp.zeros((self.turned.size, 6, 6)).at[:, :3, :3].set(self.axes).at[:, 3:, 3:].set(self.axes)
            rows = rows.at[self.turned].set(rows[self.turned] @ both)
            columns = columns.at[self.turned].set(columns[self.turned] @ both)
        return Blocks(rows, columns)

    def turning(self, nodal: Float[Array, "n 6"], ends, spin: Float[Array, "n 3 3"], weight) -> Float[Array, "k 6 6"]:
        """Derivative of the moments ℓ × n of the followers' forces in `nodal` by their lever, at the masters."""
        force = jax.vmap(skew)(nodal[self.followers, :3])
        found = weight * force @ jax.vmap(skew)(ends) @ spin[self.followers]
        matrices = jnp.zeros((self.followers.size, 6, 6)).at[:, 3:, 3:].set(found)
        if self.turned.size:
            n = nodal.shape[0]
            axes = jnp.broadcast_to(jnp.eye(3), (n, 3, 3)).at[self.turned].set(self.axes)[self.followers]
            found = jnp.swapaxes(axes, 1, 2) @ found @ axes
            matrices = matrices.at[:, 3:, 3:].set(found)
        return matrices

    def placed(self, x: Float[Array, "n 3"], R: Float[Array, "n 3 3"], v, omega):
        """Positions, rotations, velocities and angular velocities with the followers where and as their masters are."""
        arms = jnp.einsum("kij,kj->ki", R[self.masters], self.arms)
        x = x.at[self.followers].set(x[self.masters] + arms)
        R = R.at[self.followers].set(R[self.masters])
        omega = omega.at[self.followers].set(omega[self.masters])
        v = v.at[self.followers].set(v[self.masters] + jnp.cross(omega[self.masters], arms))
        return x, R, v, omega

    def centripetal(self, R: Float[Array, "n 3 3"], omega: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """ω × (ω × r) of the followers, zero elsewhere."""
        arms = jnp.einsum("kij,kj->ki", R[self.masters], self.arms)
        spin = omega[self.masters]
        return jnp.zeros_like(omega).at[self.followers].set(jnp.cross(spin, jnp.cross(spin, arms)))

    def _rotated(self, nodal, axes):
        if not self.turned.size:
            return nodal
        pairs = nodal[self.turned].reshape(-1, 2, 3)
        turned = jnp.einsum("sij,skj->ski", axes, pairs).reshape(-1, 6)
        return nodal.at[self.turned].set(turned)

    def _change(self, theta: Float[Array, "k 3"], R: Float[Array, "n 3 3"], turn: Callable):
        """(R_m1 - R_m0) r and R_m0 r, (k, 3) each."""
        start = jnp.einsum("kij,kj->ki", R[self.masters], self.arms)
        return jnp.cross(theta, jnp.einsum("kij,kj->ki", jax.vmap(turn)(theta), start)), start
