"""Long evidence on stability: the quick stability map, and the explicit method against Newmark under refinement."""

import json
from pathlib import Path

import jax
import numpy as np
import pytest

import jaxshell as js

pytestmark = [pytest.mark.slow, pytest.mark.optimised]


def test_newmark_fails_on_the_violent_plate_where_others_survive(tmp_path, monkeypatch):
    """Newmark dies within 800 steps, and its energy, still within 1 %, does not tell; its accelerations do."""
    monkeypatch.syspath_prepend(Path(__file__).parents[1])
    from benchmarks import stability_map

    stability_map.main(["--quick", "--output", str(tmp_path)])
    found = json.loads((tmp_path / "stability_map.json").read_text())
    runs = {row["method"].split()[0]: row for row in found["runs"]}
    assert runs["Newmark"]["how"] in ("diverged", "stagnated")
    assert 500 < runs["Newmark"]["steps"] < 800
    assert runs["generalised"]["how"] == "survived" and -0.1 < runs["generalised"]["drift_end"] < 0.0
    assert runs["EnergyMomentum"]["how"] == "survived"
    assert max(runs["EnergyMomentum"]["drift_max"], -runs["EnergyMomentum"]["drift_min"]) < 1e-5
    (rows,) = found["anatomies"].values()
    doomed = [row for row in rows if row["alternation"] > 1.0]
    assert abs(doomed[0]["drift"]) < 0.01
    assert rows[0]["alternation"] < 0.2
    assert (tmp_path / "stability_map.png").exists() and "stagnated" in (tmp_path / "stability_map.md").read_text()


@pytest.mark.evidence
def test_explicit_and_newmark_agree_as_the_mesh_is_refined():
    """Lumped and consistent mass are different on a mesh; their difference vanishes with h²."""
    differences = []
    for rows in (1, 2, 4):
        columns = 4 * rows
        x, y = (k.ravel() for k in np.meshgrid(np.arange(columns + 1), np.arange(rows + 1), indexing="ij"))
        nodes = np.stack([x / columns, 0.2 * y / rows, 0.0 * x], axis=1)
        end = np.flatnonzero(x == columns)
        load = js.EdgeForce(np.stack([end[:-1], end[1:]], 1), [0.0, 0.0, 5.0], js.History([0.0, 1.0], [0.0, 1.0]))
        scene = js.Scene(
            js.Mesh(nodes, js.structured_triangles(columns, rows)),
            js.Section(0.02, 1e6, 0.3, 1000.0),
            supports=[js.clamped(np.flatnonzero(x == 0))],
            loads=[load],
            watch={"tip": (int(end[0]), "uz")},
        )
        explicit = js.CentralDifference()
        runs = [
            js.simulate(scene, method, dt=dt, t_end=1.0, save_every=100)
            for method, dt in ((explicit, explicit.critical_step(scene)), (js.Newmark(), 2e-3))
        ]
        tips = [float(run.watched["tip"][-1]) for run in runs]
        print(rows, tips)
        differences.append(abs(tips[0] - tips[1]) / abs(tips[1]))
    assert differences[1] < 0.5 * differences[0] and differences[2] < 0.35 * differences[1]


@pytest.mark.parametrize(
    "method",
    [
        js.CentralDifference(),
        *(pytest.param(m, marks=pytest.mark.evidence) for m in (js.GeneralizedAlpha(0.8), js.Bathe())),
    ],
)
def test_gradient_of_a_run_is_its_difference(method):
    """Tip deflection of a cantilever by its thickness: reverse mode against fourth-order differences."""
    x, y = (k.ravel() for k in np.meshgrid(np.arange(3), np.arange(2), indexing="ij"))
    mesh = js.Mesh(np.stack([0.5 * x, 0.2 * y, 0.0 * x], axis=1), js.structured_triangles(2, 1))
    dt = np.full(60, 1.8e-4 if isinstance(method, js.CentralDifference) else 2e-2)

    def tip(thickness):
        scene = js.Scene(
            mesh,
            js.Section(thickness, 1e6, 0.3, 1000.0),
            supports=[js.clamped([0, 1])],
            loads=[js.NodalForce([4], [0.0, 0.1, 0.5])],
            watch={"tip": (4, "uz")},
        )
        return js.simulate(scene, method, dt=dt, newton=js.Newton(tolerance=1e-12)).watched["tip"][-1]

    h, width = 0.02, 2e-5
    f = [float(tip(h + k * width)) for k in (-2, -1, 1, 2)]
    difference = (f[0] - 8.0 * f[1] + 8.0 * f[2] - f[3]) / (12.0 * width)
    assert float(jax.grad(tip)(h)) == pytest.approx(difference, rel=1e-7)
