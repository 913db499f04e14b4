"""Lumped masses and rotary inertias of the nodes, one value for all directions: those of central differences."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.assembly.discretised import Model
from jaxshell.elements.element import Element

_OF_AREA = {"physical": 0.0, "scaled": 1 / 8}
"""Rotary inertia over mass times area, at least: below 1/8 the element's bending asks for smaller steps than its
membrane."""
ROTARY = tuple(_OF_AREA)


def lumped_mass(model: Model, rotary: str | Float[Array, ""] = "physical") -> Float[Array, "n 6"]:
    """A third of each element's mass and of its rotary inertia at each of its nodes, and point masses."""
    found = lumped(model, rotary, None)
    if model.lumps is None:
        return found
    ball = model.lumps.inertia[:, 0, 0]
    own = jnp.stack([model.lumps.mass, ball], axis=1)
    return found.at[model.lumps.at].add(jnp.repeat(own, 3, axis=1))


def part_of_area(rotary: str) -> Float[Array, ""]:
    """What `thirds` takes in place of the name, so that a program serves for all of them."""
    return jnp.asarray(_OF_AREA[rotary])


def thirds(elements: Element, rotary: str | Float[Array, ""]) -> Float[Array, "... 2"]:
    """Mass and rotary inertia that an element, or each of several, gives to each of its nodes."""
    inertia = elements.rotary_inertia
    part = _OF_AREA[rotary] if isinstance(rotary, str) else rotary
    if not isinstance(part, float) or part:
        inertia = jnp.maximum(inertia, part * elements.mass_per_area * elements.area)
    return jnp.stack([elements.mass_per_area, inertia], axis=-1) * elements.area[..., None] / 3.0


def lumped(model: Model, rotary: str | Float[Array, ""], factors: Float[Array, " m"] | None) -> Float[Array, "n 6"]:
    """`lumped_mass` with the elements' masses times these factors."""
    third = thirds(model.elements, rotary)
    if factors is not None:
        third = third * factors[:, None]
    corner = jnp.broadcast_to(third[:, None, :, None], (third.shape[0], 3, 2, 3))
    return model.tables.nodal(corner.reshape(-1, 6))
