"""Batches of runs under `jax.vmap`: each member's iteration goes at its own pace.

A mapped `lax.while_loop` would run every member until the slowest has converged, and the native solvers factor
one matrix at a time anyway. So the iteration of a step runs for one member after the other, in a loop inside
the compiled program, while everything around it (kinematics, updates, energies) is mapped as usual.
"""

from collections.abc import Callable

import equinox as eqx
import jax


def one_by_one(function: Callable, *args, mapped: bool = False):
    """`function(*args, mapped=False)`; under `jax.vmap` with mapped=True for one member after the other.

    args and results are pytrees of arrays and static values. Not to be differentiated. What `function` keeps outside
    JAX's arrays, such as a native factorization, is another member's when it is called with mapped=True.
    """
    arrays, static = eqx.partition(args, eqx.is_array)

    @jax.custom_batching.custom_vmap
    def call(arrays):
        return function(*eqx.combine(arrays, static), mapped=mapped)

    @call.def_vmap
    def rule(axis_size, is_mapped, arrays):
        members, shared = eqx.partition(arrays, is_mapped[0])

        def one(member):
            return one_by_one(function, *eqx.combine(member, shared, static), mapped=True)

        found = jax.lax.map(one, members)
        return found, jax.tree.map(lambda _: True, found)

    return call(arrays)
