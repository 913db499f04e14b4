"""Settings that every test runs under."""

import os

import pytest

from jaxshell.numerics.compiled import OPTIONS

# Programs of the tests' own are compiled as jaxshell's are: in half the time.
_FLAGS = " ".join(f"--{name}={str(value).lower()}" for name, value in OPTIONS.items())
os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {_FLAGS}"

import jax  # noqa: E402

jax.config.update("jax_enable_x64", True)


@pytest.fixture(scope="module", autouse=True)
def _forget_programs():
    """Compiled programs are of no use to the next file; kept, they fill gigabytes."""
    yield
    jax.clear_caches()
