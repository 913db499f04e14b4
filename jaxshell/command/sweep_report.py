"""A sweep in a few lines of text: its members, what failed, quantiles and sensitivities."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from jaxshell.analyses.sweep.design import Design
from jaxshell.analyses.sweep.varied import Varied
from jaxshell.results.sensitivities import REGRESSION
from jaxshell.results.sweep import Sweep

_QUANTILES = (0.05, 0.5, 0.95)


def describe_design(name: str, plan: Design, axes: Mapping[str, Varied], sample: str, seed: int) -> str:
    """The scene, how many members, and what each parameter runs through."""
    drawn = plan.kind not in ("grid", "zip")
    seeded = f", seed {seed}" if drawn else ""
    lines = [f"{name}: {plan.size} member{'s' if plan.size > 1 else ''}, {sample}{seeded}"]
    for key, axis in axes.items():
        line = f"  {key}: {axis.text}"
        if drawn and axis.span is not None:
            line += f", uniform between {axis.span[0]:g} and {axis.span[1]:g}"
            line += "" if axis.count is None else f" (its {axis.count} values are those of a grid)"
        lines.append(line)
    return "\n".join(lines)


def describe_sweep(sweep: Sweep, path: Path, quantities: Sequence[str] | None, seconds: float) -> str:
    """How the members ended, the spread of what they gave, what it depends on, and the file."""
    ended = int(sweep.successful.sum())
    lines = [f"{int(sweep.done.sum())} of {sweep.size} members done in {seconds:.1f} s, {ended} successfully"]
    lines += [f"  {count} failed: {name}" for name, count in sweep.failures().items()]
    if ended:
        worst = sweep.energy_balance[sweep.successful].max()
        lines.append(f"  energy: K + S + D - W changes by at most {worst:.1e} of the largest K + S")
        lines += _spread(sweep, quantities)
        lines += _sensitivities(sweep, quantities)
    return "\n".join([*lines, f"  {path} ({path.stat().st_size / 1e6:.1f} MB)"])


def _spread(sweep: Sweep, quantities: Sequence[str] | None) -> list[str]:
    lines = []
    for name in sweep.responses() if quantities is None else quantities:
        values = sweep.response(name)[sweep.successful]
        low, middle, high = np.quantile(values, _QUANTILES)
        lines.append(f"  {name}: 5 % below {low:.6g}, half below {middle:.6g}, 95 % below {high:.6g}")
    return lines


def _sensitivities(sweep: Sweep, quantities: Sequence[str] | None) -> list[str]:
    try:
        found = sweep.sensitivities(quantities)
    except ValueError as error:
        return [f"  no sensitivities: {error}"]
    said = "standardised regression coefficients" if found.estimate == REGRESSION else f"{found.estimate} S"
    lines = [f"  sensitivities ({said}, {found.members} members)"]
    for name, values in found.values.items():
        if np.isnan(values).all():
            continue
        parts = [f"{key} {value:.3g}" for key, value in zip(found.parameters, values, strict=True)]
        linear = "" if found.r_squared is None else f" (R² = {found.r_squared[name]:.3f})"
        lines.append(f"    {name}: {', '.join(parts)}{linear}")
    return lines
