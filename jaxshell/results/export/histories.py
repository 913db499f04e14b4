"""What a run records at every step, by the names that all exports give it."""

from typing import Any, NamedTuple

from jaxshell.results.export.units import watched_quantity
from jaxshell.results.solution import Solution


class History(NamedTuple):
    """Values at every step (k,), or (k, 3) of vectors, and the kind of quantity that they are."""

    values: Any
    quantity: str


def histories(solution: Solution) -> dict[str, History]:
    """Energies and momenta."""
    energy, momentum = solution.energy, solution.momentum
    return {
        "kinetic energy": History(energy.kinetic, "energy"),
        "strain energy": History(energy.strain, "energy"),
        "external work": History(energy.external_work, "energy"),
        "dissipated energy": History(energy.dissipated, "energy"),
        "linear momentum": History(momentum.linear, "linear momentum"),
        "angular momentum": History(momentum.angular, "angular momentum"),
    }


def watched(solution: Solution) -> dict[str, History]:
    """{label: what is watched}."""
    return {
        label: History(solution.watched[label], watched_quantity(component))
        for label, _, component in solution.scene.watch
    }


def times_are(solution: Solution) -> str:
    """What the times of a solution are: "time" or "load factor"."""
    return "load factor" if solution.analysis == "static" else "time"
