"""Batches of runs under `jax.vmap`: each member's iteration goes at its own pace.

A mapped `lax.while_loop` would run every member until the slowest has converged, and the native solvers factor
one matrix at a time anyway. So the iteration of a step runs for one member after the other, in a loop inside
the compiled program, while everything around it (kinematics, updates, energies) is mapped as usual.
"""

from collections.abc import Callable

import equinox as eqx
import jax


def one_by_one(function: Callable, memory, *args):
    """`function(memory, *args)`, which returns (found, memory); under `jax.vmap` for one member after the other.

    A batch has one memory, as it has one native factorization: each member gets what the one before it left,
    and the first member of a step what the last one of the step before left. memory, args and results are
    pytrees of arrays, args of static values too. Not to be differentiated.
    """
    arrays, static = eqx.partition(args, eqx.is_array)

    @jax.custom_batching.custom_vmap
    def call(memory, arrays):
        return function(memory, *eqx.combine(arrays, static))

    @call.def_vmap
    def rule(axis_size, is_mapped, memory, arrays):
        members, shared = eqx.partition(arrays, is_mapped[1])
        # Mapped only where a step was taken by some members and not by others: step control.
        last = jax.tree.map(lambda leaf, mapped: leaf[-1] if mapped else leaf, memory, is_mapped[0])

        def one(memory, member):
            found, memory = one_by_one(function, memory, *eqx.combine(member, shared, static))
            return memory, found

        memory, found = jax.lax.scan(one, last, members, length=axis_size)
        return (found, memory), (jax.tree.map(lambda _: True, found), jax.tree.map(lambda _: False, memory))

    return call(memory, arrays)
