"""How jaxshell's own programs are compiled: `eqx.filter_jit`, with options for XLA where the program is ours alone."""

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.core

OPTIONS: dict[str, Any] = {"xla_cpu_use_fusion_emitters": False} if jax.__version_info__ < (0, 11) else {}
"""XLA's older code generator: on CPUs it takes half the time to compile these programs, and they run no slower
(`python benchmarks/compile_time.py`). Given to the versions of JAX that it was tried with only."""


ONCE: dict[str, Any] = OPTIONS and OPTIONS | {"xla_backend_optimization_level": 0}
"""For what a run does once: machine code without optimisation, made in less than half the time."""


def compiled(function: Callable, options: dict[str, Any] = OPTIONS) -> Callable:
    """`eqx.filter_jit`; where the call is part of a program of the user's, that program's options hold."""
    # Equinox hands what it does not know to jax.jit, which its signature for type checkers leaves out.
    alone = eqx.filter_jit(function, compiler_options=options)  # pyright: ignore[reportCallIssue]
    within = eqx.filter_jit(function)

    @functools.wraps(function)
    def call(*arguments):
        traced = any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(arguments))
        return (within if traced else alone)(*arguments)

    return call


def compiled_once(function: Callable) -> Callable:
    """`compiled` for a program that a run calls once, where compiling it takes longer than what it does."""
    return compiled(function, ONCE)
