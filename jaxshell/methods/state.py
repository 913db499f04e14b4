"""What every state of a method offers to those that drive and record runs."""

import abc

import equinox as eqx
from jaxtyping import Array, Float


class State(eqx.Module):
    """The state at the end of a step. Each method adds what it needs to go on."""

    time: eqx.AbstractVar[Float[Array, ""]]
    """In statics the load factor."""
    R: eqx.AbstractVar[Float[Array, "n 3 3"]]
    """Nodal rotations from the stress-free shape."""
    v: eqx.AbstractVar[Float[Array, "n 3"]]
    external_work: eqx.AbstractVar[Float[Array, ""]]

    @abc.abstractmethod
    def displacements(self, x0: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """From the stress-free shape `x0`."""


class MovingState(State):
    """A state that keeps positions."""

    x: eqx.AbstractVar[Float[Array, "n 3"]]

    def displacements(self, x0: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        return self.x - x0


class PredictedState(MovingState):
    """A state that keeps the mean rates of the last steps, for the predictor and for step control."""

    rates: eqx.AbstractVar[Float[Array, "4 n 6"]]
    """Of the last steps, the latest first: mean velocities and increments of rotation over Δt."""

    @property
    def mean_velocities(self) -> Float[Array, "4 n 3"]:
        return self.rates[:, :, :3]
