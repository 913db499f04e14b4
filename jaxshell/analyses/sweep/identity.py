"""Which sweep it is: what a file must agree with, so that the sweep in it goes on."""

import contextlib
import json
from typing import Any

import numpy as np

from jaxshell.analyses.step_control import StepControl
from jaxshell.analyses.sweep.design import Design
from jaxshell.analyses.sweep.fingerprint import fingerprint
from jaxshell.analyses.sweep.member import CaseOf, Member
from jaxshell.files.quoted import quote
from jaxshell.numerics.checks import shown
from jaxshell.results.sweep import Sweep
from jaxshell.results.tree import to_json


def fingerprints(plan: Design, case_of: CaseOf, first: Member, times: np.ndarray) -> dict[str, Any]:
    """What makes a sweep another one, besides what was asked for: numbers of the members, the scene, how it is run."""
    last = None
    with contextlib.suppress(ValueError):
        last = case_of(plan.member(plan.size - 1))
    cases = [case for case in (first.case, last) if case is not None]
    return {
        "members": fingerprint(plan.parameters),
        "scene": fingerprint([case.scene for case in cases]),
        "method": " to ".join(dict.fromkeys(quote(case.method) for case in cases)),
        "newton": " to ".join(dict.fromkeys(quote(case.options.newton) for case in cases)),
        "tangent": first.case.options.tangent,
        "dt": list(dict.fromkeys(_step(case.dt) for case in cases)),
        "t_end": list(dict.fromkeys(case.t_end for case in cases)),
        "times": fingerprint(times),
    }


def _step(dt) -> float | str:
    """Of equal steps their size; of others a text that says which they are."""
    if isinstance(dt, StepControl):
        return quote(dt)
    return float(dt) if np.ndim(dt) == 0 else fingerprint(np.asarray(dt))


def sweep_before(output, settings: dict) -> Sweep:
    """The sweep in the file. Raises ValueError where it is another."""
    found = Sweep.load(output)
    said, now = (_plain(one) for one in (found.settings, settings))
    differs = [key for key in now if said.get(key) != now[key]]
    if differs:
        key = differs[0]
        of_ours = key in ("members", "scene", "times")
        words = "" if of_ours else f" (it was {shown(said.get(key))}, and is {shown(now[key])})"
        raise ValueError(
            f"{output} holds another sweep: another {key}{words}. Choose another name, or replace it with --overwrite, "
            "sweep(..., overwrite=True)."
        )
    return found


def _plain(settings: dict) -> dict:
    """As it comes back from a file."""
    return json.loads(to_json(settings))
