"""What every command does first: double precision, and compiled programs that are kept."""

import os
from pathlib import Path


def prepare_jax() -> None:
    """Switch double precision on, and keep compiled programs in the user's cache: the next start is quick.

    JAX_COMPILATION_CACHE_DIR names another place; JAX_ENABLE_COMPILATION_CACHE=false keeps nothing.
    """
    import jax

    jax.config.update("jax_enable_x64", True)
    if jax.config.values["jax_compilation_cache_dir"] is None:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        jax.config.update("jax_compilation_cache_dir", str(home / "jaxshell"))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)
