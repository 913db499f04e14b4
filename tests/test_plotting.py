"""Pictures: the right figures with the right curves, labels and units; what cannot be drawn is left out."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.image
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)

from synthetic import synthetic_solution  # noqa: E402

from jaxshell import plotting  # noqa: E402
from jaxshell.model.generators import rectangle  # noqa: E402
from jaxshell.model.scene import Scene  # noqa: E402
from jaxshell.model.sections import Section  # noqa: E402
from jaxshell.model.supports import Support, clamped, pinned, symmetry  # noqa: E402
from jaxshell.plotting.shapes import symmetry_planes  # noqa: E402
from jaxshell.plotting.style import line, scaled  # noqa: E402
from jaxshell.results.diagnostics import energy_balance, momentum_scales  # noqa: E402
from jaxshell.scenes import PAPER  # noqa: E402

# By VTK they are drawn in test_pictures.py.
figures, plot = (functools.partial(function, renderer="matplotlib") for function in (plotting.figures, plotting.plot))


@pytest.fixture(scope="module")
def cap():
    return PAPER["cap"](divisions=3)


def plain_scene(*supports) -> Scene:
    return Scene(rectangle(2.0, 1.0, [4, 2]), Section(0.1, 1.0, 0.3, 1.0), supports, watch={"a": (0, "uz")})


def test_files(cap, tmp_path):
    paths = plot({name: synthetic_solution(cap, method=name) for name in ("EMC", "EDMC1")}, tmp_path / "new", "cap")
    assert [path.name for path in paths] == [
        "cap_shapes.png", "cap_displacement.png", "cap_velocity.png", "cap_energy.png",
    ]  # fmt: skip
    for path in paths:
        image = matplotlib.image.imread(path)
        assert image.shape[1] == 1340  # 6.7 inches at 200 dots
        assert np.ptp(image[..., :3]) == 1


def test_dollar_signs_in_names_begin_no_formula(tmp_path):
    scene = dataclasses.replace(plain_scene(), watch={"cost in $": (0, "uz"), "a$b_{": (1, "ux")}, name="$x_")
    run = synthetic_solution(scene)
    drawn = figures({"$EMC": run, "b$_c$": run})
    assert drawn["displacement"].axes[0].get_ylabel() == r"cost in \$, $u_z$"
    assert len(plot({"$EMC": run, "b$_c$": run}, tmp_path, "money")) == len(drawn)


def test_deflection_is_drawn_as_the_scene_says(cap):
    run = synthetic_solution(cap)
    panel = figures({"EMC": run, "EDMC1": run})["displacement"].axes[0]
    assert panel.get_ylabel() == "Deflection $w_A/H$" and panel.get_xlabel() == "Time in ms"
    first, second = panel.get_lines()
    assert np.allclose(first.get_ydata(), run.watched["apex"] / -0.002182)
    assert np.allclose(first.get_xdata(), run.times * 1e3)
    assert (first.get_linestyle(), first.get_color()) != (second.get_linestyle(), second.get_color())


def test_energy_panels_and_balance(cap):
    runs = {name: synthetic_solution(cap, method=name) for name in ("EMC", "EDMC1", "EDMC2")}
    figure = figures(runs)["energy"]
    *panels, below = figure.axes
    assert [panel.get_title() for panel in panels] == ["EMC", "EDMC1", "EDMC2"]
    assert panels[0].get_ylabel() == "Energy of the\nmodelled quarter in J"
    total = panels[1].get_lines()[2]
    assert total.get_label() == "K + S" and np.allclose(total.get_ydata(), runs["EDMC1"].energy.total)
    # The synthetic runs lose a tenth of K + S = 1.
    ends = [np.asarray(curve.get_ydata(), float)[-1] for curve in below.get_lines()]
    assert not ends[0] > 1e-15 and np.allclose(ends[1:], 0.1)


def test_balance_counts_work_and_dissipation():
    run = synthetic_solution(plain_scene(), method="EDMC")
    lost = 0.1 * run.times
    run = eqx.tree_at(lambda s: s.energy.dissipated, run, lost)
    assert np.abs(energy_balance(run)).max() < 1e-15
    run = eqx.tree_at(lambda s: (s.energy.dissipated, s.energy.external_work), run, (0 * lost, -lost))
    assert np.abs(energy_balance(run)).max() < 1e-15


def test_momentum_of_a_free_shell_only_of_the_whole(cap):
    drawn = figures(synthetic_solution(PAPER["plate"]((3, 1))))
    assert "velocity" not in drawn
    labels = [panel.get_ylabel() for panel in drawn["momentum"].axes]
    assert labels[:2] == ["$L_x$ in N s", "$J_x$ in N m s"] and len(labels) == 8
    assert "momentum" not in figures(synthetic_solution(cap))


def test_vanishing_momentum_is_a_flat_line():
    run = synthetic_solution(plain_scene())
    run = eqx.tree_at(lambda s: s.momentum.linear, run, run.momentum.linear.at[:, 1].multiply(1e-15))
    low, high = figures(run)["momentum"].axes[2].get_ylim()
    assert low == -high and high > 0.01


def test_momentum_of_a_shell_that_only_spins_is_a_flat_line():
    """Round-off all of it: against what the kinetic energy could carry."""
    run = synthetic_solution(plain_scene())
    run = eqx.tree_at(lambda s: s.momentum.linear, run, run.momentum.linear * 1e-15)
    linear, angular = momentum_scales(run)
    size = float(np.linalg.norm(np.ptp(run.scene.mesh.nodes, axis=0)))
    assert linear > 0 and np.isclose(angular, linear * size)
    for panel in figures(run)["momentum"].axes[:6:2]:
        assert np.allclose(panel.get_ylim(), [-0.05 * linear, 0.05 * linear])


def test_units_only_where_the_scene_has_them(cap):
    assert scaled(cap, 4e-4, "s") == (1e-6, " in µs")
    assert scaled(cap, 1e-3, "s") == (1e-3, " in ms")
    assert scaled(cap, 12.0, "m") == (1.0, " in m")
    assert scaled(cap, 0.0, "J") == (1.0, " in J")
    assert scaled(plain_scene(), 4e-4, "s") == (1.0, "")
    panel = figures(synthetic_solution(plain_scene()))["displacement"].axes[0]
    assert panel.get_xlabel() == "Time" and panel.get_ylabel() == "a, $u_z$"


def test_shapes_at_the_picture_times_true_to_scale(cap):
    run = synthetic_solution(cap, steps=100, save_every=1)
    *panels, _ = figures(run)["shapes"].axes
    titles = [panel.get_title() for panel in panels]
    assert titles == ["t = 0 ms", "t = 0.05 ms", "t = 0.1 ms", "t = 0.12 ms", "t = 0.15 ms", "t = 0.2 ms"]
    assert all(panel.get_aspect() == 1 for panel in panels)
    assert len(panels[0].collections[0].get_paths()) == 4 * cap.mesh.n_elements


def test_a_flight_is_one_picture():
    run = synthetic_solution(PAPER["plate"]((3, 1)))
    way = jnp.linspace(0, 1, len(run.frame_times))[:, None, None] * jnp.array([0.9, 0.0, 0.3])
    run = eqx.tree_at(lambda s: s.frames.displacements, run, run.displacements + way)
    panel, _ = figures(run)["shapes"].axes
    shapes = len(panel.collections[0].get_paths()) / run.scene.mesh.n_elements
    assert shapes > 1 and shapes == sum("t =" in text.get_text() for text in panel.texts)


def test_symmetry_is_read_from_supports(cap):
    assert symmetry_planes(cap) == [(0, 0.0), (1, 0.0)]
    mesh = plain_scene().mesh
    left, middle = mesh.nodes_where(lambda x: x[0] == 0), mesh.nodes_where(lambda x: x[0] == 1)
    assert symmetry_planes(plain_scene(symmetry(left, "x"))) == [(0, 0.0)]
    assert symmetry_planes(plain_scene(symmetry(middle, "x"))) == []  # the shell goes on beyond it
    assert symmetry_planes(plain_scene(symmetry(left, "y"))) == []  # these nodes are in no plane of y
    assert symmetry_planes(plain_scene(clamped(left), pinned(middle), Support(left, "ux"))) == []


def test_run_that_failed_early():
    run = synthetic_solution(PAPER["opened_cap"]((6, 2)), steps=50)
    early = jax.tree.map(lambda a: a[:21], (run.times, run.watched, run.energy, run.momentum, run.iterations))
    frames = jax.tree.map(lambda a: a[:7], (run.frame_times, run.displacements, run.rotations, run.velocities))
    names = ("times", "watched", "energy", "momentum", "iterations")
    frame_names = ("frame_times", "displacements", "rotations", "velocities")
    stopped = dataclasses.replace(
        run, **dict(zip(names, early, strict=True)), **dict(zip(frame_names, frames, strict=True))
    )
    titles = [axes.get_title() for axes in figures(stopped)["shapes"].axes]
    assert titles[0] == "t = 0 s" and "t = 1.8 s" in titles and "t = 2.1 s" not in titles
    first = jax.tree.map(lambda a: a[:1], (early, frames))
    stopped = dataclasses.replace(
        run, **dict(zip(names, first[0], strict=True)), **dict(zip(frame_names, first[1], strict=True))
    )
    assert list(figures(stopped)) == ["shapes"]


def test_every_run_of_seven_looks_different():
    assert len({(line(i)["color"], str(line(i)["linestyle"])) for i in range(7)}) == 7


def test_nothing_to_plot(tmp_path):
    with pytest.raises(ValueError, match="no solution"):
        plot({}, tmp_path, "x")
