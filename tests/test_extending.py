"""docs/extending.md: its code runs as it stands and its answers are right (slow: five programs are compiled for that);
a load and a section touch few files."""

import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxshell as js

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def names(tmp_path_factory) -> dict:
    """The page's namespace, its blocks run one after the other as a reader would paste them."""
    found: dict = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("page"))
        for block in re.findall(r"^```python\n(.*?)^```$", PAGE, flags=re.MULTILINE | re.DOTALL):
            exec(compile(block, "docs/extending.md", "exec"), found)
        found["table"] = Path("tip.csv").read_text().splitlines()
        found["file"] = js.Solution.load("tip.h5")
    return found


@pytest.mark.slow
def test_load(names):
    """The page's load is the public one, and the energy changes by its work (default tolerance of Newton, 1e-8)."""
    scene, flying = names["flying"].scene, names["flying"]
    public = js.NormalForce([1, 2], 0.2, js.History.ramp(0.1))
    same = js.simulate(
        js.Scene(scene.mesh, scene.section, loads=[public], watch=names["watch"]),
        js.EnergyMomentum(),
        dt=0.01,
        t_end=0.5,
    )
    np.testing.assert_allclose(flying.displacements, same.displacements, atol=1e-9 * np.abs(same.displacements).max())
    gained = np.asarray(flying.energy.total - flying.energy.external_work)
    assert np.abs(gained).max() < 1e-7 * np.max(flying.energy.total)
    assert np.max(flying.energy.total) > 5e-3


@pytest.mark.slow
def test_section(names):
    """Two faces apart: bending as a homogeneous plate of the same D, and its derivative by the core."""
    sandwich, mesh = names["sandwich"], names["mesh"]
    found = sandwich.resultants(mesh)
    c = 1e6 / (1 - 0.3**2)
    assert float(found.D[0, 0, 0]) == pytest.approx(c * (0.02**3 - 0.018**3) / 12, rel=1e-12)
    assert float(found.rotary_inertia[0]) == pytest.approx(1000.0 * (0.02**3 - 0.018**3) / 12, rel=1e-12)
    solid = js.Section((12 * float(found.D[0, 0, 0]) / c) ** (1 / 3), 1e6, 0.3, 1.0)
    plain = js.solve_static(
        js.Scene(mesh, solid, [names["edge"]], names["bent"].scene.loads, watch=names["watch"]), [1.0]
    )
    assert float(names["bent"].watched["tip"][-1]) == pytest.approx(float(plain.watched["tip"][-1]), rel=1e-4)

    def tip(core):
        section = names["Sandwich"](js.Section(0.001, 1e6, 0.3, 1000.0), core, 0.0)
        scene = js.Scene(mesh, section, [names["edge"]], names["bent"].scene.loads, watch=names["watch"])
        return js.solve_static(scene, [1.0]).watched["tip"][-1]

    step = 1e-5
    difference = (float(tip(0.018 + step)) - float(tip(0.018 - step))) / (2 * step)
    assert float(jax.grad(tip)(jnp.array(0.018))) == pytest.approx(difference, rel=1e-5)


@pytest.mark.slow
def test_integrator(names):
    """α = 0 is Newmark's trapezoidal rule; -0.1 damps and is near it."""
    kind = names["WoodBossakZienkiewicz"]
    options = {"dt": 0.01, "t_end": 0.5}
    rule = js.simulate(names["shell"], js.Newmark(), **options).watched["tip"]
    np.testing.assert_allclose(js.simulate(names["shell"], kind(0.0), **options).watched["tip"], rule, atol=1e-9)
    apart, size = np.abs(names["damped"].watched["tip"] - rule).max(), np.abs(rule).max()
    assert 1e-6 * size < apart < 1e-2 * size


@pytest.mark.slow
def test_output(names):
    """Every step is a line, also beside a result file; the last line says how the run ended."""
    head, *rows, end = names["table"]
    assert head == "time,tip" and end == "# successful"
    written = np.array([[float(value) for value in row.split(",")] for row in rows])
    np.testing.assert_allclose(written[:, 0], names["file"].times, rtol=1e-8)
    np.testing.assert_allclose(written[:, 1], names["file"].watched["tip"], rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "own", "edited"),
    [
        ("NormalForce", "model/loads/normal_force.py", {"model/loads/__init__.py", "__init__.py"}),
        ("Gravity", "model/loads/gravity.py", {"model/loads/__init__.py", "__init__.py"}),
        ("HHT", "methods/newmark.py", {"methods/__init__.py", "__init__.py"}),
    ],
)
def test_counted_files(name, own, edited):
    """The files of the package that name a load or an integrator: its own, and those of the page's table."""
    package = ROOT / "jaxshell"
    naming = {
        str(path.relative_to(package))
        for path in package.rglob("*.py")
        if path.parent.name != "scenes"  # which use what there is
        and re.search(rf"\b{name}\b", path.read_text(encoding="utf-8"))
    }
    print(f"{name}: new {own}; edited {', '.join(sorted(edited))}")
    assert naming - {"advice/chart.py", "files/run_keys.py", "files/abaqus/model.py"} == {own, *edited}
    for file in edited:
        assert f"`jaxshell/{file}`" in PAGE
