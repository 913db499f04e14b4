"""The frames of a run: in memory, or in the result file, from which they are read when they are asked for."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxshell.results.checked import reading, run_of
from jaxshell.results.quaternions import quaternions_to_matrices

Array = jax.Array | np.ndarray
"""NumPy's in what is on its way to a result file."""
_KEPT = 2**26
"""Bytes of an array that was read which are remembered, for who asks again."""


class Frames(eqx.Module):
    """Shapes and velocities of all nodes, f times."""

    displacements: Float[Array, "*f n 3"]
    rotations: Float[Array, "*f n 3 3"]
    velocities: Float[Array, "*f n 3"]

    def at(self, which) -> "Frames":
        """One frame by its number, or several by a list of numbers."""
        which = which if isinstance(which, int) else np.asarray(which)
        return Frames(self.displacements[which], self.rotations[which], self.velocities[which])


class StoredFrames(eqx.Module):
    """The first `count` frames in a result file; `run` names the run, should the file be replaced."""

    path: str = eqx.field(static=True)
    run: str = eqx.field(static=True)
    count: int = eqx.field(static=True)

    @property
    def displacements(self) -> Float[Array, "f n 3"]:
        return _all(self, "displacements")

    @property
    def rotations(self) -> Float[Array, "f n 3 3"]:
        return _all(self, "rotations")

    @property
    def velocities(self) -> Float[Array, "f n 3"]:
        return _all(self, "velocities")

    def at(self, which) -> Frames:
        """One frame by its number, or several by a list of numbers; nothing else is read."""
        numbers = np.arange(self.count)[which]
        found = {name: _read(self, name, np.atleast_1d(numbers).tolist()) for name in _NAMES}
        return Frames(**{name: jnp.asarray(a if numbers.ndim else a[0]) for name, a in found.items()})


class JoinedFrames(eqx.Module):
    """The frames of several runs, one run's after another's."""

    parts: tuple["Frames | StoredFrames | JoinedFrames", ...]
    numbers: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    """Which of each run's own frames."""

    @property
    def displacements(self) -> Float[Array, "f n 3"]:
        return self.at(self._every()).displacements

    @property
    def rotations(self) -> Float[Array, "f n 3 3"]:
        return self.at(self._every()).rotations

    @property
    def velocities(self) -> Float[Array, "f n 3"]:
        return self.at(self._every()).velocities

    def at(self, which) -> Frames:
        """One frame by its number, or several by a list of numbers; nothing else is read."""
        owners = [(part, own) for part, numbers in enumerate(self.numbers) for own in numbers]
        chosen = np.arange(len(owners))[which]
        if not chosen.ndim:
            part, own = owners[chosen]
            return self.parts[part].at(own)
        found = [
            (position, self.parts[part].at([owners[i][1] for i in chosen[position]]))
            for part in range(len(self.parts))
            if (position := np.flatnonzero([owners[i][0] == part for i in chosen])).size
        ]
        if not found:
            return self.parts[0].at([])
        back = np.argsort(np.concatenate([position for position, _ in found]))
        arrays = jax.tree.map(lambda *a: jnp.concatenate(a)[back], *(frames for _, frames in found))
        return Frames(arrays.displacements, arrays.rotations, arrays.velocities)

    def _every(self) -> list[int]:
        return list(range(sum(map(len, self.numbers))))


_NAMES = ("displacements", "rotations", "velocities")
_remembered: dict[tuple[StoredFrames, str], jax.Array] = {}
"""The arrays that were read last."""


def _all(frames: StoredFrames, name: str) -> jax.Array:
    found = _remembered.pop((frames, name), None)
    if found is None:
        found = jnp.asarray(_read(frames, name))
    if found.nbytes <= _KEPT:
        _remembered[frames, name] = found
        while len(_remembered) > len(_NAMES):
            _remembered.pop(next(iter(_remembered)))
    return found


def _read(frames: StoredFrames, name: str, numbers: list[int] | None = None) -> np.ndarray:
    """All frames, or those with the given numbers in their order. Raises ValueError where another run replaced them."""
    with reading(frames.path) as file:
        if run_of(file) != frames.run:
            raise ValueError(f"{frames.path} holds another run by now: its frames are not those of this solution.")
        dataset = file["frames"][name]
        if numbers is None:
            found = dataset[: frames.count]
        else:
            chosen, back = np.unique(numbers, return_inverse=True)
            found = dataset[chosen.tolist()][back.ravel()] if len(chosen) else dataset[:0]
    return quaternions_to_matrices(found) if name == "rotations" else found
