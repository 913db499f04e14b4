"""How jaxshell's own programs are compiled: `eqx.filter_jit`, with options for XLA where the program is ours alone."""

import contextlib
import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.core
import numpy as np

COMPILER_OPTIONS: dict[str, Any] = (
    {"xla_cpu_use_fusion_emitters": False, "xla_cpu_experimental_ynn_fusion_type": ""}
    if jax.__version_info__ < (0, 11)
    else {}
)
"""Options for XLA with which jaxshell compiles runs, for programs of your own that contain runs:
`jax.jit(f, compiler_options=jaxshell.COMPILER_OPTIONS)`.

XLA's older code generator: on CPUs it takes half the time to compile these programs, and they run no slower
(`python benchmarks/compile_time.py`). And its own loops for sums, instead of calls of a library that cost more than
sums over some thousand elements. Empty but for the versions of JAX that they were tried with, 0.10.
"""
ONCE: dict[str, Any] = COMPILER_OPTIONS and COMPILER_OPTIONS | {"xla_backend_optimization_level": 0}
"""For what is run once: machine code without optimisation, made in about half the time and several times slower (the
same command)."""
_FRAME = 50_000
"""Numbers in all arguments below which compiling takes longer than what is to be done for a frame, either way."""
_SCENE = 10_000_000
"""The same for a scene, whose tables of assembly are most of the numbers: some 700 for an element."""


def compiled(function: Callable, little: int = 0) -> Callable:
    """`eqx.filter_jit`; where the call is part of a program of the user's, that program's options hold.

    Calls whose arguments have fewer than `little` numbers are compiled as what runs `ONCE`.
    """

    # Equinox hands what it does not know to jax.jit, which its signature for type checkers leaves out.
    def alone(options):
        return eqx.filter_jit(function, compiler_options=options)  # pyright: ignore[reportCallIssue]

    quick, small, within = alone(COMPILER_OPTIONS), alone(ONCE), eqx.filter_jit(function)

    @functools.wraps(function)
    def call(*arguments):
        leaves = jax.tree.leaves(arguments)
        if any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
            return within(*arguments)
        try:
            return (small if little and sum(map(np.size, leaves)) < little else quick)(*arguments)
        except KeyboardInterrupt:
            _let_end()
            raise

    return call


def _let_end() -> None:
    """Wait for the program that a signal interrupted the waiting for: XLA's threads run on in it, and a process that
    ended meanwhile would take the native solvers from under them. A second signal does not wait."""
    # The exception's traceback still holds what the program is to return.
    with contextlib.suppress(RuntimeError, ValueError):
        jax.block_until_ready(jax.live_arrays())


def compiled_once(function: Callable) -> Callable:
    """`compiled` for what is run once for a scene: not worth the optimiser's time but on the largest."""
    return compiled(function, _SCENE)


def compiled_for_frames(function: Callable) -> Callable:
    """`compiled` for what is run once for a frame: on small scenes not worth the optimiser's time."""
    return compiled(function, _FRAME)
