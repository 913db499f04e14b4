"""What `jaxshell run` runs, and how: from the command line first, then the scene's or result file, then defaults."""

import argparse
import dataclasses
import math
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxshell.files.run_keys import ANALYSES, KEYS, METHOD_KEYS, STEP_KEYS, RunSettings
from jaxshell.numerics.nearest import meant

_RESULT_FILES = (".h5", ".hdf5")
SMALL = 500
"""Elements below which XLA's second thread costs more than it brings (docs/performance.md, "Size and threads")."""


def one_thread_for_small_meshes(name: str, divisions: Sequence[int] | None = None) -> None:
    """Let XLA have one thread where the scene is small; NPROC in the environment says otherwise.

    To be called before JAX starts: without effect in a process that has imported it.
    """
    if "jax" not in sys.modules and 0 < _about_as_many_elements(name, divisions) < SMALL:
        os.environ.setdefault("NPROC", "1")


def _about_as_many_elements(name: str, divisions: Sequence[int] | None) -> int:
    """Elements of a scene, estimated from its divisions, without an array of JAX's; 0 where they are not known."""
    path = Path(name)
    try:
        if path.suffix in _RESULT_FILES:
            import h5py

            with h5py.File(path) as file:
                return len(file["scene/mesh/connectivity"])  # pyright: ignore[reportArgumentType]
        if path.suffix == ".toml":
            import tomllib

            content = tomllib.loads(path.read_text(encoding="utf-8"))
            if "adapt" in content.get("run", {}):
                return 0
            found = content["mesh"]["divisions"]
        else:
            from jaxshell.scenes import BY_NAME, default_divisions

            found = divisions or default_divisions(BY_NAME[name])
        counts = [found] if isinstance(found, int) else [*found]
        return 2 * math.prod(counts if len(counts) > 1 else 2 * counts)
    except (AttributeError, KeyError, OSError, OverflowError, RecursionError, TypeError, ValueError):
        return 0  # What is wrong with it is said when the scene is made.


def open_scene(name: str, divisions: Sequence[int] | None = None):
    """(scene, [run] settings, stem of files to write) of a scene's name, a scene file or a result file."""
    from jaxshell.scenes import BY_NAME

    path = Path(name)
    if name in BY_NAME and divisions is not None:
        return BY_NAME[name](divisions=_counts(name, divisions)), RunSettings(), name
    if name in BY_NAME:
        return BY_NAME[name](), RunSettings(), name
    if divisions is not None:
        raise ValueError(f"--divisions is for the library's scenes ({', '.join(BY_NAME)}), not for files: {name!r}.")
    if path.suffix == ".toml":
        from jaxshell.files.scene_file import read_scene_file

        return *read_scene_file(path), path.stem
    if path.suffix in _RESULT_FILES:
        from jaxshell.results.hdf5 import read_scene, read_settings

        # Under another name, so that the results that are run again stay.
        return read_scene(path), RunSettings.from_result_file(read_settings(path)), f"{path.stem}_rerun"
    raise ValueError(
        f"There is no scene {name!r}.{meant(name, BY_NAME)} Choose out of {', '.join(BY_NAME)}, or name a .toml scene "
        "file or an .h5 result file."
    )


def _counts(name: str, divisions: Sequence[int]):
    """Divisions as the scene's function wants them: one number, or as many as its default has."""
    from jaxshell.scenes import BY_NAME, default_divisions

    default = default_divisions(BY_NAME[name])
    if min(divisions) < 1:
        raise ValueError(f"--divisions must be whole numbers of at least 1, but are {' '.join(map(str, divisions))}.")
    count = len(default) if isinstance(default, tuple) else 1
    if len(divisions) != count:
        raise ValueError(f"The scene {name!r} takes {count} divisions, but {len(divisions)} are given.")
    return tuple(divisions) if count > 1 else divisions[0]


def settled(options: argparse.Namespace, of_file: RunSettings, scene) -> RunSettings:
    """What the command line says, else the file, else the scene; dt, t_end and save_every are said then.

    A method on the command line comes with its own parameters, and an analysis without the file's keys for another. A
    dt on the command line takes the place of the step control that a result file's run was made with. Raises ValueError
    for what is given on the command line and does not fit the analysis.
    """
    given = RunSettings.from_command_line(options)
    analysis = given.analysis or of_file.analysis or ANALYSES[0]
    if analysis != (of_file.analysis or ANALYSES[0]):
        # Times of pictures, and steps between frames, say nothing about load factors.
        of_file = dataclasses.replace(of_file.fitting(analysis), picture_times=(), save_every=None)
        if Path(options.scene).suffix in _RESULT_FILES:  # which quote all of the iteration
            of_file = of_file.without(*(key for key in KEYS if key.startswith("newton_")))
    dataclasses.replace(given, analysis=analysis).check_analysis()
    if given.load_steps is not None or given.load_factors is not None:
        of_file = of_file.without("load_steps", "load_factors")
    if given.method is not None:
        of_file = of_file.without(*METHOD_KEYS)
    if given.dt is not None and given.step_tolerance is None and Path(options.scene).suffix in _RESULT_FILES:
        of_file = of_file.without("step_tolerance", *STEP_KEYS)
    return with_defaults(of_file | given, scene, analysis)


def with_defaults(settings: RunSettings, scene, analysis: str) -> RunSettings:
    """What the settings say, else the scene."""
    of_scene = _of_scene(scene) if analysis == ANALYSES[0] else RunSettings()
    return (RunSettings(save_every=1) | of_scene | settings).fitting(analysis)


def first_step(options: argparse.Namespace, of_file: RunSettings, scene) -> float:
    """dt of a command that takes no other key."""
    return required(_of_scene(scene) | of_file | RunSettings.checked({"dt": options.dt}), "dt")


def _of_scene(scene) -> RunSettings:
    return RunSettings.checked(
        {key: getattr(scene.defaults, key, None) for key in ("method", "dt", "t_end", "save_every")}
    )


def with_picture_times(scene, settings: RunSettings):
    """The scene, drawn at the times of the settings where they say any."""
    from jaxshell.model.scene import Defaults

    if settings.picture_times is None:
        return scene
    defaults = scene.defaults or Defaults()
    return dataclasses.replace(scene, defaults=defaults._replace(picture_times=settings.picture_times))


def required(settings: RunSettings, key: str) -> Any:
    """A setting that must be said. Raises ValueError where it is not."""
    value = getattr(settings, key)
    if value is None:
        raise ValueError(f"The scene gives no {key}: add --{key.replace('_', '-')}, or {key} in the file's [run].")
    return value


def chosen_methods(settings: RunSettings, scene) -> dict[str, Any]:
    """{label: method}."""
    from jaxshell.command.method_names import choose_methods

    parameters = {key: getattr(settings, key) for key in METHOD_KEYS if getattr(settings, key) is not None}
    return choose_methods(scene, settings.method or (), parameters)


def arguments_of_simulate(settings: RunSettings) -> dict[str, Any]:
    """What the settings say besides the method and t_end, as arguments of `simulate`."""
    from jaxshell.analyses.step_control import StepControl

    dt: Any = required(settings, "dt")
    stray = [key for key in STEP_KEYS if getattr(settings, key) is not None]
    if settings.step_tolerance is None and stray:
        raise ValueError(f"{stray[0]} is of step control, which step_tolerance switches on.")
    if settings.step_tolerance is not None:
        dt = StepControl(settings.step_tolerance, initial=dt, **_of(settings, "step_", skip="tolerance"))
    return {"dt": dt, "reactions": bool(settings.reactions), **solvers_of(settings)}


def solvers_of(settings: RunSettings, newton=None) -> dict[str, Any]:
    """What every analysis that goes step by step is solved with; `newton` is the one that settings are changes of."""
    from jaxshell.solvers import linear_solver
    from jaxshell.solvers.newton import Newton

    solvers = {"pardiso": linear_solver.Pardiso, "klu": linear_solver.KLU, "dense": linear_solver.Dense}
    return {
        "save_every": settings.save_every,
        "tangent": settings.tangent or "closed_form",
        "newton": dataclasses.replace(newton or Newton(), **_of(settings, "newton_")),
        "linear_solver": None if settings.linear_solver is None else solvers[settings.linear_solver](),
    }


def kernels_of(settings: RunSettings):
    """The context in which the settings' kernels are made. Raises ImportError where this machine cannot."""
    from jaxshell.numerics.kernels import kernels

    return kernels(settings.kernels or "xla")


def _of(settings: RunSettings, prefix: str, skip: str = "") -> dict[str, Any]:
    """The keys with a prefix, without it."""
    said = {key.removeprefix(prefix): value for key, value in settings.said().items() if key.startswith(prefix)}
    said.pop(skip, None)
    return said


def solution_to_go_on_from(options: argparse.Namespace):
    """The run in the result file that `--continue` goes on with. Raises ValueError where it cannot."""
    from jaxshell.results.durable import in_use
    from jaxshell.results.solution import Solution

    if Path(options.scene).suffix not in _RESULT_FILES:
        raise ValueError(f"--continue goes on from a result file (.h5), but the scene is {options.scene!r}.")
    if options.method:
        raise ValueError("--continue goes on with the method of the file: leave --method out.")
    solution = Solution.load(options.scene)
    if in_use(options.scene):
        raise ValueError(f"{options.scene} is in use: the run that writes it goes on.")
    if solution.state is None:
        raise ValueError(f"{options.scene} holds no state to go on from: it is of statics, or of an older version.")
    return solution


def what_is_left(restart, t_end: float) -> float:
    """The rest of a run that was to go on to the time `t_end`. Raises ValueError where there is none."""
    from jaxshell.results.restart import time_of

    reached = time_of(restart.state)
    if t_end - reached <= 1e-9 * t_end:
        raise ValueError(
            f"The run has reached its end, t = {reached:.6g}: say with --t-end for how much longer it is to go on."
        )
    left = t_end - reached
    # The rest that leads to the end to the last bit: so the last step is the one that the run was to take.
    near = (math.nextafter(left, 0.0), left, math.nextafter(left, math.inf))
    return float(min(near, key=lambda rest: abs(reached + rest - t_end)))
