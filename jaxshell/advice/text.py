"""What `advise` found, and how it is told: in words, as a call, a command, or a scene file's section."""

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from jaxshell import methods
from jaxshell.advice.chart import Configuration, Point
from jaxshell.advice.family import Member, own_shapes
from jaxshell.advice.references import Reference
from jaxshell.analyses.step_control import StepControl
from jaxshell.files.run_keys import METHOD_KEYS
from jaxshell.model.scene import Scene
from jaxshell.model.sections.regions import Regions
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
    """Whether what is advised was measured to be within the tolerance; else `best` is the most accurate, or on one mesh
    the best of the step alone."""
    member: Member
    """The mesh, and how it is made of the scene's."""


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
        *(f"  scene = {line}" for line in _scene_lines(scene, advice)),
        f"  js.simulate(scene, js.{method_text(advice.best.method)}, dt={_step_text(advice.best)}, "
        f"t_end=...{_newton_text(advice.best)})",
    ]
    return "\n".join(lines)


def _scene_lines(scene: Scene, advice: Advice) -> list[str]:
    """What makes the scene that is advised, as Python."""
    member, shape, lines = advice.member, advice.best.shape, []
    if member.divisions is not None:
        lines.append(f"js.scenes.{scene.name}(divisions={member.divisions!r})")
    elif member.levels > 0:
        lines.append(f"js.refine(scene, levels={member.levels})")
    else:
        lines += ["js.coarsen(scene)"] * -member.levels
    if _other_shape(scene, shape):
        lines.append(f'js.with_shape(scene, "{shape}")')
    return lines


def _other_shape(scene: Scene, shape: str | None) -> bool:
    """Whether the scene's elements are of another shape than is advised."""
    return shape is not None and shape not in own_shapes(scene)


def mesh_text(member: Member) -> str:
    """How a mesh is made of the scene's own."""
    if member.divisions is not None:
        return f"divisions {divisions_text(member.divisions)}"
    if member.levels == 0:
        return "the scene's own mesh"
    times = abs(member.levels)
    return f"{'refined' if member.levels > 0 else 'coarsened'} {'once' if times == 1 else f'{times} times'}"


def command_line(scene: str, advice: Advice) -> str:
    """The advice as a command."""
    method, newton, member = advice.best.method, advice.best.newton, advice.member
    parts = ["jaxshell run", scene]
    if member.divisions is not None:
        parts.append(f"--divisions {divisions_text(member.divisions)}")
    elif member.levels:
        parts.append(f"--{'refine' if member.levels > 0 else 'coarsen'} {abs(member.levels)}")
    if _other_shape(member.scene, advice.best.shape):
        parts.append(f"--shape {advice.best.shape}")
    parts.append(f"--method {_file_name(method)}")
    parts += [f"--{key.replace('_', '-')} {_plain(value)}" for key, value in _parameters(method).items()]
    dt = advice.best.dt
    if isinstance(dt, StepControl):
        parts.append(f"--dt {float(dt.initial):.6g} --step-tolerance {float(dt.tolerance):g}")
    else:
        parts.append(f"--dt {dt:.6g}")
    if float(newton.tolerance) != float(Newton().tolerance):
        parts.append(f"--newton-tolerance {float(newton.tolerance):g}")
    if newton.reuse != Newton().reuse:
        parts.append("--newton-reuse" if newton.reuse else "--no-newton-reuse")
    return " ".join(parts)


def file_tables(scene: Scene, advice: Advice) -> str:
    """What a scene file's [mesh], [section] and [run] say for it: keys to be put there."""
    return "\n".join(
        filter(None, (_mesh_table(advice.member), _section_table(scene, advice), run_section(scene, advice)))
    )


def _mesh_table(member: Member) -> str:
    if member.divisions is not None:
        given = member.divisions
        return f"[mesh]\ndivisions = {given if isinstance(given, int) else list(given)}\n"
    if member.levels > 0:
        return f"[mesh]\nrefine = {member.levels}  # more than the file says already\n"
    return "" if member.levels == 0 else f"# [mesh]: divisions over {2**-member.levels}\n"


def _section_table(scene: Scene, advice: Advice) -> str:
    if not _other_shape(scene, advice.best.shape):
        return ""
    line = f'shape = "{advice.best.shape}"\n'
    return f"# every section: {line}" if isinstance(scene.section, Regions) else f"[section]\n{line}"


def run_section(scene: Scene, advice: Advice) -> str:
    """The [run] table of a scene file."""
    method = advice.best.method
    t_end = None if scene.defaults is None else scene.defaults.t_end
    t_end = float(advice.reference.times[-1]) if t_end is None else t_end
    lines = ["[run]", f'method = "{_file_name(method)}"']
    for key, value in _parameters(method).items():
        lines.append(f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {_plain(value)}")
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


def _parameters(method: methods.Method) -> dict[str, Any]:
    """The method's parameters that differ from its defaults, by their keys."""
    default, names = type(method)(), [field.name for field in dataclasses.fields(method)]
    keys = [key for key in METHOD_KEYS if key in names]
    return {key: getattr(method, key) for key in keys if getattr(method, key) != getattr(default, key)}


def _plain(value: Any) -> str:
    return value if isinstance(value, str) else f"{float(value):g}"


def _file_name(method: methods.Method) -> str:
    named = {"GeneralizedEnergyMomentum": "EMC", "EnergyMomentum": "exact"}
    return named.get(type(method).__name__, type(method).__name__)


def method_text(method: methods.Method) -> str:
    """The method as one writes it, with what differs from the defaults."""
    default = type(method)()
    parts = [
        f"{field.name}={value!r}"
        for field in dataclasses.fields(method)
        if (value := getattr(method, field.name)) != getattr(default, field.name)
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
