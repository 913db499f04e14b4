"""The README: its Python runs as it stands, its commands are those that CI runs, its links lead somewhere."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", README, flags=re.MULTILINE | re.DOTALL)


@pytest.mark.slow
def test_the_python_runs(capsys):
    """One block after the other in one namespace, as a reader would paste them."""
    names: dict = {}
    assert len(blocks("python")) == 2
    for block in blocks("python"):
        exec(compile(block, "README.md", "exec"), names)
    first, second = capsys.readouterr().out.splitlines()
    tip, energy = (float(word) for word in first.split())
    assert 1e-3 < tip < 1.0 and energy > 0
    assert tip == pytest.approx(float(names["solution"].watched["tip"][-1]))
    step = 1e-5
    difference = (float(names["tip"](0.02 + step)) - float(names["tip"](0.02 - step))) / (2 * step)
    assert float(second) == pytest.approx(difference, rel=1e-4)


def test_the_first_example_has_ten_lines():
    lines = [line for line in blocks("python")[0].splitlines() if line.strip()]
    assert len(lines) == 10


def test_ci_runs_the_commands_word_for_word():
    script = (ROOT / ".ci" / "run").read_text()
    commands = [block.strip() for block in blocks("sh")]
    assert commands == ["pip install . && jaxshell run cap", "pip install '.[test]' && pytest"]
    for command in commands:
        assert f'step "{command}"' in script


def test_links_and_tests_that_it_names_exist():
    files = re.findall(r"\]\(([^)#:]+)\)", README) + re.findall(r"\b(?:tests|examples|benchmarks)/[\w./]+", README)
    assert len(files) > 8
    missing = [name for name in files if not (ROOT / name).exists()]
    assert not missing
