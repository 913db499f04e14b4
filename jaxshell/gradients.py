"""How reverse mode remembers a run: the strategies for `simulate(gradients=...)`, and the scan that they shape.

The adjoint of a run walks its steps backwards and needs each step's state and its converged increments u. With
both, a step is replayed by one assembly, one factorization and one transposed substitution; Newton's loop is
never run again for a step whose increments were kept. See docs/gradients.md.
"""

import abc
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.ad_checkpoint import checkpoint_name

INCREMENTS = "converged increments"
"""The name under which a step's converged increments are kept."""


def keep(solved: Any) -> Any:
    """Mark what Newton found, so that a strategy may keep it for the reverse pass."""
    return jax.tree.map(lambda leaf: checkpoint_name(leaf, INCREMENTS), solved)


class Gradients(eqx.Module):
    """What is kept of a run for reverse mode. Costs nothing where nothing is differentiated."""

    @abc.abstractmethod
    def segments(self, steps: int) -> tuple[int, ...]:
        """Lengths of the nested segments, in steps, ascending, that are replayed from their start."""

    @property
    @abc.abstractmethod
    def outer_policy(self) -> Callable:
        """What a segment keeps besides the state at its start."""

    @property
    def repeats_newton(self) -> bool:
        """Whether the reverse pass runs Newton's iteration again. A factorization kept is then of a later step."""
        return False


class Stored(Gradients):
    """Keep the state at the start of every step, and its increments.

    Memory a step: the method's state and 6n floats (n nodes, m elements). For `GeneralizedEnergyMomentum` the
    state is 18n + 105m floats (the seven Gauss points of each element carry a rotation and its rates), for
    `EnergyMomentum` 24n. The cheapest in time.
    """

    def segments(self, steps: int) -> tuple[int, ...]:
        return ()

    @property
    def outer_policy(self) -> Callable:
        return _keep_increments


class Checkpointed(Gradients):
    """Keep the state only at the start of segments, and replay a segment when the reverse pass reaches it.

    Arguments:
        levels: depth of the nesting. A run of N steps keeps about (levels + 1)·N^(1/(levels + 1)) states at a
            time, and every step is replayed `levels` times more than with `Stored`.
        keep_increments: keep the 6n increments of every step. A replay is then one evaluation of the
            step's kinematics, without Newton. False keeps nothing that grows with N, and a replay is a whole step.

    Raises ValueError for levels below 1.
    """

    levels: int = eqx.field(static=True, default=1)
    keep_increments: bool = eqx.field(static=True, default=True)

    def __check_init__(self):
        if not isinstance(self.levels, int | np.integer) or self.levels < 1:
            raise ValueError(f"Checkpointed levels must be a whole number of at least 1, but it is {self.levels!r}.")

    def segments(self, steps: int) -> tuple[int, ...]:
        parts = (round(steps ** (k / (self.levels + 1))) for k in range(1, self.levels + 1))
        return tuple(sorted({n for n in parts if 1 < n < steps}))

    @property
    def outer_policy(self) -> Callable:
        return _keep_increments if self.keep_increments else _keep_nothing

    @property
    def repeats_newton(self) -> bool:
        return not self.keep_increments


_keep_increments = jax.checkpoint_policies.save_only_these_names(INCREMENTS)
_keep_nothing = jax.checkpoint_policies.nothing_saveable


def scan_steps(gradients: Gradients, step: Callable, frame: Callable, carry, steps, save_every: int):
    """Scan `step` over all `steps` (a pytree with a leading axis N) and take a `frame` every `save_every` of them.

    Returns (carry, records of every step (N, ...), frames (ceil(N/save_every), ...)). A last frame of fewer steps
    is a scan of its own.
    """
    count = _length(steps)
    lengths = gradients.segments(count)
    within = [n for n in lengths if n < save_every]
    across = sorted({round(n / save_every) for n in lengths if n >= save_every} - {1})
    one = jax.checkpoint(step, policy=_keep_increments, prevent_cse=False)

    def one_frame(carry, steps):
        carry, records = _nested(one, carry, steps, within, gradients.outer_policy)
        return carry, (records, frame(carry))

    whole = count // save_every
    parts = []
    if whole:
        grouped = jax.tree.map(lambda a: a[: whole * save_every].reshape(whole, save_every), steps)
        carry, (records, frames) = _nested(one_frame, carry, grouped, across, gradients.outer_policy)
        parts.append((jax.tree.map(merge, records), frames))
    if whole * save_every < count:
        rest = jax.tree.map(lambda a: a[whole * save_every :], steps)
        carry, (records, last) = one_frame(carry, rest)
        parts.append((records, jax.tree.map(lambda a: a[None], last)))
    records, frames = jax.tree.map(lambda *a: jnp.concatenate(a), *parts) if len(parts) > 1 else parts[0]
    return carry, records, frames


def _nested(body: Callable, carry, xs, lengths: list[int], policy: Callable):
    """`lax.scan` in nested segments of the given lengths, each replayed from its start in reverse mode."""
    if not lengths:
        return jax.lax.scan(body, carry, xs)
    count = _length(xs)
    length = _near_divisor(count, lengths[-1])
    segment = jax.checkpoint(
        lambda carry, xs: _nested(body, carry, xs, lengths[:-1], policy), policy=policy, prevent_cse=False
    )
    whole = count // length
    grouped = jax.tree.map(lambda a: a[: whole * length].reshape(whole, length, *a.shape[1:]), xs)
    carry, ys = jax.lax.scan(segment, carry, grouped)
    ys = jax.tree.map(merge, ys)
    if whole * length < count:
        carry, rest = segment(carry, jax.tree.map(lambda a: a[whole * length :], xs))
        ys = jax.tree.map(lambda *a: jnp.concatenate(a), ys, rest)
    return carry, ys


def _near_divisor(count: int, wanted: int) -> int:
    """The divisor of `count` nearest to `wanted` by ratio if within a factor of two, else `wanted`.

    Segments that do not fill the run need a second compiled loop for the rest.
    """
    divisors = [d for d in range(max(1, -(-wanted // 2)), min(count, 2 * wanted) + 1) if count % d == 0]
    return min(divisors, key=lambda d: abs(np.log(d / wanted)), default=min(wanted, count))


def merge(array):
    """The first two axes as one, also where others are empty (a scene that watches nothing)."""
    return array.reshape(array.shape[0] * array.shape[1], *array.shape[2:])


def _length(tree) -> int:
    return jax.tree.leaves(tree)[0].shape[0]
