"""What every command does first: double precision, compiled programs that are kept, and fewer searches for garbage."""

import atexit
import gc
import os
from pathlib import Path

_GARBAGE = 100_000
"""New objects between two searches for garbage: tracing makes millions that stay, and few that are to be found."""


def prepare_jax() -> None:
    """Switch double precision on, and keep compiled programs in the user's cache: the next start is quick.

    JAX_COMPILATION_CACHE_DIR names another place; JAX_ENABLE_COMPILATION_CACHE=false keeps nothing.
    """
    import jax

    gc.set_threshold(_GARBAGE, 50, 1000)
    atexit.register(gc.freeze)  # the interpreter's end searches once more, in what is given back anyway
    jax.config.update("jax_enable_x64", True)
    if jax.config.values["jax_compilation_cache_dir"] is None:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        jax.config.update("jax_compilation_cache_dir", str(home / "jaxshell"))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)  # also of the many that are small
