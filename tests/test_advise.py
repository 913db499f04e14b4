"""References, errors and charts: figures of merit, extrapolation, points and pictures."""

import types

import jax
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)

import jaxshell as js  # noqa: E402
from jaxshell.advice import chart as charting  # noqa: E402
from jaxshell.advice import references  # noqa: E402
from jaxshell.advice.chart import Point  # noqa: E402
from jaxshell.advice.references import Reference  # noqa: E402
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


def test_total_errors_are_the_main_picture(tmp_path):
    total = [
        Point(
            "total", label, dt, (slow if elements > 50 else 1) * elements / dt, dt**2 + 10 / elements, 10, 20, elements
        )
        for label, slow in (("exact, curved", 1), ("central differences", 10))
        for elements in (50, 200)
        for dt in (1.0, 0.5)
    ]
    figure = work_precision.draw("cap", total + [point("EMC", 1.0, 1.0, 0.1)], floor=1e-5, whole_floor=1e-3)
    main, left, right = figure.axes
    assert main.get_title().startswith("Total error") and left.get_title() == "Methods, over the time step"
    labels = main.get_legend_handles_labels()[1]
    assert {"exact, curved", "central differences", "reference's uncertainty"} <= set(labels) and len(labels) == 4
    # Once where two lines meet.
    assert sorted(text.get_text() for text in main.texts) == ["200", "200", "50"]
    assert "EMC" in left.get_legend_handles_labels()[1] and right.get_xscale() == "log"
    charting.write_points(tmp_path / "points.json", cap(), total, SINE, SINE._replace(uncertainty=2e-3))
    assert '"continuous_uncertainty": 0.002' in (tmp_path / "points.json").read_text()
