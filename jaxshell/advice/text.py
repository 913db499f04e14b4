"""What `advise` found, and how it is told: in words, as a call, a command, or a scene file's section."""

from typing import NamedTuple

import numpy as np

from jaxshell import methods
from jaxshell.advice.chart import Configuration, Point
from jaxshell.advice.references import Reference
from jaxshell.analyses.step_control import StepControl
from jaxshell.model.scene import Scene
from jaxshell.solvers.newton import Newton


class Advice(NamedTuple):
    """The best configuration found, why, and everything that was tried."""

    best: Configuration
    point: Point
    reasons: list[str]
    points: list[Point]
    reference: Reference
    tolerance: float
    met: bool
    """Whether anything tried met the tolerance; else `best` is the most accurate."""
    divisions: int | tuple[int, ...] | None = None
    """Fewer divisions of a library scene's mesh that suffice; None for its own."""


def describe(scene: Scene, advice: Advice) -> str:
    """The advice in words, and as arguments of `simulate`."""
    window = float(advice.reference.times[-1])
    lines = [
        f"{scene.name}: answers to {advice.tolerance:g}, tried over t ≤ {window:.4g}"
        f" against {advice.reference.origin} (known to {advice.reference.uncertainty:.1e})",
        *(f"  - {reason}" for reason in advice.reasons),
    ]
    t_end = None if scene.defaults is None else scene.defaults.t_end
    if t_end is not None and window < 0.999 * t_end:
        lines.append(f"  What happens after t = {window:.4g} was not tried.")
    lines += [
        "Use",
        f"  js.simulate(scene, js.{method_text(advice.best.method)}, dt={_step_text(advice.best)}, "
        f"t_end=...{_newton_text(advice.best)})",
    ]
    if advice.divisions is not None:
        lines[-1] += f" with scene = ...(divisions={advice.divisions!r})"
    return "\n".join(lines)


def command_line(scene: str, advice: Advice) -> str:
    """The advice as a command."""
    method, newton = advice.best.method, advice.best.newton
    parts = ["jaxshell run", scene, "--method", _file_name(method)]
    if isinstance(method, methods.GeneralizedEnergyMomentum):
        if float(method.spectral_radius) != 1.0:
            parts.append(f"--spectral-radius {float(method.spectral_radius):g}")
        if method.inertia != "seven_point":
            parts.append(f"--inertia {method.inertia}")
    dt = advice.best.dt
    if isinstance(dt, StepControl):
        parts.append(f"--dt {float(dt.initial):.6g} --step-tolerance {float(dt.tolerance):g}")
    else:
        parts.append(f"--dt {dt:.6g}")
    if advice.divisions is not None:
        parts.append(f"--divisions {divisions_text(advice.divisions)}")
    if float(newton.tolerance) != float(Newton().tolerance):
        parts.append(f"--newton-tolerance {float(newton.tolerance):g}")
    if newton.reuse != Newton().reuse:
        parts.append("--newton-reuse" if newton.reuse else "--no-newton-reuse")
    return " ".join(parts)


def run_section(scene: Scene, advice: Advice) -> str:
    """The [run] table of a scene file."""
    method = advice.best.method
    t_end = None if scene.defaults is None else scene.defaults.t_end
    t_end = float(advice.reference.times[-1]) if t_end is None else t_end
    lines = ["[run]", f'method = "{_file_name(method)}"']
    if isinstance(method, methods.GeneralizedEnergyMomentum):
        lines += [
            f"spectral_radius = {float(method.spectral_radius):g}",
            f"dissipation = {float(method.dissipation):g}",
            f'inertia = "{method.inertia}"',
        ]
    dt = advice.best.dt
    if isinstance(dt, StepControl):
        lines += [f"dt = {float(dt.initial):.6g}", f"step_tolerance = {float(dt.tolerance):g}"]
    else:
        lines.append(f"dt = {dt:.6g}")
    lines.append(f"t_end = {t_end:.6g}")
    newton = advice.best.newton
    if float(newton.tolerance) != float(Newton().tolerance):
        lines.append(f"newton_tolerance = {float(newton.tolerance):g}")
    if newton.reuse != Newton().reuse:
        lines.append(f"newton_reuse = {str(newton.reuse).lower()}")
    return "\n".join(lines) + "\n"


def _file_name(method: methods.Method) -> str:
    named = {"GeneralizedEnergyMomentum": "EMC", "EnergyMomentum": "exact"}
    return named.get(type(method).__name__, type(method).__name__)


def method_text(method: methods.Method) -> str:
    """The method as one writes it, with what differs from the defaults."""
    default = type(method)()
    parts = [
        f"{name}={value!r}"
        for name in type(method).__dataclass_fields__
        if (value := getattr(method, name)) != getattr(default, name)
    ]
    return f"{type(method).__name__}({', '.join(parts)})"


def _step_text(configuration: Configuration) -> str:
    dt = configuration.dt
    if isinstance(dt, StepControl):
        return f"js.StepControl({float(dt.tolerance):g}, initial={float(dt.initial):.6g})"
    return f"{dt:.6g}"


def _newton_text(configuration: Configuration) -> str:
    newton, parts = configuration.newton, []
    if float(newton.tolerance) != float(Newton().tolerance):
        parts.append(f"tolerance={float(newton.tolerance):g}")
    if newton.reuse != Newton().reuse:
        parts.append(f"reuse={newton.reuse}")
    return f", newton=js.Newton({', '.join(parts)})" if parts else ""


def divisions_text(divisions) -> str:
    """Divisions as the command line wants them."""
    return " ".join(map(str, np.atleast_1d(divisions).tolist()))
