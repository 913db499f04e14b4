"""A run and its continuation are one run; what is none is refused."""

import dataclasses

import equinox as eqx
import jax
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)

from synthetic import synthetic_solution  # noqa: E402

import jaxshell as js  # noqa: E402
from jaxshell.model.scene import Defaults  # noqa: E402
from jaxshell.plotting.shapes import picture_frames  # noqa: E402
from jaxshell.results.joined import continues, join_continuations, joined  # noqa: E402
from jaxshell.results.solution import Stats  # noqa: E402


def cut(run, first: int, last: int):
    """Steps `first` to `last` of a run with a frame at every second step."""
    steps, frames = slice(first, last + 1), slice((first + 1) // 2, last // 2 + 1)
    names = ("times", "watched", "energy", "momentum", "iterations")
    parts = {name: jax.tree.map(lambda a: a[steps], getattr(run, name)) for name in names}
    shapes = {name: getattr(run, name)[frames] for name in ("displacements", "rotations", "velocities")}
    stats = Stats(run.stats | {"steps": last - first})
    return dataclasses.replace(run, **parts, **shapes, frame_times=run.frame_times[frames], stats=stats)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A whole run, and the same in three parts, the first of which comes from a file. The second begins at a step
    without a frame."""
    mesh = js.Mesh([[0, 0, 0], [1, 0, 0], [1, 0.5, 0], [0, 0.5, 0]], [[0, 1, 2], [0, 2, 3]])
    section = js.Section(0.02, 1e6, 0.3, 1e3)
    scene = js.Scene(mesh, section, [js.clamped([0, 3])], [js.Gravity([0, 0, -9.8])], watch={"a": (2, "uz")})
    whole = synthetic_solution(scene, steps=12, save_every=2)
    path = tmp_path_factory.mktemp("joined") / "first.h5"
    cut(whole, 0, 5).save(path)
    return whole, js.Solution.load(path), cut(whole, 5, 8), cut(whole, 8, 12)


def test_a_chain_of_continuations_is_the_whole_run(runs):
    whole, first, second, third = runs
    found = join_continuations({"c": third, "a": first, "b": second})
    assert list(found) == ["a"]
    run = found["a"]
    for name in ("times", "frame_times", "iterations"):
        assert np.allclose(getattr(run, name), getattr(whole, name), rtol=0, atol=1e-15), name
    for one, other in ((run.energy, whole.energy), (run.momentum, whole.momentum), (run.watched, whole.watched)):
        assert all(
            np.allclose(a, b, rtol=1e-9, atol=1e-12) for a, b in zip(*map(jax.tree.leaves, (one, other)), strict=True)
        )
    assert run.stats["steps"] == 12


def test_frames_of_a_joined_run_are_read_by_their_numbers(runs):
    whole, first, second, third = runs
    run = joined(first, joined(second, third))
    for name in ("displacements", "rotations", "velocities"):
        assert np.allclose(getattr(run, name), getattr(whole, name), atol=1e-12), name
    for which in ([6, 0, 3, 2], [1], [-1, 4], []):
        found = run.frame(which)
        assert found.displacements.shape == (len(which), 4, 3)
        assert np.allclose(found.displacements, whole.displacements[np.array(which, int)], atol=1e-12)
    assert np.allclose(run.frame(3).velocities, whole.velocities[3], atol=1e-12)
    assert (
        picture_frames(run).tolist() == [0, 1, 2, 3, 4, 5, 6][: len(picture_frames(run))]
        or len(picture_frames(run)) == 6
    )


def test_what_does_not_go_on_is_no_continuation(runs):
    whole, first, second, third = runs
    assert continues(second, first) and not continues(first, second) and not continues(third, first)
    assert not continues(first, first) and not continues(whole, first)
    other = dataclasses.replace(second.scene, section=js.Section(0.03, 1e6, 0.3, 1e3))
    method = eqx.tree_at(lambda s: s.energy.strain, second, second.energy.strain + 1e-3)
    for stranger in (dataclasses.replace(second, scene=other), method):
        assert not continues(stranger, first)
        with pytest.raises(ValueError, match="does not go on"):
            joined(first, stranger)
    assert list(join_continuations({"a": first, "b": third})) == ["a", "b"]


def test_how_a_scene_is_shown_does_not_matter(runs):
    _, first, second, _ = runs
    shown = dataclasses.replace(second.scene, defaults=Defaults(0.1, 1.0, picture_times=(0.0, 0.5)))
    run = joined(first, dataclasses.replace(second, scene=shown))
    assert run.frame_times[picture_frames(run)].tolist() == [0.0, 0.5]
