"""What the paper's scheme and `EnergyMomentum` conserve: the figures of docs/energy_momentum.md.

    python benchmarks/conservation_figure.py               # all tables and the picture (some minutes), into docs/
    python benchmarks/conservation_figure.py cost order    # some of: conservation, tolerance, step_size, order, cost

Tables go between the page's markers `<!-- NAME -->` and `<!-- end NAME -->`, and to the screen. The free plate
loses its loads at 4 ms; errors are counted from the first step after it.
"""

import argparse
import itertools
import time
from pathlib import Path

import jax
import matplotlib
import numpy as np
from pages import fill  # beside this script

import jaxshell as js
from jaxshell.assembly.discretised import Model
from jaxshell.assembly.structure import structure_of
from jaxshell.assembly.tables import analyse
from jaxshell.plotting.style import STYLE, WIDTH, line

DOCS = Path(__file__).parent.parent / "docs"
FREE_FROM = 0.004
"""Time from which the plate is free [s]."""
EXACT_TOLERANCE = 1e-14
"""Newton's tolerance at which the equations of the step are solved to round-off."""
METHODS = {
    "EMC": js.GeneralizedEnergyMomentum(),
    "EDMC, ρ∞ = 0.95": js.GeneralizedEnergyMomentum(spectral_radius=0.95),
    "EnergyMomentum": js.EnergyMomentum(),
    "EnergyMomentum, ξ = 0.02": js.EnergyMomentum(dissipation=0.02),
}


def run_plate(method, dt: float = 5e-5, tolerance: float = EXACT_TOLERANCE) -> js.Solution:
    newton = js.Newton(tolerance=tolerance, max_iterations=40)
    return js.simulate(js.scenes.free_plate(), method, dt=dt, t_end=0.1, save_every=50, newton=newton, throw=False)


def errors(solution: js.Solution) -> dict[str, np.ndarray]:
    """Times and relative errors at every step of the free flight; `balance` over the whole run, loads included."""
    times = np.asarray(solution.times)
    free = times > FREE_FROM * (1 + 1e-9)
    energy = np.asarray(solution.energy.total)
    lost = np.asarray(solution.energy.dissipated)
    found = {"time": times[free]}
    for name, history in (
        ("energy", energy + lost),
        ("linear", np.linalg.norm(solution.momentum.linear, axis=1)),
        ("angular", np.linalg.norm(solution.momentum.angular, axis=1)),
    ):
        found[name] = np.abs(history[free] / history[free][0] - 1.0)
    found["balance"] = np.abs(energy + lost - np.asarray(solution.energy.external_work)) / energy.max()
    return found


def conservation() -> str:
    runs = {name: run_plate(method) for name, method in METHODS.items()}
    draw(runs)
    lines = [
        "| method | energy | \\|L\\| | \\|J\\| | energy against work | energy left at 0.1 s | iterations/step |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, solution in runs.items():
        found = errors(solution)
        energy = np.asarray(solution.energy.total)[np.asarray(solution.times) > FREE_FROM * (1 + 1e-9)]
        worst = " | ".join(f"{found[key].max():.1e}" for key in ("energy", "linear", "angular", "balance"))
        lines.append(f"| {name} | {worst} | {energy[-1] / energy[0]:.6f} | {per_step(solution)} |")
    return "\n".join(lines)


def per_step(solution: js.Solution) -> str:
    return f"{solution.stats['iterations'] / max(1, solution.stats['steps']):.2f}"


def draw(runs: dict[str, js.Solution]) -> None:
    matplotlib.use("Agg")
    from matplotlib import pyplot

    with pyplot.rc_context(STYLE):
        figure, axes = pyplot.subplots(2, 1, figsize=(WIDTH, 5.2), sharex=True, layout="constrained")
        for position, (name, solution) in enumerate(runs.items()):
            found = errors(solution)
            for axis, key in zip(axes, ("energy", "angular"), strict=True):
                # The first value is the reference; round-off may hit it again exactly.
                shown = np.maximum(found[key][1:], 1e-17)
                axis.semilogy(1e3 * found["time"][1:], shown, label=name, **line(position))
        axes[0].set_ylabel("Relative error of energy\n(plus energy dissipated)")
        axes[1].set_ylabel("Relative error of $|J|$")
        axes[1].set_xlabel("Time in ms")
        for axis in axes:
            axis.set_ylim(1e-17, 1.0)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
        (DOCS / "figures").mkdir(parents=True, exist_ok=True)
        figure.savefig(DOCS / "figures" / "conservation.png")


def tolerance() -> str:
    lines = ["| Newton tolerance | energy | \\|L\\| | \\|J\\| | iterations/step |", "|---|---|---|---|---|"]
    for value in (1e-8, 1e-10, 1e-12, 1e-13, 1e-14):
        solution = run_plate(js.EnergyMomentum(), tolerance=value)
        found = errors(solution)
        worst = " | ".join(f"{found[key].max():.1e}" for key in ("energy", "linear", "angular"))
        lines.append(f"| {value:g} | {worst} | {per_step(solution)} |")
    return "\n".join(lines)


def step_size() -> str:
    lines = [
        "| method | Δt in s | steps taken | energy | \\|J\\| | iterations/step |",
        "|---|---|---|---|---|---|",
    ]
    for name in ("EMC", "EnergyMomentum"):
        for dt in (5e-5, 1e-4, 2e-4, 4e-4):
            solution = run_plate(METHODS[name], dt=dt)
            found = errors(solution)
            taken = f"{solution.stats['steps']} of {round(0.1 / dt)}"
            worst = " | ".join(f"{found[key].max():.1e}" for key in ("energy", "angular"))
            lines.append(f"| {name} | {dt:g} | {taken} | {worst} | {per_step(solution)} |")
    return "\n".join(lines)


def order() -> str:
    """The cap's apex over its first swing, 100 µs, in the mean-square norm over common times."""
    scene, end, newton = js.scenes.spherical_cap(divisions=6), 1e-4, js.Newton(tolerance=1e-11)
    counts = (100, 200, 400, 800, 1600)
    apex = {}
    for name in ("EMC", "EnergyMomentum"):
        runs = [js.simulate(scene, METHODS[name], dt=end / n, t_end=end, save_every=50, newton=newton) for n in counts]
        apex[name] = [np.asarray(s.watched["apex"])[:: n // counts[0]] for s, n in zip(runs, counts, strict=True)]
    size = np.linalg.norm(apex["EMC"][-1])
    changes = {
        name: [np.linalg.norm(a - b) / size for a, b in itertools.pairwise(values)] for name, values in apex.items()
    }
    lines = [
        "| Δt in s | EMC: change to half of it | slope | EnergyMomentum: the same | slope |",
        "|---|---|---|---|---|",
    ]
    for i, n in enumerate(counts[:-1]):
        cells = []
        for change in changes.values():
            cells += [f"{change[i]:.2e}", f"{np.log2(change[i - 1] / change[i]):.2f}" if i else ""]
        lines.append(f"| {end / n:g} | {' | '.join(cells)} |")
    limits = [values[-1] + (values[-1] - values[-2]) / 3.0 for values in apex.values()]
    apart = np.linalg.norm(limits[0] - limits[1]) / size
    lines.append(f"\nThe limits of the two (Richardson extrapolation) differ by {apart:.1e}.")
    return "\n".join(lines)


def cost() -> str:
    """Microseconds per element of the residual and the tangent, both methods in turn; the best of 30."""
    scene = js.scenes.spherical_cap(divisions=10)
    tables, _ = analyse(structure_of(scene))
    model = Model.build(scene, tables)
    increments = np.random.default_rng(0).normal(size=(scene.mesh.n_nodes, 6)) * ([1e-5] * 3 + [1e-2] * 3)
    programs = {}
    for name in ("EMC", "EnergyMomentum"):
        method = METHODS[name]
        state = method.start(model, scene, 0.0)
        data, step, _ = method.begin(model, state, 2e-6)
        u = jax.numpy.asarray(increments)
        arguments = (model.gather(method.motion(state, u)), model.gather(u), data)
        for part in ("element_forces", "element_tangent"):

            def whole(motion, u, data, method=method, part=part, step=step):
                found = jax.vmap(getattr(method, part), in_axes=(0, 0, 0, None))(motion, u, data, step)
                return found.elastic + found.inertial if isinstance(found, tuple) else found

            program = jax.jit(whole)
            jax.block_until_ready(program(*arguments))
            programs[name, part] = (program, arguments)
    best = dict.fromkeys(programs, np.inf)
    for _ in range(30):
        for key, (program, arguments) in programs.items():
            begun = time.perf_counter()
            jax.block_until_ready([program(*arguments) for _ in range(5)])
            best[key] = min(best[key], (time.perf_counter() - begun) / 5)
    micro = {key: 1e6 * value / scene.mesh.n_elements for key, value in best.items()}
    lines = ["| µs per element | residual | tangent |", "|---|---|---|"]
    for name in ("EMC", "EnergyMomentum"):
        lines.append(f"| {name} | {micro[name, 'element_forces']:.2f} | {micro[name, 'element_tangent']:.2f} |")
    return "\n".join(lines)


TABLES = {f.__name__: f for f in (conservation, tolerance, step_size, order, cost)}


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", choices=[[], *TABLES], help="which tables; all by default")
    page = DOCS / "energy_momentum.md"
    for name in parser.parse_args().tables or TABLES:
        text = TABLES[name]()
        print(f"{name}\n{text}\n", flush=True)
        fill(page, {name: text})


if __name__ == "__main__":
    main()
