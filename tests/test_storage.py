"""Result files: what comes back is what was written, killed runs load, and foreign files are refused."""

import contextlib
import dataclasses

import equinox as eqx
import h5py
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

jax.config.update("jax_enable_x64", True)

from synthetic import synthetic_solution  # noqa: E402

from jaxshell.model.initial import Initial  # noqa: E402
from jaxshell.model.loads import EdgeForce, Gravity, History, NodalForce, NodalMoment, NormalForce, Pressure  # noqa: E402
from jaxshell.model.mesh import Mesh  # noqa: E402
from jaxshell.model.scene import Defaults, Scene  # noqa: E402
from jaxshell.model.sections import Section  # noqa: E402
from jaxshell.model.supports import Support, clamped  # noqa: E402
from jaxshell.results import hdf5 as storage  # noqa: E402
from jaxshell.results.quaternions import matrices_to_quaternions, quaternions_to_matrices  # noqa: E402
from jaxshell.results.solution import RESULTS, Solution  # noqa: E402
from jaxshell.scenes import PAPER  # noqa: E402


@pytest.fixture
def everything() -> Scene:
    """Two triangles with every kind of load, support and initial value that a scene can have."""
    mesh = Mesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.1]], np.array([[0, 1, 2], [0, 2, 3]]))
    turned = Rotation.from_rotvec([[0, 0, 0], [0.1, 0, 0], [0, 3.1, 0], [1, 2, 3]]).as_matrix()
    return Scene(
        mesh,
        Section([0.1, 0.2], 1e9, 0.3, [1000.0, 1100.0]),
        (
            clamped([0]),
            Support([1], ("ux", "uz"), [0.5, 0.25], History([0.0, 1.0, 3.0], [0.0, 1.0, -1.0])),
            Support([2], "rx"),
        ),
        (
            NodalForce([2], [1.0, 2.0, 3.0], History.ramp(2.0)),
            NodalMoment([2, 3], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
            EdgeForce([[1, 2]], [0.0, 0.0, 4.0]),
            Gravity([0.0, 0.0, -9.81]),
            NormalForce([1, 3], [0.5, -2.0]),
            Pressure([5.0, 6.0], History.ramp(1.0)),
        ),
        initial=Initial(jnp.ones((4, 3)), 2 * jnp.ones((4, 3)), 0.1 * jnp.ones((4, 3)), jnp.asarray(turned)),
        name="everything",
        watch={"a/b.c %": (2, "uz"), "π": (3, "vx"), "..": (1, "uy"), "": (0, "ux")},
        defaults=Defaults(0.1, 1.0, 2, (0.0, 0.5), (("EMC", 1.0, 0.0),), "SI", (("π", 2.0, "v / v₀"),)),
    )


def assert_same_solution(loaded: Solution, saved: Solution):
    """Equal to the last bit, but for rotations, which go through quaternions."""
    frames = loaded.frame(list(range(len(loaded.frame_times))))
    assert np.abs(np.asarray(frames.rotations - saved.rotations)).max() <= 1e-15
    assert np.array_equal(frames.displacements, saved.displacements)
    assert np.array_equal(frames.velocities, saved.velocities)
    assert eqx.tree_equal(dataclasses.replace(loaded, frames=saved.frames), saved)


def test_scene_comes_back_whole(everything, tmp_path):
    synthetic_solution(everything).save(tmp_path / "a.h5")
    assert eqx.tree_equal(storage.read_scene(tmp_path / "a.h5"), everything)


@pytest.mark.parametrize("name", PAPER)
def test_solution_comes_back(name, tmp_path):
    solution = synthetic_solution(PAPER[name]())
    solution.save(tmp_path / "a.h5")
    loaded = Solution.load(tmp_path / "a.h5")
    assert loaded.displacements.dtype == np.float64
    assert_same_solution(loaded, solution)


def test_failed_run_keeps_its_result(everything, tmp_path):
    solution = dataclasses.replace(
        synthetic_solution(everything), result=RESULTS.diverged, message="Step 3 at time 0.25."
    )
    solution.save(tmp_path / "a.h5")
    loaded = Solution.load(tmp_path / "a.h5")
    assert bool(loaded.result == RESULTS.diverged)
    assert loaded.message == "Step 3 at time 0.25."


def _append(writer, s: Solution, steps: slice, frames: slice):
    take = lambda tree, part: jax.tree.map(lambda a: np.asarray(a)[part], tree)  # noqa: E731
    histories = {
        name: take(getattr(s, name), steps) for name in ("times", "watched", "energy", "momentum", "iterations")
    }
    shapes = ("frame_times", "displacements", "rotations", "velocities")
    writer.append(dataclasses.replace(s, **histories, **{name: take(getattr(s, name), frames) for name in shapes}))


@contextlib.contextmanager
def _writing(path, scene, settings):
    with contextlib.closing(storage.ResultWriter(path)) as writer:
        writer.begin(scene, settings)
        yield writer


def test_chunks_add_up_to_the_run(everything, tmp_path):
    solution = synthetic_solution(everything, steps=600)
    with _writing(tmp_path / "a.h5", everything, {"dt": 0.1}) as writer:
        for start in range(0, 601, 150):
            frames = slice(-(-start // 3), -(-(start + 150) // 3))
            _append(writer, solution, slice(start, start + 150), frames)
        writer.finish("successful", "", solution.stats)
    assert_same_solution(Solution.load(tmp_path / "a.h5"), solution)
    assert storage.read_settings(tmp_path / "a.h5") == {"dt": 0.1}


def test_killed_run_loads_as_far_as_it_went(everything, tmp_path):
    """A copy of the file taken while the writer still has it open is what a killed process leaves behind."""
    solution = synthetic_solution(everything)
    with _writing(tmp_path / "a.h5", everything, {"dt": 0.1}) as writer:
        _append(writer, solution, slice(0, 8), slice(0, 3))
        (tmp_path / "copy.h5").write_bytes((tmp_path / "a.h5").read_bytes())
        _append(writer, solution, slice(8, 13), slice(3, 5))
    loaded = Solution.load(tmp_path / "copy.h5")
    assert bool(loaded.result == RESULTS.interrupted)
    assert "7 steps" in loaded.message and "0.5833" in loaded.message
    assert np.array_equal(loaded.times, solution.times[:8])
    assert np.array_equal(loaded.displacements, solution.displacements[:3])
    assert loaded.stats == {"dt": 0.1}


def test_quaternions_are_exact_at_every_angle():
    rng = np.random.default_rng(0)
    axes = np.concatenate([np.eye(3), -np.eye(3), rng.normal(size=(300, 3))])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    for angle in (0.0, 1e-9, 0.5, 2.0, np.pi - 1e-9, np.pi):
        R = Rotation.from_rotvec(angle * axes).as_matrix()
        assert np.abs(quaternions_to_matrices(matrices_to_quaternions(R)) - R).max() <= 1e-15


def test_numpy_figures_can_be_settings(everything, tmp_path):
    settings = {"a": np.float64(0.1), "b": np.arange(2), "c": jnp.ones(())}
    with _writing(tmp_path / "a.h5", everything, settings) as writer:
        assert not (tmp_path / "a.h5").exists()  # it holds nothing yet
        writer.append(synthetic_solution(everything))
    assert storage.read_settings(tmp_path / "a.h5") == {"a": 0.1, "b": [0, 1], "c": 1.0}


def _foreign(path):
    with h5py.File(path, "w") as file:
        file["x"] = 1.0


def _schema(path):
    with h5py.File(path, "r+") as file:
        file.attrs["schema"] = 99


def _damaged(path):
    with h5py.File(path, "r+") as file:
        del file["histories/energy/kinetic"]


def _no_section(path):
    with h5py.File(path, "r+") as file:
        del file["scene/section"]


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda path: path.write_text("t, w\n"), "cannot be read as an HDF5 file"),
        (lambda path: path.write_bytes(path.read_bytes()[:3000]), "cannot be read as an HDF5 file"),
        (_foreign, "not one that jaxshell wrote"),
        (_schema, "has schema 99, and this version of jaxshell reads schemas 1 to 2"),
        (_damaged, "is damaged.*kinetic"),
        (_no_section, "The scene in .* is damaged.*section"),
    ],
)
def test_unusable_files_are_refused(everything, tmp_path, spoil, message):
    path = tmp_path / "a.h5"
    synthetic_solution(everything).save(path)
    spoil(path)
    with pytest.raises(ValueError, match=message):
        Solution.load(path)


def test_missing_file_and_folder(everything, tmp_path):
    with pytest.raises(FileNotFoundError, match="no file"):
        Solution.load(tmp_path / "none.h5")
    with pytest.raises(OSError, match="Cannot write"):
        synthetic_solution(everything).save(tmp_path / "none" / "a.h5")


def test_batch_is_refused(everything, tmp_path):
    batch = jax.tree.map(lambda a: jnp.stack([a, a]), synthetic_solution(everything))
    with pytest.raises(ValueError, match="Index the batch"):
        batch.save(tmp_path / "a.h5")


def test_loading_needs_float64(everything, tmp_path):
    synthetic_solution(everything).save(tmp_path / "a.h5")
    with jax.enable_x64(False), pytest.raises(RuntimeError, match="float64"):
        Solution.load(tmp_path / "a.h5")
