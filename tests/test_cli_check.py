"""`jaxshell check`, `init`, `schema` and `completion`: what they say, write and refuse."""

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import jax
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)

import jsonschema  # noqa: E402

from jaxshell.command.cli import main  # noqa: E402
from jaxshell.command.completion import SCENES  # noqa: E402
from jaxshell.files.run_keys import KEYS  # noqa: E402
from jaxshell.files.scene_file import read_scene_file  # noqa: E402
from jaxshell.files.schema import schema, schema_text  # noqa: E402
from jaxshell.files.selectors import NODE_SELECTORS  # noqa: E402
from jaxshell.model.generators import rectangle  # noqa: E402
from jaxshell.scenes import BY_NAME  # noqa: E402

ROOT = Path(__file__).parents[1]
PANEL = """
name = "panel"
[mesh]
generator = "rectangle"
length = 2.0
width = 1.0
divisions = [2, 1]
node_sets = { root = { plane = { x = 0.0 } }, tip = { plane = { x = 2.0 } } }
element_sets = { skin = [0, 1] }
side_sets = { rib = { plane = { x = 1.0 }, inner = true } }
[section]
thickness = 0.1
young_modulus = 1e6
poisson_ratio = 0.0
density = 10.0
[[supports]]
nodes = "root"
hold = "clamped"
[[loads]]
kind = "edge force"
edges = "rib"
force = [0.0, 0.0, 3.0]
history = { ramp = 0.5 }
[[loads]]
kind = "pressure"
elements = "skin"
pressure = 2.0
[[initial]]
nodes = "tip"
velocity = [0.0, 0.0, 1.5]
[watch]
end = { nearest = [2.0, 1.0, 0.0], component = "uz" }
[run]
dt = 0.01
t_end = 1.0
"""


def lines_of(text):
    """{first column: the rest} of a report; of several lines of a name the last."""
    return {line[:15].strip(): line[15:] for line in text.splitlines() if line.strip()}


def test_check_says_what_the_scene_is(tmp_path, capsys):
    (tmp_path / "panel.toml").write_text(PANEL)
    assert main(["check", str(tmp_path / "panel.toml"), "--frequencies", "2", "--output", str(tmp_path)]) == 0
    said = lines_of(capsys.readouterr().out)
    assert said["mesh"] == "4 triangles, 6 nodes, 36 degrees of freedom, 24 unknowns"
    assert said["extent"] == "x 0 to 2, y 0 to 1, z 0 to 0; area 2"
    assert said["edges"] == "1 (element 0) to 1.41421 (element 0)"
    assert said["worst shape"] == "element 0: longest edge 2 times its height"
    assert (said["node sets"], said["element sets"], said["side sets"]) == ("root (2), tip (2)", "skin (2)", "rib (1)")
    assert said["mass"] == "2, centre (1, 0.5, 0)"
    assert said["support"] == "clamped: 2 nodes" and said["held"] == "12 degrees of freedom of 2 nodes"
    # 3 on the rib at x = 1, and the pressure 2 on the half 0 <= x <= 1.
    assert said["all loads"] == "force (0, 0, 5), moment about the origin (2.5, -4, 0) at factor 1"
    assert said["at the start"] == "velocity up to 1.5 on 2 nodes"
    assert said["run"] == "in time: EMC to t = 1, dt 0.01: 100 steps"
    assert "period" in said["frequencies"] and "central differences" in said["critical step"]
    assert (tmp_path / "panel_check.png").is_file()


def test_check_refuses_what_a_run_would_refuse(tmp_path, capsys):
    """With what is wrong on standard error, after all that it found."""
    loose = PANEL.replace('hold = "clamped"', 'hold = ["ux", "uy", "uz"]')
    static = PANEL.replace("dt = 0.01\nt_end = 1.0", 'analysis = "static"')
    for text, status, message in (
        (PANEL.replace("dt = 0.01", 'dt = 0.01\nmethod = "CentralDifference"'), 2, "the critical step of CentralDiff"),
        (PANEL.replace("dt = 0.01", 'dt = 0.01\nmethod = "emd"'), 2, "There is no method 'emd'. Did you mean 'EMC'?"),
        (static.replace("clamped", "symmetry x"), 2, "free to move as a rigid body"),
        (loose, 0, ""),
    ):
        (tmp_path / "panel.toml").write_text(text)
        arguments = ["check", str(tmp_path / "panel.toml"), "--frequencies", "0", "--no-plots"]
        assert main(arguments) == status
        said = capsys.readouterr()
        assert message in said.err and "mass" in lines_of(said.out)
    assert "rotation about the axis (0, 1, 0)" in lines_of(said.out)["free motions"]


def test_check_needs_a_scene_that_can_be_read(tmp_path, capsys):
    (tmp_path / "panel.toml").write_text(PANEL.replace('nodes = "root"', 'nodes = "roots"'))
    assert main(["check", str(tmp_path / "panel.toml")]) == 2
    said = capsys.readouterr()
    assert "There is no set of nodes 'roots': those of the mesh are 'root', 'tip'. Did you mean 'root'?" in said.err
    assert not said.out


def test_init_writes_a_scene_that_checks_and_never_overwrites(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["init"]) == 0
    text = Path("scene.toml").read_text()
    assert text.startswith("#:schema ./scene.schema.json\n") and Path("scene.schema.json").read_text() == schema_text()
    assert main(["check", "scene.toml", "--no-plots", "--frequencies", "0"]) == 0
    assert "in time: exact to t = 0.5, dt 0.005: 100 steps" in capsys.readouterr().out
    Path("scene.toml").write_text("mine")
    assert main(["init"]) == 2 and "scene.toml exists: choose another name" in capsys.readouterr().err
    assert Path("scene.toml").read_text() == "mine"
    assert main(["init", "--overwrite", "--no-schema"]) == 0
    assert Path("scene.toml").read_text() == text.removeprefix("#:schema ./scene.schema.json\n")
    assert main(["init", "scene.txt"]) == 2 and "ends with .toml" in capsys.readouterr().err


def test_init_of_a_mesh_file_lists_and_uses_its_sets(tmp_path, capsys, monkeypatch):
    from jaxshell.model.mesh import Mesh

    mesh = rectangle(2.0, 1.0, [2, 1]).with_sets({"the root": [0, 1]}, {"skin": [0, 1]}, {"rim": [[0, 1]]})
    monkeypatch.setattr(Mesh, "read", classmethod(lambda *_, **__: mesh))
    (tmp_path / "part.msh").write_text("read above")
    assert main(["init", str(tmp_path / "sub" / "part.toml"), "--mesh", str(tmp_path / "part.msh")]) == 0
    text = (tmp_path / "sub" / "part.toml").read_text()
    for line in ('# node sets: "the root" (2)', '# element sets: "skin" (2)', '# side sets: "rim" (1)',
                 'file = "../part.msh"', 'nodes = "the root"', 'elements = "skin"', 'edges = "rim"'):  # fmt: skip
        assert line in text.splitlines()
    scene, run = read_scene_file(tmp_path / "sub" / "part.toml")
    assert run.analysis == "modes" and scene.supports[0].nodes.array.tolist() == [0, 1]


# --- the schema ------------------------------------------------------------------------------------------


def problems(text):
    return [error.message for error in jsonschema.Draft7Validator(schema()).iter_errors(tomllib.loads(text))]


def test_the_schema_in_the_docs_is_the_one_that_the_code_has():
    assert (ROOT / "docs" / "scene.schema.json").read_text(encoding="utf-8") == schema_text()
    jsonschema.Draft7Validator.check_schema(json.loads(schema_text()))


def test_what_the_schema_shares_is_there_and_is_used():
    definitions, text = schema()["definitions"], schema_text()
    used = set(re.findall(r'"\$ref": "#/definitions/(\w+)"', text))
    assert used == set(definitions)
    assert len(text) < 100_000  # of everything written out where it stands it is 250 000


def test_every_scene_file_of_the_repository_fits_the_schema():
    template = ROOT / "jaxshell" / "data" / "scene.toml"
    files = [template, *(ROOT / "examples").glob("**/*.toml")]
    assert len(files) > 2
    for file in files:
        assert problems(file.read_text(encoding="utf-8")) == [], file
    assert problems(PANEL) == []


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("thickness = 0.1", "thicknes = 0.1"), ("thickness = 0.1", 'thickness = "0.1"'), ("length", "lenght"),
        ('hold = "clamped"', 'hold = "fixed"'), ("pressure = 2.0", "presure = 2.0"), ('elements = "skin"', "nodes = [1]"),
        ("dt = 0.01", "dtt = 0.01"), ("dt = 0.01", 'analysis = "modes"\ndt = 0.01'), ("dt = 0.01", "load_steps = 3"),
        ('kind = "pressure"', 'kind = "wind"'), ("ramp = 0.5", "ramp = 0.5, times = [0.0]"), ("inner = true", "inner = 1"),
        ("velocity = [0.0, 0.0, 1.5]", "velocity = [0.0, 1.5]"), ('component = "uz"', "component = 3"), ('name = "panel"', "title = 3"),
    ],
)  # fmt: skip
def test_what_is_wrong_does_not_fit_the_schema(right, wrong):
    assert right in PANEL and problems(PANEL.replace(right, wrong, 1))


def test_the_schema_has_every_key():
    text = schema()["properties"]
    assert set(text["run"]["properties"]) == set(KEYS)
    for kind in text["supports"]["items"]["anyOf"]:
        assert set(NODE_SELECTORS) < set(kind["properties"])


# --- completion ------------------------------------------------------------------------------------------


def completed(line):
    """What argcomplete answers for a line, as a shell asks it: by the environment, on file descriptor 8."""
    read, write = os.pipe()
    code = (
        f"import os, sys; os.dup2({write}, 8)\n"
        "from jaxshell.command.cli import main\nmain([])\n"
    )  # fmt: skip
    environment = {**os.environ, "_ARGCOMPLETE": "1", "_ARGCOMPLETE_IFS": "\n", "COMP_LINE": line,
                   "COMP_POINT": str(len(line)), "_ARGCOMPLETE_SHELL": "bash"}  # fmt: skip
    subprocess.run([sys.executable, "-c", code], env=environment, pass_fds=[write], capture_output=True, timeout=60)
    os.close(write)
    with os.fdopen(read) as answer:
        return answer.read().split()


def test_commands_options_and_scenes_are_completed():
    assert completed("jaxshell ch") == ["check", "chart"]
    assert completed("jaxshell run --analysis b") == ["buckling"]
    assert "cap" in completed("jaxshell run c")
    assert tuple(BY_NAME) == SCENES


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_shells_accept_what_completion_prints(shell, capsys, tmp_path):
    assert main(["completion", shell]) == 0
    text = capsys.readouterr().out
    assert "jaxshell" in text
    if shutil.which(shell):
        done = subprocess.run([shell, "-n"], input=text, text=True, capture_output=True)
        assert done.returncode == 0, done.stderr


@pytest.mark.skipif(not shutil.which("bash"), reason="needs bash")
def test_bash_completes_after_the_script_is_sourced(tmp_path):
    """Through bash's own machinery: the function that the script registers, called as bash calls it."""
    program = tmp_path / "jaxshell"
    program.write_text(f"#!{sys.executable}\nfrom jaxshell.command.cli import main\nraise SystemExit(main())\n")
    program.chmod(0o755)
    script = f"""
export PATH={tmp_path}:$PATH
eval "$(jaxshell completion bash)"
COMP_LINE='jaxshell sch'; COMP_POINT=${{#COMP_LINE}}; COMP_WORDS=(jaxshell sch); COMP_CWORD=1; COMP_TYPE=9
_python_argcomplete jaxshell
printf '%s\\n' "${{COMPREPLY[@]}}"
"""
    done = subprocess.run(["bash", "-c", script], text=True, capture_output=True, timeout=120)
    assert done.stdout.split() == ["schema"], done.stderr


def test_lengths_that_vanish_are_zero_in_reports():
    from jaxshell.command.path_report import vector

    assert vector(np.array([1.0, 1e-17, -2.5])) == "(1, 0, -2.5)"
