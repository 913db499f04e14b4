"""What joints cost: `python benchmarks/joints.py`.

The panel of the library that unfolds, against the same shell without joints: its plates, apart, each of which turns as
fast as it does while the panel unfolds, and one plate of the same triangles, welded at the lines of the hinges, which
bends. Same steps, one core, without compilation, asked in turn; medians. Set-up, apart from the steps, is what a call of
`simulate` takes besides: of joints it looks whether they repeat each other. `--rounds 1 --steps 20 --divisions 4 2
--dry` tries it. Writes the table of docs/performance.md unless --dry.
"""

import argparse
import os

os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[-1:])
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"
os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_multi_thread_eigen=false"

import dataclasses  # noqa: E402
import sys  # noqa: E402
import time  # noqa: E402
from pathlib import Path  # noqa: E402

sys.path.insert(0, str(Path(__file__).parent.parent))

import jax  # noqa: E402

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import jaxshell as js  # noqa: E402
from benchmarks.pages import fill, table  # noqa: E402
from benchmarks.workers import machine, median  # noqa: E402

PAGE = Path(__file__).parent.parent / "docs" / "performance.md"
RATE = 2.0
"""[rad/s] The panel's plates turn by 85° within about 0.8 s."""


def scenes(divisions: tuple[int, int]) -> dict[str, js.Scene]:
    panel = js.scenes.unfolding_panel(divisions)
    mesh, initial = panel.mesh, panel.initial
    assert initial is not None and initial.displacements is not None
    shell = mesh.n_nodes - mesh.points
    nodes, n = mesh.nodes[:shell], shell // 3
    apart = js.Mesh(nodes, mesh.triangles, coincident="allow")
    folded = js.Mesh(nodes + initial.displacements[:shell], mesh.triangles, coincident="allow")
    # About its edge at the hinges that fold it, every other one the other way round.
    turning = [
        (np.arange(k * n, (k + 1) * n), None, (0.0, (-1) ** k * RATE, 0.0), folded.nodes[k * n]) for k in range(3)
    ]
    at_folds = js.Initial.of(folded, *turning)
    at_folds = dataclasses.replace(
        at_folds, displacements=initial.displacements[:shell], rotations=initial.rotations[:shell]
    )
    welded = js.Mesh.merged(nodes, mesh.triangles, 1e-6)
    wave = 0.5 * jnp.sin(jnp.pi * welded.nodes[:, 0] / 1.2)
    struck = js.Initial(velocities=wave[:, None] * jnp.array([0.0, 0.0, 1.0]))
    return {
        "panel that unfolds, six hinges with springs": panel,
        "its plates, apart": js.Scene(apart, panel.section, initial=at_folds),
        "one plate, welded": js.Scene(welded, panel.section, initial=struck),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--divisions", type=int, nargs=2, default=[12, 8])
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--dry", action="store_true", help="print the table, and leave the page as it is")
    options = parser.parse_args()
    found = scenes(tuple(options.divisions))
    dt = js.scenes.unfolding_panel((1, 1)).defaults.dt

    def run(scene):
        begun = time.perf_counter()
        solution = js.simulate(scene, js.EnergyMomentum(), dt=dt, t_end=options.steps * dt, save_every=options.steps)
        steps = solution.stats["wall_time"]
        return steps, time.perf_counter() - begun - steps, solution.stats

    for scene in found.values():
        run(scene)  # compiles
    asked = [{name: run(scene) for name, scene in found.items()} for _ in range(options.rounds)]
    seconds, set_up = ({name: median([answers[name][k] for answers in asked]) for name in found} for k in (0, 1))
    rows = []
    for name, scene in found.items():
        stats = asked[-1][name][2]
        ratios = (f"{seconds[name] / seconds[other]:.2f}" for other in list(found)[1:])
        per_step = (f"{stats[key] / options.steps:.2f}" for key in ("iterations", "factorizations"))
        times = f"{1e3 * seconds[name] / options.steps:.2f}", *ratios
        rows.append([name, str(scene.mesh.n_elements), *times, *per_step, f"{set_up[name]:.2f}"])
    header = ["shell", "elements", "ms/step", "times the plates apart's", "times the welded plate's", "iterations/step",
              "factorizations/step", "set-up s"]  # fmt: skip
    m = machine()
    text = (
        f"{m['processor']}, one core, load {m['load'][0]}; jax {m['versions']['jax']}; {m['commit']}, {m['date']}.\n\n"
        f"{table(header, rows)}"
    )
    print(text)
    if not options.dry:
        fill(PAGE, {"joints": text})


if __name__ == "__main__":
    main()
