"""What `jaxshell run --adapt` does before a run: it looks for the mesh that the run is to be made on."""

import argparse
import contextlib
import functools
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxshell.command.analyses import path_analysis
from jaxshell.command.outputs import outputs
from jaxshell.command.run_settings import arguments_of_simulate, chosen_methods, required
from jaxshell.files.run_keys import ANALYSES, RunSettings

if TYPE_CHECKING:
    from jaxshell.model.scene import Scene


def adapted(options: argparse.Namespace, settings: RunSettings, scene: "Scene", stem: str) -> "tuple[Scene, bool]":
    """The scene on the last mesh of `adapt`, and whether that is within the tolerance; said is a line for each mesh.

    What is run on the way is not written: a result file says how its run was asked for and holds it from its first step
    on, so the last mesh is run as any other scene. That costs a run, and no compilation. Raises ValueError for settings
    that do not go together, and where the files of the run could not be written.
    """
    from jaxshell.analyses.adapting import HEADING, adapt
    from jaxshell.command.report import describe_scene

    if options.go_on:
        raise ValueError("--continue goes on on the mesh that the run was made with: leave --adapt and --goal out.")
    analysis = _analysis(settings, scene)
    _check_place(options, scene, stem)
    say = (lambda *_: None) if options.quiet else lambda line: print(line, flush=True)
    say(describe_scene(scene))
    goal, tolerance = settings.goal, required(settings, "adapt")
    say(f"  adapting to {100 * tolerance:.3g} % of {goal or 'the strain energy'}\n  {HEADING}")
    with warnings.catch_warnings():
        # The run on the last mesh says again what there is to say, and the message why the tolerance was not met.
        warnings.simplefilter("ignore", UserWarning)
        found = adapt(scene, tolerance, analysis=analysis, goal=goal, report=lambda mesh: say(f"  {mesh}"))
    if found.met:
        say("  within the tolerance")
    else:
        print(f"jaxshell: the mesh is not within the tolerance. {found.message}", file=sys.stderr)
    return found.scene, found.met


def check_adapting(settings: RunSettings, scene: "Scene") -> None:
    """Raise ValueError naming what of the settings does not go together with `adapt`."""
    from jaxshell.analyses.adapting import goal_of
    from jaxshell.numerics.checks import check_within

    if settings.adapt is None:
        raise ValueError("goal says what adapt is to get right: give adapt, a tolerance, too.")
    check_within("adapt", settings.adapt, 0.0, 1.0)
    goal_of(scene, settings.goal)
    if settings.analysis != ANALYSES[0]:
        return
    if settings.goal is not None and settings.step_tolerance is not None:
        raise ValueError(
            "goal needs a run that can be differentiated, with a number of steps that is known: leave step_tolerance "
            "out, or goal."
        )
    methods = chosen_methods(settings, scene)
    if len(methods) > 1:
        raise ValueError(f"adapt makes the mesh of one method, but {', '.join(methods)} are asked for: choose one.")


def _analysis(settings: RunSettings, scene: "Scene") -> "Callable[[Scene], Any]":
    """What is done with each mesh. Raises ValueError as `check_adapting`."""
    from jaxshell.analyses.simulation import simulate

    check_adapting(settings, scene)
    if settings.analysis == ANALYSES[0]:
        (method,) = chosen_methods(settings, scene).values()
        t_end, asked = required(settings, "t_end"), arguments_of_simulate(settings)
        run = functools.partial(simulate, method=method, t_end=t_end, **asked, throw=False)
    else:
        solve, arguments = path_analysis(settings)
        run = functools.partial(solve, **arguments, throw=False)

    def analysis(each: "Scene"):
        try:
            return run(each)
        except ValueError as error:
            if each.mesh.n_elements == scene.mesh.n_elements:
                raise
            raise ValueError(f"On the mesh of {each.mesh.n_elements} elements: {error}") from error

    return analysis


def _check_place(options: argparse.Namespace, scene: "Scene", stem: str) -> None:
    """Raise ValueError, or OSError, where what is to be written at the end could not be."""
    options.output.mkdir(parents=True, exist_ok=True)
    for output in outputs(Path(options.output) / f"{stem}.h5", options):
        with contextlib.closing(output):
            output.begin(scene, {})
