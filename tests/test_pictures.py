"""Pictures of shapes by both renderers: true depth, views, labels, titles, fallbacks; scenes, films and the window."""

import dataclasses
import importlib.util
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

jax.config.update("jax_enable_x64", True)

from synthetic import synthetic_solution  # noqa: E402

from jaxshell.model.generators import rectangle  # noqa: E402
from jaxshell.model.loads import Gravity, History, NodalForce, NodalMoment, Pressure  # noqa: E402
from jaxshell.model.scene import Defaults, Scene  # noqa: E402
from jaxshell.model.sections import Section  # noqa: E402
from jaxshell.model.supports import Support, clamped, pinned, symmetry  # noqa: E402
from jaxshell.plotting import animate, figures, offscreen, plot, rendering, scene_figure, view, window  # noqa: E402
from jaxshell.plotting.colouring import colouring  # noqa: E402
from jaxshell.plotting.movie import _pace  # noqa: E402
from jaxshell.plotting.panels import frame, place_labels, triad  # noqa: E402
from jaxshell.plotting.projection import chosen_view, view_from, window_of  # noqa: E402
from jaxshell.plotting.scene import held_as  # noqa: E402

with_vtk = pytest.mark.skipif(importlib.util.find_spec("pyvista") is None, reason="needs PyVista")


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """Pictures of a few pixels."""
    monkeypatch.setattr(rendering, "_DOTS", 30.0)


@pytest.fixture(scope="module")
def run():
    mesh = rectangle(0.2, 0.1, [4, 2])
    held = clamped(mesh.nodes_where(lambda x: x[0] == 0))
    scene = Scene(
        mesh,
        Section(0.001, 1e9, 0.3, 1000.0),
        [held],
        name="shelf",
        watch={"tip": (14, "uz"), "root": (0, "ux")},
        defaults=Defaults(0.1, 1.0, units="SI"),
    )
    return synthetic_solution(scene)


def drawn(sheets, renderer: str) -> np.ndarray:
    """Pixels of sheets seen from above, without anything else."""
    seen = view_from(-90.0, 90.0)
    figure = Figure(figsize=(2, 2), dpi=50)
    panel = figure.add_axes((0, 0, 1, 1))
    area = window_of([seen.project(sheet.points) for sheet in sheets], 0.0)
    frame(panel, area)
    colours = ScalarMappable(Normalize(0, 1), "coolwarm")
    rendering.renderer(renderer, 60.0).draw(panel, sheets, seen, area, colours)
    frame(panel, area)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].astype(int)


def sheet(z, value: float) -> rendering.Sheet:
    """One rectangle of two triangles, with a height at each corner."""
    points = np.array([[0, 0, z[0]], [2, 0, z[1]], [2, 1, z[1]], [0, 1, z[0]]], float)
    return rendering.Sheet(points, np.array([[0, 1, 2], [0, 2, 3]]), np.full((2, 3), value))


@with_vtk
def test_of_two_crossing_sheets_each_is_seen_where_it_is_nearer():
    """Polygons cannot: each of a sheet's triangles is in front of the other's or behind them, as a whole."""
    rising, falling = sheet((0, 1), 0.0), sheet((1, 0), 1.0)
    image = drawn([rising, falling], "vtk")
    blue = image[..., 2] > image[..., 0] + 30
    red = image[..., 0] > image[..., 2] + 30
    middle = slice(30, 70)
    assert red[middle, 10:45].mean() > 0.9 and blue[middle, 55:90].mean() > 0.9
    flat = drawn([rising, falling], "matplotlib")
    wrong = (flat[middle, 10:45, 0] < flat[middle, 10:45, 2]) | (flat[middle, 55:90, 0] > flat[middle, 55:90, 2])
    assert wrong.mean() > 0.2


@pytest.mark.parametrize("renderer", [pytest.param("vtk", marks=with_vtk), "matplotlib"])
def test_the_nearer_sheet_hides_the_farther_one_in_its_own_colour(renderer):
    image = drawn([sheet((1, 1), 1.0), sheet((0, 0), 0.0)], renderer)
    near, far = image[40:60, 20:80].reshape(-1, 3), drawn([sheet((0, 0), 0.0)], renderer)[40:60, 20:80].reshape(-1, 3)
    assert np.median(near[:, 0] - near[:, 2]) > 60 and np.median(far[:, 0] - far[:, 2]) < -60


@with_vtk
def test_both_renderers_have_the_same_colours_in_the_same_places():
    sheets = [sheet((0.0, 0.3), 0.8)]
    first, second = drawn(sheets, "vtk"), drawn(sheets, "matplotlib")
    assert np.abs(np.median(first - second, axis=(0, 1))).max() <= 6
    assert ((first.min(axis=2) < 250) == (second.min(axis=2) < 250)).mean() > 0.97


@with_vtk
def test_values_run_smoothly_across_a_triangle():
    ramp = sheet((0, 0), 0.0)._replace(values=np.array([[0, 1, 1], [0, 1, 0.0]]))
    row = drawn([ramp], "vtk")[60]
    assert len(np.unique(row[:, 0])) > 25  # polygons have two colours
    assert np.all(np.diff(row[5:-5, 2] - row[5:-5, 0]) <= 12)


def test_without_pyvista_pictures_are_matplotlibs(run, monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "pyvista" else find(name))
    panel = figures(run)["shapes"].axes[0]
    assert panel.collections and not panel.images
    with pytest.raises(ImportError, match="pip install pyvista"):
        figures(run, renderer="vtk")
    with pytest.raises(ValueError, match="renderer"):
        figures(run, renderer="povray")


@with_vtk
def test_where_vtk_breaks_pictures_are_matplotlibs_and_vtk_says_why(run, monkeypatch, capfd):
    monkeypatch.setattr(offscreen, "_process", None)
    monkeypatch.setattr(offscreen, "_broken", "")
    monkeypatch.setattr(offscreen.sys, "executable", "/bin/false")
    panel = figures(run)["shapes"].axes[0]
    assert panel.collections and not panel.images
    with pytest.raises(offscreen.RenderingFailed, match="without a picture"):
        figures(run, renderer="vtk")
    assert capfd.readouterr() == ("", "")


@with_vtk
def test_a_renderer_that_hangs_is_given_up(monkeypatch, tmp_path):
    sleeper = tmp_path / "sleeper"
    sleeper.write_text("#!/bin/sh\nexec sleep 60\n")
    sleeper.chmod(0o755)
    monkeypatch.setattr(offscreen, "_process", None)
    monkeypatch.setattr(offscreen, "_broken", "")
    monkeypatch.setattr(offscreen, "_PATIENCE", 0.2)
    monkeypatch.setattr(offscreen.sys, "executable", str(sleeper))
    with pytest.raises(offscreen.RenderingFailed, match="without a picture"):
        drawn([sheet((0, 0), 0.0)], "vtk")


@with_vtk
def test_what_was_rendered_before_leaves_no_trace():
    first, other = [sheet((0.0, 0.3), 0.8)], [sheet((1, 1), 1.0), sheet((0, 0), 0.0)]
    before, between, after = (drawn(sheets, "vtk") for sheets in (first, other, first))
    assert np.array_equal(before, after) and not np.array_equal(before, between)


def test_titles_have_scene_and_method_and_shapes_have_times_axes_and_scale(run):
    for what, figure in figures({"EMC": run}, renderer="matplotlib").items():
        assert figure.get_suptitle().startswith("shelf, EMC: "), what
    shapes = figures({"EMC": run}, renderer="matplotlib")["shapes"]
    texts = {text.get_text() for panel in shapes.axes for text in panel.texts}
    assert {"x", "y", "z", "50 mm"} <= texts
    assert shapes.axes[0].get_title() == "t = 0 s"
    assert shapes.axes[-1].get_ylabel() == "Displacement in mm"  # as the scale bar
    compared = figures({"EMC": run, "exact": run}, renderer="matplotlib")["energy"]
    assert compared.get_suptitle() == "shelf: energy"
    assert figures(run, renderer="matplotlib")["energy"].get_suptitle() == "shelf, EMC: energy"


def test_panels_of_one_picture_have_one_unit(run):
    small = eqx.tree_at(lambda s: s.watched["root"], run, 1e-4 * run.watched["root"])
    labels = [panel.get_ylabel() for panel in figures(small, renderer="matplotlib")["displacement"].axes]
    assert labels == ["tip, $u_z$ in mm", "root, $u_x$ in mm"]


def test_a_held_shell_has_no_picture_of_momentum(run):
    assert "momentum" not in figures(run, renderer="matplotlib")
    free = dataclasses.replace(run, scene=dataclasses.replace(run.scene, supports=()))
    panels = figures(free, renderer="matplotlib")["momentum"].axes
    assert panels[6].get_yscale() == panels[7].get_yscale() == "log"  # its drift


def test_drifts_of_very_different_size_are_told_apart(run):
    kept = eqx.tree_at(lambda s: s.energy.strain, run, 1 + 1e-15 * run.times - run.energy.kinetic)
    lost = eqx.tree_at(lambda s: s.energy.strain, run, (1 - 1e-4 * run.times) * (1 - run.energy.kinetic))
    below = figures({"exact": kept, "EMC": lost}, renderer="matplotlib")["energy"].axes[-1]
    assert below.get_yscale() == "log"
    low, high = below.get_ylim()
    ends = [np.nanmax(np.asarray(curve.get_ydata(), float), initial=low) for curve in below.get_lines()]
    assert low <= ends[0] < 1e-14 and 1e-6 < ends[1] <= high


def strip(along: int) -> np.ndarray:
    nodes = np.array(rectangle(10.0, 1.0, [10, 1]).nodes)
    return nodes if along == 0 else nodes[:, [1, 0, 2]] if along == 1 else nodes[:, [1, 2, 0]]


def test_no_strip_is_seen_along_itself_and_no_sheet_edge_on():
    triangles = rectangle(10.0, 1.0, [10, 1]).triangles
    for along in range(3):
        seen = chosen_view([strip(along)], triangles).project(strip(along))
        assert np.linalg.norm(np.ptp(seen[:, :2], axis=0)) > 7
    for normal in range(3):
        sheet = np.roll(np.array(rectangle(10.0, 10.0, [10, 1]).nodes), normal, axis=1)
        assert abs(chosen_view([sheet], triangles).axes[(2 + normal) % 3, 2]) > 0.25
    usual = view_from(-60.0, 35.0).axes
    assert np.allclose(chosen_view([strip(0)], triangles).axes, usual)


def test_labels_of_shapes_do_not_lie_on_each_other():
    figure = Figure(figsize=(4, 3))
    panel = figure.subplots()
    shape = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 1.0, 0.0]])
    shapes = [shape + np.array([0.02, 0.0, 0.0]) * k for k in range(6)]
    frame(panel, window_of(shapes, 0.3))
    boxes = place_labels(panel, shapes, [f"t = {k}.5 ms" for k in range(6)])
    assert len(boxes) == 6
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])
    figure.draw_without_rendering()
    real = [text.get_window_extent() for text in panel.texts]
    assert not any(a.overlaps(b) for i, a in enumerate(real) for b in real[:i])


def test_an_axis_that_points_at_the_viewer_is_a_letter_without_an_arrow():
    panel = Figure().subplots()
    triad(panel, view_from(0.0, 0.0))
    arrows = [text for text in panel.texts if not text.get_text()]
    assert len(arrows) == 2 and {text.get_text() for text in panel.texts} == {"", "x", "y", "z"}


def test_a_scene_is_drawn_with_its_supports_loads_sets_and_watches():
    mesh = rectangle(2.0, 1.0, [4, 2])
    mesh = type(mesh)(mesh.nodes, mesh.triangles, node_sets={"root": [0, 1, 2]}, element_sets={"skin": [0, 1, 2]})
    supports = [clamped([0, 1, 2]), Support([14], ("uz",)), Support([13], ("ux",), 0.1, History.ramp(1.0))]
    loads = [
        NodalForce([12], [0.0, 0.0, -5.0]), NodalMoment([14], [1.0, 0.0, 0.0]), Pressure(2.0), Gravity([0.0, 0.0, -9.8]),
    ]  # fmt: skip
    scene = Scene(mesh, Section(0.1, 1.0, 0.3, 1.0), supports, loads, name="all_kinds", watch={"tip": (12, "uz")})
    figure = scene_figure(scene, renderer_name="matplotlib")
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [
        "skin: 3 elements", "clamped: root, 3 nodes", "uz held: 1 node", "ux moved: 1 node", "force: 1 node",
        "moment: 1 node", "pressure: 15 nodes", "gravity: 15 nodes", "watched: tip",
    ]  # fmt: skip
    assert figure.get_suptitle() == "all_kinds: supports and loads"
    down = [t for t in figure.axes[0].texts if t.arrow_patch is not None and t.xy[1] < t.xyann[1] - 1e-9]
    assert len(down) >= 1 + 15  # the force and gravity


def test_supports_have_their_usual_names():
    assert [held_as(s) for s in (clamped([0]), pinned([0]), symmetry([0], "y"), Support([0], ["ux", "rz"]))] == [
        "clamped", "pinned", "symmetry y", "ux, rz held",
    ]  # fmt: skip


def test_a_film_has_as_many_pictures_as_asked_and_they_differ(run, tmp_path):
    from PIL import Image, ImageSequence

    path = animate({"a": run, "b": run}, tmp_path / "new" / "film.gif", fps=10, duration=0.4, size=(201, 150),
                   renderer="matplotlib")  # fmt: skip
    with Image.open(path) as film:
        pictures = [np.asarray(picture.convert("RGB")).astype(int) for picture in ImageSequence.Iterator(film)]
        assert film.info["duration"] == 100
    assert len(pictures) == 4 and pictures[0].shape == (150, 200, 3)
    assert all(np.abs(a - b).max() > 50 for a, b in zip(pictures, pictures[1:], strict=False))


def test_a_film_as_mp4(run, tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    path = animate(run, tmp_path / "film.mp4", "velocity", fps=5, duration=1.0, size=(200, 150), renderer="matplotlib")
    count, seconds = ffmpeg.count_frames_and_secs(str(path))
    assert count == 5 and abs(seconds - 1.0) < 0.3


def test_the_usual_length_of_films(run):
    assert _pace({"": run}, None, None) == (5.0, 5)  # of five stored frames
    assert _pace({"": run}, 10.0, 3.0) == (10.0, 30)
    many = eqx.tree_at(lambda s: s.frame_times, run, jnp.linspace(0, 1, 1001))
    assert _pace({"": many}, None, None) == (25.0, 200)


def test_what_is_no_film_is_refused_by_name(run, tmp_path, monkeypatch):
    with pytest.raises(ValueError, match=r"film\.avi"):
        animate(run, tmp_path / "film.avi")
    with pytest.raises(ValueError, match="fps"):
        animate(run, tmp_path / "film.gif", fps=0)
    with pytest.raises(ValueError, match="64 to 8192"):
        animate(run, tmp_path / "film.gif", size=(10, 10))
    with pytest.raises(ValueError, match="names no stress"):
        animate(run, tmp_path / "film.gif", "beauty")
    monkeypatch.setitem(__import__("sys").modules, "imageio_ffmpeg", None)
    with pytest.raises(ImportError, match="pip install imageio-ffmpeg"):
        animate(run, tmp_path / "film.mp4")
    assert not list(tmp_path.iterdir())


@with_vtk
def test_the_window_needs_a_display_and_says_so(run, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr(window.sys, "platform", "linux")
    with pytest.raises(OSError, match="no display"):
        view(run)


def test_the_window_needs_pyvista_and_says_so(run, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyvista", None)
    with pytest.raises(ImportError, match="pip install pyvista"):
        view(run)


@with_vtk
def test_the_slider_of_the_window_shows_other_times(run):
    import pyvista

    plotter = pyvista.Plotter(off_screen=True, shape=(1, 2), window_size=(200, 150))
    stage = window.staged({"a": run, "b": run}, "displacement", plotter)
    window._add_slider(stage)
    try:
        (slider,) = getattr(plotter, "widgets", plotter).slider_widgets  # elsewhere before PyVista 0.49
        ends = slider.GetRepresentation().GetMinimumValue(), slider.GetRepresentation().GetMaximumValue()
        np.testing.assert_allclose(ends, np.asarray(run.frame_times)[[0, -1]] / stage.clock.divisor, rtol=1e-6)
        first = np.array(plotter.screenshot(return_img=True)).astype(int)
        slider.GetRepresentation().SetValue(ends[1])
        slider.InvokeEvent("InteractionEvent")
        last = np.array(plotter.screenshot(return_img=True)).astype(int)
        texts = [renderer.actors["title"].input for renderer in plotter.renderers]
    finally:
        plotter.close()
    changed = np.abs(first - last).max(axis=2)[:120] > 20  # above the slider
    assert changed[:, :100].mean() > 0.005 and changed[:, 100:].mean() > 0.005
    assert texts == ["shelf, a\nDisplacement in mm", "shelf, b\nDisplacement in mm"]


PAGE = """
import sys
import jax
jax.config.update("jax_enable_x64", True)
import numpy as np
import jaxshell as js
from jaxshell.plotting import window

run = js.Solution.load(sys.argv[1])
shown = js.plotting.view({"a": run, "b": run}, "sxx bottom", notebook=True)
viewer = shown.viewer
state, plotter = viewer.server.state, viewer.plotter
(name,) = [name for name in state.to_dict() if name.startswith("jaxshell_time")]
shapes = lambda: [np.array(r.actors[next(k for k in r.actors if k.startswith("PolyData"))].mapper.dataset.points) for r in plotter.renderers]
first = shapes()
end = float(run.frame_times[-1])
state[name] = end / window._clock({"a": run}).divisor
state.flush()
last = shapes()
assert all(np.abs(one - other).max() > 1e-3 for one, other in zip(first, last)), (first, last)
assert "<iframe" in shown.value and state[viewer.EDGES] is True
"""


@pytest.mark.slow
@with_vtk
@pytest.mark.skipif(importlib.util.find_spec("trame") is None, reason="needs pyvista[jupyter]")
def test_a_page_of_a_notebook_has_a_slider_that_moves_the_shapes(run, tmp_path):
    """In a process of its own: PyVista lets event loops run within each other, for good."""
    run.save(tmp_path / "run.h5")
    command = [sys.executable, "-c", PAGE, str(tmp_path / "run.h5")]
    page = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert page.returncode == 0, page.stderr


@pytest.mark.parametrize(
    ("label", "expected"),
    [
        (r"$\sigma_{xx}$, bottom in MPa", "Stress xx, bottom in MPa"),
        (r"$\tau_{xy}$, ply 0", "Shear stress xy, ply 0"),
        (r"$M_{xx}$ (material axes)", "Mxx (material axes)"),
        (r"a\$b", "a$b"),
    ],
)
def test_what_vtk_writes_has_no_formulas(label, expected):
    assert window.spoken(label) == expected


def test_a_stress_that_is_never_negative_has_no_scale_of_two_signs(run):
    colours = colouring([run], [list(range(len(run.frame_times)))], "von mises top").colours
    low, high = colours.get_clim()
    assert 0.0 <= low < high and colours.get_cmap().name != "coolwarm"


@with_vtk
def test_files_drawn_by_vtk(run, tmp_path):
    import matplotlib.image

    (path, *_) = plot({"EMC": run}, tmp_path, "shelf", renderer="vtk")
    image = matplotlib.image.imread(path)
    assert path.name == "shelf_shapes.png" and np.ptp(image[..., :3]) == 1
