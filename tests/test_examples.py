"""Every example runs, and its assertion holds."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import jaxshell as js
from jaxshell import scenes
from jaxshell.command.cli import main

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))


@pytest.mark.slow
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example(path, tmp_path):
    # In a process of its own, as a user runs it; pictures land in tmp_path.
    environment = {**os.environ, "PYTHONPATH": str(path.parents[1])}
    done = subprocess.run([sys.executable, str(path)], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
def test_scene_file_with_a_record(tmp_path):
    """The other scene files run in test_scene_file.py and test_section_files.py."""
    scene = EXAMPLES[0].with_name("shaken_plate.toml")
    assert main(["run", str(scene), "--no-plots", "--quiet", "--output", str(tmp_path)]) == 0
    run = js.Solution.load(tmp_path / "shaken_plate.h5")
    base = 20.0 * scenes.shaken_plate().supports[0].history.double_integral(run.times)
    np.testing.assert_allclose(run.watched["base"], base, atol=1e-15)
    assert 0.016 < np.abs(run.watched["tip"] - run.watched["base"]).max() < 0.02
