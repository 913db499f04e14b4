"""Settings that every test runs under."""

import jax
import pytest

jax.config.update("jax_enable_x64", True)


@pytest.fixture(scope="module", autouse=True)
def _forget_programs():
    """Compiled programs are of no use to the next file; kept, they fill gigabytes."""
    yield
    jax.clear_caches()
