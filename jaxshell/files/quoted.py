"""Objects with plain arguments as text, such as "Newton(tolerance=1e-08, ...)": what a file quotes of its run.

And text as a part of a file's name, whoever wrote it.
"""

import ast
import math
from collections.abc import Mapping
from typing import Any


def quote(module) -> str:
    """Name and arguments of a method, of Newton or of a step control, floats as numbers."""
    values = ((name, float(v) if hasattr(v, "dtype") else v) for name, v in vars(module).items())
    texts = (f"{name}={value!r}" if isinstance(value, float) else f"{name}={value}" for name, value in values)
    return f"{type(module).__name__}({', '.join(texts)})"


def parts(text: str) -> tuple[str, dict[str, Any]]:
    """Name and arguments of what `quote` described. Raises ValueError for anything else."""
    wrong = ValueError(f"{text!r} is not a name with its arguments in parentheses.")
    try:
        call = ast.parse(text, mode="eval").body
        if not (isinstance(call, ast.Call) and isinstance(call.func, ast.Name)) or call.args:
            raise wrong
        return call.func.id, {str(argument.arg): _value(argument.value) for argument in call.keywords}
    except (SyntaxError, TypeError, ValueError, RecursionError, MemoryError) as error:
        raise wrong from error


def unquote(text: str, kinds: Mapping[str, Any]) -> Any:
    """The object that `quote` described; `kinds` are the classes that it may be of, by their names.

    Raises ValueError for anything else.
    """
    try:
        name, arguments = parts(text)
        return kinds[name](**arguments)
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{text!r} is not one of {', '.join(kinds)} as this version of jaxshell has them.") from error


def file_part(text: str, otherwise: str = "scene") -> str:
    """Any text as a part of a file's name: letters, digits, ".", "_" and "-", the rest as "_".

    It names no folder, no hidden file and nothing longer than 100 characters; `otherwise` where nothing is left.
    """
    plain = "".join(c if c.isalnum() or c in "._-" else "_" for c in text).lstrip(".")
    return plain.encode("utf-8", "ignore")[:100].decode("utf-8", "ignore") or otherwise


def _value(node: ast.expr) -> Any:
    # Names are quoted without quotation marks.
    if isinstance(node, ast.Name):
        return math.inf if node.id == "inf" else node.id
    return ast.literal_eval(node)
