"""The operations of a jaxpr on object arrays of numbers and of `Vector`s.

Arrays exist only here: to reshape, transpose, slice or stack them is no code at all, and products with entries that
are always zero or one vanish.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.core
import numpy as np
from jax.extend.core import ClosedJaxpr, Literal

from jaxshell.numerics.kernels.code import Code, Unsupported, Vector


def _on_entries(function: Callable) -> Callable:
    """An operation on object arrays from one on entries."""

    def applied(code, eqn, *arrays):
        entries = np.frompyfunc(lambda *values: function(code, *values), len(arrays), 1)
        return np.asarray(entries(*arrays), dtype=object)

    return applied


def _constant(*values) -> bool:
    return not any(isinstance(v, Vector) for v in values)


def _is_truth(value) -> bool:
    return value.is_truth if isinstance(value, Vector) else isinstance(value, bool)


_OF_TRUTHS = {"oeq": "eq", "une": "ne"}


def _compare(condition: str, of_constants: Callable) -> Callable:
    def compared(code, a, b):
        if _constant(a, b):
            return bool(of_constants(a, b))
        if _is_truth(a) or _is_truth(b):
            if condition not in _OF_TRUTHS:
                raise Unsupported("an order of truths")
            return code.made(
                f"icmp {_OF_TRUTHS[condition]} {code.truths} {code.text(a)}, {code.text(b)}", is_truth=True
            )
        return code.made(f"fcmp {condition} {code.vector} {code.text(a)}, {code.text(b)}", is_truth=True)

    return _on_entries(compared)


def _logical(operation: str, of_constants: Callable) -> Callable:
    def combined(code, a, b):
        if not (_is_truth(a) and _is_truth(b)):
            raise Unsupported(f"{operation} of bits")
        if _constant(a, b):
            return bool(of_constants(a, b))
        return code.made(f"{operation} {code.truths} {code.text(a)}, {code.text(b)}", is_truth=True)

    return _on_entries(combined)


def _call(function: str, of_constants: Callable) -> Callable:
    def called(code, *values):
        if _constant(*values):
            return float(of_constants(*values))
        return code.called(f"llvm.{function}.v{code.width}f64", *values)

    return _on_entries(called)


def _select(code, which, first, second=None, *others):
    if second is None or others:
        raise Unsupported("a choice of other than two")
    if _constant(which):
        return second if which else first
    if _constant(first, second) and first == second:
        return first
    truth = _is_truth(first) or _is_truth(second)
    kind = code.truths if truth else code.vector
    arms = f"{kind} {code.text(second)}, {kind} {code.text(first)}"
    return code.made(f"select {code.truths} {code.text(which)}, {arms}", is_truth=truth)


def _power(code, eqn, array):
    return np.asarray(np.frompyfunc(lambda entry: _to_power(entry, eqn.params["y"]), 1, 1)(array), dtype=object)


def _to_power(base, exponent: int):
    found, square, left = None, base, abs(exponent)
    while left:
        if left & 1:
            found = square if found is None else found * square
        left >>= 1
        square = square * square if left else square
    if found is None:
        return 1.0
    return found if exponent > 0 else 1.0 / found


def _converted(code, eqn, array):
    to = np.dtype(eqn.params["new_dtype"])

    def entry(value):
        if not isinstance(value, Vector):
            return to.type(value).item()
        if value.is_truth:
            return value if to.kind == "b" else _select(code, value, 0.0, 1.0)
        if to != np.float64 and eqn.invars[0].aval.dtype.kind == "f":
            raise Unsupported(f"floats made {to}")
        return value

    return np.asarray(np.frompyfunc(entry, 1, 1)(array), dtype=object)


def _matrix_product(code, eqn, a, b):
    (of_a, of_b), (batch_a, batch_b) = eqn.params["dimension_numbers"]

    def as_matrices(array, batch, summed, summed_last):
        kept = [k for k in range(array.ndim) if k not in batch and k not in summed]
        order = [*batch, *kept, *summed] if summed_last else [*batch, *summed, *kept]
        moved = array.transpose(order)
        shape = [array.shape[k] for k in batch]
        sizes = [array.shape[k] for k in kept]
        count, depth = int(np.prod(sizes)), int(np.prod([array.shape[k] for k in summed]))
        return moved.reshape(*shape, *((count, depth) if summed_last else (depth, count))), shape, sizes

    left, shape, rows = as_matrices(a, batch_a, of_a, True)
    right, _, columns = as_matrices(b, batch_b, of_b, False)
    return np.matmul(left, right).reshape([*shape, *rows, *columns])


def _sum(code, eqn, array):
    axes = eqn.params["axes"]
    kept = [k for k in range(array.ndim) if k not in axes]
    moved = array.transpose([*kept, *axes]).reshape([*(array.shape[k] for k in kept), -1])
    total = moved[..., 0] if moved.shape[-1] else np.zeros(moved.shape[:-1], dtype=object)
    for k in range(1, moved.shape[-1]):
        total = np.asarray(total + moved[..., k], dtype=object)
    return total


def _reshaped(code, eqn, array):
    return array.reshape(eqn.outvars[0].aval.shape)


def _broadcast(code, eqn, array):
    shape, at = eqn.params["shape"], eqn.params["broadcast_dimensions"]
    spread = [1] * len(shape)
    for own, to in enumerate(at):
        spread[to] = array.shape[own]
    return np.broadcast_to(array.reshape(spread), shape)


def _slice(code, eqn, array):
    starts, limits, strides = (eqn.params[k] for k in ("start_indices", "limit_indices", "strides"))
    strides = strides or (1,) * array.ndim
    return array[tuple(slice(*of) for of in zip(starts, limits, strides, strict=True))]


def _pad(code, eqn, array, filling):
    config = eqn.params["padding_config"]
    sizes = [
        low + high + n + max(n - 1, 0) * inside for n, (low, high, inside) in zip(array.shape, config, strict=True)
    ]
    found = np.full([max(n, 0) for n in sizes], filling.item(), dtype=object)
    for index in np.ndindex(array.shape):
        to = tuple(low + i * (inside + 1) for i, (low, _, inside) in zip(index, config, strict=True))
        if all(0 <= k < n for k, n in zip(to, found.shape, strict=True)):
            found[to] = array[index]
    return found


def _gathered(code, eqn, array, indices):
    """By what the operation does to the entries' numbers."""
    if not _constant(*indices.flat):
        raise Unsupported("places that are found at run time")
    numbers = np.arange(array.size, dtype=np.int32).reshape(array.shape)
    with jax.ensure_compile_time_eval():
        places = np.asarray(eqn.primitive.bind(numbers, np.asarray(indices, eqn.invars[1].aval.dtype), **eqn.params))
    if places.min(initial=0) < 0 or places.max(initial=0) >= array.size:
        raise Unsupported("places outside")
    return array.reshape(-1)[places]


def _iota(code, eqn):
    shape, along = eqn.params["shape"], eqn.params["dimension"]
    numbers = np.arange(shape[along]).reshape([-1 if k == along else 1 for k in range(len(shape))])
    return np.broadcast_to(numbers, shape).astype(object)


def _split(code, eqn, array):
    at = np.cumsum(eqn.params["sizes"])[:-1]
    return np.split(array, at, axis=eqn.params["axis"])


def _unstack(code, eqn, array):
    axis = eqn.params["axis"]
    return [np.asarray(array.take(k, axis), dtype=object) for k in range(array.shape[axis])]


def _quotient(code, eqn, a, b):
    if eqn.outvars[0].aval.dtype.kind != "f":
        raise Unsupported("a quotient of whole numbers")
    return a / b


def _not(code, value):
    if not _is_truth(value):
        raise Unsupported("not of bits")
    return not value if _constant(value) else code.made(f"xor {code.truths} {value.name}, splat (i1 true)", True)


_OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": lambda code, eqn, a, b: a + b,
    "add_any": lambda code, eqn, a, b: a + b,
    "sub": lambda code, eqn, a, b: a - b,
    "mul": lambda code, eqn, a, b: a * b,
    "div": _quotient,
    "neg": lambda code, eqn, a: -a,
    "square": lambda code, eqn, a: a * a,
    "integer_pow": _power,
    "sqrt": _call("sqrt", np.sqrt),
    "abs": _call("fabs", abs),
    "max": _call("maximum", max),
    "min": _call("minimum", min),
    "sin": _call("sin", np.sin),
    "cos": _call("cos", np.cos),
    "lt": _compare("olt", lambda a, b: a < b),
    "le": _compare("ole", lambda a, b: a <= b),
    "gt": _compare("ogt", lambda a, b: a > b),
    "ge": _compare("oge", lambda a, b: a >= b),
    "eq": _compare("oeq", lambda a, b: a == b),
    "ne": _compare("une", lambda a, b: a != b),
    "and": _logical("and", lambda a, b: a and b),
    "or": _logical("or", lambda a, b: a or b),
    "not": _on_entries(_not),
    "select_n": _on_entries(_select),
    "convert_element_type": _converted,
    "dot_general": _matrix_product,
    "reduce_sum": _sum,
    "broadcast_in_dim": _broadcast,
    "reshape": _reshaped,
    "squeeze": _reshaped,
    "expand_dims": _reshaped,
    "transpose": lambda code, eqn, a: a.transpose(eqn.params["permutation"]),
    "rev": lambda code, eqn, a: np.flip(a, eqn.params["dimensions"]),
    "slice": _slice,
    "pad": _pad,
    "gather": _gathered,
    "concatenate": lambda code, eqn, *arrays: np.concatenate(arrays, axis=eqn.params["dimension"]),
    "stack": lambda code, eqn, *arrays: np.stack(arrays, axis=eqn.params["axis"]),
    "unstack": _unstack,
    "split": _split,
    "tile": lambda code, eqn, a: np.tile(a, eqn.params["reps"]),
    "iota": _iota,
    "optimization_barrier": lambda code, eqn, *arrays: list(arrays),
    "copy": lambda code, eqn, a: a,
}
_INNER = {
    "jit": "jaxpr",
    "checkpoint": "jaxpr",
    "closed_call": "call_jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "custom_vjp_call": "call_jaxpr",
}
"""Operations that are functions, and where they keep them."""
_ANY_KIND = {"convert_element_type", "broadcast_in_dim", "reshape", "squeeze", "optimization_barrier", *_INNER}
"""Operations that whole numbers may pass, which stand as floats here."""


def evaluate(code: Code, jaxpr, constants, arguments: list[np.ndarray]) -> list[np.ndarray]:
    """The results of a jaxpr, as object arrays."""
    known: dict[Any, np.ndarray] = {}

    def read(variable) -> np.ndarray:
        if isinstance(variable, Literal):
            return np.asarray(variable.val).astype(object)
        return known[variable]

    for variable, value in zip([*jaxpr.constvars, *jaxpr.invars], [*constants, *arguments], strict=True):
        known[variable] = value
    for eqn in jaxpr.eqns:
        values, name = [read(v) for v in eqn.invars], eqn.primitive.name
        if name not in _ANY_KIND and any(
            np.issubdtype(v.aval.dtype, np.integer) and not _constant(*a.flat)
            for v, a in zip(eqn.invars, values, strict=True)
        ):
            raise Unsupported(f"whole numbers that are not known, in {name}")
        if name in _INNER:
            inner = eqn.params[_INNER[name]]
            closed = inner if isinstance(inner, ClosedJaxpr) else ClosedJaxpr(inner, ())
            found = evaluate(code, closed.jaxpr, [as_entries(c) for c in closed.consts], values)
        elif name in _OPERATIONS:
            found = _OPERATIONS[name](code, eqn, *values)
            found = list(found) if eqn.primitive.multiple_results else [found]
        else:
            raise Unsupported(name)
        for variable, value in zip(eqn.outvars, found, strict=True):
            known[variable] = np.asarray(value, dtype=object)
    return [read(v) for v in jaxpr.outvars]


def as_entries(constant) -> np.ndarray:
    """A constant as an object array."""
    if isinstance(constant, jax.core.Tracer):
        raise Unsupported("a constant that is traced")
    return np.asarray(constant).astype(object)
