"""Checks of what the user states: clear errors, raised before anything is compiled.

Numbers are taken strictly: no text, no true or false, nothing ragged, and nothing that is not finite. Values that are
being traced (under `jax.grad`, `jax.vmap`, `jax.jit`) cannot be looked at and are let through.
"""

import reprlib
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Float

Real = int | float | Float[jax.Array, ""]
"""A number that JAX may trace."""

LARGEST = 1e100
"""Numbers of greater size, or positive ones below its reciprocal, overflow or vanish in products of a few of them."""
MOST_STEPS = 1e8
"""More steps than that no run takes: their histories alone fill many gigabytes."""
_DEEPEST = 16
"""Lists are taken to this depth."""


def require_float64() -> None:
    """Raise RuntimeError when JAX runs in single precision, in which a shell's tangent is not solvable."""
    if jax.dtypes.canonicalize_dtype(np.float64) != np.float64:
        raise RuntimeError(
            "jaxshell needs float64, and JAX has it switched off. Call "
            'jax.config.update("jax_enable_x64", True) at the top of the script, before any array is made, '
            "or set the environment variable JAX_ENABLE_X64=1."
        )


def is_concrete(value) -> bool:
    """Whether `value` holds numbers that can be looked at (no tracer, no placeholder of a tree operation)."""
    return isinstance(value, np.ndarray | float | int | np.number) or (
        isinstance(value, jax.Array) and not isinstance(value, Tracer)
    )


def is_infinite(value) -> bool:
    """Whether `value` is one number, +inf, where that means no limit."""
    return is_concrete(value) and np.ndim(value) == 0 and bool(value == np.inf)


def shown(value) -> str:
    """`value` as messages show it: its beginning where it is long."""
    try:
        text = repr(value) if isinstance(value, bool | int | float | np.generic) else reprlib.repr(value)
    except Exception:  # a number of more digits than Python prints, or a type whose repr fails
        text = f"a {type(value).__name__}"
    return text if len(text) <= 200 else f"{text[:200]}..."


# --- numbers ---------------------------------------------------------------------------------------------


def float_array(value, name: str = "A value") -> jax.Array:
    """A number, list or array as a JAX array of the default float type.

    Raises ValueError naming it for anything but numbers: text, true and false, lists whose rows differ in length.
    """
    if isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jnp.floating):
        return jnp.asarray(value, dtype=float)
    try:
        return jnp.asarray(_numbers(name, value), dtype=float)
    except OverflowError:
        raise ValueError(f"{name} must be finite, but it holds an integer too large for a float.") from None


def floats(name: str) -> Callable[[Any], jax.Array]:
    """The converter of a field called `name`: `float_array`."""
    return lambda value: float_array(value, name)


def optional_floats(name: str) -> Callable[[Any], jax.Array | None]:
    """The converter of a field called `name` that may be None."""
    return lambda value: None if value is None else float_array(value, name)


def index_array(value) -> jax.Array:
    """Convert whole numbers (NumPy) to an int32 JAX array; jnp.asarray would compile a program for every length."""
    return jax.device_put(np.asarray(value, np.int32))


def whole_array(name: str, value, wanted: str = "whole numbers") -> np.ndarray:
    """Whole numbers as a NumPy array of int64. Raises ValueError naming them for anything else."""
    if is_traced(value):
        raise ValueError(f"{name} must be {wanted} that are known, but JAX is tracing them.")
    array = np.asarray(_numbers(name, value, wanted))
    if array.size and not np.issubdtype(array.dtype, np.integer):
        raise ValueError(f"{name} must be {wanted}, but the type is {array.dtype}: {shown(value)}.")
    if array.size and (array.max() > np.iinfo(np.int64).max):
        raise ValueError(f"{name} must be {wanted} of 64 bits, but one is {array.max()}.")
    return array.astype(np.int64)


def is_traced(value) -> bool:
    """Whether JAX is tracing `value`, or an entry of this list."""
    return (
        any(isinstance(item, Tracer) for item in _entries(value))
        if isinstance(value, list | tuple)
        else (isinstance(value, Tracer))
    )


def _numbers(name: str, value, wanted: str = "a number or an array of numbers") -> Any:
    """`value` as an array, of JAX where a part of it is one. Raises ValueError unless it is numbers throughout."""
    listed = isinstance(value, list | tuple | range)
    entries = list(_entries(value)) if listed else [value]
    if not all(map(_is_numeric, entries)):
        raise ValueError(f"{name} must be {wanted}, but it is {shown(value)}.")
    try:
        if listed and any(isinstance(entry, jax.Array) for entry in entries):
            return jnp.asarray(value)
        array = np.asarray(value)
        if array.dtype.kind == "O":  # integers beyond 64 bits
            array = np.asarray(value, float)
    except OverflowError:
        raise ValueError(f"{name} must be finite, but it holds an integer too large for a float.") from None
    except (TypeError, ValueError):
        raise ValueError(f"{name} must be {wanted}, all rows of one length, but it is {shown(value)}.") from None
    return array


def _entries(value, depth: int = 0) -> Iterator:
    """What lists hold, at any depth; a list that is too deep stands for itself."""
    if isinstance(value, list | tuple | range) and depth < _DEEPEST:
        for item in value:
            yield from _entries(item, depth + 1)
    else:
        yield value


def _is_numeric(entry) -> bool:
    if isinstance(entry, bool):
        return False
    if isinstance(entry, int | float):
        return True
    if isinstance(entry, jax.Array):
        return bool(jnp.issubdtype(entry.dtype, jnp.floating) or jnp.issubdtype(entry.dtype, jnp.integer))
    if not hasattr(entry, "__array__"):
        return False
    return np.asarray(entry).dtype.kind in "fiu"


# --- checks ----------------------------------------------------------------------------------------------


def check_finite(name: str, value) -> None:
    """Raise ValueError for anything but numbers, and naming the first entry that is not finite or beyond 1e100."""
    if isinstance(value, Tracer):
        return
    array = _numbers(name, value)
    if isinstance(array, Tracer):
        return
    array = np.asarray(array, float)  # in single precision 1e100 would be infinite too
    # Written so that NaN fails too.
    if not np.all(np.abs(array) <= LARGEST):
        index, where = _first(~(np.abs(array) <= LARGEST))
        if np.isfinite(array[index]):
            raise ValueError(f"{name} must be at most {LARGEST:g} in size, but it is {array[index]}{where}.")
        raise ValueError(f"{name} must be finite, but it is {array[index]}{where}.")


def check_positive(name: str, value, allow_zero: bool = False) -> None:
    """Raise ValueError naming the first entry of `value` that is not positive (or negative, with `allow_zero`)."""
    check_finite(name, value)
    if is_traced(value):
        return
    array = np.asarray(value)
    bad = array < 0 if allow_zero else array <= 0
    if np.any(bad):
        index, where = _first(bad)
        wanted = "zero or positive" if allow_zero else "positive"
        raise ValueError(f"{name} must be {wanted}, but it is {array[index]}{where}.")
    tiny = (array > 0) & (array < 1 / LARGEST)
    if np.any(tiny):
        index, where = _first(tiny)
        raise ValueError(f"{name} must be at least {1 / LARGEST:g}, but it is {array[index]}{where}.")


def _first(bad) -> tuple[tuple[int, ...], str]:
    """Index of the first that is bad, and its words."""
    index = tuple(int(i) for i in np.argwhere(bad)[0])
    return index, f" at index {index}" if index else ""


def check_number(name: str, value) -> None:
    """Raise ValueError unless `value` is one finite number."""
    if np.ndim(value) if isinstance(value, Tracer) else (not _is_numeric(value) or np.ndim(value)):
        raise ValueError(f"{name} must be one number, but it is {shown(value)}.")
    check_finite(name, value)
    if isinstance(value, int) and abs(value) > 2**53:
        raise ValueError(f"{name} must be a float where it is as large as {value}: write {float(value)}.")


def check_positive_number(name: str, value) -> None:
    """Raise ValueError unless `value` is one positive number."""
    check_number(name, value)
    check_positive(name, value)


def check_within(name: str, value, low: float, high: float) -> None:
    """Raise ValueError unless `value`, one number, lies in [low, high]."""
    check_number(name, value)
    if is_concrete(value) and not low <= value <= high:
        raise ValueError(f"{name} must lie in [{low:g}, {high:g}], but it is {value}.")


def check_count(name: str, value, least: int = 1) -> None:
    """Raise ValueError unless `value` is a whole number of at least `least`."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise ValueError(f"{name} must be a whole number of at least {least}, but it is {shown(value)}.")


def check_switch(name: str, value) -> None:
    """Raise ValueError unless `value` is true or false."""
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"{name} must be True or False, but it is {shown(value)}.")


def check_choice(name: str, value, choices: tuple[str, ...]) -> None:
    """Raise ValueError unless `value` is one of these words."""
    if not isinstance(value, str) or value not in choices:
        raise ValueError(f"{name} must be one of {', '.join(choices)}, but it is {shown(value)}.")


def check_text(name: str, value) -> None:
    """Raise ValueError unless `value` is text of at least a character."""
    if not isinstance(value, str) or not value:
        raise ValueError(f"{name} must be a text, but it is {shown(value)}.")


def check_kind(name: str, value, kind: Any, public: str) -> None:
    """Raise ValueError unless `value` is a `kind`, which messages call `public`."""
    if not isinstance(value, kind):
        raise ValueError(f"{name} must be {public}, but it is {shown(value)}.")


def check_steps(dt, t_end, name: str = "dt") -> None:
    """Raise ValueError for a run of more than a hundred million steps, or a t_end that is nothing beside dt."""
    for what, value in ((name, dt), ("t_end", t_end)):
        check_positive_number(what, value)
    if t_end > MOST_STEPS * dt:
        raise ValueError(
            f"t_end = {t_end:g} with {name} = {dt:g} asks for {t_end / dt:.3g} steps, and at most {MOST_STEPS:g} are "
            "taken: one of the two is not what was meant, or the unit of time."
        )
    if t_end < dt / MOST_STEPS:
        raise ValueError(f"t_end = {t_end:g} is nothing beside {name} = {dt:g}: one of the two is not what was meant.")


def check_shape(name: str, value, shape: tuple) -> None:
    """Raise ValueError when `value` has another shape; None in `shape` stands for any length."""
    actual = np.shape(value)
    if len(actual) != len(shape) or any(w is not None and a != w for a, w in zip(actual, shape, strict=True)):
        wanted = "(" + ", ".join("any" if w is None else str(w) for w in shape) + ("," if len(shape) == 1 else "") + ")"
        raise ValueError(f"{name} must have shape {wanted}, but it has shape {actual}.")


def check_for_each(name: str, value, count: int, shape: tuple[int, ...] = ()) -> None:
    """Raise ValueError unless `value` is one of `shape`, or one for each of `count` elements."""
    if value.shape not in (shape, (count, *shape)):
        raise ValueError(f"{name} must be one value or one per element ({count}), but it has shape {value.shape}.")


def for_each(name: str, value, count: int, shape: tuple[int, ...] = ()) -> jax.Array:
    """`value` for every element, (count, *shape). Raises ValueError as `check_for_each`."""
    check_for_each(name, value, count, shape)
    return jnp.broadcast_to(value, (count, *shape))


def check_one_or_each(name: str, value) -> None:
    """Raise ValueError unless `value` is one number, or a list of at least one."""
    shape = np.shape(value)
    if len(shape) > 1 or shape == (0,):
        raise ValueError(f"{name} must be one value or a list of them, but it has shape {shape}.")


def node_indices(name: str, nodes) -> np.ndarray:
    """Convert to a 1-d integer array of node indices; raise ValueError for anything else."""
    wanted = "a list of node indices (integers)"
    try:
        array = np.atleast_1d(whole_array(name, nodes, wanted))
        if array.ndim != 1:
            raise ValueError(f"{name} must be {wanted}, but it is {shown(nodes)}.")
    except ValueError as error:
        raise ValueError(f"{error} Use mesh.nodes_where(...) to select nodes by position.") from None
    if array.size == 0:
        raise ValueError(f"{name} is empty: no node was selected.")
    return array
