"""A short text for a scene or a table of numbers; another one for anything else."""

import hashlib
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import numpy as np


def fingerprint(value: Any) -> str:
    """Of scenes, arrays, numbers, texts, and lists and mappings of them: the same for equal ones in every process."""
    found = hashlib.sha256()
    _feed(found, value)
    return found.hexdigest()[:16]


def _feed(found, value) -> None:
    found.update(f"<{type(value).__name__}>".encode())
    if isinstance(value, eqx.Module):
        for name, part in vars(value).items():
            found.update(name.encode())
            _feed(found, part)
    elif isinstance(value, Mapping):
        for key in value:
            found.update(repr(key).encode())
            _feed(found, value[key])
    elif isinstance(value, list | tuple):
        for part in value:
            _feed(found, part)
    elif hasattr(value, "__array__"):
        array = np.asarray(value)
        found.update(f"{array.dtype}{array.shape}".encode())
        found.update(array.tobytes())
    else:
        found.update(repr(value).encode())
