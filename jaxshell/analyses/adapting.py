"""`adapt`: analyse, estimate, bisect where the error comes from, until what is left of it is small enough.

The error of the mesh in every element is the energy η² of its recovered less its computed section forces, of moments by
half (`jaxshell.results.mesh_errors`). A goal J weighs it: an element with an error e = η²/(U + η²) of its own energy U
counts as one whose stiffness C is so much in error, and changes the goal by

    |dJ/d ln C| e,

with all derivatives from one reverse pass through the analysis. In linear statics that is ∫ σ_u C⁻¹ σ_z dA e, with the
adjoint z of the goal: the dual-weighted residual, estimated by the element's energies. Of the energy itself it is η².

Recovered energies see where the error is, but not all of how large it is in the goal: the plate's element is no Ritz
method; its deflections are better than its moments, or too soft. So the sum η of them is the measure by which the goal
V is extrapolated,

    V∞ - V ≈ κ η,   κ = |V - V'| / (η' - η)

from the mesh before (V', η') to this. κ begins with 1 and falls to no less than half from mesh to mesh, lest a goal
that turns back on its way seem right; and where η did not fall the goal errs by no less than it changed.
"""

import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxshell.analyses.statics import solve_static
from jaxshell.model.corner_normals import CREASE
from jaxshell.model.gauge import gauge_of
from jaxshell.model.refinement.refined import refined_once
from jaxshell.model.scene import Scene
from jaxshell.model.sections.scaled import scaled
from jaxshell.model.surface import TrueSurface
from jaxshell.numerics.checks import check_choice, check_count, check_kind, check_within, is_concrete, require_float64
from jaxshell.results.mesh_errors import deflection_errors
from jaxshell.results.solution import Solution

HALVINGS = 2
"""How often what is chosen is bisected: its edges are halved."""
_TELLS = 0.1
"""Part of the recovered error that a round must have removed for what changed with it to say how large the rest is."""

HEADING = f"{'elements':>9} {'unknowns':>9} {'value':>13} {'error':>8}"
"""Of rounds as text."""

Goal = Callable[[Solution], Any]


class Round(NamedTuple):
    """One mesh of `adapt`."""

    elements: int
    unknowns: int
    value: float
    """Of the goal; without one the strain energy, of runs in time the mean over frames."""
    recovered: float
    """Its relative error as recovered section forces say."""
    estimate: float
    """The same as the mesh before corrects it; of the first mesh it is not."""

    def __str__(self) -> str:
        return f"{self.elements:9d} {self.unknowns:9d} {self.value:13.6g} {self.estimate:8.2%}"


class Adapted(NamedTuple):
    """What `adapt` ends with."""

    scene: Scene
    """On the last mesh."""
    solution: Solution
    rounds: tuple[Round, ...]
    met: bool
    """Whether the estimate came within the tolerance."""
    message: str
    """Why not; empty where it did."""

    def __str__(self) -> str:
        return "\n".join([HEADING, *map(str, self.rounds), self.message or "within the tolerance"])


def adapt(
    scene: Scene,
    tolerance: float,
    *,
    analysis: Callable[[Scene], Solution] | None = None,
    goal: Goal | str | None = None,
    bulk: float = 0.5,
    rounds: int = 12,
    most_elements: int = 20_000,
    surface: TrueSurface | str | None = None,
    crease: float = CREASE,
    report: Callable[[Round], Any] | None = None,
) -> Adapted:
    """Refine a scene's mesh where its errors come from, until the answer is within a tolerance.

    Arguments:
        scene: the scene on its first mesh, which is as coarse as it tells the shape and the loads.
        tolerance: relative error of the goal, between 0 and 1.
        analysis: what is done with each scene; it returns its `Solution`. None is `solve_static`. Of statics the last
            frame counts, of runs in time all frames do, each as much.
        goal: what must be right: the label of what is watched, at the end of the run (its error is over the largest
            size that it has in the run), or a function of the `Solution` that gives one number; the analysis is then
            differentiated once for each mesh. A gauge is none: it is where its element is, and cut with it. None: the
            strain energy, in statics under loads that are not prescribed displacements also the work of the loads, and
            so the deflection under a single force.
        bulk: the elements with the largest errors are bisected that together have this part of all.
        rounds: meshes, at most.
        most_elements: no mesh has more.
        surface, crease: where new nodes go, as in `refine`.
        report: called with every round when it is done, `print` for one.

    Every mesh is another program to compile: a few good rounds cost less than many small ones. Where the tolerance is
    not met there is a warning, and `met` and `message` say so. docs/adapting.md shows what the estimate is worth.
    Raises ValueError for bad input and what `refine` cannot carry over, and what the analysis raises.
    """
    require_float64()
    check_kind("scene", scene, Scene, "a jaxshell.Scene")
    check_within("tolerance", tolerance, 0.0, 1.0)
    check_within("bulk", bulk, 0.0, 1.0)
    check_count("rounds", rounds)
    check_count("most_elements", most_elements)
    function = goal_of(scene, goal)
    analysis = solve_static if analysis is None else analysis
    done: list[Round] = []
    factor, recovered, split = 1.0, 0.0, None
    while True:
        solution = analysis(scene)
        check_kind("what analysis returns", solution, Solution, "a jaxshell.Solution")
        if solution.message:
            return _ended(scene, solution, done, f"The analysis failed: {solution.message}")
        value, shares, scale = _errors(scene, solution, analysis, function, goal)
        before, recovered = recovered, float(shares.sum())
        changed = value - done[-1].value if done else 0.0
        factor = corrected(factor, changed, before - recovered, before) if done else factor
        relative = recovered / scale if scale else 0.0
        estimate = max(factor * recovered, least(changed, before - recovered, before)) / scale if scale else 0.0
        done.append(Round(scene.mesh.n_elements, _unknowns(scene), value, relative, estimate))
        if report is not None:
            report(done[-1])
        if len(done) > 1 and done[-1].estimate <= tolerance:
            return Adapted(scene, solution, tuple(done), True, "")
        if len(done) == rounds:
            return _ended(scene, solution, done, f"{rounds} meshes were not enough: raise rounds.")
        if not recovered:
            return _ended(scene, solution, done, "The section forces show no error, and no element to refine.")
        finer, split = _bisected(scene, chosen(shares, bulk), split, surface, crease)
        if finer.mesh.n_elements > most_elements:
            text = f"The next mesh would have {finer.mesh.n_elements} elements: raise most_elements."
            return _ended(scene, solution, done, text)
        scene = finer


def corrected(factor: float, changed: float, removed: float, before: float) -> float:
    """κ after a round that changed the goal, and removed a part of the recovered error that was there before.

    Where too little was removed to tell it stays; of the first mesh it is 1.
    """
    if removed <= _TELLS * before:
        return factor
    return max(abs(changed) / removed, 0.5 * factor)


def least(changed: float, removed: float, before: float) -> float:
    """What the error is at least taken for: where too little was removed to tell what the goal's change came of, all of
    it."""
    return abs(changed) if removed <= _TELLS * before else 0.0


def chosen(shares: np.ndarray, bulk: float) -> np.ndarray:
    """Numbers of the fewest elements that together have the part `bulk` of all shares (W. Dörfler, SIAM J. Numer. Anal.
    33 (1996) 1106-1124)."""
    order = np.argsort(-shares, kind="stable")
    sums = np.cumsum(shares[order])
    return np.sort(order[: int(np.searchsorted(sums, bulk * sums[-1])) + 1])


def _bisected(scene: Scene, elements: np.ndarray, split, surface, crease: float):
    for _ in range(HALVINGS):
        scene, split = refined_once(scene, elements, split, surface, crease)
        elements = split.elements(elements)
    return scene, split


def _ended(scene: Scene, solution: Solution, done: list[Round], message: str) -> Adapted:
    if done:
        message = f"The error is estimated at {done[-1].estimate:.2g} with {done[-1].elements} elements. {message}"
    warnings.warn(message, stacklevel=3)
    return Adapted(scene, solution, tuple(done), False, message)


def _unknowns(scene: Scene) -> int:
    return 6 * scene.mesh.n_nodes - len(scene.held_dofs)


def goal_of(scene: Scene, goal: Goal | str | None) -> Goal | None:
    """The goal as a function of the solution. Raises ValueError for a label that is not watched, and for a gauge."""
    if not isinstance(goal, str):
        if goal is not None and not callable(goal):
            raise ValueError(f"goal must be a label or a function of the Solution, but it is {goal!r}.")
        return goal
    watched = {label: component for label, _, component in scene.watch}
    check_choice("goal", goal, tuple(watched))
    if gauge_of(watched[goal]) is not None:
        raise ValueError(
            f"goal {goal!r} is a gauge, which is where its element is, and goes elsewhere when that is cut. Give a "
            "function of the Solution that takes the stress at a place."
        )
    return lambda solution: solution.watched[goal][-1]


def _errors(scene: Scene, solution: Solution, analysis, function: Goal | None, goal):
    """The goal's value, (m,) what the elements add to its error, and the size to which that is compared."""
    frames = len(solution.frame_times)
    which: Any = [frames - 1] if solution.analysis == "static" else list(range(1, frames))
    errors = deflection_errors(solution, which)
    energy, strain_energy = (np.asarray(jnp.mean(part, axis=0)) for part in (errors.energy, errors.strain_energy))
    if function is None:
        value = float(strain_energy.sum())
        return value, energy, value + float(energy.sum())
    whole = energy + strain_energy
    relative = np.where(whole > 0, energy / np.where(whole > 0, whole, 1.0), 0.0)

    def of_factors(factors):
        softer = eqx.tree_at(lambda s: s.section, scene, scaled(scene.section, factors))
        found = analysis(softer)
        # A goal of stresses means those of the shell's own section.
        return function(eqx.tree_at(lambda s: s.scene, found, scene))

    value = function(solution)
    if np.shape(value) != () or not is_concrete(value):
        raise ValueError(f"goal must give one number, but it gives an array of shape {np.shape(value)}.")
    weights = np.asarray(jax.grad(of_factors)(jnp.ones(scene.mesh.n_elements)))
    if not np.all(np.isfinite(weights)):
        raise RuntimeError(
            "The derivatives of the goal are not finite: traced by jax.grad, the analysis fails. Statics then take the "
            "load factors as they are given: give more of them."
        )
    size = jnp.max(jnp.abs(solution.watched[goal])) if isinstance(goal, str) else jnp.abs(value)
    return float(value), np.abs(weights) * relative, float(size)
