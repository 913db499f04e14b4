"""Step control: an estimate of the local error, and the step size that follows from it.

All implicit methods here move the shell by mean velocities r_n = Δx_n/Δt_n of second order. Their local error
is Δt³/12 times the second derivative of the velocity, which the last three mean velocities give by divided
differences. Mean velocities hold nothing of the undamped oscillation at the step's own frequency that
accelerations are full of, so the estimate follows the motion and not the noise.

In an undamped structure an error lasts: one made early is in the answer for the rest of the run, one made at the end
for a moment. The error of the whole run (its mean over time) is Σ w_n c_n Δt_n³ with c_n = |r''|/12 and the time left
w_n; for the fewest steps Δt_n ∝ (w_n c_n)^(-1/3). That is a tolerance for each step that grows as w_n falls.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxshell.numerics.checks import Real, check_number, check_positive_number, is_concrete, is_infinite

_SAFETY, _LEAST, _MOST = 0.85, 0.25, 4.0
"""Aim below the tolerance, and change the step by no more than these factors at once."""
_ACCEPT = 2.0
"""A step with up to this many times the tolerance is taken: the estimate scatters, and a repetition costs a step."""
_STRETCH = 1.0 / _SAFETY
"""A step may be this much longer than chosen where it lands then: the error is still the tolerance."""
_SHARED = 3
"""So many steps before a time to land on share what is left evenly."""
_LATE = 0.1
"""Of the time left, as a fraction of the run: no less is counted, so that the last steps are not careless."""


class Control(NamedTuple):
    """State of the step control: part of the compiled loop's carry."""

    time: Float[Array, ""]
    dt: Float[Array, ""]
    """The step to try next."""
    taken: Float[Array, "2"]
    """Sizes of the last two accepted steps."""
    accepted: Int[Array, ""]
    rejected: Int[Array, ""]
    began: Float[Array, ""]
    """When the run began."""


class StepControl(eqx.Module):
    """Choose the step size as the run goes: pass it as `simulate(..., dt=StepControl(...))`.

    Arguments:
        tolerance: of the local error of a step: the root mean square over the nodes of the estimated error in
            displacement, as a fraction of the shell's size (the diagonal of its bounding box). For the run's first
            steps; later ones may err more, in inverse proportion to the time left, and up to ten times more.
        initial: first step to try [time].
        smallest, largest: limits of the step size [time]; None for initial/1e6 and no limit. A step that fails
            at the smallest size ends the run with `RESULTS.step_too_small` (or Newton's failure).
        output_interval: time between frames [time], landed on exactly; None for a hundredth of the run.
        horizon: until when errors count [time]; None for the run's end, which makes the mean error over the run
            small with the fewest steps. float("inf") holds all steps to the same tolerance, for a run that another
            goes on from or whose last state is what is wanted.

    Steps also land on the load histories' sample times, where the loads have kinks. A step with more than twice the
    tolerance is repeated, one on which Newton fails is halved. Histories are kept at every accepted step. All
    numbers are traced: others compile nothing anew. Raises ValueError for numbers that are not positive or out of
    order.
    """

    tolerance: Real
    initial: Real
    smallest: Real
    largest: Real
    output_interval: float | None = eqx.field(static=True)
    horizon: Real | None

    def __init__(self, tolerance, initial, smallest=None, largest=None, output_interval=None, horizon=None):
        check_number("StepControl initial", initial)
        self.tolerance = tolerance
        self.initial = initial
        self.smallest = 1e-6 * initial if smallest is None else smallest
        self.largest = float("inf") if largest is None else largest
        self.output_interval = output_interval
        self.horizon = horizon

    def __check_init__(self):
        check_positive_number("StepControl tolerance", self.tolerance)
        check_positive_number("StepControl initial", self.initial)
        check_positive_number("StepControl smallest", self.smallest)
        if not is_infinite(self.largest):
            check_positive_number("StepControl largest", self.largest)
        if self.output_interval is not None:
            check_positive_number("StepControl output_interval", self.output_interval)
        if self.horizon is not None and not is_infinite(self.horizon):
            check_positive_number("StepControl horizon", self.horizon)
        limits = self.smallest, self.initial, self.largest
        if all(map(is_concrete, limits)) and not self.smallest <= self.initial <= self.largest:
            raise ValueError(
                f"StepControl needs smallest <= initial <= largest, but they are {self.smallest}, {self.initial} "
                f"and {self.largest}."
            )

    def start(self, time) -> Control:
        """Before the first step."""
        dt, zero = jnp.asarray(self.initial, float), jnp.zeros((), jnp.int32)
        return Control(jnp.asarray(time, float), dt, jnp.stack([dt, dt]), zero, zero, jnp.asarray(time, float))

    def next_step(self, now: Control, stop) -> tuple[Float[Array, ""], Bool[Array, ""]]:
        """Size of the next attempt, and whether it lands on `stop`; what is left is shared to avoid a sliver."""
        left = stop - now.time
        parts = jnp.ceil(left / jnp.minimum(_STRETCH * now.dt, self.largest) - 1e-6)
        return jnp.where(parts <= _SHARED, left / parts, now.dt), parts <= 1.0

    def judge(self, now: Control, dt, solved, state, size, end) -> tuple[Control, Bool[Array, ""]]:
        """Accept or reject the attempt that led to `state`, and say how large the next one is to be.

        `end` is when the run ends.
        """
        horizon = end if self.horizon is None else self.horizon
        span = horizon - now.began
        left = jnp.where(jnp.isinf(horizon), 1.0, jnp.where(span > 0, (horizon - now.time) / span, 0.0))
        tolerance = self.tolerance / jnp.maximum(left, _LATE)
        relative = local_error(state.mean_velocities[:3], dt, now.taken) / size / tolerance
        relative = jnp.where(jnp.isfinite(relative), relative, jnp.inf)
        accepted = solved & (relative <= _ACCEPT)
        factor = _SAFETY * jnp.maximum(relative, 1e-12) ** (-1.0 / 3.0)
        factor = jnp.clip(factor, _LEAST, _MOST)
        # A step cut short to land on a stop says nothing against the size wanted before.
        wanted = jnp.where(accepted & (factor >= 1.0), jnp.maximum(factor * dt, now.dt), factor * dt)
        after = jnp.where(solved, jnp.minimum(wanted, self.largest), 0.5 * dt)
        taken = jnp.where(accepted, jnp.stack([dt, now.taken[0]]), now.taken)
        count = accepted.astype(jnp.int32)
        time = jnp.where(accepted, state.time, now.time)
        return Control(time, after, taken, now.accepted + count, now.rejected + 1 - count, now.began), accepted


def local_error(rates: Float[Array, "3 n 3"], dt, before: Float[Array, "2"]) -> Float[Array, ""]:
    """RMS over the nodes of the step's error in displacement, Δt³ r''/12 with r'' from three mean velocities."""
    first = (rates[0] - rates[1]) / (0.5 * (dt + before[0]))
    second = (rates[1] - rates[2]) / (0.5 * (before[0] + before[1]))
    curvature = (first - second) / (0.25 * (dt + 2.0 * before[0] + before[1]))
    return dt**3 / 12.0 * jnp.sqrt(jnp.mean(jnp.sum(curvature**2, axis=1)))
