"""What a step's balance is made of: nodes at its end, an element's forces, the residual, the step's constants."""

from typing import Any, NamedTuple

from jaxtyping import Array, Float


class Motion(NamedTuple):
    """A node at the end of the step."""

    x: Float[Array, "*n 3"]
    """Position; in statics displacement."""
    R: Float[Array, "*n 3 3"]
    theta: Float[Array, "*n 3"]
    """The rotation of the step, in the method's parameters."""
    spin: Float[Array, "*n 3 3"]
    """Derivative of the spin: δω = spin δθ."""


class Forces(NamedTuple):
    """One element's contributions to the balance, each (18,)."""

    elastic: Float[Array, "*m 18"]
    inertial: Float[Array, "*m 18"]


class Balance(NamedTuple):
    """The assembled residual and the scale of what is in balance."""

    residual: Float[Array, "n 6"]
    """Inertial plus internal minus external forces and moments."""
    force: Float[Array, ""]
    """Largest force of an element or a load on a node."""
    moment: Float[Array, ""]
    work: Float[Array, ""]
    """What the step exchanges: sizes of the works of every element's elastic forces, of its inertia, and of loads."""


class Begun(NamedTuple):
    """Constants of a step."""

    data: Any
    """Per element, each leaf with a leading axis m."""
    step: Any
    """What the elements share."""
    loads: Float[Array, "n 6"]
    """The loads of the balance that are known: dead loads, and what contributions count at the start."""
    end: Float[Array, ""]
    """The time at the end."""
    lumps: Any = None
    """Of the point masses, each leaf with a leading axis k; None where there are none."""


class Taken(NamedTuple):
    """What contributions that resist do to the energy in a step."""

    lost: Float[Array, ""]
    """Dissipated."""
    work: Float[Array, ""]
    """Done from outside by what moves them."""
