"""Names of runs in legends and titles."""

from collections.abc import Mapping

from jaxshell.plotting.style import plain
from jaxshell.results.solution import Solution


def named_runs(solutions: Mapping[str, Solution] | Solution) -> dict[str, Solution]:
    """{name, as matplotlib draws it: solution}; of a single run without a name, that of its method.

    Raises ValueError where there is none.
    """
    if isinstance(solutions, Solution):
        solutions = {"": solutions}
    if not solutions:
        raise ValueError("There is no solution to plot.")
    return {plain(name or _method(run)): run for name, run in solutions.items()}


def _method(run: Solution) -> str:
    """The class of a run's method, such as "EnergyMomentum", as its figures quote it."""
    return str(run.stats.get("method", "")).partition("(")[0]
