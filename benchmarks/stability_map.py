"""Stability map: method × time step × scene over long runs. Who survives, who fails, when and how.

    python benchmarks/stability_map.py                 # the full map (tens of minutes), into docs/
    python benchmarks/stability_map.py --missing       # only the cells that the figures do not hold yet
    python benchmarks/stability_map.py --redraw        # its tables and picture again from the figures, without a run
    python benchmarks/stability_map.py --quick --output DIR

Writes `stability_map.json` (every figure), `stability_map.png`, and the tables: into the page stability.md of
the output folder between its markers `<!-- map -->`, `<!-- limits -->` and `<!-- inside -->`, or where there is no
such page into `stability_map.md`.

Drift is (K + S - W)/max|W|, the energy that the method made (+) or lost (-) as a fraction of the work of the loads.
Newton may take 100 iterations here, each with its own factorization, so that a failure is the method's; where its
default limit of 25 would have ended the run is recorded.
"""

import argparse
import itertools
import json
import sys
import time
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).parent.parent))

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
from matplotlib import cm, colors, patches

import jaxshell as js
from benchmarks.pages import fill, table
from jaxshell.assembly.discretised import Model
from jaxshell.assembly.structure import structure_of
from jaxshell.assembly.tables import nodal_tables
from jaxshell.elements import corotational
from jaxshell.methods import Method
from jaxshell.plotting.style import ORANGE, VERMILLION

GROWN = 0.05
"""Drift from which energy counts as grown: the run has failed, whether it goes on or not."""
LIMITS = (6, 8, 10, 25)
"""Newton iterations a step: when a run would have ended that allows no more is recorded."""
LEFT = 0.01
"""Size of the drift whose first crossing is recorded."""
PATIENT, USUAL = js.Newton(max_iterations=100, reuse=False), js.Newton().max_iterations
DOCS = Path(__file__).parent.parent / "docs"


class Case(NamedTuple):
    label: str
    scene: js.Scene
    duration: float
    steps: tuple[float, ...]
    methods: tuple[str, ...]


METHODS = {
    "Newmark 1/4, 1/2": js.Newmark(),
    "HHT, α = -0.05": js.HHT(-0.05),
    "generalised α, ρ∞ = 0.8": js.GeneralizedAlpha(0.8),
    "Bathe": js.Bathe(),
    "EMC (Yang & Xia)": js.GeneralizedEnergyMomentum(),
    "EDMC, ρ∞ = 0.8": js.GeneralizedEnergyMomentum(0.8),
    "EnergyMomentum": js.EnergyMomentum(),
}
EXPLICIT = "central differences"


def cases(quick: bool) -> list[Case]:
    few = ("Newmark 1/4, 1/2", "generalised α, ρ∞ = 0.8", "EnergyMomentum")
    implicit = tuple(METHODS)
    plate = js.scenes.free_plate()
    if quick:
        return [Case("plate, 0.04 s", plate, 0.04, (5e-5,), few)]
    milder = [
        Case(f"plate, loads × {factor}, 0.3 s", scaled(plate, factor), 0.3, (5e-5,), few[:1])
        for factor in (0.9, 0.8, 0.7, 0.5)
    ]
    return [
        Case("plate, 0.1 s", plate, 0.1, (5e-5, 1e-4, 2e-4), (*implicit, EXPLICIT)),
        Case("plate, 1 s", plate, 1.0, (5e-5,), implicit),
        Case("cap, 5 ms", js.scenes.spherical_cap(), 5e-3, (2e-6, 5e-6, 1e-5), (*implicit, EXPLICIT)),
        Case("opened cap, t = 20", js.scenes.opened_cap(), 20.0, (0.02,), (*implicit, EXPLICIT)),
        *milder,
    ]


def scaled(scene: js.Scene, factor: float) -> js.Scene:
    """The scene with all its loads times `factor`."""

    def values(scene):
        return [load.history.values for load in scene.loads]

    return eqx.tree_at(values, scene, [factor * value for value in values(scene)])


# --- one run ----------------------------------------------------------------------------------------------


def measure(case: Case, label: str, method: Method, dt: float) -> dict:
    """Run and return the figures of one cell of the map."""
    begun = time.perf_counter()
    every = 5000 if label == EXPLICIT else 250
    solution = js.simulate(
        case.scene, method, dt=dt, t_end=case.duration, save_every=every, newton=PATIENT, throw=False
    )
    times, work = np.asarray(solution.times), np.asarray(solution.energy.external_work)
    drift = (np.asarray(solution.energy.total) - work) / np.abs(work).max()
    iterations = np.asarray(solution.iterations)[1:]
    how = _how(solution)
    if how == "survived" and drift.max() > GROWN:
        how = "energy grew"
    usual = 2 * USUAL if isinstance(method, js.Bathe) else USUAL  # two solutions a step
    return {
        "scene": case.label,
        "method": label,
        "dt": dt,
        "how": how,
        "end": float(times[-1]),
        "steps": len(times) - 1,
        "drift_max": float(drift.max()),
        "drift_min": float(drift.min()),
        "drift_end": float(drift[-1]),
        "left_1_percent": _first(times, np.abs(drift) > LEFT),
        "grew": _first(times, drift > GROWN),
        "default_newton_gave_up": _first(times[:-1], iterations > usual),
        "limits": {str(limit): _ended(drift, iterations > limit * usual // USUAL) for limit in LIMITS},
        "momentum_drift": _momentum_drift(case, times, np.asarray(solution.momentum.linear)),
        "angular_drift": _momentum_drift(case, times, np.asarray(solution.momentum.angular)),
        "iterations_mean": float(iterations.mean()) if iterations.size else None,
        "iterations_max": int(iterations.max()) if iterations.size else None,
        "wall_time": time.perf_counter() - begun,
    }


def _first(times, mask) -> float | None:
    """The first time at which the mask holds."""
    return float(times[np.argmax(mask)]) if mask.any() else None


def _ended(drift, mask) -> dict | None:
    """The first step at which the mask holds, and the drift at its start and the largest until then."""
    if not mask.any():
        return None
    k = int(np.argmax(mask))
    return {"step": k + 1, "drift": float(drift[k]), "most": float(np.abs(drift[: k + 1]).max())}


def _how(solution: js.Solution) -> str:
    names = ("successful", "diverged", "stagnated", "singular", "unstable")
    (found,) = [name for name in names if solution.result == getattr(js.RESULTS, name)]
    return "survived" if found == "successful" else found


def _momentum_drift(case: Case, times, momentum) -> float | None:
    """Largest change of a free shell's momentum since the loads ended, over its size then."""
    if case.scene.held_dofs.size:
        return None
    ended = max(float(load.history.times[-1]) for load in case.scene.loads)
    after = momentum[times >= ended * (1 + 1e-9)]
    if not len(after):
        return None
    return float(np.abs(after - after[0]).max() / np.linalg.norm(after[0]))


# --- anatomy of a failure ---------------------------------------------------------------------------------


def anatomy(case: Case, label: str, dt: float, stride: int = 50) -> list[dict]:
    """What goes on inside a run, looked at in two consecutive steps every `stride` steps.

    `alternation` is |a_{n+1} - a_n|/|a_{n+1} + a_n| of the nodal accelerations: small for motion that the
    step resolves, 1 for noise, large where accelerations change their sign from each step to the next.
    """
    model = eqx.filter_jit(Model.build)(case.scene, nodal_tables(structure_of(case.scene)))
    rows: list[dict] = []
    solution = None
    while not rows or rows[-1]["time"] < case.duration - stride * dt:
        for count in (stride - 1, 1):
            before = solution
            solution = js.simulate(
                case.scene,
                METHODS[label],
                dt=dt,
                t_end=count * dt,
                save_every=250,
                newton=PATIENT,
                throw=False,
                restart=before,
            )
            if solution.message:
                return rows
        assert before is not None
        earlier, state = np.asarray(before.state.a), solution.state
        membrane, bending = (float(k) for k in _strain_energies(model, state.x, state.R))
        work = float(solution.energy.external_work[-1])
        later = np.asarray(state.a)
        rows.append(
            {
                "step": stride * (len(rows) + 1),
                "time": float(solution.times[-1]),
                "drift": (float(solution.energy.total[-1]) - work) / work,
                "alternation": float(np.linalg.norm(later - earlier) / np.linalg.norm(later + earlier)),
                "largest_acceleration": float(np.abs(later).max()),
                "membrane_energy": membrane,
                "bending_energy": bending,
                "rotation_per_step": float(jnp.max(jnp.linalg.norm(state.rates[0, :, 3:], axis=1))) * dt,
                "iterations": int(solution.iterations[-1]),
            }
        )
    return rows


@eqx.filter_jit
def _strain_energies(model: Model, x, R):
    def one(x, R, element):
        e = corotational.kinematics(x, R, element).deformations
        f = corotational.stresses(e, element)
        return 0.5 * jnp.sum(e[:6] * f[:6]), 0.5 * jnp.sum(e[6:] * f[6:])

    membrane, bending = jax.vmap(one)(model.gather(x), model.gather(R), model.elements)
    return jnp.sum(membrane), jnp.sum(bending)


# --- tables and picture -----------------------------------------------------------------------------------


def _percent(value: float | None) -> str:
    return "" if value is None else f"{100 * value:+.2g} %" if abs(value) >= 1e-4 else f"{value:+.0e}"


def _verdict(row: dict) -> str:
    parts = []
    if row["grew"] is not None:
        parts.append(f"**energy grew** by {100 * GROWN:g} % at t = {row['grew']:.4g}")
    if row["how"] not in ("survived", "energy grew"):
        parts.append(f"**{row['how']}** at step {row['steps'] + 1}, t = {row['end']:.4g}")
    if row["default_newton_gave_up"] is not None:
        parts.append(f"more than {USUAL} iterations at t = {row['default_newton_gave_up']:.4g}")
    return "; ".join(parts or ["survived"])


def map_table(rows: list[dict]) -> str:
    header = [
        "method", "Δt", "outcome", "drift: most", "least", "at the end", "momentum", "angular momentum",
        "iterations a step (most)",
    ]  # fmt: skip
    tables = []
    for scene, group in itertools.groupby(rows, key=lambda row: row["scene"]):
        cells = []
        for row in sorted(group, key=lambda row: row["dt"], reverse=True):
            mean, most = row["iterations_mean"], row["iterations_max"]
            cells.append([row["method"], f"{row['dt']:.3g}", _verdict(row)])
            cells[-1] += [_percent(row[key]) for key in ("drift_max", "drift_min", "drift_end")]
            cells[-1] += ["" if row[k] is None else f"{row[k]:.0e}" for k in ("momentum_drift", "angular_drift")]
            cells[-1].append(f"{mean:.1f} ({most})" if most else "none")
        tables.append(f"**{scene}**\n\n{table(header, cells)}")
    return "\n\n".join(tables)


def limits_table(rows: list[dict]) -> str:
    """Of Newmark's runs on the plate: with what energy they end, by the iterations allowed in a step."""
    runs = [row for row in rows if row["method"].startswith("Newmark") and row["scene"].startswith("plate")]
    cells = []
    for row in runs:
        if row.get("limits") and row["scene"] != "plate, 1 s":  # which has ended by then
            cells.append([row["scene"], f"{row['dt']:.3g}"])
            for end in row["limits"].values():
                told = end and f"step {end['step']}: {_percent(end['drift'])} ({100 * end['most']:.2g} %)"
                cells[-1].append(told or "goes on")
    return table(["scene", "Δt", *(f"{limit} iterations" for limit in LIMITS)], cells)


def anatomy_table(anatomies: dict[str, list[dict]]) -> str:
    header = [
        "step", "drift", "alternation of accelerations", "largest [m/s²]", "membrane energy [J]",
        "bending energy [J]", "rotation per step [rad]", "iterations",
    ]  # fmt: skip
    tables = []
    for label, rows in anatomies.items():
        cells = [
            [
                str(r["step"]), _percent(r["drift"]), f"{r['alternation']:.2f}", f"{r['largest_acceleration']:.1e}",
                f"{r['membrane_energy']:.2f}", f"{r['bending_energy']:.1f}", f"{r['rotation_per_step']:.2f}",
                str(r["iterations"]),
            ]
            for r in rows
        ]  # fmt: skip
        step = rows[0]["time"] / rows[0]["step"]
        tables.append(f"**{label}**, Δt = {step:.3g} s\n\n{table(header, cells)}")
    return "\n\n".join(tables)


def picture(rows: list[dict], path: Path) -> None:
    """One cell a run: its colour is the drift, its text the outcome."""
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    # Left out: the explicit method, whose steps are its own, and scenes that one method ran alone.
    rows = [row for row in rows if row["method"] != EXPLICIT]
    ran = {scene: {row["method"] for row in rows if row["scene"] == scene} for scene in (r["scene"] for r in rows)}
    rows = [row for row in rows if len(ran[row["scene"]]) > 1]
    columns = list(dict.fromkeys((row["scene"], row["dt"]) for row in rows))
    methods = list(dict.fromkeys(row["method"] for row in rows))
    fig, axes = plt.subplots(figsize=(1.0 * len(columns) + 2.2, 0.5 * len(methods) + 1.6), layout="constrained")
    norm, colours = colors.LogNorm(1e-6, 0.3), matplotlib.colormaps["YlGnBu"]
    for row in rows:
        x, y = columns.index((row["scene"], row["dt"])), methods.index(row["method"])
        drift = max(row["drift_max"], -row["drift_min"], 1e-6)
        failed, ended = row["how"] != "survived", row["default_newton_gave_up"]
        hard = not failed and ended is not None
        colour = VERMILLION if failed else ORANGE if hard else colours(norm(min(drift, 0.3)))
        axes.add_patch(patches.Rectangle((x, y), 1, 1, facecolor=colour, edgecolor="white", linewidth=2))
        text = _percent(row["drift_end"])
        if failed:
            text = f"{row['how']}\nt = {row['end'] if row['grew'] is None else row['grew']:.3g}"
        elif hard:
            text = f"{text}\nhard, t = {ended:.3g}"
        dark = failed or norm(min(drift, 0.3)) > 0.55
        axes.text(x + 0.5, y + 0.5, text, ha="center", va="center", fontsize=6.5, color="white" if dark else "black")
    axes.set(xlim=(0, len(columns)), ylim=(len(methods), 0))
    axes.set_xticks(np.arange(len(columns)) + 0.5, [f"{scene}\nΔt = {dt:g}" for scene, dt in columns], fontsize=6.5)
    axes.set_yticks(np.arange(len(methods)) + 0.5, methods, fontsize=8)
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    axes.set_title(
        "Energy made or lost at the end, as a fraction of the loads' work\nred: failed; orange: over 25 iterations",
        fontsize=8,
    )
    fig.colorbar(cm.ScalarMappable(norm, colours), ax=axes, label="largest |drift|", fraction=0.03)
    fig.savefig(path, dpi=160)
    plt.close(fig)


def write(rows: list[dict], anatomies: dict, output: Path) -> None:
    """The figures, and what is drawn from them."""
    output.mkdir(parents=True, exist_ok=True)
    content = {"runs": rows, "anatomies": anatomies}
    (output / "stability_map.json").write_text(json.dumps(content, indent=1) + "\n")
    draw(output)


def draw(output: Path) -> None:
    """The picture and the tables from the figures in the output folder."""
    content = json.loads((output / "stability_map.json").read_text())
    picture(content["runs"], output / "stability_map.png")
    tables = {"map": map_table(content["runs"]), "limits": limits_table(content["runs"])}
    if content["anatomies"]:
        tables["inside"] = anatomy_table(content["anatomies"])
    page = output / "stability.md"
    if page.exists():
        fill(page, tables)
    else:
        (output / "stability_map.md").write_text("\n\n".join(tables.values()) + "\n")


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Method by time step by scene: who survives, who fails, when and how.")
    parser.add_argument("--quick", action="store_true", help="one short scene and three methods")
    parser.add_argument("--missing", action="store_true", help="only runs that stability_map.json does not hold")
    parser.add_argument("--redraw", action="store_true", help="tables and picture from stability_map.json, no run")
    parser.add_argument("--output", type=Path, default=DOCS)
    options = parser.parse_args(arguments)
    if options.redraw:
        draw(options.output)
        return
    jax.config.update("jax_enable_x64", True)
    file = options.output / "stability_map.json"
    content = json.loads(file.read_text()) if options.missing else {"runs": [], "anatomies": {}}
    known = {(row["scene"], row["method"], f"{row['dt']:.6g}"): row for row in content["runs"]}
    rows: list[dict] = []
    for case in cases(options.quick):
        for label in case.methods:
            explicit = js.CentralDifference()
            steps = (explicit.critical_step(case.scene),) if label == EXPLICIT else case.steps
            for dt in steps:
                row = known.pop((case.label, label, f"{dt:.6g}"), None)
                if row is None:
                    row = measure(case, label, METHODS.get(label, explicit), dt)
                    print(json.dumps(row, ensure_ascii=False), flush=True)
                rows.append(row)
        # With what is known of the scenes to come: a run that is stopped keeps all.
        write([*rows, *known.values()], content["anatomies"], options.output)
    (plate, *others), anatomies = cases(options.quick), content["anatomies"]
    newmark = plate.methods[0]
    inside = [(plate._replace(duration=0.04), 50), *((case, 250) for case in others if "0.8" in case.label)]
    for case, stride in inside:
        label = f"{newmark}, {case.label}"
        anatomies[label] = anatomies.get(label) or anatomy(case, newmark, 5e-5, stride)
    write(rows, anatomies, options.output)
    print(f"{len(rows)} runs, {sum(row['wall_time'] for row in rows):.0f} s", flush=True)


if __name__ == "__main__":
    main()
