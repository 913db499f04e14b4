"""Tables of a scene file as text that a person can read and edit.

A line for each key; lists of tables and of vectors that do not fit have a line for each entry. Python's own library
reads TOML and writes none.
"""

import re
from decimal import Decimal
from typing import Any

_WIDTH = 100
_LONG = 8
"""Numbers of more characters are written with an exponent where that is shorter."""
_PLAIN = re.compile(r"[A-Za-z0-9_-]+")


def toml_text(tables: dict[str, Any]) -> str:
    """The text of a file with these keys, tables and arrays of tables; numbers keep all their digits."""
    blocks = ["".join(f"{_key(key)} = {_value(value)}\n" for key, value in tables.items() if not _is_table(value))]
    for key, value in tables.items():
        if isinstance(value, dict):
            blocks += _table(_key(key), value)
        elif _is_table(value):
            blocks += [f"[[{_key(key)}]]\n{_entries(table)}" for table in value]
    return "\n".join(block for block in blocks if block)


def _table(name: str, table: dict[str, Any]) -> list[str]:
    """A table, or those in it where it is made of tables alone."""
    if table and all(isinstance(value, dict) for value in table.values()):
        return [f"[{name}.{_key(key)}]\n{_entries(value)}" for key, value in table.items()]
    return [f"[{name}]\n{_entries(table)}"]


def _entries(table: dict[str, Any]) -> str:
    return "".join(f"{_key(key)} = {_value(value, len(key) + 3)}\n" for key, value in table.items())


def _is_table(value: Any) -> bool:
    return isinstance(value, dict) or (
        isinstance(value, list) and bool(value) and all(isinstance(item, dict) for item in value)
    )


def _key(key: str) -> str:
    return key if _PLAIN.fullmatch(key) else _quoted(key)


def _quoted(text: str) -> str:
    escaped = "".join(
        f"\\u{ord(c):04x}" if ord(c) < 32 or ord(c) == 127 else {'"': '\\"', "\\": "\\\\"}.get(c, c) for c in text
    )
    return f'"{escaped}"'


def _value(value: Any, indent: int = 0) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, dict):
        inner = ", ".join(f"{_key(key)} = {_value(item)}" for key, item in value.items())
        return "{ " + inner + " }"
    if isinstance(value, float):
        plain = repr(float(value))
        return plain if len(plain) <= _LONG else min(plain, f"{Decimal(plain).normalize():e}", key=len)
    if not isinstance(value, list | tuple):
        return repr(int(value))
    items = [_value(item) for item in value]
    line = f"[{', '.join(items)}]"
    if indent + len(line) <= _WIDTH or not items:
        return line
    if isinstance(value[0], dict | list):
        return "[\n" + "".join(f"  {item},\n" for item in items) + "]"
    return "[\n" + "".join(f"  {', '.join(row)},\n" for row in _rows(items)) + "]"


def _rows(items: list[str]) -> list[list[str]]:
    """Numbers in lines of at most the width."""
    rows: list[list[str]] = [[]]
    used = 0
    for item in items:
        if rows[-1] and used + len(item) + 2 > _WIDTH:
            rows.append([])
            used = 0
        rows[-1].append(item)
        used += len(item) + 2
    return rows
