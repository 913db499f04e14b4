"""An array that was found by other means (an iteration, an eigensolver), with a derivative stated for it.

As `jax.custom_jvp`, but the derivative is right to every order wherever the call stands. JAX forgets the rule of a
custom_jvp function where it splits a program into what is known and what is to be transposed, in the body of a
`lax.scan` for one, since "no need to keep the custom JVP rule": then the second derivative in reverse mode is that of a
constant, and wrong without a word (JAX 0.10). A primitive keeps its rule.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.extend.core
import jax.numpy as jnp
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Float


def derived(change: Callable, value: Float[Array, "..."], parameters: Any) -> Float[Array, "..."]:
    """`value` as a function of `parameters`, a pytree of arrays and static values.

    change(value, parameters, along) → the derivative of the value, like `value`; along(function) is the derivative of
    function(parameters) in the direction in which the parameters move. It is asked for only where some of them move,
    and what does not move is not differentiated. `value` in it has its derivative again, so that every order is right.
    """
    arrays, static = eqx.partition(parameters, eqx.is_array)
    leaves, structure = jax.tree.flatten(arrays)

    def combined(leaves):
        return eqx.combine(jax.tree.unflatten(structure, leaves), static)

    def of_leaves(value, leaves, directions):
        moves = [direction is not None for direction in directions]

        def along(function):
            def of_moving(moving):
                return function(combined(_merged(moves, moving, leaves)))

            return jax.jvp(of_moving, (_chosen(moves, leaves),), (_chosen(moves, directions),))[1]

        return change(value, combined(leaves), along)

    return _derived.bind(value, *leaves, change=of_leaves)


_derived = jax.extend.core.Primitive("derived")
_derived.def_impl(lambda value, *_, change: value)
_derived.def_abstract_eval(lambda value, *_, change: value)
mlir.register_lowering(_derived, lambda _, value, *others, change: [value])


def _jvp(primals, tangents, *, change):
    value = _derived.bind(*primals, change=change)
    directions = [None if _still(tangent) else tangent for tangent in tangents[1:]]
    if all(direction is None for direction in directions):
        return value, ad.Zero.from_primal_value(value)  # pyright: ignore[reportAttributeAccessIssue]
    return value, change(value, list(primals[1:]), directions)


def _still(tangent) -> bool:
    return isinstance(tangent, ad.Zero) or tangent.dtype == jax.dtypes.float0


ad.primitive_jvps[_derived] = _jvp


def _batched(arguments, axes, *, change):
    size = next(a.shape[d] for a, d in zip(arguments, axes, strict=True) if d is not None)
    value, *leaves = (a if d is None else jnp.moveaxis(a, d, 0) for a, d in zip(arguments, axes, strict=True))
    if axes[0] is None:
        value = jnp.broadcast_to(value, (size, *value.shape))
    mapped = tuple(axis is not None for axis in axes[1:])
    return _derived.bind(value, *leaves, change=_Mapped(change, mapped)), 0


batching.primitive_batchers[_derived] = _batched


@dataclasses.dataclass(frozen=True)
class _Mapped:
    """The change of a batch of values, of which some parameters are mapped."""

    change: Callable
    mapped: tuple[bool, ...]

    def __call__(self, value, leaves, directions):
        moves = [direction is not None for direction in directions]
        axes = [0 if mapped else None for mapped in self.mapped]

        def one(value, leaves, moving):
            return self.change(value, leaves, _merged(moves, moving, [None] * len(moves)))

        return jax.vmap(one, in_axes=(0, axes, _chosen(moves, axes)))(value, leaves, _chosen(moves, directions))


def _chosen(moves: list[bool], items) -> list:
    return [item for item, moving in zip(items, moves, strict=True) if moving]


def _merged(moves: list[bool], moving, still) -> list:
    """Items in their order: of `moving` those that move, of `still` the others."""
    rest = iter(moving)
    return [next(rest) if moves_ else item for moves_, item in zip(moves, still, strict=True)]
