"""The benchmarks: cases for peers, the workers' protocol, summaries and tables. No timing is asserted."""

import json
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))

from benchmarks import harness, stability_map, tables, validation, workers  # noqa: E402
from benchmarks.cases import SCENES, write_case  # noqa: E402

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


# Resultants [N] at a time, from the scenes' definitions: the step force on the quarter; the ramped ring; and the
# plate's line loads 0.8, -0.4 and ±0.4 f over edges of 0.06 and 0.04 m, which cancel in z up to 0.4 f 0.06.
@pytest.mark.parametrize(
    ("name", "time", "resultant"),
    [
        ("cap", 1e-4, [0.0, 0.0, -111.2]),
        ("opened_cap", 0.25, [0.0, 0.0, -12.0]),
        ("opened_cap", 3.0, [0.0, 0.0, -48.0]),
        ("plate", 0.001, [0.8 * 2e4 * 0.06, 0.0, 0.4 * 2e4 * 0.06]),
        ("plate", 0.01, [0.0, 0.0, 0.0]),
    ],
)
def test_case_has_the_loads_of_the_scene(name, time, resultant, tmp_path):
    scene = SCENES[name]()
    with np.load(write_case(scene, tmp_path / "case.npz")) as case:
        total = sum(
            np.interp(time, case[f"history_{k}_times"], case[f"history_{k}_values"]) * pattern
            for k, pattern in enumerate(case["load_patterns"])
        )
        assert np.allclose(total.sum(axis=0), [*resultant, 0.0, 0.0, 0.0], atol=1e-9)
        assert case["thickness"].shape == () and len(case["held"]) == len(scene.held_dofs)


def test_harness_asks_every_program_in_turn(echo, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(workers.SCRIPTS, "jaxshell", workers.SCRIPTS["echo"])
    monkeypatch.setattr(harness, "PEERS", {"peer": ("echo", {"variant": "bossak"})})
    output = tmp_path / "speed.json"
    assert harness.main(["--smoke", "--peers", sys.executable, "--output", str(output)]) == 0
    found = json.loads(output.read_text())
    programs = found["results"]["tiny, 1 cores"]
    assert set(programs) == {*harness.JAXSHELL, "peer"}
    assert programs["peer"]["steps"] == harness.STEPS["tiny"] and programs["peer"]["iterations_per_step"] == 1.5
    assert found["machine"]["versions"]["jax"] == jax.__version__
    for text in (capsys.readouterr().out, tables.speed(found)):
        assert "| tiny | 1 | jaxshell EMC | 125.00 | 1.50 | 83.33 |" in text


@pytest.mark.slow
def test_harness_runs_jaxshell(tmp_path):
    output = tmp_path / "speed.json"
    assert harness.main(["--smoke", "--output", str(output)]) == 0
    for figures in json.loads(output.read_text())["results"]["tiny, 1 cores"].values():
        assert figures["converged"] and figures["elements"] == 18 and figures["iterations_per_step"] >= 1


def test_page_has_a_place_for_every_table(tmp_path, monkeypatch):
    page = tmp_path / "page.md"
    page.write_text(tables.PAGE.read_text(encoding="utf-8"), encoding="utf-8")
    monkeypatch.setattr(tables, "PAGE", page)
    assert tables.main() == 0
    text = page.read_text(encoding="utf-8")
    for name in ("speed", "scaling", "scaling_llvm", "kernels", "cold_start", "references", "to_one_percent"):
        assert f"<!-- {name} -->" in text and f"<!-- end {name} -->" in text
    assert "| cap | 0.00025 of 0.00025 |" in text


def test_validation_fills_its_page(tmp_path, monkeypatch, capsys):
    """Every table has its place; one asked for by name lands in its own, and nothing else moves."""
    page = tmp_path / "page.md"
    before = validation.PAGE.read_text(encoding="utf-8")
    page.write_text(before, encoding="utf-8")
    monkeypatch.setattr(validation, "PAGE", page)
    for name in validation.TABLES:
        assert before.count(f"<!-- {name} -->") == before.count(f"<!-- end {name} -->") == 1
    monkeypatch.setitem(validation.TABLES, "plates", lambda: validation.titled("t", ["mesh", "w"], [["8×8", 0.12345]]))
    monkeypatch.setattr(sys, "argv", ["validation.py", "plates"])
    validation.main()
    table = "**t**\n\n| mesh | w |\n|---|---|\n| 8×8 | 0.1235 |\n"
    head, rest = before.split("<!-- plates -->\n")
    tail = rest.split("<!-- end plates -->")[1]
    assert page.read_text(encoding="utf-8") == f"{head}<!-- plates -->\n{table}<!-- end plates -->{tail}"
    assert table in capsys.readouterr().out


def test_stability_page_is_drawn_from_its_figures(tmp_path):
    """Redrawn from stability_map.json, the page is what it is; from a changed figure it is not."""
    for name in ("stability.md", "stability_map.json"):
        (tmp_path / name).write_bytes((stability_map.DOCS / name).read_bytes())
    stability_map.main(["--redraw", "--output", str(tmp_path)])
    page = (stability_map.DOCS / "stability.md").read_text(encoding="utf-8")
    assert (tmp_path / "stability.md").read_text(encoding="utf-8") == page

    figures = json.loads((tmp_path / "stability_map.json").read_text())
    figures["runs"][0]["end"], figures["runs"][0]["limits"]["6"]["step"] = 0.123, 77
    figures["anatomies"]["Newmark 1/4, 1/2, plate, 0.1 s"][0]["drift"] = 0.5
    (tmp_path / "stability_map.json").write_text(json.dumps(figures))
    stability_map.main(["--redraw", "--output", str(tmp_path)])
    changed = (tmp_path / "stability.md").read_text(encoding="utf-8")
    assert "t = 0.123;" in changed and "| step 77: " in changed and "| 50 | +50 % |" in changed
