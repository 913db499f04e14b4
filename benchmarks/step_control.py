"""What step control brings: `python benchmarks/step_control.py` writes docs/energy_momentum.md's table and a picture.

Each scene with `EnergyMomentum`, fixed steps beside controlled ones: the number of steps, and the error of the first
watched displacement against a run of many small steps: root mean square over time, as a part of its largest size. The
picture is the opened cap's, whose steps grow until it buckles.
"""

from pathlib import Path

import equinox as eqx
import jax
import matplotlib
import numpy as np
from pages import fill  # beside this script
from scipy.interpolate import CubicSpline

import jaxshell as js
from jaxshell.plotting.style import COLOURS, STYLE, WIDTH

DOCS = Path(__file__).parent.parent / "docs"
METHOD = js.EnergyMomentum()


def ramped(scene: js.Scene, duration: float) -> js.Scene:
    """The scene with its load rising over `duration` instead of at once."""
    return eqx.tree_at(lambda s: s.loads[0].history, scene, js.History.ramp(duration))


jax.config.update("jax_enable_x64", True)

CASES = {
    "cap, first swing (force at once)": (js.scenes.spherical_cap(), 1.26e-4, 3000, (15, 25, 50, 100, 200)),
    "cap, force over 0.1 ms": (ramped(js.scenes.spherical_cap(), 1e-4), 1.5e-4, 3000, (15, 25, 50, 100, 200)),
    "plate, to 20 ms": (js.scenes.free_plate(), 0.02, 6400, (50, 100, 200, 400)),
    "opened cap, to t = 5": (js.scenes.opened_cap(), 5.0, 4000, (50, 100, 200, 400)),
}
TOLERANCES = (3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5)


def compare(scene: js.Scene, duration: float, fine: int, counts) -> list[str]:
    """Two cells of the table, steps and errors: of fixed steps, and of controlled ones."""
    label = next(name for name, _, component in scene.watch if component[0] == "u")
    reference = js.simulate(scene, METHOD, dt=duration / fine, t_end=duration, save_every=50)
    answer = CubicSpline(np.asarray(reference.times), np.asarray(reference.watched[label]))
    size = np.abs(reference.watched[label]).max()

    def cell(dt) -> str:
        run = js.simulate(scene, METHOD, dt=dt, t_end=duration, save_every=50, throw=False)
        if run.message:
            return f"failed at {float(run.times[-1]):.3g}"
        times = np.asarray(run.times)
        squares = (np.asarray(run.watched[label]) - answer(times)) ** 2
        error = np.sqrt(np.trapezoid(squares, times) / duration) / size
        rejected = f" (+{run.stats['rejected']})" if isinstance(dt, js.StepControl) else ""
        return f"{len(times) - 1}{rejected}: {error:.1e}"

    fixed = [cell(duration / count) for count in counts]
    first = duration / max(counts)
    controlled = [cell(js.StepControl(tol, first, output_interval=duration)) for tol in TOLERANCES]
    return [", ".join(fixed), ", ".join(controlled)]


def picture(path: Path) -> str:
    """Step sizes and deflection of the opened cap under control; returns a sentence with the figures."""
    scene = js.scenes.opened_cap()
    run = js.simulate(scene, METHOD, dt=js.StepControl(1e-4, 0.002, output_interval=5.0), t_end=5.0)
    times, sizes = np.asarray(run.times), np.asarray(run.step_sizes)
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    with matplotlib.rc_context(STYLE):
        figure, (top, bottom) = plt.subplots(2, 1, sharex=True, figsize=(WIDTH, 4.2), layout="constrained")
        top.plot(times, run.watched["A"], color=COLOURS[0])
        top.set(ylabel="Deflection of A in m", title="Opened cap under step control, tolerance 1e-4")
        bottom.semilogy(times[1:], sizes, color=COLOURS[1], marker=".", markersize=3)
        bottom.set(xlabel="t in s", ylabel="Step size in s")
        figure.savefig(path)
    before, during, after = (
        sizes[(times[1:] > low) & (times[1:] < high)] for low, high in ((0.2, 1.5), (2.0, 3.0), (4.0, 5.0))
    )
    return (
        f"{len(sizes)} steps ({run.stats['rejected']} rejected): up to {before.max():.3g} s before buckling, down to "
        f"{during.min():.3g} s in it, up to {after.max():.3g} s after."
    )


def main() -> None:
    lines = ["| scene | fixed, steps: error | controlled, steps (+ rejected): error |", "|---|---|---|"]
    for name, case in CASES.items():
        lines.append(f"| {name} | {' | '.join(compare(*case))} |")
        print(lines[-1], flush=True)
    lines += ["", "The opened cap of the picture takes " + picture(DOCS / "figures" / "step_control.png")]
    print(lines[-1])
    fill(DOCS / "energy_momentum.md", {"step_control": "\n".join(lines)})


if __name__ == "__main__":
    main()
