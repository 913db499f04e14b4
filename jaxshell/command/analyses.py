"""What `jaxshell run` runs besides motions: statics, arc length, natural frequencies, linear buckling."""

import argparse
import contextlib
import dataclasses
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

from jaxshell.command.outputs import outputs, say_besides
from jaxshell.command.run_settings import solvers_of
from jaxshell.files.run_keys import RunSettings
from jaxshell.numerics.signals import exit_status

_COUNTS = {"modes": 10, "buckling": 5}
"""How many are sought where nothing is said: those of the functions, or fewer where the scene has fewer."""
_PRELOAD_STEPS = 10


def run_analysis(options: argparse.Namespace, settings: RunSettings, scene, stem: str) -> int:
    """Run the settings' analysis of a scene; write its results and pictures. Returns the exit status."""
    from jaxshell.command.report import describe_scene

    if options.go_on:
        raise ValueError(
            f'--continue goes on with a run in time, but the analysis is "{settings.analysis}": run it again without.'
        )
    if options.vtkhdf and settings.analysis in _COUNTS:
        raise ValueError(
            f'--vtkhdf is for runs in time, "static" and "arc-length", but the analysis is "{settings.analysis}": mode '
            "shapes are drawn as pictures, and jaxshell.Modes.load and jaxshell.BucklingModes.load read them."
        )
    options.output.mkdir(parents=True, exist_ok=True)
    say = (lambda *_: None) if options.quiet else print
    say(describe_scene(scene))
    path = options.output / f"{stem}.h5"
    run = _eigenmodes if settings.analysis in _COUNTS else _equilibria
    try:
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always", UserWarning)
            status, draw = run(options, settings, scene, path, say)
    except KeyboardInterrupt as stopped:
        kept = f"{path} holds what was computed until then" if _written(settings, path) else "nothing was written"
        print(f"jaxshell: stopped; {kept}.", file=sys.stderr)
        return exit_status(stopped)
    for warning in told:
        print(f"jaxshell: {warning.message}", file=sys.stderr)
    if not options.no_plots:
        for picture in draw(options.output, stem):
            say(f"  {picture}")
    return status


def _written(settings: RunSettings, path: Path) -> bool:
    return settings.analysis not in _COUNTS and path.exists()


def path_analysis(settings: RunSettings) -> tuple[Callable, dict[str, Any]]:
    """The function of statics or of arc length, and its arguments."""
    from jaxshell.analyses import arc_length, statics

    solve, own = arc_length.solve_arc_length, ("arc_length", "max_load_factor")
    if settings.analysis == "static":
        solve, own = statics.solve_static, ("load_factors", "branch")
    asked: dict[str, Any] = {key: value for key, value in settings.said().items() if key in own}
    if settings.load_steps is not None:
        asked["load_factors"] = _steps_to(1.0, settings.load_steps)
    if settings.max_steps is not None:
        asked["steps"] = settings.max_steps
    return solve, asked | solvers_of(settings, statics.DEFAULT_NEWTON)


def _equilibria(options, settings: RunSettings, scene, path: Path, say) -> tuple[int, Callable]:
    """Statics, by load steps or by arc length."""
    from jaxshell.command.path_report import NAMES, describe_path
    from jaxshell.command.pictures import PicturesAhead
    from jaxshell.results.solution import RESULTS

    solve, asked = path_analysis(settings)
    ahead = PicturesAhead(wanted=not options.no_plots)
    solution = solve(
        scene,
        **asked,
        throw=False,
        progress=sys.stderr.isatty() and not options.quiet,
        output=outputs(path, options, ahead),
    )
    if not options.quiet:
        say(describe_path(solution, path))
    say_besides(path, options, say)
    failed = not bool(solution.result == RESULTS.successful)
    if failed:
        print(f"jaxshell: {settings.analysis} failed. {solution.message}", file=sys.stderr)
    elif settings.errors:
        _say_errors(scene, solution, lambda other: solve(other, **asked, throw=False), say)
    runs = {NAMES[str(settings.analysis)]: solution}

    def draw(folder: Path, stem: str):
        ahead.wait()
        from jaxshell.plotting import plot

        return plot(runs, folder, stem, contours_of(settings, scene))

    return int(failed), draw


def contours_of(settings: RunSettings, scene) -> tuple[str, ...]:
    """What shapes are coloured by besides, where errors are asked for."""
    from jaxshell.command.errors import CONTOUR

    return (CONTOUR,) if settings.errors and scene.mesh.n_elements else ()


def _say_errors(scene, found, again: Callable, say) -> None:
    """Of the mesh; these analyses have no step that errs."""
    from jaxshell.command.errors import describe_errors

    for line in describe_errors(scene, found, again, None, say):
        say(line)


def _eigenmodes(options, settings: RunSettings, scene, path: Path, say) -> tuple[int, Callable]:
    """Natural frequencies, or linear buckling factors."""
    from jaxshell.command.path_report import describe_modes
    from jaxshell.plotting.modes import plot_modes
    from jaxshell.results.eigenmodes import Eigenmodes, EigenmodesFile

    kind = str(settings.analysis)
    count = settings.count or min(_COUNTS[kind], max(1, 6 * scene.mesh.n_nodes - len(scene.held_dofs) - 2))
    with contextlib.closing(EigenmodesFile(path, options.overwrite)) as file:
        begun = time.perf_counter()
        try:
            found = Eigenmodes(kind, scene, *_found(settings, scene, count))
        except RuntimeError as error:
            print(f"jaxshell: {kind} failed. {error}", file=sys.stderr)
            return 1, lambda folder, stem: ()
        seconds = time.perf_counter() - begun
        file.write(found, dataclasses.replace(settings, count=count).said(), {"wall_time": seconds})
    say(describe_modes(found, seconds, path))
    if settings.errors:

        def values(scene, known=None) -> dict[str, Any]:
            numbers = _found(settings, scene, count)[0] if known is None else known
            return {f"mode {k}": value for k, value in enumerate(numbers, 1)}

        _say_errors(scene, values(scene, found.values), values, say)
    return 0, lambda folder, stem: plot_modes(found, folder, stem)


def _found(settings: RunSettings, scene, count: int):
    """(values, shapes) of the modes. Raises RuntimeError where they, or the equilibrium before, are not found."""
    from jaxshell.analyses.modal import linear_buckling, natural_frequencies
    from jaxshell.analyses.statics import solve_static

    if settings.analysis == "buckling":
        buckling = linear_buckling(scene, count)
        return buckling.load_factors, buckling.shapes
    about = None
    if settings.preload is not None:
        if settings.preload == 0:
            raise ValueError("preload must not be zero: leave it out for the state at the start.")
        factors = _steps_to(settings.preload, _PRELOAD_STEPS)
        about = solve_static(scene, factors, save_every=_PRELOAD_STEPS)
    chosen = {} if settings.inertia is None else {"inertia": settings.inertia}
    modes = natural_frequencies(scene, count, about, rigid_modes=settings.rigid_modes is not False, **chosen)
    return modes.frequencies, modes.shapes


def _steps_to(factor: float, count: int) -> list[float]:
    """Equal load steps to a load factor."""
    return [factor * step / count for step in range(1, count + 1)]
