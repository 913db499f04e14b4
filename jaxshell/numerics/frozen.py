"""Integer arrays as static data: connectivity, supports' pattern and other structure that is never traced."""

import functools

import numpy as np


class Frozen:
    """A read-only integer array that hashes and compares by content.

    It lets connectivity stand in an equinox static field, so that two scenes with the same
    structure share one compiled program, and `jax.grad` sees the floats only.
    """

    def __init__(self, array):
        array = np.array(array, dtype=np.int64)
        array.flags.writeable = False
        self.array = array

    @functools.cached_property
    def _key(self) -> tuple:
        return self.array.shape, self.array.tobytes()

    @functools.cached_property
    def _hash(self) -> int:
        return hash(self._key)

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other) -> bool:
        return self is other or (isinstance(other, Frozen) and self._hash == other._hash and self._key == other._key)

    def __reduce__(self):
        """The array alone: a hash is of its process, and would be another's in the next."""
        return Frozen, (self.array,)

    def __array__(self, dtype=None, copy=None) -> np.ndarray:
        """What `np.asarray` gives; a copy where the type asked for is another."""
        return np.array(self.array, dtype=dtype, copy=copy)

    def __repr__(self) -> str:
        return f"Frozen(shape={self.array.shape})"
