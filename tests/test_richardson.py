"""Richardson's extrapolation: exact on powers of the size, silent outside the asymptotic range, and on shells."""

import equinox as eqx
import numpy as np
import pytest
from synthetic import synthetic_solution

import jaxshell as js
from jaxshell.advice import references
from jaxshell.model import generators
from jaxshell.numerics import extrapolation
from jaxshell.numerics.extrapolation import estimate

SIZES = [1.0, 0.5, 0.25]
TIMES = np.linspace(0.0, 1.0, 21)


def powers(order, limit=2.0, factor=0.3, sizes=SIZES):
    return [limit + factor * size**order for size in sizes]


# --- formulas ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [0.8, 1.0, 2.0, 2.9])
@pytest.mark.parametrize("sizes", [SIZES, [1.0, 0.6, 0.2, 0.15]])
def test_limit_order_and_errors_of_a_power_are_exact(order, sizes):
    found = estimate(powers(order, sizes=sizes), sizes)
    assert not found.problem
    assert found.order == pytest.approx(order, rel=1e-8)
    assert float(found.limit) == pytest.approx(2.0, rel=1e-9)
    np.testing.assert_allclose(found.errors, [0.3 * size**order / 2.0 for size in sizes], rtol=1e-8)
    assumed = extrapolation.extrapolated(*powers(order, sizes=sizes)[-2:], 2.0, sizes[-2] / sizes[-1])
    assert found.uncertainty == pytest.approx(max(abs(assumed / 2.0 - 1), 0.25 * found.errors[-1]), rel=1e-6)


def test_two_levels_take_the_order_that_is_given():
    found = estimate(powers(3.0)[1:], [0.5, 0.25], order=3.0)
    assert float(found.limit) == pytest.approx(2.0) and found.order is None
    assert found.uncertainty == pytest.approx(found.errors[-1])


def test_an_order_above_what_can_be_is_not_believed():
    found = estimate([0.5, 0.99, 1.0], SIZES)  # 5.6: the error by it would be 2e-4
    assert found.order > 5 and not found.problem
    assert found.errors[-1] == pytest.approx(0.01 / 3 / found.limit)


def test_a_history_is_measured_by_its_largest_size():
    base, shape = np.sin(5 * TIMES), 0.1 * TIMES * np.cos(3 * TIMES)
    found = estimate([base + size**2 * shape for size in SIZES], SIZES)
    np.testing.assert_allclose(found.limit, base, atol=1e-12)
    np.testing.assert_allclose(found.errors, [size**2 * abs(shape).max() / abs(base).max() for size in SIZES])


@pytest.mark.parametrize(
    "values, why, spread",
    [
        ([1.0, 1.2, 1.1], "oscillate", 0.2 / 1.1),
        ([1.0, 1.1, 1.3], "grow", 0.3 / 1.3),
        ([1.0, 1.1, 1.19], "hardly shrink", 0.19 / 1.19),
        ([1.0, 1.0, 1.1], "grow", 0.1 / 1.1),
        ([1.0, np.nan, 1.1], "not finite", np.nan),
        ([[1.0, 0.0], [1.1, 0.0], [1.1, 0.05]], "another way", 0.1 / 1.1),
    ],
)
def test_levels_outside_the_asymptotic_range_give_no_number(values, why, spread):
    found = estimate(values, SIZES)
    assert why in found.problem
    assert np.all(np.isnan(found.errors)) and np.all(np.isnan(found.limit))
    assert found.uncertainty == pytest.approx(spread, nan_ok=True)


def test_what_does_not_depend_on_the_mesh_has_no_error():
    found = estimate([3.0, 3.0, 3.0 * (1 + 1e-14)], SIZES)
    assert not found.problem and found.order is None and found.errors[0] < 1e-13
    nothing = estimate([0.0, 0.0], SIZES[:2])
    assert nothing.errors.tolist() == [0.0, 0.0] and nothing.uncertainty == 0.0


def test_references_extrapolate_by_the_same_formula():
    coarse, fine = ({"a": np.array([[value]])} for value in powers(2.0)[:2])
    assert references.extrapolate(coarse, fine)["a"].item() == extrapolation.extrapolated(*powers(2.0)[:2])


@pytest.mark.parametrize("sizes", [[1.0], [0.5, 1.0]])
def test_levels_from_coarse_to_fine_are_wanted(sizes):
    with pytest.raises(ValueError, match="from coarse to fine"):
        estimate(sizes, sizes)


# --- families of meshes -----------------------------------------------------------------------------------


def area(scene):
    return js.mass_properties(scene).mass


def bowl(divisions=(4, 4)):
    return js.scenes.hemisphere(divisions)


def exact_mass(scene):
    """Of the quarter of a hemisphere with a hole of 18 degrees."""
    section = scene.section
    return 0.5 * np.pi * 10**2 * np.cos(np.radians(18)) * float(section.thickness * section.density)


@pytest.mark.parametrize("family", [bowl(), bowl, [bowl((n, n)) for n in (2, 4, 8)]], ids=["scene", "function", "list"])
def test_the_area_of_facets_on_a_sphere_is_of_second_order(family):
    found = js.richardson(family, area)
    assert found.elements == (8, 32, 128)
    told = found.mesh["value"]
    exact = exact_mass(bowl())
    assert told.order == pytest.approx(2.0, abs=0.1)
    assert float(told.limit) == pytest.approx(exact, rel=told.uncertainty)
    true = abs(float(told.values[found.level]) / exact - 1)
    assert found.error("value") == pytest.approx(true, rel=0.05)
    assert str(found).startswith("meshes of 8, 32, 128 triangles\nvalue: mesh error ")


def test_entries_of_an_array_are_quantities_and_arrays_of_a_dict_are_one():
    each = js.richardson(bowl, lambda scene: [area(scene), 1.0], coarser=0)
    assert list(each.mesh) == ["[0]", "[1]"]
    assert each.elements == (32, 128) and each.level == 0
    whole = js.richardson(bowl, lambda scene: {"both": [area(scene), 1e-9]}, coarser=0)
    assert whole.error("both") == pytest.approx(each.error("[0]"))


def test_half_the_step_gives_the_steps_error():
    def run(step):
        return lambda scene: area(scene) * (1 + step**2)

    found = js.richardson(bowl(), run(0.1), half_step=run(0.05), coarser=0)
    assert found.step_error("value") == pytest.approx(0.1**2)
    assert found.words("value").endswith(", by two meshes; step error 1 %")


@pytest.mark.parametrize(
    "call, why",
    [
        (lambda: js.richardson(bowl, area, coarser=0, finer=0), "coarser and finer are both 0"),
        (lambda: js.richardson(lambda divisions=(3, 4): bowl(divisions), area), "give coarser=0"),
        (lambda: js.richardson(js.scenes.hemisphere((3, 3)), area), "can not be coarsened"),
        (lambda: js.richardson([bowl((4, 4)), bowl((2, 2))], area), "from coarse to fine"),
        (lambda: js.richardson(bowl, lambda scene: np.ones(scene.mesh.n_nodes)), "one shape on all meshes"),
        (lambda: js.richardson(bowl, area, order=0.0), "order must be"),
    ],
)
def test_what_says_nothing_is_refused(call, why):
    with pytest.raises(ValueError, match=why):
        call()


# --- runs -------------------------------------------------------------------------------------------------


def strip(divisions):
    mesh = generators.rectangle(1.0, 0.5, divisions)
    return js.Scene(mesh, js.Section(0.05, 1e4, 0.3, 1.0), watch={"tip": (mesh.n_nodes - 1, "uz")})


def made_up(steps):
    """An analysis whose watched history is off by 1/m of the mesh, and by 0.1/steps² of the step."""

    def analysis(scene):
        solution = synthetic_solution(scene, steps)
        off = 1 / scene.mesh.n_elements + 0.1 / steps**2
        return eqx.tree_at(lambda s: s.watched, solution, {"tip": (1 + off) * solution.watched["tip"]})

    return analysis


def test_watched_histories_are_compared_at_the_times_that_runs_share():
    found = js.richardson([strip((2, 1)), strip((4, 2))], made_up(12), half_step=made_up(24))
    assert found.times.tolist() == pytest.approx(np.linspace(0, 1, 13))
    assert found.mesh["tip"].values.shape == found.step["tip"].values.shape == (2, 13)
    assert found.error("tip") == pytest.approx(1 / 16 / (1 + 0.1 / 144))
    assert found.step_error("tip") == pytest.approx(0.1 / 144 / (1 + 1 / 16))


def test_runs_that_share_no_times_are_refused():
    steps = iter([12, 17])
    with pytest.raises(ValueError, match="2 times in common: give all of them the same dt"):
        js.richardson([strip((2, 1)), strip((4, 2))], lambda scene: made_up(next(steps))(scene))


def test_a_run_that_failed_and_one_that_watches_nothing_are_refused():
    def failed(scene):
        return eqx.tree_at(lambda s: s.result, _with_message(made_up(12)(scene)), js.RESULTS.diverged)

    with pytest.raises(ValueError, match="The run on the mesh of 4 triangles failed: Step 3"):
        js.richardson([strip((2, 1)), strip((4, 2))], failed)
    bare = js.Scene(strip((2, 1)).mesh, js.Section(0.05, 1e4, 0.3, 1.0))
    with pytest.raises(ValueError, match="watches nothing"):
        js.richardson(bare, synthetic_solution, coarser=0)


def _with_message(solution):
    object.__setattr__(solution, "message", "Step 3 diverged.")
    return solution
