"""Checks of what the user states: clear errors, raised before anything is compiled.

Values that are being traced (under `jax.grad`, `jax.vmap`, `jax.jit`) cannot be looked at and are let through.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Float

Real = int | float | Float[jax.Array, ""]
"""A number that JAX may trace."""


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


def float_array(value) -> jax.Array:
    """Convert a number, list or array to a JAX array of the default float type."""
    return jnp.asarray(value, dtype=float)


def index_array(value) -> jax.Array:
    """Convert whole numbers (NumPy) to an int32 JAX array; jnp.asarray would compile a program for every length."""
    return jax.device_put(np.asarray(value, np.int32))


def check_finite(name: str, value) -> None:
    """Raise ValueError naming the first entry of `value` that is NaN or infinite."""
    if is_concrete(value):
        array = np.asarray(value)
        if not np.all(np.isfinite(array)):
            index = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
            where = f" at index {index}" if array.ndim else ""
            raise ValueError(f"{name} must be finite, but it is {array[index]}{where}.")


def check_positive(name: str, value, allow_zero: bool = False) -> None:
    """Raise ValueError naming the first entry of `value` that is not positive (or negative, with `allow_zero`)."""
    check_finite(name, value)
    if is_concrete(value):
        array = np.asarray(value)
        bad = array < 0 if allow_zero else array <= 0
        if np.any(bad):
            index = tuple(int(i) for i in np.argwhere(bad)[0])
            where = f" at index {index}" if array.ndim else ""
            wanted = "zero or positive" if allow_zero else "positive"
            raise ValueError(f"{name} must be {wanted}, but it is {array[index]}{where}.")


def check_within(name: str, value, low: float, high: float) -> None:
    """Raise ValueError unless `value`, one number, lies in [low, high]."""
    check_finite(name, value)
    if is_concrete(value) and not low <= value <= high:
        raise ValueError(f"{name} must lie in [{low:g}, {high:g}], but it is {value}.")


def check_shape(name: str, value, shape: tuple) -> None:
    """Raise ValueError when `value` has another shape; None in `shape` stands for any length."""
    actual = np.shape(value)
    if len(actual) != len(shape) or any(w is not None and a != w for a, w in zip(actual, shape, strict=True)):
        wanted = "(" + ", ".join("any" if w is None else str(w) for w in shape) + ("," if len(shape) == 1 else "") + ")"
        raise ValueError(f"{name} must have shape {wanted}, but it has shape {actual}.")


def node_indices(name: str, nodes) -> np.ndarray:
    """Convert to a 1-d integer array of node indices; raise ValueError for anything else."""
    array = np.atleast_1d(np.asarray(nodes))
    if array.ndim != 1 or (array.size and not np.issubdtype(array.dtype, np.integer)):
        raise ValueError(
            f"{name} must be a list of node indices (integers), but it is {nodes!r}. "
            "Use mesh.nodes_where(...) to select nodes by position."
        )
    if array.size == 0:
        raise ValueError(f"{name} is empty: no node was selected.")
    return array.astype(np.int64)
