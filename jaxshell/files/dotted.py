"""Keys of a scene file by dotted paths: `section.thickness`, `materials.steel.density`, `loads.1.force.3`, `run.dt`.

Entries of lists are counted from 1, as in error messages. What a path names is a number, a list of numbers, or a text.
"""

import copy
import difflib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from jaxshell.files.run_keys import KEYS
from jaxshell.numerics.checks import shown

_SHOWN = 40
"""Keys that a message lists."""


def with_values(content: dict, values: Mapping[str, Any], factors: frozenset[str] = frozenset()) -> dict:
    """A copy of a scene file's content with other values at some paths; those of `factors` multiply what is there.

    A whole number takes the place of a whole number. Raises ValueError for a path that names nothing, or a table, and
    for values of another kind.
    """
    changed = copy.deepcopy(content)
    for path, value in values.items():
        *way, last = path.split(".")
        holder = _at(changed, way, path, content)
        key = _key(holder, last)
        new_of_run = way == ["run"] and last in KEYS and key not in holder
        if key is None or not (new_of_run or _has(holder, key)):
            raise _unknown(path, content)
        before = None if new_of_run else holder[key]
        holder[key] = _new(path, before, value, path in factors)
    return changed


def paths_of(content: Any, above: str = "") -> Iterator[str]:
    """The paths of all numbers in a scene file's content."""
    entries = content.items() if isinstance(content, dict) else enumerate(content, start=1)
    for key, value in entries:
        path = f"{above}{key}"
        if isinstance(value, dict | list):
            yield from paths_of(value, f"{path}.")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield path


def _at(content, way: list[str], path: str, whole: dict):
    holder = content
    if way == ["run"]:
        return content.setdefault("run", {})
    for step in way:
        key = _key(holder, step)
        if key is None or not _has(holder, key):
            raise _unknown(path, whole)
        holder = holder[key]
    return holder


def _key(holder, step: str) -> Any:
    """The key of a table, or the index of a list's entry counted from 1; None where it can be neither."""
    if isinstance(holder, dict):
        return step
    if isinstance(holder, list) and step.isdecimal():
        return int(step) - 1
    return None


def _has(holder, key) -> bool:
    return key in holder if isinstance(holder, dict) else 0 <= key < len(holder)


def _new(path: str, before, value, factor: bool):
    """What takes the place of `before`."""
    if isinstance(value, np.generic):
        value = value.item()
    if factor:
        if not _is_numeric(before):
            raise ValueError(f"{path} is no number that a factor could multiply: {shown(before)}.")
        return _scaled(before, value)
    if isinstance(value, str):
        if before is not None and not isinstance(before, str) and path != "run.method":
            raise ValueError(f"{path} is {shown(before)}, and cannot be the text {value!r}.")
        return value
    if isinstance(before, dict):
        raise ValueError(f"{path} is a table: vary one of its keys, {', '.join(before) or 'of which it has none'}.")
    if isinstance(before, list):
        raise ValueError(
            f"{path} is {shown(before)}, not one number. Vary an entry of it, such as {path}.1, or give factors: "
            "x0.9:1.1:5."
        )
    if isinstance(before, str | bool):
        raise ValueError(f"{path} is {shown(before)}, not a number; it takes texts only.")
    whole = isinstance(value, float) and value.is_integer() and isinstance(before, int)
    return int(value) if whole else value


def _is_numeric(value) -> bool:
    if isinstance(value, list):
        return bool(value) and all(map(_is_numeric, value))
    return isinstance(value, int | float) and not isinstance(value, bool)


def _scaled(value, by: float):
    return [_scaled(item, by) for item in value] if isinstance(value, list) else value * by


def _unknown(path: str, content: dict) -> ValueError:
    """The error for a path that names nothing, with those that there are, the nearest first."""
    known = list(paths_of(content))
    near = difflib.get_close_matches(path, known, n=3, cutoff=0.6)
    listed = ", ".join(known[:_SHOWN]) + (f", and {len(known) - _SHOWN} more" if len(known) > _SHOWN else "")
    meant = f" Is it {' or '.join(near)}?" if near else ""
    return ValueError(f"There is no key {path!r} in the scene file.{meant} What can be varied: {listed}; keys of run.")
