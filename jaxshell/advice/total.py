"""Total error against time: every line on every mesh at a few steps, mesh and step judged together."""

from collections.abc import Callable

from jaxshell.advice.chart import Point, measure
from jaxshell.advice.converged import Converged, converged
from jaxshell.advice.family import Family
from jaxshell.advice.lines import lines_of
from jaxshell.model.scene import Scene

KNOWN = 2e-3
"""What a chart would have the continuous answer known to, if the budget allows."""
_AROUND = (0.5, 1.0, 2.0)
"""Steps tried on each mesh, over those whose error is that of the mesh."""


def total_points(
    scene: Scene,
    dt: float,
    t_end: float,
    make: Callable[..., Scene] | None = None,
    budget: float = 120.0,
    say: Callable = print,
) -> tuple[list[Point], Converged]:
    """Points of kind "total": errors of the continuous answer, which trials make first (`jaxshell.advice.converged`).

    Arguments as in `advise`; `budget` is of the answer alone.
    """
    family = Family(scene, make)
    found = converged(family, dt, t_end, KNOWN, budget, say)
    points = []
    for line in lines_of(family, found):
        for member in line.members:
            for step in line.around(member, _AROUND):
                try:
                    tried = line.configuration(step)
                    point = measure(member.scene, tried, found.reference, signals_of=family.signals)
                except ValueError as error:
                    say(f"  {line.label}: {error}")
                    break
                points.append(point)
                say(f"  {point.label}, {member.label}, dt = {step:.3g}: error {point.error:.1e}, {point.seconds:.3g} s")
    return points, found
