"""Make the answers of the continuous problems: `python benchmarks/continuous.py [cap opened_cap plate ...]`.

`EnergyMomentum` on a sequence of meshes, each with half the size of elements and half the step of the one before, by
two discretisations that have little in common but the limit: the flat element with linear inertia, and the curved one
with cubic inertia (on plane scenes: the flat one with cubic inertia). Both errors are of second order in mesh and step
together, so that one extrapolation takes both out. The answer is the extrapolation of the second discretisation; its
uncertainty, at every time, the larger of two: a third of its distance to the extrapolation before, which has errors at
least four times as large as those of the runs are; and its distance to the extrapolation of the other discretisation.
The clamped cap is another matter: a force that is there at once, on a point, excites waves of every
length, and what a step does not resolve is missing from the deflection under the force, about 0.6 Δt times the speed at
which it begins: an error of first order. Its runs are explicit, with steps that resolve all that the mesh has. Runs are
kept in --runs, so that a finer level can be added later. Writes `jaxshell/data/*_limit.npz`, and what was seen into
results/continuous.json and the table of docs/accuracy.md.
"""

import argparse
import json
import math
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

os.environ.setdefault("MKL_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parent.parent))

import jax
import numpy as np
from scipy.interpolate import CubicSpline

jax.config.update("jax_enable_x64", True)

import jaxshell as js  # noqa: E402
from benchmarks.pages import fill, mesh_name, table  # noqa: E402
from jaxshell import scenes  # noqa: E402
from jaxshell.advice import limits, references  # noqa: E402
from jaxshell.advice.references import Reference, agreement, extrapolate, signal_size  # noqa: E402

HERE = Path(__file__).parent
DATA = Path(limits.__file__).parent.parent / "data"
PAGE = HERE.parent / "docs" / "accuracy.md"
NEWTON = js.Newton(tolerance=1e-9)


class Case(NamedTuple):
    """A scene, the meshes of its levels, and the step of the first."""

    make: Callable[..., js.Scene]
    meshes: tuple
    dt: float
    window: float
    first: float
    """Until when its first swing lasts."""
    smooth: str = "curved"
    """Shape of the second discretisation: plane scenes have nothing to be curved."""
    explicit: bool = False
    """By central differences, dt the time between samples."""

    def method(self, shape: str, inertia: str) -> js.methods.Method:
        return js.CentralDifference() if self.explicit else js.EnergyMomentum(inertia=inertia)

    def step(self, scene: js.Scene, level: int) -> tuple[float, int]:
        """The step of a level and how many are between samples."""
        count = 2**level
        if self.explicit:
            count = math.ceil(self.dt / js.CentralDifference().critical_step(scene))
        return self.dt / count, count


CASES = {
    "cap": Case(scenes.spherical_cap, (20, 40, 80, 160), 2e-6, 2.5e-4, 1.25e-4, explicit=True),
    "suddenly_loaded_cap": Case(scenes.suddenly_loaded_cap, (20, 40, 80, 160), 5e-6, 1e-3, 4e-4, explicit=True),
    "opened_cap": Case(scenes.opened_cap, ((24, 5), (48, 10), (96, 20), (192, 40)), 0.02, 2.6, 1.0),
    "plate": Case(scenes.free_plate, ((15, 3), (30, 6), (60, 12), (120, 24)), 5e-5, 0.02, 0.005, "flat"),
    # When it has snapped it swings chaotically: from 0.12 s on no two levels agree.
    "snapping_panel": Case(scenes.snapping_panel, ((8, 16), (16, 32), (32, 64), (64, 128)), 1e-3, 0.11, 0.09),
    "flying_cylinder": Case(scenes.flying_cylinder, ((4, 32), (8, 64), (16, 128), (32, 256)), 0.02, 10.0, 2.0),
}


def run(name: str, level: int, shape: str, inertia: str, folder: Path) -> tuple[np.ndarray, dict, dict]:
    """(times, signals, what was seen) of a level, at the times of the first level's steps; from the file if it is there."""
    case, path = CASES[name], folder / f"{name}_{level}_{shape}_{inertia}.npz"
    if not path.is_file():
        scene = js.with_shape(case.make(case.meshes[level]), shape)
        begun, (dt, count) = time.perf_counter(), case.step(scene, level)
        solution = js.simulate(
            scene, case.method(shape, inertia), dt=dt, t_end=case.window, save_every=count, newton=NEWTON
        )
        found = references.signals(scene, np.asarray(solution.displacements))
        seen = {"elements": scene.mesh.n_elements, "dt": dt, "seconds": time.perf_counter() - begun}
        np.savez(path, times=np.asarray(solution.frame_times), **found, **{f"seen {k}": v for k, v in seen.items()})
    with np.load(path) as stored:
        seen = {k[5:]: float(stored[k]) for k in stored.files if k.startswith("seen ")}
        within = stored["times"] <= case.window * (1 + 1e-9)
        named = {k: stored[k][within] for k in stored.files if k != "times" and not k.startswith("seen ")}
        return stored["times"][within], named, seen


def answer(name: str, levels: int, folder: Path) -> dict:
    """Extrapolate, write the reference, and tell what was seen."""
    case = CASES[name]
    forms = [("flat", "linear"), (case.smooth, "linear" if case.explicit else "cubic")]
    found, plain, rows = {}, {}, []
    times = np.zeros(0)
    for form in forms:
        runs = [run(name, level, *form, folder) for level in range(levels)]
        times, plain[form] = runs[0][0], [signals for _, signals, _ in runs]
        found[form] = [extrapolate(*plain[form][k : k + 2]) for k in range(levels - 1)]
        rows += [(level, *form, seen) for level, (*_, seen) in enumerate(runs)]
    mine, other = found[forms[1]], found[forms[0]]
    apart = np.maximum(agreement(times, mine[-2], mine[-1]) / 3.0, agreement(times, other[-1], mine[-1]))
    finest, steps = mesh_name(case.meshes[levels - 1]), [seen["dt"] for *_, seen in rows]
    name_of, smooth = type(case.method("flat", "linear")).__name__, " and ".join(f"{a} ({b} inertia)" for a, b in forms)
    origin = (
        f"{name_of} on {levels} meshes to {finest}, dt {max(steps):.3g} to {min(steps):.3g}, {smooth}, extrapolated; "
        f"benchmarks/continuous.py, {time.strftime('%Y-%m-%d')}"
    )
    limit = Reference(times, mine[-1], float(apart[-1]), origin)
    limits.write_limit(DATA, case.make(case.meshes[0]), limit, apart)
    first = times <= case.first * (1 + 1e-9)

    def errors(signals) -> list[float]:
        parts = [{k: v[chosen] for k, v in signals.items()} for chosen in (first, slice(None))]
        return [
            _distance(part, limit.signals, chosen) for part, chosen in zip(parts, (first, slice(None)), strict=True)
        ]

    return {
        "window": case.window,
        "first_swing": case.first,
        "uncertainty": {"first_swing": float(apart[first][-1]), "window": float(apart[-1])},
        "sizes": {k: float(signal_size(k, v)) for k, v in limit.signals.items()},
        "first_peaks": {k: _peak(times[first], v[first, 0]) for k, v in limit.signals.items() if v.shape[1] == 1},
        "levels": [
            {
                "mesh": case.meshes[level],
                "shape": shape,
                "inertia": inertia,
                "errors": errors(plain[shape, inertia][level]),
            }
            | seen
            for level, shape, inertia, seen in rows
        ],
    }


def _peak(times, values) -> tuple[float, float]:
    """(time, value) where one of the watched is largest."""
    fine = np.linspace(times[0], times[-1], 20 * len(times))
    smooth = CubicSpline(times, values)(fine)
    at = np.abs(smooth).argmax()
    return float(fine[at]), float(smooth[at])


def _distance(found: dict, limit: dict, chosen) -> float:
    """The largest distance over the largest size in the whole window."""
    return max(
        float(np.linalg.norm(values - limit[k][chosen], axis=1).max() / signal_size(k, limit[k]))
        for k, values in found.items()
    )


def report(found: dict) -> str:
    """What is known, and how far each level is from it."""
    rows = []
    for name, seen in found.items():
        known = seen["uncertainty"]
        rows.append([f"`{name}`, known to", "", "", "", f"{known['first_swing']:.1e}", f"{known['window']:.1e}"])
        for level in seen["levels"]:
            mesh = mesh_name(level["mesh"])
            errors = [f"{100 * e:.2f} %" for e in level["errors"]]
            rows.append(["", mesh, f"{level['dt']:.3g}", f"{level['shape']}, {level['inertia']}", *errors])
    return table(["", "mesh", "dt", "discretisation", "first swing", "window"], rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=list(CASES), choices=list(CASES))
    parser.add_argument("--levels", type=int, default=3, choices=(3, 4))
    parser.add_argument("--runs", type=Path, default=HERE / "results" / "continuous_runs", help="where runs are kept")
    options = parser.parse_args()
    options.runs.mkdir(parents=True, exist_ok=True)
    path = HERE / "results" / "continuous.json"
    for name in options.scenes:
        found = json.loads(path.read_text()) if path.is_file() else {}
        found[name] = answer(name, options.levels, options.runs)
        print(name, json.dumps({key: found[name][key] for key in ("uncertainty", "first_peaks")}), flush=True)
        found = {key: found[key] for key in CASES if key in found}
        path.write_text(json.dumps(found, indent=1) + "\n")
        fill(PAGE, {"continuous": report(found)})


if __name__ == "__main__":
    main()
