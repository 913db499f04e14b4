"""How a load or a prescribed motion varies in time: a piecewise linear factor, its slope and its integrals."""

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

    def rate(self, time) -> Float[jax.Array, "*t"]:
        """Its slope at a time [1/time], or at each of several; at a kink the slope that follows."""
        return self.integrals().rate(time)

    def integral(self, time) -> Float[jax.Array, "*t"]:
        """∫ from 0 to `time` [time], or to each of several times. Exact: a parabola between the samples."""
        return self.integrals().integral(time)

    def double_integral(self, time) -> Float[jax.Array, "*t"]:
        """∫∫ from 0 to `time` [time²], or to each of several times. Exact: a cubic between the samples.

        Of an acceleration, where that leads from rest at time 0. What the samples lack of a mean of zero grows with
        time²: a record of an earthquake must come with its baseline corrected.
        """
        return self.integrals().double_integral(time)

    def integrals(self) -> "Integrals":
        """Its slope and its integrals, prepared: each call then costs the search for the samples around a time."""
        return Integrals.of(self.times, self.values)

    @classmethod
    def constant(cls) -> "History":
        """Factor 1 at all times: the load is there, whole, from the start."""
        return cls([0.0], [1.0])

    @classmethod
    def ramp(cls, end) -> "History":
        """Factor t/end up to t = end, then 1. Raises ValueError unless `end` is positive."""
        check_positive_number("The end of a ramp", end)
        return cls([0.0, end], [0.0, 1.0])


class Integrals(eqx.Module):
    """Slope and integrals of a `History`, with the sums over its samples made once."""

    times: Float[jax.Array, " k"]
    values: Float[jax.Array, " k"]
    slopes: Float[jax.Array, " k"]
    """From each sample to the next; zero from the last on."""
    first: Float[jax.Array, " k"]
    """∫ from 0 to each sample."""
    second: Float[jax.Array, " k"]
    """∫∫ from 0 to each sample."""

    @classmethod
    def of(cls, times: Float[jax.Array, " k"], values: Float[jax.Array, " k"]) -> "Integrals":
        """Of the samples of a history."""
        spans = jnp.diff(times)
        slopes = jnp.append(jnp.diff(values) / spans, 0.0)
        first = _sums(0.5 * spans * (values[1:] + values[:-1]))
        second = _sums(spans * first[:-1] + spans**2 / 6.0 * (2.0 * values[:-1] + values[1:]))
        from_sample = cls(times, values, slopes, first, second)
        shift, moved = from_sample.integral(0.0), from_sample.double_integral(0.0)
        return cls(times, values, slopes, first - shift, second - moved - shift * times)

    def rate(self, time) -> Float[jax.Array, "*t"]:
        _, _, slope = self._around(time)
        return slope

    def integral(self, time) -> Float[jax.Array, "*t"]:
        i, since, slope = self._around(time)
        return self.first[i] + since * (self.values[i] + since / 2.0 * slope)

    def double_integral(self, time) -> Float[jax.Array, "*t"]:
        i, since, slope = self._around(time)
        return self.second[i] + since * (self.first[i] + since / 2.0 * (self.values[i] + since / 3.0 * slope))

    def _around(self, time):
        """The sample before a time (the first where there is none), the time since it and the slope there."""
        i = jnp.maximum(jnp.searchsorted(self.times, time, side="right") - 1, 0)
        since = time - self.times[i]
        return i, since, jnp.where(since < 0, 0.0, self.slopes[i])


def _sums(parts: Float[jax.Array, " _"]) -> Float[jax.Array, " k"]:
    """Of the parts before each sample."""
    return jnp.concatenate([jnp.zeros(1), jnp.cumsum(parts)])
