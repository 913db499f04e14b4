"""Which members a sweep has, what it refuses, and statistics and files of sweeps that were not run."""

import contextlib

import h5py
import jax
import numpy as np
import pytest
from scipy import stats

jax.config.update("jax_enable_x64", True)

import tomllib  # noqa: E402

from strip import STRIP  # noqa: E402

import jaxshell as js  # noqa: E402
from jaxshell.analyses.sweep.design import design  # noqa: E402
from jaxshell.analyses.sweep.varied import varied  # noqa: E402
from jaxshell.files.dotted import paths_of, with_values  # noqa: E402
from jaxshell.results.sensitivities import sensitivities_of  # noqa: E402
from jaxshell.results.sweep_file import SweepWriter, rows_of, sweep_of  # noqa: E402

CONTENT = tomllib.loads(STRIP)


def made(sample="grid", seed=0, **texts):
    return design({name: varied(name, text) for name, text in texts.items()}, sample, seed)


def test_a_grid_has_every_combination_the_last_parameter_running_fastest():
    plan = made(a="1:3:3", b="10,20", c="EMC,exact")
    assert plan.size == 12
    assert plan.member(1) == {"a": 1.0, "b": 10.0, "c": "exact"}
    assert {tuple(plan.member(k).values()) for k in range(12)} == {
        (a, b, c) for a in (1.0, 2.0, 3.0) for b in (10.0, 20.0) for c in ("EMC", "exact")
    }


def test_zip_takes_values_side_by_side():
    plan = made("zip", a="1,2,3", b="5:7:3")
    assert [plan.member(k) for k in range(3)] == [{"a": 1, "b": 5}, {"a": 2, "b": 6}, {"a": 3, "b": 7}]
    with pytest.raises(ValueError, match=r"a has 3, b has 2"):
        made("zip", a="1,2,3", b="5,7")


def test_a_latin_hypercube_has_a_member_in_every_stratum_and_follows_its_seed():
    plan = made("latin:50", seed=3, a="2:4", b="normal(10, 2)")
    strata = np.sort((plan.parameters["a"] - 2) / 2 * 50).astype(int)
    np.testing.assert_array_equal(strata, np.arange(50))
    np.testing.assert_array_equal(np.sort(stats.norm(10, 2).cdf(plan.parameters["b"]) * 50).astype(int), np.arange(50))
    again, other = made("latin:50", seed=3, a="2:4", b="normal(10, 2)"), made("latin:50", seed=4, a="2:4", b="1:2")
    np.testing.assert_array_equal(again.parameters["b"], plan.parameters["b"])
    assert not np.array_equal(other.parameters["a"], plan.parameters["a"])


@pytest.mark.parametrize("sample", ["sobol:256", "random:4000", "latin:400"])
@pytest.mark.parametrize(
    ("text", "mean", "deviation"),
    [
        ("uniform(0.3, 0.5)", 0.4, 0.2 / 12**0.5),
        ("normal(0.4, 0.02)", 0.4, 0.02),
        ("lognormal(0.4, 0.1)", 0.4, 0.1),
        ("triangular(0, 0.3, 0.6)", 0.3, 0.6 / 24**0.5),
        ("0.3:0.5:7", 0.4, 0.2 / 12**0.5),
    ],
)
def test_samples_have_the_moments_of_their_distributions(sample, text, mean, deviation):
    values = made(sample, a=text, b="0:1").parameters["a"]
    assert abs(values.mean() - mean) < 4 * deviation / len(values) ** 0.5
    assert abs(values.std() / deviation - 1) < 0.1


def test_a_truncated_normal_stays_within_its_ends():
    values = made("random:500", a="truncated(1, 0.5, 0.9, 1.2)", b="0:1").parameters["a"]
    assert 0.9 <= values.min() < 0.91 and 1.19 < values.max() <= 1.2


@pytest.mark.parametrize(
    ("sample", "texts", "said"),
    [
        ("grid", {"a": "1:2:0"}, "a: a range has at least 1 value"),
        ("grid", {"a": "1:2:-3"}, "at least 1 value"),
        ("grid", {"a": "1:2:2.5"}, "whole number"),
        ("grid", {"a": "1:b:3"}, "low:high:n"),
        ("grid", {"a": "1:2"}, "latin:200"),
        ("grid", {"a": "1,,2"}, "empty value"),
        ("grid", {"a": "1,steel"}, "mixes numbers with texts"),
        ("grid", {"a": "normal(1, 2)"}, "Say how it is sampled"),
        ("latin:9", {"a": "gauss(1, 2)"}, "no distribution 'gauss'.*uniform, normal"),
        ("latin:9", {"a": "normal(1)"}, r"normal\(mean, deviation\)"),
        ("latin:9", {"a": "normal(1, 0)"}, "positive deviation"),
        ("latin:9", {"a": "uniform(2, 1)"}, "low < high"),
        ("latin", {"a": "1:2"}, "latin needs the number of its members"),
        ("latin:0", {"a": "1:2"}, "latin needs the number"),
        ("sobol:100", {"a": "1:2"}, "sobol:64 or sobol:128"),
        ("saltelli:8", {"a": "1:2"}, "use latin or sobol"),
        ("cubes:3", {"a": "1:2"}, "one of grid, zip, random:N"),
        ("grid", {"a": "1:2:2000", "b": "1:2:2000"}, "4,000,000 members, and at most 1,000,000"),
        ("random:2000000", {"a": "1:2"}, "at most 1,000,000"),
    ],
)
def test_what_is_no_sweep_is_refused_by_name(sample, texts, said):
    with pytest.raises(ValueError, match=said):
        made(sample, **texts)


def test_dotted_paths_count_from_one_and_leave_the_content_as_it_is():
    changed = with_values(CONTENT, {"section.thickness": 0.03, "loads.1.force.3": np.float64(2), "run.save_every": 4.0})
    assert changed["section"]["thickness"] == 0.03 and changed["loads"][0]["force"] == [0.0, 0.0, 2.0]
    assert CONTENT["section"]["thickness"] == 0.02 and CONTENT["loads"][0]["force"] == [0.0, 0.0, 1.0]
    whole = with_values(CONTENT, {"mesh.divisions.1": 3.0, "section.density": 900.5})
    assert whole["mesh"]["divisions"] == [3, 1] and isinstance(whole["mesh"]["divisions"][0], int)
    assert whole["section"]["density"] == 900.5
    doubled = with_values(
        CONTENT, {"loads.1.force": 2.0, "section.thickness": 1.5}, frozenset(["loads.1.force", "section.thickness"])
    )
    assert doubled["loads"][0]["force"] == [0.0, 0.0, 2.0] and doubled["section"]["thickness"] == 0.03
    assert with_values(CONTENT, {"run.method": "EMC"})["run"]["method"] == "EMC"
    assert "loads.1.force.3" in set(paths_of(CONTENT))


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("section.thicknes", 1.0, r"no key 'section.thicknes'.*Is it section.thickness.*mesh.length"),
        ("loads.0.force.3", 1.0, r"no key 'loads.0.force.3'"),
        ("loads.2.force.3", 1.0, r"no key"),
        ("run.dtt", 1.0, r"no key 'run.dtt'"),
        ("section", 1.0, "section is a table.*thickness"),
        ("loads.1.force", 1.0, r"not one number.*loads.1.force.1.*x0.9:1.1:5"),
        ("name", 1.0, "takes texts only"),
        ("section.thickness", "steel", "cannot be the text 'steel'"),
    ],
)
def test_a_path_that_names_no_number_is_refused(path, value, said):
    with pytest.raises(ValueError, match=said):
        with_values(CONTENT, {path: value})


# --- statistics ------------------------------------------------------------------------------------------


def ishigami(x):
    return np.sin(x[0]) + 7 * np.sin(x[1]) ** 2 + 0.1 * x[2] ** 4 * np.sin(x[0])


def test_sobol_indices_of_the_ishigami_function():
    """Ishigami & Homma 1990, a = 7, b = 0.1: S = 0.3139, 0.4424, 0; S_T = 0.5576, 0.4424, 0.2437."""
    plan = made("saltelli:1024", **dict.fromkeys("abc", f"uniform({-np.pi}, {np.pi})"))
    assert plan.size == 5 * 1024
    y, usable = ishigami(list(plan.parameters.values())), np.ones(plan.size, bool)
    found = sensitivities_of("saltelli", plan.parameters, {"y": y}, usable)
    np.testing.assert_allclose(found.values["y"], [0.3139, 0.4424, 0.0], atol=0.03)
    np.testing.assert_allclose(found.total["y"], [0.5576, 0.4424, 0.2437], atol=0.03)
    f_A, f_B, *f_AB = y.reshape(5, 1024)
    theirs = {"f_A": f_A[None], "f_B": f_B[None], "f_AB": np.stack(f_AB)[:, None]}
    peer = stats.sobol_indices(func=theirs, n=1024)
    np.testing.assert_allclose(found.values["y"], peer.first_order.ravel(), atol=1e-12)
    np.testing.assert_allclose(found.total["y"], peer.total_order.ravel(), atol=1e-12)
    usable[17] = False  # a base point less
    fewer = sensitivities_of("saltelli", plan.parameters, {"y": np.where(usable, y, np.nan)}, usable)
    assert fewer.members == 5 * 1023
    np.testing.assert_allclose(fewer.values["y"], [0.3139, 0.4424, 0.0], atol=0.03)


def test_main_effects_of_a_grid_are_exact():
    """y = x + 2 z + x z on {-1, 1}²: variance 6, of which x explains 1/6, z 4/6."""
    plan = made(x="-1,1", z="-1,1")
    x, z = plan.parameters.values()
    found = sensitivities_of("grid", plan.parameters, {"y": x + 2 * z + x * z}, np.ones(4, bool))
    np.testing.assert_allclose(found.values["y"], [1 / 6, 4 / 6], rtol=1e-12)


def test_regression_tells_a_linear_function_from_another():
    plan = made("latin:400", a="normal(0, 1)", b="normal(5, 3)")
    a, b = plan.parameters.values()
    responses = {"linear": 4 * a - b, "square": a**2, "constant": 0 * a + 1.0}
    found = sensitivities_of("latin", plan.parameters, responses, np.ones(400, bool))
    np.testing.assert_allclose(found.values["linear"], [0.8, -0.6], atol=0.02)
    assert found.r_squared["linear"] == pytest.approx(1, abs=1e-12) and found.r_squared["square"] < 0.1
    assert np.isnan(found.values["constant"]).all()


def test_what_a_design_cannot_tell_is_refused():
    together = made("zip", a="1,2,3,4,5", b="2,4,6,8,10")
    y, usable = {"y": np.arange(5.0)}, np.ones(5, bool)
    with pytest.raises(ValueError, match="a, b go together"):
        sensitivities_of("zip", together.parameters, y, usable)
    with pytest.raises(ValueError, match=r"3 members.*4 are the least"):
        sensitivities_of("zip", together.parameters, y, np.arange(5) < 3)
    with pytest.raises(ValueError, match="has texts: vary it in a grid"):
        sensitivities_of("zip", made("zip", a="1,2,3,4,5", b="p,q,r,s,t").parameters, y, usable)


# --- files -----------------------------------------------------------------------------------------------


def synthetic(size=5, k=4) -> js.Sweep:
    """A sweep whose member i has the history i t; the last has not been run, the one before has failed."""
    scene = js.scenes.spherical_cap(divisions=1)
    scene = js.Scene(scene.mesh, scene.section, scene.supports, watch={"apex": (0, "uz")}, name="cap")
    n, t = np.arange(size, dtype=float), np.linspace(0, 1, k)
    table = {name: n[:, None].copy() for name in ("minimum", "maximum", "time_of_minimum", "time_of_maximum", "end")}
    table |= {"watched": n[:, None, None] * t, "energy": np.outer(n, np.arange(4.0)), "energy_balance": n / 100}
    table |= {"quantity work": n**2, "steps": np.full(size, k - 1)}
    table["result"] = np.array(["successful"] * (size - 2) + ["diverged", ""])
    table["watched"][-2, :, 2:] = np.nan
    for values in table.values():
        if values.dtype.kind == "f":
            values[-1] = np.nan
    table["steps"][-1] = 0
    settings = {"kind": "zip", "labels": ["apex"], "quantities": ["work"], "sample": "zip", "method": "Newmark()"}
    parameters = {"section.thickness": 1 + n, "run.method": np.array(list("abcde")[:size])}
    return sweep_of(scene, settings, parameters, t, table, {size - 2: "Step 2: it diverged."})


def test_statistics_are_of_the_members_that_ended():
    sweep = synthetic()
    np.testing.assert_allclose(sweep.mean()["apex"], sweep.times)
    np.testing.assert_allclose(sweep.deviation()["apex"], sweep.times)
    np.testing.assert_allclose(sweep.quantile([0.0, 0.5, 1.0])["apex"], np.outer([0, 1, 2], sweep.times))
    assert sweep.failures() == {"diverged": 1} and sweep.done.sum() == 4
    assert list(sweep.responses()) == ["apex min", "apex max", "apex end", "work"]
    with pytest.raises(ValueError, match=r"no quantity 'tip'.*apex min"):
        sweep.sensitivities(["tip"])
    with pytest.raises(ValueError, match=r"quantile lies in \[0, 1\]"):
        sweep.quantile(95.0)


def test_a_saved_sweep_comes_back(tmp_path):
    sweep, path = synthetic(), tmp_path / "a.h5"
    sweep.save(path)
    found = js.Sweep.load(path)
    assert found.settings == {**sweep.settings, "labels": ("apex",), "quantities": ("work",)}
    for name in ("result", "times", "steps", "energy_balance"):
        np.testing.assert_array_equal(getattr(found, name), getattr(sweep, name))
    for name in ("parameters", "watched", "minimum", "maximum", "end", "energy", "quantities"):
        for key, values in getattr(sweep, name).items():
            np.testing.assert_array_equal(getattr(found, name)[key], values, err_msg=f"{name} {key}")
    assert found.messages == sweep.messages and found.scene.name == "cap"
    with pytest.raises(ValueError, match="holds a sweep"):
        sweep.save(path)
    sweep.save(path, overwrite=True)


def test_a_file_that_is_being_written_stays_and_can_be_read(tmp_path):
    sweep, path = synthetic(), tmp_path / "a.h5"
    with contextlib.closing(SweepWriter(path, sweep.scene, sweep.settings, sweep.parameters, sweep.times)) as writer:
        rows = rows_of(sweep)
        writer.append({name: values[:2] for name, values in rows.items()})
        assert list(js.Sweep.load(path).done) == [True, True, False, False, False]
        with pytest.raises(ValueError, match="in use"):
            sweep.save(path, overwrite=True)
        writer.append({name: values[2:] for name, values in rows.items()})
    np.testing.assert_array_equal(js.Sweep.load(path).result, sweep.result)


def test_other_files_are_no_sweeps(tmp_path):
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["a"] = [1.0]
    with pytest.raises(ValueError, match="no sweep"):
        js.Sweep.load(tmp_path / "other.h5")
    with pytest.raises(ValueError, match="holds no sweep that can go on"):
        synthetic().save(tmp_path / "other.h5")
    with pytest.raises(FileNotFoundError):
        js.Sweep.load(tmp_path / "none.h5")
    with pytest.raises(ValueError, match="no folder"):
        synthetic().save(tmp_path / "nowhere" / "a.h5")


def test_a_flipped_byte_of_a_sweep_is_an_error_or_counts_for_nothing(tmp_path):
    path, random = tmp_path / "a.h5", np.random.default_rng(0)
    synthetic().save(path)
    content, whole, seen = path.read_bytes(), js.Sweep.load(path), 0
    for at in random.integers(0, len(content), 60):
        flipped = bytearray(content)
        flipped[at] ^= 1 << int(random.integers(8))
        path.write_bytes(flipped)
        try:
            found = js.Sweep.load(path)
        except ValueError:
            seen += 1
            continue
        np.testing.assert_array_equal(found.watched["apex"], whole.watched["apex"])
        np.testing.assert_array_equal(found.parameters["section.thickness"], whole.parameters["section.thickness"])
        np.testing.assert_array_equal(found.result, whole.result)
        assert found.messages == whole.messages
    assert seen > 10


def test_pictures_of_a_sweep(tmp_path):
    from jaxshell.plotting.ensembles import plot_sweep, sweep_figures

    sweep = synthetic(5)
    paths = plot_sweep(sweep, tmp_path, "cap")
    assert [path.name for path in paths] == ["cap_quantiles.png", "cap_scatter.png"]  # texts have no regression
    figures = sweep_figures(sweep)
    panel = figures["quantiles"].axes[0]
    median = next(line for line in panel.get_lines() if line.get_label() == "median")
    np.testing.assert_allclose(median.get_ydata(), sweep.times)
    assert "cap, Newmark: 3 members (zip)" in figures["quantiles"].get_suptitle()
