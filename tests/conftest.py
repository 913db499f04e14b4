"""Settings that every test runs under."""

import os
import re

import jax
import jaxtyping
import pytest

from jaxshell.numerics.compiled import OPTIONS

jax.config.update("jax_enable_x64", True)


def pytest_configure(config):
    """Programs are compiled in half the time: the tests' own as jaxshell's are, and all by LLVM without optimising.

    The long tests run for longer than they compile: a little of it pays there. Two tests are marked slow for that alone:
    that chunks of any length, and a run that goes on, make the same run to the last bit is shown with optimised
    programs, as users have them.
    """
    level = 1 if {"slow", "evidence"} & set(re.findall(r"(?<!not )\b\w+", config.option.markexpr)) else 0
    options = {**OPTIONS, "xla_backend_optimization_level": level}
    flags = " ".join(f"--{name}={str(value).lower()}" for name, value in options.items())
    os.environ["XLA_FLAGS"] = f"{flags} {os.environ.get('XLA_FLAGS', '')}"


@pytest.fixture(autouse=True)
def _shapes_unchecked(request):
    """Annotations are checked in every test (pyproject.toml: --jaxtyping-packages) but those marked `wrong_types`."""
    off = request.node.get_closest_marker("wrong_types") is not None
    before = jaxtyping.config.jaxtyping_disable
    jaxtyping.config.update("jaxtyping_disable", before or off)
    yield
    jaxtyping.config.update("jaxtyping_disable", before)


@pytest.fixture(scope="module", autouse=True)
def _forget_programs():
    """Compiled programs are of no use to the next file; kept, they fill gigabytes."""
    yield
    jax.clear_caches()


_RANKS_AGREE = ("test_shapes", "test_simulate", "test_storage")
"""Files in which no array is broadcast to a higher rank unasked. Not clean in the package: `Initial.rigid`, and
`_local_tangent` in elements/energy_momentum.py."""


@pytest.fixture(scope="module", autouse=True)
def _ranks(request):
    before = jax.config.jax_numpy_rank_promotion
    if request.module.__name__ in _RANKS_AGREE:
        jax.config.update("jax_numpy_rank_promotion", "raise")
    yield
    jax.config.update("jax_numpy_rank_promotion", before)
