"""`each`: a function of one element applied to all of them, by XLA or by a kernel of LLVM's."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir

from jaxshell.numerics.checks import check_choice
from jaxshell.numerics.kernels.code import Unsupported
from jaxshell.numerics.kernels.machine import kernel_of, require_llvm, this_machine

_KERNELS = ("xla", "llvm")
_MOST_SHARED = 64
"""Numbers that elements may share: each of them is a vector of its own."""
_chosen = jax.make_user_context("xla")


def kernels(by: str):
    """A context in which programs compute their elements by kernels of XLA's, the default, or of LLVM's.

    `with jaxshell.kernels("llvm"): ...` holds for what is compiled in it, gradients included: programs that were
    compiled outside are compiled again. LLVM's kernels are straight-line code for vectors, made from the same functions
    of one element; results agree to round-off. They take llvmlite (`pip install llvmlite`). What has no
    straight-line form, what has fewer elements than a vector has numbers, and all that runs on no CPU stays with XLA.

    Raises ValueError for another name, ImportError where there is no llvmlite, RuntimeError where XLA's calls are of a
    version that is not known here.
    """
    check_choice("kernels", by, _KERNELS)
    if by == "llvm":
        require_llvm()
    return _chosen(by)


def kernels_chosen() -> str:
    """What computes the elements, here: "xla" or "llvm"."""
    return _chosen.value


def each(function: Callable, in_axes: int | Sequence[int | None] = 0) -> Callable:
    """`jax.vmap(function, in_axes)` over elements, or nodes, by the kernels that are chosen; axes 0 and None."""

    def over_all(*arguments):
        found = None
        if _chosen.value == "llvm" and jax.default_backend() == "cpu":
            axes = (in_axes,) * len(arguments) if isinstance(in_axes, int) else tuple(in_axes)
            found = _by_kernel(function, arguments, axes)
        return jax.vmap(function, in_axes)(*arguments) if found is None else found

    return over_all


def _by_kernel(function: Callable, arguments: tuple, axes: tuple[int | None, ...]):
    """The results on all elements; None where it is XLA's business."""
    everything, tree = jax.tree.flatten(arguments)
    if not any(isinstance(leaf, jax.core.Tracer) for leaf in everything):
        return None  # without a program around it, it is run once
    own = [axis == 0 for axis, a in zip(axes, arguments, strict=True) for _ in jax.tree.leaves(a)]
    # Plain numbers stay in the program's text.
    given = [k for k, leaf in enumerate(everything) if not isinstance(leaf, int | float)]
    leaves, own = [jnp.asarray(everything[k]) for k in given], [own[k] for k in given]
    counts = {leaf.shape[0] for leaf, is_own in zip(leaves, own, strict=True) if is_own}
    if len(counts) != 1 or min(counts) < this_machine().width:
        return None

    def of_one(*values):
        merged = list(everything)
        for k, value in zip(given, values, strict=True):
            merged[k] = value
        return function(*jax.tree.unflatten(tree, merged))

    one = [jax.ShapeDtypeStruct(a.shape[1:] if o else a.shape, a.dtype) for a, o in zip(leaves, own, strict=True)]
    closed, shape = jax.make_jaxpr(of_one, return_shape=True)(*one)
    closed, traced = _closed(closed)
    mapped = (*[False] * len(traced), *own)
    if sum(aval.size for aval, is_own in zip(closed.in_avals, mapped, strict=True) if not is_own) > _MOST_SHARED:
        return None
    if not all(_fits(aval, is_own) for aval, is_own in zip(closed.in_avals, mapped, strict=True)):
        return None
    if not all(_fits(aval, True) for aval in closed.out_avals):
        return None
    found = _each.bind(*traced, *leaves, jaxpr=closed, mapped=mapped)
    return jax.tree.unflatten(jax.tree.structure(shape), found)


def _closed(closed: ClosedJaxpr) -> tuple[ClosedJaxpr, list]:
    """Traced values that a function closes over as its first arguments, and they; numbers stay, to be folded."""
    traced = [value for value in closed.consts if isinstance(value, jax.core.Tracer)]
    if not traced:
        return closed, traced

    def function(values, *arguments):
        given = iter(values)
        consts = [next(given) if isinstance(value, jax.core.Tracer) else value for value in closed.consts]
        return jaxpr_as_fun(ClosedJaxpr(closed.jaxpr, consts))(*arguments)

    return jax.make_jaxpr(function)([value.aval for value in traced], *closed.in_avals), traced


def _fits(aval, is_own: bool) -> bool:
    return aval.dtype == np.float64 or (not is_own and np.issubdtype(aval.dtype, np.integer))


# --- the operation, for JAX ---------------------------------------------------------------------------------

_each = Primitive("each_element")
_each.multiple_results = True


def _by_xla(*arguments, jaxpr: ClosedJaxpr, mapped):
    return jax.vmap(jaxpr_as_fun(jaxpr), [0 if own else None for own in mapped])(*arguments)


def _shapes(*avals, jaxpr: ClosedJaxpr, mapped):
    count = avals[mapped.index(True)].shape[0]
    return [jax.core.ShapedArray((count, *a.shape), a.dtype) for a in jaxpr.out_avals]


def _lowered(context, *operands, jaxpr: ClosedJaxpr, mapped):
    try:
        name = kernel_of(jaxpr, mapped)
    except Unsupported:
        return mlir.lower_fun(partial(_by_xla, jaxpr=jaxpr, mapped=mapped))(context, *operands)

    def call(*arguments):
        results = [jax.ShapeDtypeStruct(a.shape, a.dtype) for a in context.avals_out]
        return jax.ffi.ffi_call(name, results)(*(a.astype(float) for a in arguments))

    return mlir.lower_fun(call)(context, *operands)


def _batched(arguments, axes, *, jaxpr: ClosedJaxpr, mapped):
    """Members of a batch are more elements."""
    members = next(a.shape[axis] for a, axis in zip(arguments, axes, strict=True) if axis is not None)
    first = mapped.index(True)
    count = arguments[first].shape[0 if axes[first] != 0 else 1]
    flat, owns = [], []
    for a, axis, own in zip(arguments, axes, mapped, strict=True):
        if axis is not None or own:
            a = jnp.broadcast_to(a, (members, *a.shape)) if axis is None else jnp.moveaxis(a, axis, 0)
            a = a if own else jnp.broadcast_to(a[:, None], (members, count, *a.shape[1:]))
            a = a.reshape(members * count, *a.shape[2:])
        flat.append(a)
        owns.append(axis is not None or own)
    found = _each.bind(*flat, jaxpr=jaxpr, mapped=tuple(owns))
    return [f.reshape(members, count, *f.shape[1:]) for f in found], [0] * len(found)


def _pushed(primals, tangents, *, jaxpr: ClosedJaxpr, mapped):
    """Derivatives along tangents, by a kernel of their own."""
    moving = [k for k, t in enumerate(tangents) if not isinstance(t, ad.Zero)]

    def change(*values):
        at, along = list(values[: len(primals)]), values[len(primals) :]

        def function(*moved):
            merged = list(at)
            for k, value in zip(moving, moved, strict=True):
                merged[k] = value
            return jaxpr_as_fun(jaxpr)(*merged)

        return jax.jvp(function, tuple(at[k] for k in moving), along)[1]

    slope = jax.make_jaxpr(change)(*jaxpr.in_avals, *(jaxpr.in_avals[k] for k in moving))
    found = _each.bind(*primals, jaxpr=jaxpr, mapped=mapped)
    more = (*mapped, *(mapped[k] for k in moving))
    return found, _each.bind(*primals, *(tangents[k] for k in moving), jaxpr=slope, mapped=more)


def _pulled(cotangents, *arguments, jaxpr: ClosedJaxpr, mapped):
    """The transpose by the arguments that are not known, in which the function is linear."""
    unknown = [k for k, a in enumerate(arguments) if ad.is_undefined_primal(a)]
    known = [k for k in range(len(arguments)) if k not in unknown]
    asked = [k for k, c in enumerate(cotangents) if not isinstance(c, ad.Zero)]

    def pulled(*values):
        def linear(*free):
            merged = dict(zip((*known, *unknown), (*values[: len(known)], *free), strict=True))
            found = jaxpr_as_fun(jaxpr)(*(merged[k] for k in range(len(merged))))
            return [found[k] for k in asked]

        free = [jax.ShapeDtypeStruct(jaxpr.in_avals[k].shape, jaxpr.in_avals[k].dtype) for k in unknown]
        return jax.linear_transpose(linear, *free)(list(values[len(known) :]))

    avals = [*(jaxpr.in_avals[k] for k in known), *(jaxpr.out_avals[k] for k in asked)]
    more = (*(mapped[k] for k in known), *[True] * len(asked))
    given = [*(arguments[k] for k in known), *(cotangents[k] for k in asked)]
    found = _each.bind(*given, jaxpr=jax.make_jaxpr(pulled)(*avals), mapped=more)
    results: list[Any] = [None] * len(arguments)
    for k, cotangent in zip(unknown, found, strict=True):
        # What elements share gets the sum of what each of them says.
        results[k] = cotangent if mapped[k] else jnp.sum(cotangent, axis=0)
    return results


_each.def_impl(lambda *arguments, **how: jax.jit(partial(_each.bind, **how))(*arguments))
_each.def_abstract_eval(_shapes)
mlir.register_lowering(_each, mlir.lower_fun(_by_xla))
mlir.register_lowering(_each, _lowered, platform="cpu")
batching.primitive_batchers[_each] = _batched
ad.primitive_jvps[_each] = _pushed
ad.primitive_transposes[_each] = _pulled
