"""The benchmarks run: cases for peers, the workers' protocol, summaries and tables. No timing is asserted."""

import json
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))

from benchmarks import harness, tables, workers  # noqa: E402
from benchmarks.cases import SCENES, write_case  # noqa: E402
from jaxshell.model import Model, structure_of  # noqa: E402
from jaxshell.assembly import nodal_tables  # noqa: E402

ECHO = """
import sys
sys.path.insert(0, {peers!r})
from serve import serve
print("a banner that is no answer")
def run(request):
    print("noise while running")
    if request["steps"] < 0: raise ValueError("negative steps")
    return {{"seconds": 0.5, "iterations": 6, "steps": request["steps"], "converged": True, "version": "1"}}
serve(run)
"""


@pytest.fixture
def echo(tmp_path, monkeypatch):
    script = tmp_path / "echo.py"
    script.write_text(ECHO.format(peers=str(ROOT / "benchmarks" / "peers")))
    monkeypatch.setitem(workers.SCRIPTS, "echo", script)
    worker = workers.Worker("echo", 1)
    yield worker
    worker.close()


def test_worker_answers_in_spite_of_banners_and_noise(echo):
    for steps in (3, 4):
        answer = echo(steps=steps)
        assert answer["steps"] == steps and answer["peak_rss"] > 1


def test_worker_says_why_it_failed(echo):
    with pytest.raises(RuntimeError, match="negative steps"):
        echo(steps=-1)
    assert echo(steps=2)["steps"] == 2  # and lives on


def test_summary_takes_medians_over_rounds():
    runs = [{"seconds": s, "iterations": 8, "steps": 4, "converged": True, "peak_rss": 9.6, "version": "1"}
            for s in (0.3, 0.1, 0.2)]  # fmt: skip
    found = harness.summary(runs[0], runs)
    assert np.isclose(found["ms_per_step"], 50.0) and np.isclose(found["ms_per_iteration"], 25.0)
    assert found["iterations_per_step"] == 2 and found["peak_rss_mb"] == 10 and "compile_seconds" not in found


@pytest.mark.parametrize("name", ["cap", "plate", "opened_cap"])
def test_case_has_the_loads_of_the_scene(name, tmp_path):
    scene = SCENES[name]()
    with np.load(write_case(scene, tmp_path / "case.npz")) as case:
        model = Model.build(scene, nodal_tables(structure_of(scene)))
        for time in (0.0, 0.001, 0.7, 3.0):
            total = sum(
                np.interp(time, case[f"history_{k}_times"], case[f"history_{k}_values"]) * pattern
                for k, pattern in enumerate(case["load_patterns"])
            )
            assert np.allclose(total, model.dead_load(time), rtol=1e-13, atol=0)
        assert case["thickness"].shape == () and len(case["held"]) == len(scene.held_dofs)


def test_harness_runs_a_tiny_scene(tmp_path, monkeypatch, capsys):
    # One method: every further one would only compile again.
    monkeypatch.setattr(harness, "JAXSHELL", {"jaxshell EMC": {"method": "GeneralizedEnergyMomentum"}})
    output = tmp_path / "speed.json"
    assert harness.main(["--smoke", "--output", str(output)]) == 0
    found = json.loads(output.read_text())
    figures = found["results"]["tiny, 1 cores"]["jaxshell EMC"]
    assert figures["converged"] and figures["steps"] == harness.STEPS["tiny"] and figures["elements"] == 18
    assert figures["iterations_per_step"] >= 1 and figures["peak_rss_mb"] > 10
    assert found["machine"]["versions"]["jax"] == jax.__version__
    assert "| tiny | 1 | jaxshell EMC |" in capsys.readouterr().out
    assert "| tiny | 1 | jaxshell EMC |" in tables.speed(found)


def test_page_has_a_place_for_every_table(tmp_path, monkeypatch):
    page = tmp_path / "page.md"
    page.write_text(tables.PAGE.read_text(encoding="utf-8"), encoding="utf-8")
    monkeypatch.setattr(tables, "PAGE", page)
    assert tables.main() == 0
    text = page.read_text(encoding="utf-8")
    for name in ("speed", "scaling", "cold_start", "references", "to_one_percent"):
        assert f"<!-- {name} -->" in text and f"<!-- end {name} -->" in text
    assert "| cap | 0.00025 of 0.00025 |" in text
