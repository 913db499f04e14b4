"""How a kept factorization turns with the nodes, and what balances the forces on all of a shell that nothing holds."""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.assembly.discretised import Model
from jaxshell.solvers.iteration import Turning


def turning(model: Model, R: Float[Array, "n 3 3"]) -> Turning | None:
    """For a step that starts with the nodal rotations R; None where joints have multipliers.

    A condition that two places stay together is the same however the nodes there turn. Where they turn apart, as at a
    hinge, no node's rotation turns its rows as it turns the elements', and what a kept factorization leaves in the
    joint's forces is lost of the angular momentum (5e-12 in 800 steps of the unfolding panel, where what it solves was
    not refined).
    """
    if model.tables.zeros is not None:
        return None
    return Turning(R, functools.partial(_turned, model), _translations(model))


def _turned(model: Model, rotations: Float[Array, "n 3 3"], free: Float[Array, " nf"]) -> Float[Array, " nf"]:
    """The free vector with the displacement and the rotation, or force and moment, of every node turned.

    What of a turned vector falls on held degrees of freedom is left out.
    """
    nodal = model.expand(free, jnp.zeros(model.tables.held.shape))
    if model.elimination is not None:
        nodal = model.elimination.nodal_forces(nodal)
    pairs = nodal.reshape(-1, 2, 3)
    return model.unknowns(jnp.einsum("nij,nkj->nki", rotations, pairs).reshape(-1, 6))


def _translations(model: Model) -> Float[Array, "k nf"]:
    """The translations of the shell that no support holds, as free vectors."""
    tables = model.tables
    along = jnp.zeros((len(tables.adrift), tables.place.size // 6, 6))
    for k, axis in enumerate(tables.adrift):
        along = along.at[k, : tables.nodes, axis].set(1.0)
    return jax.vmap(model.free)(along)
