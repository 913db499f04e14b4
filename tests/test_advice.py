"""Advice: the family of meshes, the continuous answer, the search, what is said and written."""

import dataclasses
import itertools
import tomllib
import types

import jax
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)

import jaxshell as js  # noqa: E402
from jaxshell.advice import advise as advising  # noqa: E402
from jaxshell.advice import chart as charting  # noqa: E402
from jaxshell.advice import converged as converging  # noqa: E402
from jaxshell.advice import references, total  # noqa: E402
from jaxshell.advice.family import FACTORS, Family, is_curved, scaled_divisions, shapes_of  # noqa: E402
from jaxshell.advice.lines import lines_of  # noqa: E402
from jaxshell.advice.text import command_line, describe, file_tables, method_text  # noqa: E402
from jaxshell.command.cli import _parser, main  # noqa: E402
from jaxshell.command.run import _changed  # noqa: E402
from jaxshell.files.run_keys import KEYS  # noqa: E402
from jaxshell.model import generators  # noqa: E402

SECTION = js.Section(0.1, 1e6, 0.3, 1.0)
WINDOW = 2.0

# --- the meshes of a scene -----------------------------------------------------------------------------------


def of_family(family: Family) -> dict:
    return {f: member for f in FACTORS if (member := family.at(f)) is not None}


def test_meshes_of_a_library_scene_keep_their_aspect():
    family = Family(js.scenes.opened_cap((24, 5)), lambda divisions=(24, 5): js.scenes.opened_cap(divisions))
    found = {f: m.divisions for f, m in of_family(family).items()}
    assert found[1.0] is None and found[2.0] == (48, 10) and found[1.4] == (34, 7)
    assert 0.25 not in found  # (6, 1): 1.25 elements along the meridian are no one
    assert family.at(2.0).factor == pytest.approx(2.0)


def test_divisions_that_a_function_wants_even_are_even():
    divisions = [scaled_divisions(js.scenes.flying_cylinder, 1.4, multiple) for multiple in (1, 2)]
    assert divisions == [(6, 45), (6, 44)]
    family = Family(js.scenes.flying_cylinder(), js.scenes.flying_cylinder)
    assert family.at(1.4).divisions == (6, 44)  # around a multiple of 4


def test_a_mesh_with_other_loads_is_left_out():
    """A function that loads half of an edge with odd divisions, all of it with even ones."""

    def make(divisions=(2, 2)):
        mesh = generators.rectangle(1.0, 1.0, divisions)
        edge = np.flatnonzero(np.asarray(mesh.nodes)[:, 0] == 1.0)
        chosen = edge if divisions[1] % 2 == 0 else edge[: len(edge) // 2 + 1]
        pairs = np.stack([chosen[:-1], chosen[1:]], 1)
        return js.Scene(mesh, SECTION, (js.clamped([0]),), (js.EdgeForce(pairs, [0.0, 0.0, 1.0]),))

    family = Family(make(), make)
    assert family.at(1.4).divisions is None if family.at(1.4) else True
    assert family.at(1.4) is None and family.at(2.0).divisions == (4, 4)
    assert family.notes == ["divisions (3, 3) are left out: the function puts the loads elsewhere there"]


def test_any_other_scene_is_refined_and_coarsened():
    scene = js.refine(js.scenes.spherical_cap(2))
    family = Family(scene)
    found = {f: (m.levels, m.scene.mesh.n_elements) for f, m in of_family(family).items()}
    assert found == {0.5: (-1, 8), 1.0: (0, 32), 2.0: (1, 128), 4.0: (2, 512), 0.25: (-2, 2)}


def test_a_scene_whose_nodal_forces_would_move_is_not_coarsened():
    scene = js.scenes.spherical_cap(2)
    moved = dataclasses.replace(scene, loads=(js.NodalForce([4], [0.0, 0.0, -1.0]),))
    family = Family(js.refine(moved))
    assert family.at(0.5) is not None  # node 4 stays
    fine = dataclasses.replace(js.refine(scene), loads=(js.NodalForce([12], [0.0, 0.0, -1.0]),))
    family = Family(fine)
    assert family.at(0.5) is None and family.at(2.0) is not None
    assert family.notes == ["it is not coarsened: forces on nodes would be on other nodes there"]


def test_answers_without_watches_are_compared_at_common_nodes():
    scene = dataclasses.replace(js.scenes.spherical_cap(2), watch=())
    family = Family(scene)
    fine = family.at(2.0).scene
    moved = np.arange(fine.mesh.n_nodes, dtype=float)[None, :, None] * np.ones((1, 1, 3))
    found = family.signals(fine, moved)["displacements"].reshape(-1, 3)[:, 0]
    assert np.array_equal(found, np.arange(scene.mesh.n_nodes))  # of refined meshes the old nodes stay
    other = dataclasses.replace(js.scenes.spherical_cap(3), watch=())
    with pytest.raises(ValueError, match="no nodes in common"):
        family.signals(other, np.zeros((1, other.mesh.n_nodes, 3)))


def test_shapes_to_choose_from():
    curved, flat = js.scenes.spherical_cap(2), js.scenes.l_shaped_plate(1)
    assert is_curved(curved) and not is_curved(flat)  # a fold is no curvature
    assert shapes_of(curved) == ("flat", "curved") and shapes_of(flat) == ("flat",)
    assert shapes_of(js.with_shape(curved, "relaxed")) == ("relaxed", "flat", "curved")
    regions = js.Scene(
        generators.rectangle(1.0, 1.0, (1, 1)),
        [([0], SECTION), ([1], dataclasses.replace(SECTION, shape="curved"))],
    )
    assert shapes_of(regions) == ()
    assert shapes_of(js.with_shape(regions, "flat")) == ("flat",)


def test_with_shape_names_what_is_wrong():
    with pytest.raises(ValueError, match="shape"):
        js.with_shape(js.scenes.spherical_cap(2), "round")


# --- runs that are pretended ---------------------------------------------------------------------------------

MESH, STEP = {"curved": 0.03, "flat": 0.06}, 0.5
"""Errors of the exact method: of the mesh of factor 1 by the shape, of a step over its square."""


class Pretended:
    """sin(t) with errors of second order in place of runs; what was run."""

    def __init__(self):
        self.timed, self.order, self.noise, self.explicit = [], 2.0, 0.0, 0.1
        self.clock = 0.0

    def error(self, scene, tried) -> float:
        size = np.sqrt(32 / scene.mesh.n_elements)
        method = tried.method
        if isinstance(method, js.CentralDifference):
            return 0.2 * size**2
        if isinstance(method, js.GeneralizedEnergyMomentum):
            return 0.3 * size**2 + STEP * tried.dt**2
        mesh = MESH[tried.shape] * (size**self.order + 0.1 * size**4)
        return mesh + STEP * tried.dt**2 + self.noise * np.sin(1e3 * size)

    def measured(self, scene, tried, t_end):
        seconds = self.seconds(scene, tried, t_end)
        if not isinstance(tried.dt, js.StepControl):
            self.timed.append((scene, tried, seconds))
        return self.run(scene, tried, t_end), seconds

    def seconds(self, scene, tried, t_end) -> float:
        if isinstance(tried.dt, js.StepControl):
            return 1e9
        explicit = self.explicit if isinstance(tried.method, js.CentralDifference) else 1.0
        loose = 1.0 if float(tried.newton.tolerance) <= 1e-8 else 0.9
        return 1e-5 * scene.mesh.n_elements * (t_end / tried.dt) * explicit * loose

    def run(self, scene, tried, t_end):
        if isinstance(tried.dt, js.StepControl):
            return types.SimpleNamespace(
                message="not pretended", scene=scene, stats={"steps": 1, "iterations": 1}, times=[0, t_end]
            )
        self.clock += self.seconds(scene, tried, t_end)
        steps = round(t_end / tried.dt)
        times = np.linspace(0.0, t_end, steps + 1)
        displacements = np.zeros((steps + 1, scene.mesh.n_nodes, 3))
        displacements[:, 0, 2] = np.sin(times) * (1.0 + self.error(scene, tried))
        stats = {"steps": steps, "iterations": 3 * steps, "first_chunk_time": 0.0}
        return types.SimpleNamespace(
            message="", scene=scene, frame_times=times, times=times, displacements=displacements, stats=stats
        )


@pytest.fixture
def pretended(monkeypatch):
    world = Pretended()
    monkeypatch.setattr(converging, "run_once", world.run)
    monkeypatch.setattr(converging, "time", types.SimpleNamespace(perf_counter=lambda: world.clock))
    monkeypatch.setattr(charting, "timed", world.measured)
    monkeypatch.setattr(js.CentralDifference, "critical_step", lambda self, scene: 0.02 / scene.mesh.n_elements**0.5)
    monkeypatch.setattr(converging, "_EXPLICIT_SECONDS", 1.0)  # too long for the answer
    return world


def make_cap(divisions=4):
    return js.scenes.spherical_cap(divisions)


def cap():
    return make_cap()


def advice_of(tolerance, **changes):
    given = {"dt": 0.1, "t_end": WINDOW, "say": lambda _: None, "make": make_cap} | changes
    return js.advise(cap(), tolerance, **given)


@pytest.mark.wrong_types  # stand-ins for runs
def test_the_continuous_answer_is_extrapolated_from_mesh_and_step(pretended):
    family = Family(cap(), make_cap)
    found = converging.converged(family, 0.1, WINDOW, 1e-3, 1e3, lambda _: None)
    truth = np.sin(found.reference.times)
    error = np.abs(found.reference.signals["apex"][:, 0] - truth).max()
    assert error <= found.reference.uncertainty <= 2e-3
    assert len({trial.member.factor for trial in found.trials}) >= 2
    assert {trial.form.label for trial in found.trials} == {"curved, cubic inertia", "flat, cubic inertia"}


@pytest.mark.wrong_types
def test_an_answer_that_does_not_converge_as_it_should_is_not_thought_known(pretended, monkeypatch):
    """Of first order, extrapolation as of second misses; the uncertainty says so."""
    pretended.order = 1.0
    family = Family(cap(), make_cap)
    found = converging.converged(family, 0.1, WINDOW, 1e-5, 1e3, lambda _: None)
    error = np.abs(found.reference.signals["apex"][:, 0] - np.sin(found.reference.times)).max()
    assert 1e-3 < error <= found.reference.uncertainty


@pytest.mark.wrong_types
def test_where_explicit_steps_are_cheap_the_answer_is_that_of_central_differences(pretended, monkeypatch):
    monkeypatch.setattr(converging, "_EXPLICIT_SECONDS", 1e-6)
    found = converging.converged(Family(cap(), make_cap), 0.1, WINDOW, 1e-3, 1e3, lambda _: None)
    explicit = [trial for trial in found.trials if trial.form.explicit]
    assert {trial.form.shape for trial in explicit} == {"curved", "flat"}
    assert "central differences" in found.reference.origin
    implicit = [trial for trial in found.trials if not trial.form.explicit]
    coarsest = min(trial.member.factor for trial in explicit)
    assert len(implicit) > 1 and {trial.member.factor for trial in implicit} == {coarsest}
    error = np.abs(found.reference.signals["apex"][:, 0] - np.sin(found.reference.times)).max()
    # On three meshes of second order 3/5 - 1/3 of the last change is what is not known.
    last = 0.2 * (32 / 128 - 32 / 512)
    assert error < 1e-4 and np.isclose(found.reference.uncertainty, (3 / 5 - 1 / 3) * last, rtol=0.2)


@pytest.mark.wrong_types
@pytest.mark.parametrize("tolerance", [0.1, 0.03, 0.01])
def test_what_is_advised_is_within_the_tolerance_of_the_continuous_answer(pretended, tolerance):
    advice = advice_of(tolerance)
    error = pretended.error(advice.member.scene, advice.best)
    assert advice.met and error <= tolerance
    assert advice.point.error + advice.reference.uncertainty <= tolerance
    timed = [seconds for scene, tried, seconds in pretended.timed if pretended.error(scene, tried) <= 0.8 * error]
    assert all(seconds >= advice.point.seconds for seconds in timed)  # nothing nearer was cheaper


@pytest.mark.wrong_types
def test_a_tighter_tolerance_takes_a_finer_mesh_and_a_smaller_step(pretended):
    loose, tight = advice_of(0.1), advice_of(0.01)
    assert tight.point.elements > loose.point.elements and tight.point.dt < loose.point.dt


@pytest.mark.wrong_types
def test_an_explicit_method_that_is_cheaper_is_advised(pretended):
    pretended.explicit = 1e-3
    advice = advice_of(0.1)
    assert advice.met and isinstance(advice.best.method, js.CentralDifference)
    assert "--method CentralDifference --rotary scaled" in command_line("cap", advice)


@pytest.mark.wrong_types
def test_where_no_time_is_left_the_answer_s_own_runs_are_advised(pretended, monkeypatch):
    monkeypatch.setattr(advising._Clock, "left", lambda self: -1.0)
    advice = advice_of(0.03)
    assert advice.met and not pretended.timed
    assert pretended.error(advice.member.scene, advice.best) + advice.reference.uncertainty <= 0.03
    assert any("the budget of time was spent" in reason for reason in advice.reasons)


@pytest.mark.wrong_types
def test_a_tolerance_below_what_is_known_is_not_promised(pretended):
    pretended.noise = 0.1
    advice = advice_of(0.005, budget=1e3)
    assert not advice.met and "cannot be promised" in advice.reasons[0]
    assert advice.point.error == min(p.error for p in advice.points)


@pytest.mark.wrong_types
def test_on_one_mesh_only_the_step_is_judged(pretended, monkeypatch):
    monkeypatch.setattr(Family, "_anew", lambda *_: None)
    monkeypatch.setattr(Family, "_by_levels", lambda *_: None)
    advice = advice_of(0.05)
    assert not advice.met and "Of the step alone" in advice.reasons[0] and advice.member.factor == 1.0
    assert STEP * advice.best.dt**2 < 0.05 and "nothing tells" in describe(cap(), advice)


@pytest.mark.wrong_types
def test_advice_is_told_as_words_call_command_and_file(pretended):
    advice = advice_of(0.03)
    text = describe(cap(), advice)
    divisions = advice.member.divisions
    assert f"js.scenes.spherical_cap(divisions={divisions})" in text and 'js.with_shape(scene, "curved")' in text
    assert f"js.{method_text(advice.best.method)}, dt=" in text and "is of the mesh, of the step" in text
    for words in ("central differences, scaled", "EMC without rotary inertia", "Newton to 1e-06"):
        assert words in text
    command = command_line("cap", advice)
    options = _parser().parse_args(command.split()[1:])
    assert (options.divisions, options.shape, options.inertia) == ([divisions], "curved", "cubic")
    assert options.dt == pytest.approx(advice.best.dt, rel=1e-5)
    tables = tomllib.loads(file_tables(cap(), advice))
    assert tables["mesh"] == {"divisions": divisions} and tables["section"] == {"shape": "curved"}
    assert set(tables["run"]) <= set(KEYS) and tables["run"]["inertia"] == "cubic"


@pytest.mark.wrong_types
def test_a_scene_of_ones_own_is_told_by_levels(pretended):
    scene = dataclasses.replace(js.refine(js.scenes.spherical_cap(5)), name="dome")  # 200 triangles, of 50
    for tolerance, words, options in (
        (0.6, "js.coarsen(scene)", "--coarsen 1"),
        (0.004, "js.refine(scene, ", "--refine"),
    ):
        advice = js.advise(scene, tolerance, dt=0.1, t_end=WINDOW, say=lambda _: None)
        assert advice.met and words in describe(scene, advice) and options in command_line("dome.toml", advice)
    assert tomllib.loads(file_tables(scene, advice))["mesh"] == {"refine": advice.member.levels}


@pytest.mark.wrong_types
def test_command_writes_tables_that_scene_files_take(pretended, tmp_path, capsys):
    file = tmp_path / "tables.toml"
    given = ["--tolerance", "0.03", "--dt", "0.1", "--t-end", "2", "--output", str(file), "--quiet"]
    assert main(["advise", "cap", *given]) == 0
    assert set(tomllib.loads(file.read_text())) == {"mesh", "section", "run"}
    assert "jaxshell run cap --divisions" in capsys.readouterr().out


@pytest.mark.wrong_types
def test_total_errors_are_charted_over_mesh_and_step(pretended, monkeypatch):
    monkeypatch.setattr(total, "KNOWN", 1e-2)
    points, found = total.total_points(cap(), 0.1, WINDOW, make_cap, 1e3, lambda _: None)
    assert {p.kind for p in points} == {"total"} and found.reference.uncertainty <= 1e-2
    exact = [p for p in points if p.label == "exact, curved, cubic inertia"]
    assert len({p.elements for p in exact}) >= 3 and len({p.dt for p in exact if p.elements == 128}) == 3
    of_mesh = [min(p.error for p in exact if p.elements == n) for n in sorted({p.elements for p in exact})]
    assert all(fine < coarse for coarse, fine in itertools.pairwise(of_mesh))
    assert any(p.label.startswith("central differences") for p in points)


def test_run_takes_what_is_advised():
    options = _parser().parse_args(["run", "cap", "--divisions", "2", "--coarsen", "1", "--shape", "curved"])
    scene, stem = _changed(options, js.scenes.spherical_cap(2), "cap")
    assert (scene.mesh.n_elements, scene.section.shape, stem) == (2, "curved", "cap_coarsened_1_curved")
    for given, words in (
        ("--shape curved --continue", "leave --shape out"),
        ("--coarsen -1", "at least 0"),
        ("--shape bent", "one of flat, curved, relaxed"),
    ):
        with pytest.raises(ValueError, match=words):
            _changed(_parser().parse_args(["run", "cap", *given.split()]), scene, "cap")


@pytest.mark.wrong_types
def test_a_form_that_fails_on_the_way_leaves_the_other(pretended, monkeypatch):
    run = pretended.run

    def fails(scene, tried, t_end):
        found = run(scene, tried, t_end)
        found.message = "diverged" if tried.shape == "flat" and scene.mesh.n_elements > 100 else ""
        return found

    monkeypatch.setattr(converging, "run_once", fails)
    found = converging.converged(Family(cap(), make_cap), 0.1, WINDOW, 1e-3, 1e3, lambda _: None)
    assert any(note.startswith("flat, cubic inertia does not run on 128 triangles") for note in found.notes)
    error = np.abs(found.reference.signals["apex"][:, 0] - np.sin(found.reference.times)).max()
    assert error <= found.reference.uncertainty


@pytest.mark.parametrize("tolerance", [0.0, -1.0, 1.0])
def test_bad_tolerances(tolerance):
    with pytest.raises(ValueError, match="tolerance"):
        advice_of(tolerance)


def test_a_scene_without_a_step_asks_for_one():
    with pytest.raises(ValueError, match="give dt"):
        js.advise(dataclasses.replace(cap(), defaults=None), 0.1)


@pytest.mark.slow
def test_advice_on_a_real_scene_holds(monkeypatch):
    """A dome under a pressure that comes at once, by the lines of the reference: against a mesh four times as fine."""

    def make(divisions=3):
        return js.scenes.suddenly_loaded_cap(divisions, pressure=60.0)

    monkeypatch.setattr(advising, "lines_of", lambda *given: lines_of(*given)[:2])
    monkeypatch.setattr(advising._Search, "control_step", lambda *_: None)
    advice = js.advise(make(), 0.1, t_end=1e-4, make=make, say=lambda _: None, budget=1e3)
    fine = js.with_shape(make(12), "curved")
    run = js.simulate(fine, js.EnergyMomentum(inertia="cubic"), dt=2e-6, t_end=1e-4)
    found = dict(references.signals(fine, np.asarray(run.displacements)))
    truth = references.Reference(np.asarray(run.frame_times), found, 0.0, "")
    assert advice.met and charting.measure(advice.member.scene, advice.best, truth).error < 0.1
