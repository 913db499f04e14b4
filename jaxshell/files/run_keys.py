"""How a scene is run, in one dataclass: from a scene file's [run] table, a result file, or the command line.

Each field is a key, and the only place that has to know it: its kind checks what files hold and makes the option of the
command line. This file imports no JAX, since the command line reads it first.
"""

import argparse
import dataclasses
import math
import reprlib
from collections.abc import Mapping
from typing import Any

from jaxshell.files.quoted import parts
from jaxshell.numerics.nearest import check_known, meant

_WORDS = {
    "number": "a number",
    "count": "a whole number of at least 1",
    "switch": "true or false",
    "names": "a name or a list of names",
    "numbers": "a list of numbers",
    "label": "a label, which is text",
}


_SOLVERS = ("pardiso", "klu", "dense")


ANALYSES = ("time", "static", "arc-length", "modes", "buckling")
"""What can be run; where nothing is said, a run in time."""
_PATHS = ("static", "arc-length")
_STEPPED = ("time", *_PATHS)


def _key(
    kind: str,
    help: str = "",
    choices: tuple[str, ...] = (),
    metavar: str | None = None,
    of: tuple[str, ...] = ("time",),
) -> Any:
    """A field; `of` are the analyses that the key is for."""
    return dataclasses.field(
        default=None, metadata={"kind": kind, "help": help, "choices": choices, "metavar": metavar, "of": of}
    )


@dataclasses.dataclass(frozen=True)
class RunSettings:
    """The keys of a run; None is not said, and then the method's, the scene's or jaxshell's default holds."""

    analysis: str | None = _key(
        "choice",
        "a run in time, equilibria under growing loads, the path through limit points, natural frequencies, or linear "
        "buckling (default: time)",
        ANALYSES,
        of=ANALYSES,
    )
    load_factors: tuple[float, ...] | None = _key(
        "numbers",
        "statics: the loads as multiples of the scene's (default: 0.1, 0.2, ..., 1)",
        metavar="L",
        of=("static",),
    )
    load_steps: int | None = _key(
        "count",
        "statics: as many equal load steps to the scene's loads, in place of load factors",
        metavar="N",
        of=("static",),
    )
    branch: str | None = _key(
        "choice",
        "statics: go straight on where the equilibrium becomes unstable, or follow the stable path (default: straight)",
        ("straight", "follow"),
        of=("static",),
    )
    arc_length: float | None = _key(
        "number",
        "arc length: the longest step, as the root mean square of the nodes' displacements (default: chosen)",
        metavar="S",
        of=("arc-length",),
    )
    max_steps: int | None = _key(
        "count", "arc length: the largest number of steps (default: 200)", metavar="N", of=("arc-length",)
    )
    max_load_factor: float | None = _key(
        "number",
        "arc length: the path ends with the first step at or beyond this load factor, in size (default: 1)",
        metavar="L",
        of=("arc-length",),
    )
    count: int | None = _key(
        "count", "how many modes (default: 10 frequencies, 5 buckling factors)", metavar="N", of=("modes", "buckling")
    )
    rigid_modes: bool | None = _key(
        "switch", "modes: report motions as a rigid body, of frequency 0 (default: yes)", of=("modes",)
    )
    preload: float | None = _key(
        "number",
        "modes: vibrate about the equilibrium under this multiple of the scene's loads, with its stresses (default: "
        "about the state at the start)",
        metavar="L",
        of=("modes",),
    )
    method: tuple[str, ...] | None = _key(
        "names",
        "EMC, EDMC1, EDMC2, exact, a class of jaxshell.methods, or all for the paper's three; several are drawn "
        "together (default: EMC)",
        metavar="NAME",
    )
    spectral_radius: float | None = _key("number", "ρ∞, in place of the method's", metavar="RHO")
    dissipation: float | None = _key("number", "ξ, in place of the method's", metavar="XI")
    inertia: str | None = _key(
        "choice",
        "the form of inertia, in place of the method's",
        ("seven_point", "traditional", "none", "linear", "cubic"),
        of=("time", "modes"),
    )
    initial_acceleration: str | None = _key(
        "choice", "accelerations at the start, in place of the method's", ("consistent", "zero")
    )
    beta: float | None = _key("number", "Newmark's β")
    gamma: float | None = _key("number", "Newmark's γ")
    alpha: float | None = _key("number", "HHT's α")
    safety: float | None = _key("number", "fraction of the critical step that central differences may take")
    rotary: str | None = _key(
        "choice", "rotary inertia of central differences; scaled takes larger steps", ("physical", "scaled")
    )
    dt: float | None = _key("number", "time step (default: the scene's)")
    t_end: float | None = _key("number", "duration (default: the scene's)")
    save_every: int | None = _key("count", "steps between frames (default: the scene's)", metavar="N", of=_STEPPED)
    reactions: bool | None = _key("switch", "record what the supports carry (default: no)")
    tangent: str | None = _key("choice", "default: closed_form", ("closed_form", "autodiff"), of=_STEPPED)
    linear_solver: str | None = _key("choice", "default: the quickest that this machine has", _SOLVERS, of=_STEPPED)
    kernels: str | None = _key(
        "choice", "what computes the elements; llvm needs llvmlite (default: xla)", ("xla", "llvm"), of=_STEPPED
    )
    newton_tolerance: float | None = _key("number", "default: 1e-8; in statics 1e-12", metavar="TOL", of=_STEPPED)
    newton_max_iterations: int | None = _key(
        "count", "corrections allowed in a step (default: 25)", metavar="N", of=_STEPPED
    )
    newton_max_rotation: float | None = _key(
        "number", "largest rotation of a correction [rad] (default: 0.3)", of=_STEPPED
    )
    newton_reuse: bool | None = _key(
        "switch", "keep factors over iterations and steps while they serve (default: yes, in statics no)", of=_STEPPED
    )
    newton_criterion: str | None = _key("choice", "default: predicted", ("predicted", "norm"), of=_STEPPED)
    step_tolerance: float | None = _key(
        "number",
        "choose the steps by their local error, as a fraction of the shell's size; --dt is the first",
        metavar="TOL",
    )
    step_smallest: float | None = _key("number", "smallest step under step control (default: dt/1e6)")
    step_largest: float | None = _key("number", "largest step under step control (default: no limit)")
    step_output_interval: float | None = _key("number", "time between frames under step control")
    step_horizon: float | None = _key("number", "until when errors count under step control (default: the end)")
    errors: bool | None = _key(
        "switch",
        "estimate the errors of mesh and step afterwards, by other meshes, half the step and recovered section forces "
        "(docs/errors.md; default: no)",
        of=("time", "static", "modes", "buckling"),
    )
    adapt: float | None = _key(
        "number",
        "refine the mesh where its errors come from, until the strain energy or the goal is within this relative error "
        "(docs/adapting.md; default: the scene's mesh)",
        metavar="TOL",
        of=("time", "static"),
    )
    goal: str | None = _key(
        "label",
        "what is watched that adapt brings within its tolerance, at the end of the run (default: the strain energy)",
        metavar="LABEL",
        of=("time", "static"),
    )
    picture_times: tuple[float, ...] | None = _key(
        "numbers", "times of the shapes that are drawn, or load factors", metavar="T", of=_STEPPED
    )

    @property
    def adapts(self) -> bool:
        """Whether the mesh is to be adapted before the run; a goal alone asks for it without a tolerance."""
        return self.adapt is not None or self.goal is not None

    @classmethod
    def checked(cls, values: Mapping[str, Any]) -> "RunSettings":
        """Of values by key, None included. Raises ValueError naming the key whose value is of another kind."""
        fields = {field.name: field for field in dataclasses.fields(cls)}
        return cls(**{key: _checked(fields[key], value) for key, value in values.items() if value is not None})

    def __or__(self, other: "RunSettings") -> "RunSettings":
        """These, with what `other` says in place of what they say."""
        return dataclasses.replace(self, **other.said())

    def said(self) -> dict[str, Any]:
        """The keys that are not None."""
        return {name: getattr(self, name) for name in KEYS if getattr(self, name) is not None}

    def check_analysis(self) -> None:
        """Raise ValueError naming a key that is not for the analysis."""
        analysis = self.analysis or ANALYSES[0]
        for key in self.said():
            if analysis not in OF[key]:
                fits = " or ".join(f'"{name}"' for name in OF[key])
                raise ValueError(f'{key} is for analysis = {fits}, but the analysis is "{analysis}".')
        if self.load_factors is not None and self.load_steps is not None:
            raise ValueError("load_factors and load_steps say the same in two ways: give one of them.")

    def fitting(self, analysis: str) -> "RunSettings":
        """These, without the keys that are not for `analysis`, which is said."""
        return dataclasses.replace(self.without(*(key for key in KEYS if analysis not in OF[key])), analysis=analysis)

    def without(self, *names: str) -> "RunSettings":
        """These, with the given keys not said."""
        return dataclasses.replace(self, **dict.fromkeys(names))

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> "RunSettings":
        """Of a scene file's [run] table. Raises ValueError naming the key that is unknown or of another kind."""
        check_known("[run]", table, KEYS)
        try:
            settings = cls.checked(table)
            settings.check_analysis()
        except ValueError as error:
            raise ValueError(f"[run] {error}") from error
        return settings

    @classmethod
    def from_result_file(cls, settings: Mapping[str, Any]) -> "RunSettings":
        """Of what a result file says about its run; nothing where it is of statics and does not say of which."""
        name, parameters = parts(settings["method"]) if "method" in settings else ("", {})
        analysis = settings.get("analysis", ANALYSES[0])
        if name == "Static" and analysis == ANALYSES[0]:
            return cls()  # of an earlier version
        found = {key: settings[key] for key in KEYS if key in settings and key not in ("method", "dt")}
        if found.get("linear_solver") not in _SOLVERS:
            found.pop("linear_solver", None)  # what a saved solution says it was solved with
        found |= {"method": name or None} | parameters
        _, newton = parts(settings["newton"]) if "newton" in settings else ("", {})
        found |= {f"newton_{key}": value for key, value in newton.items()}
        dt = settings.get("dt")
        if isinstance(dt, str):
            _, control = parts(dt)
            dt = control.pop("initial")
            found |= {f"step_{key}": value for key, value in control.items()}
        unknown = [key for key in found if key not in KEYS]
        if unknown:
            raise ValueError(f"The file's run has {unknown[0]!r}, which this version of jaxshell does not know.")
        found = cls.checked({**found, "dt": dt})
        return found if analysis == ANALYSES[0] else found.fitting(analysis)

    @classmethod
    def from_command_line(cls, options: argparse.Namespace) -> "RunSettings":
        """Of the options that `add_options` made."""
        return cls.checked({name: getattr(options, name) for name in KEYS})


KEYS = tuple(field.name for field in dataclasses.fields(RunSettings))
OF: dict[str, tuple[str, ...]] = {field.name: field.metadata["of"] for field in dataclasses.fields(RunSettings)}
"""The analyses that each key is for."""
METHOD_KEYS = KEYS[KEYS.index("spectral_radius") : KEYS.index("dt")]
"""Parameters of methods."""
STEP_KEYS = ("step_smallest", "step_largest", "step_output_interval", "step_horizon")


def add_options(parser: argparse.ArgumentParser) -> None:
    """An option for every key."""
    for field in dataclasses.fields(RunSettings):
        kind, choices = field.metadata["kind"], field.metadata["choices"]
        options: dict[str, Any] = {"help": field.metadata["help"]}
        if kind == "switch":
            options["action"] = argparse.BooleanOptionalAction
        elif kind == "choice":
            options["choices"] = choices
        else:
            options["metavar"] = field.metadata["metavar"]
            options["type"] = {"count": int, "names": str, "label": str}.get(kind, float)
            if kind in ("names", "numbers"):
                options["nargs"] = "+"
        parser.add_argument("--" + field.name.replace("_", "-"), **options)


def _checked(field: dataclasses.Field, value: Any) -> Any:
    """`value` as the field has it. Raises ValueError naming the field where it is of another kind."""
    kind, choices = field.metadata["kind"], field.metadata["choices"]
    wanted = _WORDS.get(kind) or "one of " + ", ".join(choices)
    found = _CHECKS[kind](value, choices)
    if found is None:
        near = meant(value, choices)
        raise ValueError(f"{field.name} must be {wanted}, but it is {reprlib.repr(value)}.{near}")
    return found


def _number(value: Any, _=()) -> float | None:
    whole_or_float = isinstance(value, int | float) and not isinstance(value, bool)
    try:
        return float(value) if whole_or_float and not math.isnan(value) else None
    except OverflowError:
        return None  # an integer beyond the floats


def _text(value: Any, _=()) -> str | None:
    return value if isinstance(value, str) and value else None


def _list_of(check):
    def checked(value, _=()):
        items = [value] if isinstance(value, str) else value
        found = tuple(check(item) for item in items) if isinstance(items, list | tuple) else ()
        return found if found and None not in found else None

    return checked


_CHECKS = {
    "number": _number,
    "numbers": _list_of(_number),
    "count": lambda value, _: value if type(value) is int and value >= 1 else None,
    "switch": lambda value, _: value if isinstance(value, bool) else None,
    "choice": lambda value, choices: value if isinstance(value, str) and value in choices else None,
    "names": _list_of(_text),
    "label": _text,
}
