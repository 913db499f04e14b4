"""Objects with plain arguments as text, such as "Newton(tolerance=1e-08, ...)": what a file quotes of its run."""

import ast
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np


def quote(module) -> str:
    """Name and arguments of a method, of Newton or of a step control, floats as numbers."""
    values = (
        f"{name}={value!r}" if isinstance(value, float) else f"{name}={value}"
        for name, value in ((name, float(v) if isinstance(v, jax.Array) else v) for name, v in vars(module).items())
    )
    return f"{type(module).__name__}({', '.join(values)})"


def unquote(text: str, kinds: Mapping[str, Any]) -> Any:
    """The object that `quote` described; `kinds` are the classes that it may be of, by their names.

    Raises ValueError for anything else.
    """
    try:
        call = ast.parse(text, mode="eval").body
        assert isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and not call.args
        return kinds[call.func.id](**{str(k.arg): _value(k.value) for k in call.keywords})
    except (SyntaxError, AssertionError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{text!r} is not one of {', '.join(kinds)} as this version of jaxshell has them.") from error


def _value(node: ast.expr) -> Any:
    # Names are quoted without quotation marks.
    if isinstance(node, ast.Name):
        return np.inf if node.id == "inf" else node.id
    return ast.literal_eval(node)
