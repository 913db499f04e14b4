"""A table of a scene file, for errors that say where they are."""

import contextlib
import inspect
from typing import Any

import numpy as np

from jaxshell.numerics.checks import check_finite, float_array, shown
from jaxshell.numerics.nearest import check_known

_TOP = "the file"


class Table:
    """A table of the file with its name, for errors that say where they are."""

    @classmethod
    def top(cls, content) -> "Table":
        """The whole file."""
        return cls(_TOP, content)

    def __init__(self, name: str, content):
        if not isinstance(content, dict):
            raise ValueError(f"{name} must be a table, but it is {shown(content)}.")
        self.name, self.content = name, content

    def only(self, *known: str) -> None:
        """Raise ValueError for a key that is not one of `known`."""
        check_known(self.name, self.content, known)

    def get(self, key: str) -> Any:
        if key not in self.content:
            raise ValueError(f"{self.name} lacks {key!r}.")
        return self.content[key]

    def vectors(self, key: str, shape: tuple[int, ...]) -> np.ndarray:
        """A key's finite numbers as an array of the given shape."""
        value, array = self.get(key), None
        with contextlib.suppress(ValueError):
            array = np.asarray(float_array(value))
        if array is None or array.shape != shape:
            wanted = {(): "a number", (3,): "[x, y, z]"}.get(shape, "[[x, y, z], [x, y, z]]")
            raise ValueError(f"{self.name} {key} must be {wanted}, but it is {shown(value)}.")
        self.call(check_finite, key, array)
        return array

    def text(self, key: str, default: str | None = None) -> str:
        """A key that holds text; it may be left out where there is a default."""
        value = self.get(key) if default is None else self.content.get(key, default)
        if not isinstance(value, str):
            raise ValueError(f"{self.name} {key} must be a text, but it is {shown(value)}.")
        return value

    def table(self, key: str, optional: bool = False) -> "Table":
        name = f"[{key}]" if self.name == _TOP else f"{self.name} {key}"
        return Table(name, self.content.get(key, {}) if optional else self.get(key))

    def tables(self, key: str) -> list["Table"]:
        """The tables of an array of tables, which may be absent; counted from 1 in messages."""
        found = self.content.get(key, [])
        if not isinstance(found, list):
            if self.name == _TOP:
                raise ValueError(f"{key} must be an array of tables: write [[{key}]] above each.")
            raise ValueError(f"{self.name} {key} must be a list of tables {{ ... }}, but it is {shown(found)}.")
        name = f"[[{key}]]" if self.name == _TOP else f"{self.name} {key}"
        return [Table(f"{name} number {i + 1}:", table) for i, table in enumerate(found)]

    def fields(self, make, *others: str, **read) -> Any:
        """What `make` returns for the table's keys, which are the names of its parameters.

        `others` are keys that may stand there too, and `read` functions of (table, key) for those that are more than
        numbers. Raises ValueError for a key that it does not take, and for one that it needs.
        """
        parameters = inspect.signature(make).parameters
        self.only(*parameters, *others)
        for parameter in parameters.values():
            if parameter.default is parameter.empty:
                self.get(parameter.name)
        keys = [key for key in self.content if key in parameters]
        return self.call(make, **{key: read.get(key, Table.get)(self, key) for key in keys})

    def call(self, make, *arguments, **named):
        """What `make` returns; its errors say which table they come from."""
        try:
            return make(*arguments, **named)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{self.name} {error}") from error
