"""From parameters by name to scenes: functions of the user's, or a scene whose floats are replaced."""

import inspect
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxshell.analyses.sweep.design import Design
from jaxshell.model.scene import Scene
from jaxshell.numerics.checks import check_finite, shown


def maker(scene, vary: Mapping[str, Any]) -> tuple[Callable[..., Any], dict[str, Any]]:
    """The function that makes a member's scene, and the values of each parameter."""
    if not isinstance(scene, Scene):
        if not callable(scene):
            raise ValueError(f"scene must be a jaxshell.Scene or a function that makes one, but it is {shown(scene)}.")
        return scene, dict(vary)
    wheres = {}
    for name, given in vary.items():
        if not isinstance(given, tuple) or len(given) != 2 or not callable(given[0]):
            raise ValueError(
                f"Of a scene, {name} varies as (where, values), such as (lambda s: s.section.thickness, [0.3, 0.4]), "
                f"but it is {shown(given)}. Or pass a function that makes the scene."
            )
        wheres[name] = given[0]

    def changed(**parameters) -> Scene:
        for name, value in parameters.items():
            check_finite(name, value)
        return eqx.tree_at(
            lambda s: tuple(where(s) for where in wheres.values()),
            scene,
            tuple(_shaped(name, where(scene), parameters[name]) for name, where in wheres.items()),
        )

    return changed, {name: given[1] for name, given in vary.items()}


def _shaped(name: str, before, value):
    """A value in the place of `before`; one number for each of its entries."""
    if np.ndim(value) and np.shape(value) != np.shape(before):
        raise ValueError(f"{name} has values of shape {np.shape(value)} in the place of shape {np.shape(before)}.")
    return jnp.broadcast_to(jnp.asarray(value, float), np.shape(before))


def _takes(function, name: str) -> bool:
    """Whether a function takes a parameter of this name."""
    known = inspect.signature(function).parameters
    return name in known or any(parameter.kind is parameter.VAR_KEYWORD for parameter in known.values())


def _is_function(value) -> bool:
    return inspect.isroutine(value) or (callable(value) and not isinstance(value, eqx.Module | type))


def called(function, parameters: dict[str, Any]):
    """What a function makes of the parameters that it takes; anything else stands for itself."""
    if not _is_function(function):
        return function
    return function(**{name: value for name, value in parameters.items() if _takes(function, name)})


def check_used(functions: dict[str, Any], plan: Design) -> None:
    made = {what: function for what, function in functions.items() if _is_function(function)}
    for name in plan.parameters:
        if not any(_takes(function, name) for function in made.values()):
            raise ValueError(f"No function takes {name!r}: it is no parameter of {', '.join(made)}.")
