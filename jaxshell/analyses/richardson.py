"""The error of an answer by Richardson's extrapolation: over meshes, each half as coarse as the last, and the step.

An analysis is a function of a scene. It runs on a family of meshes, and whatever it gives is extrapolated
(`jaxshell.numerics.extrapolation`): every watched history, every number.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxshell.model.refinement import coarsen, refine
from jaxshell.model.scene import Scene
from jaxshell.numerics.checks import check_count, check_kind, check_positive_number
from jaxshell.numerics.extrapolation import Estimate, estimate
from jaxshell.results.solution import Solution
from jaxshell.scenes import default_divisions

Times = Float[np.ndarray, " k"]
Family = Scene | Sequence[Scene] | Callable[..., Scene]
_SAME = 1e-9
"""Times are one that differ by less than this fraction of the run."""
_FEWEST = 4
"""Times, at least, that runs under step control must share."""


class Richardson(NamedTuple):
    """What levels of a mesh say of its errors, and levels of the step of the step's."""

    elements: tuple[int, ...]
    """Of the meshes, coarse to fine."""
    level: int
    """Which of them is the scene's own."""
    mesh: dict[str, Estimate]
    """Of every quantity over the meshes."""
    step: dict[str, Estimate] | None
    """Of every quantity with the step and half of it, on the scene's mesh; None where it was not asked for."""
    times: Times | None
    """Of histories (k,): the times, or load factors, at which all runs have them; None of other results."""

    def error(self, name: str) -> float:
        """The scene's error by its mesh in a quantity, relative to its largest size; NaN where meshes do not tell."""
        return float(self.mesh[name].errors[self.level])

    def step_error(self, name: str) -> float:
        """The scene's error by its step in a quantity; NaN where it was not asked for."""
        return float("nan") if self.step is None else float(self.step[name].errors[0])

    def __str__(self) -> str:
        meshes = ", ".join(str(count) for count in self.elements)
        lines = (f"{name}: {self.words(name)}" for name in self.mesh)
        return "\n".join([f"meshes of {meshes} triangles", *lines])

    def words(self, name: str) -> str:
        """A quantity's errors in words."""
        words = told(self.mesh[name], self.level)
        return words if self.step is None else f"{words}; step error {percent(self.step_error(name))}"


def richardson(
    family: Family,
    analysis: Callable[[Scene], Any],
    *,
    coarser: int = 1,
    finer: int = 1,
    half_step: Callable[[Scene], Any] | None = None,
    order: float = 2.0,
    step_order: float = 2.0,
) -> Richardson:
    """The errors of an answer, of its mesh and of its step.

    Arguments:
        family: a scene, which is coarsened and refined; a function of the library such as
            `jaxshell.scenes.pinched_cylinder`, whose divisions are halved and doubled; or scenes from coarse to fine,
            the last of which counts as the scene itself.
        analysis: what is done with each scene. It returns a `Solution`, whose watched histories are judged; or {name:
            array}, of which each is judged as one, by its largest distance over its largest size; or an array, of which
            each entry is a quantity of its own, such as frequencies.
        coarser, finer: how many levels on either side of the scene. With one on both sides, or two on one, the order of
            convergence is observed; with two levels in all it is `order`.
        half_step: the same analysis with half the step, for the step's error, on the scene's own mesh.
        order, step_order: of the mesh and of the step, where they are assumed: 2 of this element's displacements and of
            all methods in time but those that dissipate.

    Where levels do not behave as in the asymptotic range (differences that oscillate or grow), errors are NaN, and
    `Estimate.problem` says why: they need finer meshes. Runs under step control are compared at the times that they
    share. Raises ValueError for a scene that cannot be coarsened, for runs that fail, and for results of unlike shapes.
    """
    scenes, level = _levels(family, coarser, finer)
    check_positive_number("order", order)
    check_positive_number("step_order", step_order)
    counts = tuple(scene.mesh.n_elements for scene in scenes)
    results = [
        _checked(analysis(scene), f"the mesh of {count} triangles") for scene, count in zip(scenes, counts, strict=True)
    ]
    times, quantities = _quantities(results)
    # A triangle's size goes with the square root of its area, whatever the divisions are.
    sizes = [count**-0.5 for count in counts]
    mesh = {name: estimate(values, sizes, order) for name, values in quantities.items()}
    if half_step is None:
        return Richardson(counts, level, mesh, None, times)
    pair = [results[level], _checked(half_step(scenes[level]), "half the step")]
    step = {name: estimate(values, [1.0, 0.5], step_order) for name, values in _quantities(pair)[1].items()}
    return Richardson(counts, level, mesh, step, times)


def _levels(family: Family, coarser: int, finer: int) -> tuple[list[Scene], int]:
    """The scenes, coarse to fine, and which is the scene itself."""
    if isinstance(family, Sequence) or not (callable(family) or isinstance(family, Scene)):
        return _stated(family), len(family) - 1
    check_count("coarser", coarser, least=0)
    check_count("finer", finer, least=0)
    if coarser + finer == 0:
        raise ValueError("coarser and finer are both 0: one mesh alone says nothing of its error.")
    if not isinstance(family, Scene):
        return [family(divisions=each) for each in _divisions(family, coarser, finer)], coarser
    scenes = [family]
    for _ in range(coarser):
        scenes.insert(0, coarsen(scenes[0]))
    for _ in range(finer):
        scenes.append(refine(scenes[-1]))
    return scenes, coarser


def _stated(family) -> list[Scene]:
    """Scenes from coarse to fine. Raises ValueError for others."""
    check_kind("family", family, list | tuple, "a jaxshell.Scene, a function that makes one, or a list of scenes")
    for scene in family:
        check_kind("a member of the family", scene, Scene, "a jaxshell.Scene")
    counts = [scene.mesh.n_elements for scene in family]
    if len(counts) < 2 or np.any(np.diff(counts) <= 0):
        raise ValueError(f"family must be two scenes or more, from coarse to fine, but they have {counts} triangles.")
    return list(family)


def _divisions(make: Callable, coarser: int, finer: int) -> list:
    """Of the meshes: the default ones halved and doubled."""
    default = default_divisions(make)
    counts = np.atleast_1d(default)
    if np.any(counts % 2**coarser):
        raise ValueError(
            f"Divisions of {default} cannot be halved {coarser} time{'s' * (coarser > 1)}: give coarser=0 and "
            "finer=2, or the scenes themselves as a list."
        )
    found = [(counts * 2**k // 2**coarser).tolist() for k in range(coarser + finer + 1)]
    return [tuple(each) if isinstance(default, tuple) else each[0] for each in found]


def _checked(result, where: str):
    """A result. Raises ValueError for a run that failed."""
    if isinstance(result, Solution) and result.message:
        raise ValueError(f"The run on {where} failed: {result.message}")
    if isinstance(result, Solution) and not result.watched:
        raise ValueError("The scene watches nothing: give it a watch, or let the analysis return arrays.")
    return result


def _quantities(results: Sequence) -> tuple[Times | None, dict[str, list[np.ndarray]]]:
    """The times of histories, and of every quantity its values on all levels."""
    if isinstance(results[0], Solution):
        times, picked = _shared([np.asarray(run.times) for run in results])
        names = results[0].watched
        return times, {
            name: [np.asarray(run.watched[name])[at] for run, at in zip(results, picked, strict=True)] for name in names
        }
    if isinstance(results[0], Mapping):
        found = {name: [np.asarray(result[name], float) for result in results] for name in results[0]}
    else:
        arrays = [np.asarray(result, float) for result in results]
        _same_shape("The analysis' result", arrays)
        number = [(f"{list(index)}" if index else "value", index) for index in np.ndindex(arrays[0].shape)]
        found = {name: [np.asarray(array[index]) for array in arrays] for name, index in number}
    for name, arrays in found.items():
        _same_shape(name, arrays)
    return None, found


def _same_shape(name: str, arrays: Sequence[np.ndarray]) -> None:
    shapes = [array.shape for array in arrays]
    if len(set(shapes)) > 1:
        raise ValueError(f"{name} must have one shape on all meshes, but it has {', '.join(map(str, shapes))}.")


def _shared(times: Sequence[np.ndarray]) -> tuple[Times, list[np.ndarray]]:
    """The times that all runs have, and where each has them."""
    tolerance = _SAME * max(1e-300, float(np.abs(times[0]).max(initial=0.0)))
    shared = times[0]
    for other in times[1:]:
        near = np.abs(shared[:, None] - other).min(axis=1)
        shared = shared[near <= tolerance]
    if len(shared) < min(_FEWEST, *map(len, times)):
        raise ValueError(
            f"The runs have only {len(shared)} times in common: give all of them the same dt, or a StepControl with "
            "output_interval, or the same load factors."
        )
    return shared, [np.abs(own[:, None] - shared).argmin(axis=0) for own in times]


def told(found: Estimate, level: int) -> str:
    """What an estimate says of the error of one of its levels."""
    if found.problem:
        return f"mesh error unknown, meshes differ by {percent(found.uncertainty)}: {found.problem}"
    known = f"mesh error {percent(found.errors[level])}"
    if len(found.values) == 2:
        return f"{known}, by two meshes"
    order = "" if found.order is None else f", order {found.order:.2g}"
    return f"{known}{order}, limit known to {percent(found.uncertainty)}"


def percent(part: float) -> str:
    """A fraction in words."""
    return f"{100 * part:.2g} %"
