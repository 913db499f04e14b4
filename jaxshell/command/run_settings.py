"""What `jaxshell run` runs, and how: from the command line first, then the scene's or result file, then defaults."""

import argparse
import dataclasses
import math
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

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

            found = tomllib.loads(path.read_text(encoding="utf-8"))["mesh"]["divisions"]
        else:
            from jaxshell.scenes import BY_NAME, default_divisions

            found = divisions or default_divisions(BY_NAME[name])
        counts = [found] if isinstance(found, int) else [*found]
        return 2 * math.prod(counts if len(counts) > 1 else 2 * counts)
    except (KeyError, OSError, TypeError, ValueError):
        return 0  # What is wrong with it is said when the scene is made.


def open_scene(name: str, divisions: Sequence[int] | None = None):
    """(scene, [run] settings, stem of files to write) of a scene's name, a scene file or a result file."""
    from jaxshell.scenes import BY_NAME

    path = Path(name)
    if name in BY_NAME and divisions is not None:
        return BY_NAME[name](divisions=_counts(name, divisions)), {}, name
    if name in BY_NAME:
        return BY_NAME[name](), {}, name
    if divisions is not None:
        raise ValueError(f"--divisions is for the library's scenes ({', '.join(BY_NAME)}), not for files: {name!r}.")
    if path.suffix == ".toml":
        from jaxshell.files.scene_file import read_scene_file

        return *read_scene_file(path), path.stem
    if path.suffix in _RESULT_FILES:
        from jaxshell.results.hdf5 import read_scene, read_settings

        # Under another name, so that the results that are run again stay.
        return read_scene(path), _as_in_scene_files(read_settings(path)), f"{path.stem}_rerun"
    raise ValueError(
        f"There is no scene {name!r}. Choose out of {', '.join(BY_NAME)}, or name a .toml scene file "
        "or an .h5 result file."
    )


def _as_in_scene_files(settings: dict) -> dict:
    """A result file's settings by the names that [run] has; Newton and step control as objects."""
    from jaxshell.analyses.step_control import StepControl
    from jaxshell.files.quoted import unquote
    from jaxshell.solvers.newton import Newton

    quoted = settings.get("method", "")
    if quoted.startswith("Static("):
        return {}  # Nothing of it fits a run in time.
    found = {key: value for key, value in settings.items() if key != "method"} | {"quoted_method": quoted}
    if "newton" in settings:
        found["made_newton"] = unquote(settings["newton"], {"Newton": Newton})
    if isinstance(settings.get("dt"), str):
        control = unquote(settings["dt"], {"StepControl": StepControl})
        found |= {"made_control": control, "dt": control.initial}
    return found


def _counts(name: str, divisions: Sequence[int]):
    """Divisions as the scene's function wants them: one number, or as many as its default has."""
    from jaxshell.scenes import BY_NAME, default_divisions

    default = default_divisions(BY_NAME[name])
    count = len(default) if isinstance(default, tuple) else 1
    if len(divisions) != count:
        raise ValueError(f"The scene {name!r} takes {count} divisions, but {len(divisions)} are given.")
    return tuple(divisions) if count > 1 else divisions[0]


def wanted(options: argparse.Namespace, settings: dict, scene, key: str):
    """A setting: from the command line, else from the file, else the scene's default."""
    for value in (getattr(options, key), settings.get(key), getattr(scene.defaults, key, None)):
        if value is not None:
            return value
    if key == "save_every":
        return 1
    raise ValueError(f"The scene gives no {key}: add --{key.replace('_', '-')}, or {key} in the file's [run].")


def chosen_methods(options: argparse.Namespace, settings: dict, scene) -> dict[str, Any]:
    """{label: method}; parameters and inertia given on the command line replace the file's."""
    from jaxshell.command.method_names import choose_methods, method_label, parse_method

    names = options.method or settings.get("method", [])
    names = [names] if isinstance(names, str) else names
    keys = ("spectral_radius", "dissipation")
    given = {key: getattr(options, key) for key in keys if getattr(options, key) is not None}
    if "quoted_method" in settings and not options.method:
        method = parse_method(settings["quoted_method"])
        for key in given:
            if not hasattr(method, key):
                raise ValueError(f"The file's method, {type(method).__name__}, has no {key}.")
        method = dataclasses.replace(method, **given)
        methods = {method_label(method, scene): method}
    else:
        own = {} if options.method else {key: settings[key] for key in keys if key in settings}
        given = dict.fromkeys(keys) | own | given
        methods = choose_methods(scene, names, **given)
    form = options.inertia or settings.get("inertia")
    return {label: _with_inertia(label, method, form) for label, method in methods.items()}


def _with_inertia(label: str, method, form: str | None):
    if form is None:
        return method
    if not hasattr(method, "inertia"):
        raise ValueError(f"The method {label!r} has no choice of inertia.")
    return dataclasses.replace(method, inertia=form)


def step_control(options: argparse.Namespace, settings: dict, dt: float):
    """Step control that starts with `dt`, where the command line or the file asks for it, else None."""
    from jaxshell.analyses.step_control import StepControl

    tolerance = options.step_tolerance or settings.get("step_tolerance")
    if tolerance is not None:
        return StepControl(tolerance, initial=dt)
    return settings.get("made_control") if options.dt is None else None


def chosen_newton(options: argparse.Namespace, settings: dict):
    """Newton with what the command line, else the file, says of it."""
    from jaxshell.solvers.newton import Newton

    given = {}
    for name, key in (("tolerance", "newton_tolerance"), ("reuse", "newton_reuse")):
        value = getattr(options, key) if getattr(options, key) is not None else settings.get(key)
        if value is not None:
            given[name] = value
    return dataclasses.replace(settings.get("made_newton") or Newton(), **given)


def solution_to_go_on_from(options: argparse.Namespace):
    """The run in the result file that `--continue` goes on with. Raises ValueError where it cannot."""
    from jaxshell.results.solution import Solution

    if Path(options.scene).suffix not in _RESULT_FILES:
        raise ValueError(f"--continue goes on from a result file (.h5), but the scene is {options.scene!r}.")
    if options.method:
        raise ValueError("--continue goes on with the method of the file: leave --method out.")
    solution = Solution.load(options.scene)
    if solution.state is None:
        raise ValueError(f"{options.scene} holds no state to go on from: it is of statics, or of an older version.")
    return solution


def what_is_left(restart, t_end: float) -> float:
    """The rest of a run that was to go on to the time `t_end`. Raises ValueError where there is none."""
    reached = float(restart.times[-1])
    if t_end - reached <= 1e-9 * t_end:
        raise ValueError(
            f"The run has reached its end, t = {reached:.6g}: say with --t-end for how much longer it is to go on."
        )
    return t_end - reached
