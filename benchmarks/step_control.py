"""What step control brings: `python benchmarks/step_control.py` writes docs/energy_momentum.md's table and a picture.

Each scene with `EnergyMomentum`, fixed steps beside controlled ones: how many steps it takes, rejected ones counted,
until the error of the displacements is below what is wanted, and stays there with more of them. Errors are against a
run of many small steps: root mean square over time and over a dozen nodes spread over the shell, as a fraction of the
largest displacement. The picture is the opened cap's, whose steps grow until it buckles.
"""

import dataclasses
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
    "cap, first swing": (js.scenes.spherical_cap(), 1.26e-4, 3000, (4, 250)),
    "cap, to 1 ms": (js.scenes.spherical_cap(), 1e-3, 20000, (20, 2500)),
    "cap, force over 0.1 ms, to 1 ms": (ramped(js.scenes.spherical_cap(), 1e-4), 1e-3, 20000, (20, 1000)),
    "plate, to 20 ms": (js.scenes.free_plate(), 0.02, 6400, (12, 400)),
    "opened cap, to t = 5": (js.scenes.opened_cap(), 5.0, 4000, (25, 400)),
}
"""Scene, duration, steps of the reference, and the fewest and most fixed steps."""
TOLERANCES = np.geomspace(3e-2, 4e-6, 64)
NODES = 12
WANTED = (0.1, 0.05, 0.03, 0.02, 0.01, 0.005)


def compare(scene: js.Scene, duration: float, fine: int, ends: tuple[int, int]) -> list[list[tuple[int, float]]]:
    """(steps tried, error) of fixed and of controlled runs, from few steps to many; rejected steps count too."""
    nodes = np.linspace(0, scene.mesh.n_nodes - 1, NODES).astype(int)
    watch = {f"{node} {component}": (int(node), component) for node in nodes for component in ("ux", "uy", "uz")}
    scene = dataclasses.replace(scene, watch=watch)

    def displacements(run: js.Solution) -> np.ndarray:
        return np.stack([np.asarray(values) for values in run.watched.values()], axis=1)

    reference = js.simulate(scene, METHOD, dt=duration / fine, t_end=duration, save_every=50)
    answer = CubicSpline(np.asarray(reference.times), displacements(reference))
    size = np.abs(displacements(reference)).max()

    def tried(dt) -> tuple[int, float]:
        run = js.simulate(scene, METHOD, dt=dt, t_end=duration, save_every=50, throw=False)
        times = np.asarray(run.times)
        steps = len(times) - 1 + (run.stats["rejected"] if isinstance(dt, js.StepControl) else 0)
        if run.message:
            return steps, np.inf
        squares = np.sum((displacements(run) - answer(times)) ** 2, axis=1) / NODES
        return steps, float(np.sqrt(np.trapezoid(squares, times) / duration) / size)

    counts = np.unique(np.geomspace(*ends, 48).astype(int))
    first = duration / 30  # a guess that need not be good
    return [
        [tried(duration / int(count)) for count in counts],
        [tried(js.StepControl(float(tol), first, output_interval=duration)) for tol in TOLERANCES],
    ]


def needed(runs: list[tuple[int, float]], wanted: float) -> str:
    """Steps from which on every run of the list is as good as wanted, with that run's error."""
    missed = max((i for i, (_, error) in enumerate(runs) if error > wanted), default=-1)
    if missed + 1 == len(runs):
        return f"more than {runs[-1][0]}"
    steps, error = runs[missed + 1]
    return f"{steps} ({error:.1e})"


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
    lines = ["| scene | error wanted | fixed steps (error) | controlled steps (error) |", "|---|---|---|---|"]
    for name, case in CASES.items():
        fixed, controlled = compare(*case)
        for row in (fixed, controlled):
            print(name, ", ".join(f"{steps}: {error:.1e}" for steps, error in row), flush=True)
        for wanted in WANTED:
            lines.append(f"| {name} | {wanted:g} | {needed(fixed, wanted)} | {needed(controlled, wanted)} |")
            print(lines[-1], flush=True)
    lines += ["", "The opened cap of the picture takes " + picture(DOCS / "figures" / "step_control.png")]
    print(lines[-1])
    fill(DOCS / "energy_momentum.md", {"step_control": "\n".join(lines)})


if __name__ == "__main__":
    main()
