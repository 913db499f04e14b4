"""How a load or a prescribed motion varies in time: a piecewise linear factor."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxshell.numerics.checks import check_finite, check_positive_number, check_shape, floats, is_concrete


class History(eqx.Module):
    """A piecewise linear factor of time, constant before its first and after its last sample.

    Arguments:
        times: (k,) increasing sample times.
        values: (k,) factors at these times. Differentiable.

    Raises ValueError for anything but finite numbers, times that do not increase, and another number of values.
    """

    times: Float[jax.Array, " k"] = eqx.field(converter=floats("history times"))
    values: Float[jax.Array, " k"] = eqx.field(converter=floats("history values"))

    def __check_init__(self):
        check_shape("history times", self.times, (None,))
        if self.times.size == 0:
            raise ValueError("A history needs at least one sample, but its times are empty.")
        check_shape("history values", self.values, self.times.shape)
        check_finite("history times", self.times)
        check_finite("history values", self.values)
        if is_concrete(self.times) and np.any(np.diff(np.asarray(self.times)) <= 0):
            raise ValueError(f"history times must increase, but they are {np.asarray(self.times).tolist()}.")

    def __call__(self, time) -> Float[jax.Array, "*t"]:
        """The factor at a time, or at each of several."""
        return jnp.interp(time, self.times, self.values)

    @classmethod
    def constant(cls) -> "History":
        """Factor 1 at all times: the load is there, whole, from the start."""
        return cls([0.0], [1.0])

    @classmethod
    def ramp(cls, end) -> "History":
        """Factor t/end up to t = end, then 1. Raises ValueError unless `end` is positive."""
        check_positive_number("The end of a ramp", end)
        return cls([0.0, end], [0.0, 1.0])
