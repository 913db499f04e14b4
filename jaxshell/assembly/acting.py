"""A contribution on its nodes: what it puts on every group, as arrays."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxshell.model.contribution import Constraint, Contribution, Elastic, Place, Resisting, displaced


class Acting(eqx.Module):
    """A contribution with the nodes that it acts on and what it prepared."""

    contribution: Contribution
    data: Any
    """Of a constraint with the unit of its multipliers: `Constraint.balanced`."""
    nodes: Int[Array, "k c"]
    entries: Int[Array, " e"] | None
    """Of its matrices, entry by entry: its place in the sparse matrix; None where there is none."""
    on_elements: bool = eqx.field(static=True)
    """Its groups are the elements' corners: it is summed with them."""

    def places(self, x: Float[Array, "n 3"], R: Float[Array, "n 3 3"], time) -> Place:
        """Its groups, each leaf with a leading axis k."""
        times = jnp.broadcast_to(time, self.nodes.shape[:1])
        return Place(x[self.nodes], R[self.nodes], times)

    @property
    def constrains(self) -> bool:
        return isinstance(self.contribution, Constraint)

    @property
    def is_plain(self) -> bool:
        """Whether its work is external work."""
        return not isinstance(self.contribution, Elastic | Resisting | Constraint)

    @property
    def is_elastic(self) -> bool:
        return isinstance(self.contribution, Elastic)

    @property
    def is_driven(self) -> bool:
        return isinstance(self.contribution, Elastic) and self.contribution.driven

    @property
    def is_carried(self) -> bool:
        """Whether it resists against something that moves."""
        return isinstance(self.contribution, Resisting) and self.contribution.driven

    @property
    def resists(self) -> bool:
        return isinstance(self.contribution, Resisting)

    def forces(self, place: Place) -> Float[Array, "k c 6"]:
        return jax.vmap(self.contribution.force)(self.data, place)

    def energy(self, place: Place) -> Float[Array, ""]:
        """Of all groups of an elastic one."""
        assert isinstance(self.contribution, Elastic)
        return jnp.sum(jax.vmap(self.contribution.energy)(self.data, place))

    def resistance(self, start: Place, end: Place, middle: Place, rates: Float[Array, "k c 6"]):
        """(k, c, 6) of a resisting one."""
        assert isinstance(self.contribution, Resisting)
        return jax.vmap(self.contribution.resistance)(self.data, start, end, middle, rates)

    def carried(self, start: Place, end: Place) -> Float[Array, "k c 6"]:
        """Increments of what a resisting one moves against."""
        assert isinstance(self.contribution, Resisting)
        return jax.vmap(self.contribution.carried)(self.data, start, end)

    def stiffest(self, place: Place) -> Float[Array, "k d d"]:
        """Of all groups of an elastic one."""
        assert isinstance(self.contribution, Elastic)
        return jax.vmap(self.contribution.stiffest)(self.data, place)

    def stiffness(self, place: Place) -> Float[Array, "k d d"]:
        return jax.vmap(self.contribution.stiffness)(self.data, place)

    def mean_stiffness(self, start: Place, end: Place) -> Float[Array, "k d d"]:
        return jax.vmap(self.contribution.mean_stiffness)(self.data, start, end)

    def balanced(self, place: Place) -> Float[Array, "k c 6"]:
        """Of a constraint, in a state."""
        assert isinstance(self.contribution, Constraint)
        constraint = self.contribution
        return jax.vmap(lambda data, place: constraint.balanced(data, place, place, 1.0))(self.data, place)

    def constraint_stiffness(self, x: Float[Array, "n 3"], R: Float[Array, "n 3 3"], time) -> Float[Array, "k d d"]:
        """Of a constraint by displacements and spins, multipliers among them: as they stand in the stiffness."""
        assert isinstance(self.contribution, Constraint)
        constraint = self.contribution

        def one(data, place):
            def balanced(change):
                return -constraint.balanced(data, place, displaced(place, change), 1.0).reshape(-1)

            return jax.jacfwd(balanced)(jnp.zeros(6 * place.x.shape[0]))

        return jax.vmap(one)(self.data, self.places(x, R, time))

    def bending_of_motion(self, x, R, time, rates: Float[Array, "n 6"], known: Float[Array, "n 6"]):
        """(k, c, 6) what the conditions of a constraint are accelerated by in a motion with these rates and with no
        accelerations but the known: at the nodes of the multipliers, and with their unit."""
        assert isinstance(self.contribution, Constraint)
        constraint = self.contribution

        def one(data, place, rates, known):
            def along(t):
                change = (t * rates + 0.5 * t * t * known).reshape(-1)
                return constraint.balanced(data, place, displaced(place, change), 1.0)

            return jax.jvp(lambda t: jax.jvp(along, (t,), (1.0,))[1], (0.0,), (1.0,))[1]

        # Where multipliers vanish, so do the forces on the other nodes.
        x = x.at[self.nodes[:, -constraint.multipliers :]].set(0.0)
        return jax.vmap(one)(self.data, self.places(x, R, time), rates[self.nodes], known[self.nodes])
