"""References, errors, charts and advice: the figures of merit, the search, what is said and written."""

import tomllib
import types

import jax
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)

import jaxshell as js  # noqa: E402
from jaxshell.advice import advise as advising  # noqa: E402
from jaxshell.advice import chart as charting  # noqa: E402
from jaxshell.advice import references  # noqa: E402
from jaxshell.advice.chart import Configuration, Point  # noqa: E402
from jaxshell.advice.references import Reference  # noqa: E402
from jaxshell.advice.text import command_line, describe, run_section  # noqa: E402
from jaxshell.command.cli import main  # noqa: E402
from jaxshell.files.run_keys import KEYS  # noqa: E402
from jaxshell.numerics.rotations import exp  # noqa: E402
from jaxshell.plotting import work_precision  # noqa: E402

TIMES = np.linspace(0.0, 2.0, 41)
SINE = Reference(TIMES, {"apex": np.sin(TIMES)[:, None]}, 1e-6, "a sine")


def cap():
    return js.scenes.spherical_cap(divisions=2)


# --- figures of merit --------------------------------------------------------------------------------------


def test_error_is_the_largest_distance_over_the_largest_size():
    scene = cap()
    times = np.array([0.0, 0.33, 1.01, 1.9])  # between the reference's own
    displacements = np.zeros((4, scene.mesh.n_nodes, 3))
    displacements[:, 0, 2] = np.sin(times) + np.array([0.0, 0.0, -0.02, 0.01])
    error = references.error(scene, SINE, times, displacements)
    assert np.isclose(error, 0.02 / np.sin(TIMES).max(), rtol=1e-3)
    beyond = np.append(times, 3.0)  # what the reference does not cover is not judged
    assert references.error(scene, SINE, beyond, np.append(displacements, displacements[:1] + 9, 0)) == error
    shared = np.append(TIMES[:4], 0.12)  # where both have values, those between do not count
    wild = np.zeros((5, scene.mesh.n_nodes, 3))
    wild[:, 0, 2] = np.append(np.sin(TIMES[:4]), 7.0)
    assert references.error(scene, SINE, shared, wild) < 1e-12
    displacements[2] = np.nan
    assert references.error(scene, SINE, times, displacements) == np.inf


@pytest.mark.wrong_types  # stand-ins for runs
def test_plate_is_judged_by_centre_orientation_and_tip():
    scene = js.scenes.free_plate((3, 1))
    x0 = np.asarray(scene.mesh.nodes)
    weights = references.nodal_weights(scene)
    assert np.isclose(weights.sum(), 1.0) and np.allclose(weights @ x0, [0.15, 0.03, 0.0])
    turns = [np.asarray(exp(np.array(v))) for v in ([0.0, 0.0, 0.0], [1.0, 2.0, -0.5], [1.0, 2.0, -0.5 + 1e-3])]
    moved = np.stack([x0 @ turn.T + [1.0, 2.0, 3.0] - x0 for turn in turns])
    found = references.signals(scene, moved)
    assert np.allclose(found["centre"][0], [1.0, 2.0, 3.0])
    # Rows are matrices over √2, so that their distance is the angle between them.
    orientation = found[references.ORIENTATION] * np.sqrt(2)
    assert np.allclose(orientation, np.stack(turns).reshape(3, 9), atol=1e-12)
    relative = turns[1].T @ turns[2]
    angle = np.arccos((np.trace(relative) - 1) / 2)
    distance = np.linalg.norm(found[references.ORIENTATION][1] - found[references.ORIENTATION][2])
    assert np.isclose(distance, angle, rtol=1e-6)


def test_extrapolation_removes_the_leading_error():
    coarse, fine, finer = ({"u": np.array([[1.0 + 3 * h**2 + 5 * h**4]])} for h in (0.4, 0.2, 0.1))
    second = [references.extrapolate(*pair) for pair in ((coarse, fine), (fine, finer))]
    fourth = references.extrapolate(*second, order=4)
    assert abs(float(fourth["u"][0, 0]) - 1.0) < 1e-14 < abs(float(second[1]["u"][0, 0]) - 1.0)


def test_agreement_grows_with_time():
    one, other = {"u": np.array([[1.0], [2.0], [4.0]])}, {"u": np.array([[1.0], [2.2], [4.1]])}
    assert np.allclose(references.agreement(np.arange(3), one, other), [0.0, 0.2 / 4.1, 0.2 / 4.1])


def test_shipped_reference_is_of_the_default_scene_only():
    reference = references.shipped_reference(js.scenes.spherical_cap())
    assert reference is not None and reference.uncertainty <= 1e-4
    deflection = reference.signals["apex"][:, 0] / -0.002182
    at = np.searchsorted(reference.times, 1e-4 - 1e-12)
    # Yang & Xia's figure 5 and this code at dt = 2e-6 (2.2524) have the largest deflection near here.
    assert np.isclose(deflection[at], 2.25, atol=0.15)
    assert references.shipped_reference(js.scenes.spherical_cap(9)) is None
    assert references.shipped_reference(js.scenes.spherical_cap(force=400.0)) is None


# --- the chart ---------------------------------------------------------------------------------------------


def point(label, dt, seconds, error, kind="method"):
    return Point(kind, label, dt, seconds, error, 10, 20)


def test_pareto_front():
    points = [point("a", 1, 1.0, 0.1), point("b", 1, 2.0, 0.2), point("c", 1, 3.0, 0.01), point("d", 1, 0.5, np.inf)]
    assert [p.label for p in work_precision.pareto(points)] == ["a", "c"]


def test_picture_shows_methods_choices_and_peers(tmp_path):
    points = [point("EMC", dt, 1 / dt, dt**2) for dt in (1.0, 0.5)]
    points += [point("KLU", 0.5, 3.0, 0.25, "linear solver"), point("broken", 1.0, 1.0, np.inf)]
    figure = work_precision.draw("a scene", points, [point("Kratos", 1.0, 30.0, 0.9)], floor=1e-5)
    left, right = figure.axes
    assert {"EMC", "Kratos"} <= set(left.get_legend_handles_labels()[1])
    assert "KLU" in right.get_legend_handles_labels()[1]
    assert left.get_xscale() == right.get_yscale() == "log"
    charting.write_points(tmp_path / "points.json", cap(), points, SINE)
    assert '"error": null' in (tmp_path / "points.json").read_text()


def test_every_kind_of_choice_is_charted():
    kinds = {c.kind for c in charting.configurations(cap(), 2e-6, 1e-4)}
    assert kinds == {"method", "step control", "inertia", "tangent", "newton", "linear solver"}


def test_divisions_of_a_library_scene():
    assert charting.divided(js.scenes.spherical_cap, 0.6) == 6
    assert charting.divided(js.scenes.free_plate, 0.5) == (8, 2)
    assert charting.divided(js.scenes.free_plate, 0.01) == (1, 1)


@pytest.mark.wrong_types  # stand-ins for runs
def test_meshes_are_compared_with_the_finest(monkeypatch):
    """A deflection with an error of 1/divisions² shows it, less that of the finest."""
    times = np.linspace(0.0, 1.0, 9)

    def timed(scene, tried, t_end):
        divisions = round((scene.mesh.n_elements / 2) ** 0.5)
        displacements = np.zeros((9, scene.mesh.n_nodes, 3))
        displacements[:, 0, 2] = times * (1.0 + divisions**-2.0)
        stats = {"steps": 8, "iterations": 16}
        run = types.SimpleNamespace(
            scene=scene, message="", frame_times=times, displacements=displacements, stats=stats, times=times
        )
        return run, 1e-3 * scene.mesh.n_elements

    monkeypatch.setattr(charting, "timed", timed)
    points = charting.mesh_points(js.scenes.spherical_cap, 2e-6, 1.0, say=lambda _: None)
    assert [p.label for p in points] == ["32 triangles", "72 triangles", "200 triangles", "512 triangles"]
    finest = 1.0 + 25.0**-2
    expected = [(n**-2.0 - 25.0**-2) / finest for n in (4, 6, 10, 16)]
    assert np.allclose([p.error for p in points], expected)
    assert "Triangles, against the finest mesh" in [
        axes.get_title() for axes in work_precision.draw("cap", points).axes
    ]


# --- the search --------------------------------------------------------------------------------------------

GEM = js.GeneralizedEnergyMomentum


class Asked(list):
    """What was asked for; one may set what step control costs a step, and the elements that an answer needs."""

    control_cost: list[float]
    enough: list[int]


@pytest.fixture
def pretend(monkeypatch):
    """Second-order methods with known constants and costs instead of runs; returns what was asked for."""
    asked, control_cost, enough = Asked(), [100.0], [0]
    constants = {"good": (1.0, 1.0), "light": (1.1, 0.6), "poor": (50.0, 1.0), "biased": (1.0, 0.1)}

    def measure(scene, tried: Configuration, reference) -> Point:
        asked.append(tried)
        if isinstance(tried.dt, js.StepControl):
            steps = round(0.2 * tried.dt.tolerance ** (-1 / 3))
            return Point(tried.kind, tried.label, 2.0 / steps, control_cost[0] * steps, 4.0 / steps**2, steps, steps)
        constant, cost = constants[tried.label.split(",")[0]]
        loose = float(tried.newton.tolerance)
        error = constant * tried.dt**2 + (0.5 if tried.label == "biased" else 0.0) + (0.3 if loose > 1e-5 else 0.0)
        error += 0.3 if scene.mesh.n_elements < enough[0] else 0.0
        effort = (0.5 if loose > 1e-7 else 1.0) ** (loose > 1e-8) * (1.0 if tried.newton.reuse else 1.5)
        steps = round(2.0 / tried.dt)
        effort *= scene.mesh.n_elements / cap().mesh.n_elements
        return Point(tried.kind, tried.label, tried.dt, cost * effort * steps, error, steps, 2 * steps)

    names = [("good", GEM()), ("light", GEM(inertia="none")), ("poor", js.Newmark()), ("biased", js.Bathe())]
    monkeypatch.setattr(advising, "measure", measure)
    monkeypatch.setattr(advising, "candidates", lambda: names)
    monkeypatch.setattr(advising, "inertia_change", lambda *_: 3e-5)
    asked.control_cost, asked.enough = control_cost, enough
    return asked


def test_cheapest_that_meets_the_tolerance(pretend):
    advice = advising.advise(cap(), 0.1, dt=1.0, say=lambda _: None, reference=SINE)
    best = advice.best
    # 1.1 · 0.25² = 0.069 is the largest of the halvings below 0.8 · 0.1.
    assert advice.met and best.dt == 0.25 and best.method == GEM(inertia="none")
    assert float(best.newton.tolerance) == 1e-6 and best.newton.reuse
    text = describe(cap(), advice)
    for words in (
        "rotary inertia changes the answer by 3.0e-05: left out",
        "dt = 0.5 would miss",
        "Newton to 1e-06 is enough",
        "Newton to 0.0001 instead of 1e-06: error 3.7e-01",
        "js.GeneralizedEnergyMomentum(inertia='none'), dt=0.25, t_end=..., newton=js.Newton(tolerance=1e-06))",
    ):
        assert words in text
    # Dear methods are given up before they are refined to the end.
    assert min(c.dt for c in pretend if c.label == "poor") > 0.03 and "poor: at dt" in text


def test_steps_are_doubled_while_they_meet_it(pretend):
    advice = advising.advise(cap(), 0.1, dt=0.01, say=lambda _: None, reference=SINE)
    assert np.isclose(advice.best.dt, 0.16) and advice.met


def test_steps_are_not_doubled_past_what_the_trial_shows(pretend):
    """Where any step meets the tolerance, eight of them are left in the trial."""
    window = float(SINE.times[-1])
    advice = advising.advise(cap(), 0.99, dt=window / 1000, say=lambda _: None, reference=SINE)
    assert advice.met and window / 16 < advice.best.dt <= window / 8
    assert any(reason.startswith("larger steps were not tried: the trial has ") for reason in advice.reasons)


def test_tolerance_that_nothing_meets(pretend, monkeypatch):
    monkeypatch.setattr(advising, "candidates", lambda: [("biased", js.Bathe())])
    monkeypatch.setattr(advising._Search, "try_step_control", lambda *_: None)
    advice = advising.advise(cap(), 0.1, dt=1.0, say=lambda _: None, reference=SINE)
    assert not advice.met and advice.reasons[0].startswith("Nothing tried meets 0.1; the most accurate")


def test_step_control_where_it_is_cheapest(pretend):
    pretend.control_cost[0] = 0.1
    advice = advising.advise(cap(), 0.1, dt=1.0, say=lambda _: None, reference=SINE)
    assert isinstance(advice.best.dt, js.StepControl)
    tolerance = advice.best.dt.tolerance
    assert f"js.StepControl({tolerance:g}, initial=1)" in describe(cap(), advice)
    assert f"--dt 1 --step-tolerance {tolerance:g}" in command_line("cap", advice)
    run = tomllib.loads(run_section(cap(), advice))["run"]
    assert set(run) <= set(KEYS) and run["step_tolerance"] == pytest.approx(tolerance)


@pytest.mark.wrong_types  # stand-ins for runs
def test_fewer_elements_where_they_suffice(pretend, monkeypatch):
    """Of 10 divisions 8 and 6 are enough, 5 are not; what a finer mesh would change is said."""
    still = types.SimpleNamespace(message="", frame_times=TIMES, scene=cap(), displacements=np.zeros((41, 9, 3)))
    monkeypatch.setattr(advising, "timed", lambda *_: (still, 1.0))
    pretend.enough[0] = 72
    make = js.scenes.spherical_cap
    advice = advising.advise(make(), 0.1, dt=1.0, say=lambda _: None, reference=SINE, make=make)
    assert advice.divisions == 6 and "--divisions 6" in command_line("cap", advice)
    text = describe(make(), advice)
    assert "50 triangles (divisions 5) are not enough" in text and "450 triangles would change" in text


@pytest.mark.parametrize("tolerance", [0.0, -1.0, 1.0, 1e-7])
def test_bad_tolerances(pretend, tolerance):
    with pytest.raises(ValueError, match="tolerance"):
        advising.advise(cap(), tolerance, dt=1.0, say=lambda _: None, reference=SINE)
    assert not pretend


def test_command_writes_a_run_section_that_scene_files_take(pretend, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(advising, "reference_of", lambda *_: SINE)
    failed = types.SimpleNamespace(message="the finer mesh is not of interest here")
    monkeypatch.setattr(advising, "timed", lambda *_: (failed, 1.0))
    pretend.enough[0] = 200
    file = tmp_path / "run.toml"
    assert main(["advise", "cap", "--tolerance", "0.1", "--dt", "1", "--output", str(file), "--quiet"]) == 0
    run = tomllib.loads(file.read_text())["run"]
    assert set(run) <= set(KEYS)
    assert (run["method"], run["inertia"], run["dt"], run["newton_tolerance"]) == ("EMC", "none", 0.25, 1e-6)
    command = "jaxshell run cap --method EMC --inertia none --dt 0.25 --newton-tolerance 1e-06\n"
    assert command in capsys.readouterr().out


@pytest.mark.slow
def test_advice_on_a_real_scene_holds():
    scene = js.scenes.spherical_cap(divisions=3)
    advice = advising.advise(scene, 0.02, dt=1e-6, t_end=3e-5, say=lambda _: None)
    finer = charting.make_reference(scene, 2.5e-7, 3e-5, 1e-4, lambda _: None)
    assert advice.met and charting.measure(scene, advice.best, finer).error < 0.02
