"""What is watched of connectors and obstacles, read from their parts in every step."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.model.contribution import Resisting, between, mean_rates
from jaxshell.model.items import named
from jaxshell.model.quantities import QUANTITIES
from jaxshell.model.scene import Scene


class Reading(eqx.Module):
    """A quantity of one connector or obstacle."""

    parts: tuple[int, ...] = eqx.field(static=True)
    """Which of the scene's contributions have it."""
    component: str = eqx.field(static=True)

    def read(self, contributions: tuple[Any, ...], before: tuple, after: tuple, method: Any) -> Float[Array, ""]:
        """In the step between `before` and `after`, (x, R, time) each, of a method; `contributions` are a model's."""
        values = []
        for number in self.parts:
            acting = contributions[number]
            start, end = acting.places(*before), acting.places(*after)
            forces = _forces(acting, start, end, method)
            read = jax.vmap(lambda *of_group, part=acting.contribution: part.read(*of_group, self.component))
            # Of a constraint beside the unit of its multipliers.
            data = acting.data[0] if acting.constrains else acting.data
            values.append(read(data, start, end, forces))
        return jnp.max(jnp.concatenate(values)) if self._largest else sum(map(jnp.sum, values), jnp.zeros(()))

    @property
    def _largest(self) -> bool:
        return QUANTITIES[self.component].over == "largest"


def _forces(acting: Any, start, end, method: Any) -> Float[Array, "k c 6"]:
    """On every group: as the balance of the step has them, or has them at its end."""
    if isinstance(acting.contribution, Resisting):
        if not method.has_rates:
            return jnp.zeros((*acting.nodes.shape, 6))
        return acting.resistance(start, end, between(start, end), jax.vmap(mean_rates)(start, end))
    if method.balances_means:
        return jax.vmap(acting.contribution.mean_force)(acting.data, start, end)
    return acting.forces(end)


def readings(scene: Scene) -> tuple[Reading, ...]:
    """What the scene watches of connectors and obstacles, in its order; none where it names none."""
    found = []
    for label, name, component in scene.watch:
        if isinstance(name, str):
            item = named(f"watch {label!r}", scene.items, name)
            of_item = scene.contributions_of(item)
            parts = tuple(n for n in of_item if component in scene.contributions[n].quantities())
            found.append(Reading(parts[:1] if QUANTITIES[component].same else parts, component))
    return tuple(found)
