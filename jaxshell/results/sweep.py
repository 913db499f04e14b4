"""What a sweep gives back: parameters, histories, extremes and results of all members, and their statistics."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxshell.model.scene import Scene
from jaxshell.numerics.checks import shown
from jaxshell.results.sensitivities import Sensitivities, sensitivities_of

SUCCESSFUL, REFUSED = "successful", "refused"
"""Of a member that ran to its end, and of one whose scene or run is no valid one; others are names of RESULTS."""
EXTREMES = ("minimum", "maximum", "time_of_minimum", "time_of_maximum", "end")
"""What is kept of every watched quantity besides its history."""
ENERGIES = ("kinetic", "strain", "external_work", "dissipated")


@dataclasses.dataclass(frozen=True)
class Sweep:
    """The members of a sweep, N of them, in the order of its design. Units are the scene's.

    What a member does not have (not run, refused, after its failure) is NaN. Statistics are of the members that ended
    successfully.
    """

    scene: Scene
    """The first member's."""
    kind: str
    """grid, zip, random, latin, sobol or saltelli."""
    parameters: dict[str, np.ndarray]
    """{name: (N, ...)}."""
    result: np.ndarray
    """(N,) of names: "successful", another item of RESULTS, "refused", or "" for a member that has not been run."""
    messages: dict[int, str]
    """{member: why it failed}."""
    times: np.ndarray
    """(k,) of the histories."""
    watched: dict[str, np.ndarray]
    """{label: (N, k)} histories."""
    minimum: dict[str, np.ndarray]
    """{label: (N,)} over all steps of the run, as the following."""
    maximum: dict[str, np.ndarray]
    time_of_minimum: dict[str, np.ndarray]
    time_of_maximum: dict[str, np.ndarray]
    end: dict[str, np.ndarray]
    """{label: (N,)} at the last step."""
    energy: dict[str, np.ndarray]
    """{kinetic, strain, external_work, dissipated: (N,)} at the last step."""
    energy_balance: np.ndarray
    """(N,) the largest change of K + S + D - W, as a fraction of the largest K + S."""
    steps: np.ndarray
    """(N,) steps finished; 0 where there are none."""
    quantities: dict[str, np.ndarray]
    """{name: (N, ...)} what functions of the solution gave."""
    frames: dict[str, np.ndarray] | None
    """times (N, f), displacements (N, f, n, 3), rotations (N, f, n, 3, 3) and velocities (N, f, n, 3), of a sweep
    that keeps them."""
    settings: dict[str, Any]
    """How the sweep was asked for."""

    @property
    def size(self) -> int:
        """N, how many members the design has."""
        return len(self.result)

    @property
    def done(self) -> np.ndarray:
        """(N,) whether a member has been run, or refused."""
        return self.result != ""

    @property
    def successful(self) -> np.ndarray:
        """(N,) whether a member ran to its end."""
        return self.result == SUCCESSFUL

    def failures(self) -> dict[str, int]:
        """{result: members} of those that failed, the most frequent first."""
        names, counts = np.unique(self.result[self.done & ~self.successful], return_counts=True)
        order = np.argsort(-counts, kind="stable")
        return {str(names[k]): int(counts[k]) for k in order}

    # --- statistics ---------------------------------------------------------------------------------------

    def mean(self) -> dict[str, np.ndarray]:
        """{label: (k,)} the mean history."""
        return {label: _over(np.mean, values[self.successful]) for label, values in self.watched.items()}

    def deviation(self) -> dict[str, np.ndarray]:
        """{label: (k,)} the standard deviation of the histories, of a sample (N - 1)."""
        return {label: _over(np.std, values[self.successful], ddof=1) for label, values in self.watched.items()}

    def quantile(self, q: float | Sequence[float]) -> dict[str, np.ndarray]:
        """{label: (k,)}, or (len(q), k) for several q in [0, 1]: so much of the members lies below."""
        if not np.all((np.asarray(q) >= 0) & (np.asarray(q) <= 1)):
            raise ValueError(f"A quantile lies in [0, 1], but it is {shown(q)}.")
        return {label: _over(np.quantile, values[self.successful], q=q) for label, values in self.watched.items()}

    def responses(self) -> dict[str, np.ndarray]:
        """{name: (N,)} what sensitivities are of: "<label> min", "<label> max", "<label> end", and quantities that are
        one number."""
        found = {}
        for label in self.watched:
            for word, values in (("min", self.minimum), ("max", self.maximum), ("end", self.end)):
                found[f"{label} {word}"] = values[label]
        return found | {name: values for name, values in self.quantities.items() if values.ndim == 1}

    def response(self, name: str) -> np.ndarray:
        """(N,) one of `responses`. Raises ValueError, listing them, for another name."""
        known = self.responses()
        if name not in known:
            raise ValueError(f"There is no quantity {name!r} in the sweep. Choose out of {', '.join(known) or 'none'}.")
        return known[name]

    def sensitivities(self, names: Sequence[str] | None = None) -> Sensitivities:
        """How much of each response's variance each parameter explains; see `Sensitivities` for what is estimated.

        Raises ValueError where the design cannot tell (parameters that go together, too few members).
        """
        names = list(self.responses()) if names is None else list(names)
        responses = {name: self.response(name) for name in names}
        return sensitivities_of(self.kind, self.parameters, responses, self.successful)

    # --- files --------------------------------------------------------------------------------------------

    def save(self, path, overwrite: bool = False) -> None:
        """Write the sweep to an HDF5 file. Raises ValueError where the file holds another sweep, or something else."""
        from jaxshell.results.sweep_file import save_sweep  # which imports this file

        save_sweep(self, path, overwrite)

    @classmethod
    def load(cls, path) -> "Sweep":
        """Read a sweep's file, also of one that goes on or was killed: members without a result are not done.

        Raises FileNotFoundError, or ValueError for a file that holds no sweep, is of another schema, or damaged.
        """
        from jaxshell.results.sweep_file import load_sweep

        return load_sweep(path)


def _over(statistic, values: np.ndarray, **options) -> np.ndarray:
    """A statistic over the members at every time, of those that have a value there; NaN where fewer than two or, of a
    mean or quantile, none has."""
    shape = np.shape(options.get("q", 0.0))
    found = np.full((*shape, values.shape[1]), np.nan)
    there = np.isfinite(values)
    least = 1 + options.get("ddof", 0)
    whole = there.all(axis=0) & (len(values) >= least)
    found[..., whole] = statistic(values[:, whole], axis=0, **options)
    for k in np.flatnonzero(~whole & (there.sum(axis=0) >= least)):  # some members ended before
        found[..., k] = statistic(values[there[:, k], k], **options)
    return found
