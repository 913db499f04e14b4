"""What a run gives back: histories at every step, frames, and how it ended."""

from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float, Int

from jaxshell.model.scene import Scene

Array = jax.Array | np.ndarray
"""NumPy's in what is on its way to a result file."""


class RESULTS(eqx.Enumeration):
    """How a run ended; the text says what to do next."""

    successful = ""
    diverged = (
        "Newton's iteration diverged. Reduce the time step, or use StepControl; "
        "check loads and supports if it is the first step."
    )
    stagnated = (
        "Newton's iteration did not reach the tolerance within max_iterations. "
        "Reduce the time step, raise max_iterations, or loosen the tolerance."
    )
    singular = (
        "The tangent stiffness is singular: the linear solver returned no usable solution. "
        "Look for a mechanism (unsupported motion in statics, loose parts) or a far too large step."
    )
    step_too_small = "Step control reached its smallest step. Loosen the tolerance or lower `smallest`."
    interrupted = "The run was stopped before its end; what it had computed is kept."
    unstable = "The explicit method became unstable. Use a time step below the critical one."


class Energy(eqx.Module):
    """Energies at every step [force·length], each (k,)."""

    kinetic: Float[Array, " k"]
    strain: Float[Array, " k"]
    external_work: Float[Array, " k"]
    """Work of the loads and of moving supports since the start."""
    dissipated: Float[Array, " k"]
    """Energy that the method's numerical dissipation removed, where it accounts for it; zero otherwise."""

    @property
    def total(self) -> Float[Array, " k"]:
        """Kinetic plus strain energy."""
        return self.kinetic + self.strain


class Momentum(eqx.Module):
    """Momenta at every step, each (k, 3), about the origin."""

    linear: Float[Array, "k 3"]
    angular: Float[Array, "k 3"]


class Stats(dict):
    """A dict of figures that hashes by content, so that it can stand in the static part of a solution."""

    def __hash__(self) -> int:
        return hash(frozenset(self.items()))


class Solution(eqx.Module):
    """A run: histories at every step (k of them, the start first) and frames (f of them).

    Units are the scene's. `result` says whether the run ended as asked; everything computed until then is here.
    """

    scene: Scene
    times: Float[Array, " k"]
    watched: dict[str, Float[Array, " k"]]
    energy: Energy
    momentum: Momentum
    iterations: Int[Array, " k"]
    frame_times: Float[Array, " f"]
    displacements: Float[Array, "f n 3"]
    rotations: Float[Array, "f n 3 3"]
    velocities: Float[Array, "f n 3"]
    result: RESULTS
    message: str = eqx.field(static=True)
    """For a failed run: step, time and what to try; empty otherwise."""
    stats: "Stats" = eqx.field(static=True)
    """Host-side figures: method and its parameters, wall time, steps, iterations, factorizations, solver, ..."""
    state: Any = None
    """The method's state at the end, from which `simulate(restart=...)` goes on. Of a file, a dict of its arrays."""
    reaction: Float[Array, "k nh"] | None = None
    """Of a run with reactions=True: what the supports carry at the held degrees of freedom [force, force·length], which
    `jaxshell.reactions` sorts by nodes."""
    analysis: str = eqx.field(static=True, default="time")
    """"time", or "static" where the times are load factors."""

    @property
    def step_sizes(self) -> Float[Array, " steps"]:
        """Sizes of the steps taken, e.g. to differentiate a run under step control with its steps frozen."""
        return self.times[1:] - self.times[:-1]

    def save(self, path) -> None:
        """Write the run and its scene to an HDF5 file; an existing file is replaced."""
        from jaxshell.results import hdf5 as storage  # which imports this file

        storage.save_solution(self, path)

    @classmethod
    def load(cls, path) -> "Solution":
        """Read a file that `save` or `simulate(output=...)` wrote; of a run that was killed, what it had written.

        Raises FileNotFoundError, or ValueError for a file that is not ours, of another schema, or damaged.
        """
        from jaxshell.results import hdf5 as storage

        return storage.load_solution(path)
