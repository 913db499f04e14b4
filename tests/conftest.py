"""Settings that every test runs under."""

import gc
import os

import jax
import jaxtyping
import pytest

from jaxshell.numerics.compiled import COMPILER_OPTIONS

jax.config.update("jax_enable_x64", True)


_SETTINGS = {
    "jax_disable_most_optimizations": True,  # half the time in XLA, but twice the time of a run
    "jax_traceback_in_locations_limit": 0,  # the line of Python beside every operation, which only a debugger reads
    "jax_persistent_cache_min_compile_time_secs": 0.0,  # where programs are kept, small ones too
}


def _set(name, value) -> None:
    """For this process and for those that a test starts."""
    jax.config.update(name, value)
    os.environ[name.upper()] = str(value)


def pytest_configure(config):
    """Most of the tests' time is compiling: their own programs are compiled as jaxshell's are, and all in one piece
    each, as every core has tests of its own. Garbage is looked for less often: a trace keeps all that it makes."""
    options = {**COMPILER_OPTIONS, "xla_backend_optimization_level": 1, "xla_cpu_parallel_codegen_split_count": 1}
    flags = " ".join(f"--{name}={str(value).lower()}" for name, value in options.items())
    os.environ["XLA_FLAGS"] = f"{flags} {os.environ.get('XLA_FLAGS', '')}"
    for name, value in _SETTINGS.items():
        _set(name, value)
    gc.set_threshold(200_000, 50, 100)


_LONGEST_FIRST = """gradients_slow second_derivatives examples docs sweep_slow damping statics reactions settle laminates
scenes_static stability_slow energy_momentum_slow paper_scenes_slow contributions stresses cli energy_momentum simulate
extending methods units gradients generalized_energy_momentum modal benchmarks advise sections rotations readme
properties_budgets scenes_dynamic durable properties_runs step_control"""
"""Files go to the workers in this order, then all others: none is left for one worker at the end, with the rest idle."""


def pytest_collection_modifyitems(items):
    place = {f"test_{name}": i for i, name in enumerate(_LONGEST_FIRST.split())}
    items.sort(key=lambda item: place.get(item.path.stem, len(place)))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    """Tests run programs that are not optimised, but those marked `optimised`: before their fixtures are made."""
    quick = item.get_closest_marker("optimised") is None
    if str(quick) != os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"]:
        jax.clear_caches()
        _set("jax_disable_most_optimizations", quick)


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
