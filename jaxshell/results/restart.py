"""Going on from an earlier run: from its solution, or from the state that a result file holds by names."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

_WRONG = "restart must be a solution of the same scene and method, with its final state."


def named(state: Any) -> dict[str, Any]:
    """The arrays of a state by their places in it, such as "spins.R"; a state that was read has them already."""
    if isinstance(state, dict):
        return state
    leaves, _ = jax.tree_util.tree_flatten_with_path(state)
    return {jax.tree_util.keystr(path, simple=True, separator="."): leaf for path, leaf in leaves}


def restored(state: Any, like: Any) -> Any:
    """`state` with the structure of the state `like`. Raises ValueError where it is another method's or scene's."""
    if not isinstance(state, dict):
        if jax.tree.structure(state) != jax.tree.structure(like):
            raise ValueError(_WRONG)
        return state
    wanted, state = named(like), _as_written_now(state)
    if {name: np.shape(a) for name, a in state.items()} != {name: np.shape(a) for name, a in wanted.items()}:
        raise ValueError(_WRONG)
    leaves = [jnp.asarray(state[name], a.dtype) for name, a in wanted.items()]
    return jax.tree.unflatten(jax.tree.structure(like), leaves)


def _as_written_now(state: dict[str, Any]) -> dict[str, Any]:
    """Version 0.1 wrapped the state of a run with reactions: `own.` before its names, and the reactions beside it."""
    own = {name.removeprefix("own."): array for name, array in state.items() if name.startswith("own.")}
    return own or state


def time_of(state: Any) -> float:
    """The time at which a state is."""
    return float(_as_written_now(named(state))["time"])
