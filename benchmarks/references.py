"""Make the converged references of the three scenes: `python benchmarks/references.py [cap opened_cap plate]`.

Two axes, apart. In time, on the scene's default mesh: `EnergyMomentum` with the step halved until Richardson's
extrapolations (of second order, and the fourth order on top of it) agree to TOLERANCE over the window; where they
cease to agree the response is chaotic, or the step still too large, and the reference ends there. In space:
the same figure of merit on refined meshes, each at the step that its own halving shows to be fine enough;
the differences, and their Richardson limit, go into the JSON file beside the results, since they are the
model's error and not a method's.
"""

import argparse
import json
import os
import time
from pathlib import Path

os.environ.setdefault("MKL_NUM_THREADS", "1")

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

import jaxshell as js  # noqa: E402
from jaxshell.advice import references  # noqa: E402
from jaxshell.advice.references import Reference, agreement, extrapolate  # noqa: E402

HERE = Path(__file__).parent
DATA = Path(references.__file__).parent / "data"
TOLERANCE = 1e-4
# At such small steps the tangent hardly changes: the factors are kept.
NEWTON = js.Newton(tolerance=1e-11, reuse=True)

# scene: (make, window [s], step of the reference's samples, first step, finest step allowed)
SCENES = {
    "cap": (js.scenes.spherical_cap, 2.5e-4, 1e-6, 6.25e-8, 3.9e-9),
    "opened_cap": (js.scenes.opened_cap, 2.6, 0.005, 0.0025, 0.005 / 64),
    # Later the plate is chaotic: from some 15 ms on halving the step changes its orientation at random.
    "plate": (js.scenes.free_plate, 0.02, 5e-5, 6.25e-6, 5e-5 / 128),
}
MESHES = {
    "cap": (10, 20, 40),
    "opened_cap": ((48, 10), (96, 20)),
    "plate": ((15, 3), (30, 6), (60, 12)),
}


def run(scene, dt: float, window: float, samples: float):
    """(times, signals) of the exact scheme with step dt."""
    solution = js.simulate(
        scene, js.EnergyMomentum(), dt=dt, t_end=window, save_every=max(1, round(samples / dt)), newton=NEWTON
    )
    return np.asarray(solution.frame_times), references.signals(scene, np.asarray(solution.displacements))


def in_time(name: str) -> dict:
    """Halve the step until Romberg's table settles; write the reference; return what was seen.

    The scheme is symmetric in time, so that its error has even powers of the step only. The answer is the fourth
    order extrapolation of the last three runs, its uncertainty the distance from that of the last two.
    """
    make, window, samples, first, finest = SCENES[name]
    scene = make()
    seen, plain, second = [], [], []
    dt = first
    while dt > finest * 0.99:
        begun = time.perf_counter()
        times, now = run(scene, dt, window, samples)
        plain.append(now)
        entry = {"dt": dt, "seconds": round(time.perf_counter() - begun, 1)}
        if len(plain) > 1:
            second.append(extrapolate(*plain[-2:]))
            entry["halving_changes"] = float(agreement(times, *plain[-2:])[-1])
        seen.append(entry)
        if len(second) > 1:
            fourth = extrapolate(*second[-2:], order=4)
            apart = agreement(times, second[-1], fourth)
            entry["uncertainty"] = float(apart[-1])
            known = np.flatnonzero(apart <= TOLERANCE)[-1]
            entry["known_until"] = float(times[known])
            write(name, scene, times, fourth, apart, dt)
            if apart[-1] <= TOLERANCE:
                print(name, entry, flush=True)
                break
        print(name, entry, flush=True)
        dt *= 0.5
    return {"window": window, "halvings": seen}


def write(name, scene, times, signals, apart, dt) -> None:
    """The reference as far as it is known to TOLERANCE, as package data."""
    known = int(np.flatnonzero(apart <= TOLERANCE)[-1]) + 1
    if known < 8:
        return
    DATA.mkdir(exist_ok=True)
    origin = (
        f"EnergyMomentum, dt {4 * dt:g}, {2 * dt:g} and {dt:g} extrapolated, Newton tolerance 1e-11, "
        f"jaxshell's benchmarks/references.py, {time.strftime('%Y-%m-%d')}"
    )
    np.savez_compressed(
        DATA / f"{scene.name}.npz",
        times=times[:known],
        uncertainty=float(apart[known - 1]),
        origin=origin,
        fingerprint=references.fingerprint(scene),
        **{f"signal {key}": value[:known] for key, value in signals.items()},
    )


def in_space(name: str, refine_time: float) -> list[dict]:
    """The figure of merit on refined meshes against the finest: the model's own error."""
    make, window, samples, _, _ = SCENES[name]
    reference = references.shipped_reference(make())
    window = float(reference.times[-1]) if reference else window
    runs = []
    for divisions in MESHES[name]:
        begun = time.perf_counter()
        scene = make(divisions)
        dt = refine_time
        times, coarse = run(scene, 2 * dt, window, 2 * dt if samples < 2 * dt else samples)
        _, fine = run(scene, dt, window, 2 * dt if samples < 2 * dt else samples)
        in_dt = float(agreement(times, coarse, fine)[-1])
        runs.append((times, extrapolate(coarse, fine)))
        entry = {
            "divisions": divisions,
            "elements": scene.mesh.n_elements,
            "halving_dt_changes": in_dt,
            "seconds": round(time.perf_counter() - begun, 1),
        }
        print(name, "mesh", entry, flush=True)
        runs[-1] = (*runs[-1], entry)
    finest = Reference(runs[-1][0], dict(runs[-1][1]), 0.0, "")
    for times, found, entry in runs[:-1]:
        entry["from_finest_mesh"] = references.signal_error(finest, times, found)
    return [entry for *_, entry in runs]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=list(SCENES), choices=list(SCENES))
    parser.add_argument("--meshes", action="store_true", help="refine the mesh too (minutes to an hour)")
    options = parser.parse_args()
    path = HERE / "results" / "references.json"
    path.parent.mkdir(exist_ok=True)
    for name in options.scenes:
        found = json.loads(path.read_text()) if path.is_file() else {}
        found[name] = found.get(name, {}) | in_time(name)
        if options.meshes:
            found[name]["meshes"] = in_space(name, SCENES[name][2] / 2)
        path.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
