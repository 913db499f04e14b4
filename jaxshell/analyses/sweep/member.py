"""One member of a sweep before it runs: checked, and taken apart into its numbers and the structure of its program."""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxshell.analyses.driver import check_options
from jaxshell.analyses.simulation import step_sizes
from jaxshell.analyses.step_control import StepControl
from jaxshell.files.quoted import quote
from jaxshell.methods.method import Method
from jaxshell.model.scene import Scene
from jaxshell.numerics.frozen import Frozen
from jaxshell.solvers.linear_solver import LinearSolver
from jaxshell.solvers.newton import Newton


class Options(NamedTuple):
    """How a member is solved."""

    newton: Newton
    tangent: str = "closed_form"
    linear_solver: LinearSolver | None = None
    kernels: str = "xla"

    def of_simulate(self) -> dict[str, Any]:
        """As `simulate` takes them."""
        return {"newton": self.newton, "tangent": self.tangent, "linear_solver": self.linear_solver}


class Case(NamedTuple):
    """What one member is."""

    scene: Scene
    method: Method
    dt: Any
    """A number, an array of step sizes, or a StepControl."""
    t_end: float | None
    options: Options


CaseOf = Callable[[dict[str, Any]], Case]
"""The case of a member with these parameters. Raises ValueError where they make none."""


class Member(NamedTuple):
    """A case that can run: members of equal `structure` share a compiled program."""

    number: int
    case: Case
    steps: np.ndarray | None
    """(N,) step sizes; None under step control."""
    leaves: tuple[np.ndarray, ...]
    """The floats of scene and method."""
    structure: Any


def prepared(number: int, case: Case) -> Member:
    """A member of a case. Raises ValueError where scene, method and steps do not go together."""
    scene, method, dt, t_end, options = case
    scene = unnamed(scene)  # also where it is checked: another name would compile the check again
    check_options(scene, method, 1, options.tangent, options.newton)
    controlled = isinstance(dt, StepControl)
    steps = np.asarray([dt.initial] if controlled else step_sizes(dt, t_end))
    method.check(scene, steps)
    leaves, fixed, tree = _apart(scene, method)
    shapes = tuple(leaf.shape for leaf in leaves)
    solved = quote(options.newton), options.tangent, repr(options.linear_solver), options.kernels
    structure = tree, fixed, shapes, quote(dt) if controlled else len(steps), solved
    return Member(number, case, None if controlled else steps, leaves, structure)


def _apart(scene: Scene, method: Method):
    """(floats, other leaves, tree) of scene and method."""
    leaves, tree = jax.tree.flatten((scene, method))
    floats = tuple(np.asarray(leaf) for leaf in leaves if is_float(leaf))
    fixed = (Frozen(leaf) if hasattr(leaf, "dtype") else leaf for leaf in leaves if not is_float(leaf))
    return floats, tuple(fixed), tree


def is_float(leaf) -> bool:
    """Whether a leaf is a number that may differ between the members of one program."""
    return isinstance(leaf, float | np.floating) or (
        isinstance(leaf, jax.Array | np.ndarray) and np.issubdtype(leaf.dtype, np.floating)
    )


def unnamed(scene: Scene) -> Scene:
    """The scene without its name and the suggestions of how it is run, which are no part of a program."""
    return dataclasses.replace(scene, name="member", defaults=None)
