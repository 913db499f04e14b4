"""Results on disk: HDF5 files that hold a run's histories and frames, and the whole scene it was made from.

Layout (schema 1), every float in double precision, units those of the scene:

    /            attributes format, schema, jaxshell, settings (JSON); result, message once the run has ended
    /stats       JSON text, once the run has ended
    /scene       the scene as a tree: a group per object with its class in `kind`, a dataset per array,
                 an attribute (JSON) per name or setting
    /histories   times (k,), iterations (k,), watched/<label> (k,), momentum/{linear, angular} (k, 3),
                 energy/{kinetic, strain, external_work, dissipated} (k,); reaction (k, nh) where it was recorded
    /frames      times (f,), displacements (f, n, 3), velocities (f, n, 3), rotations (f, n, 4)
    /state       of a run in time, what its method needs to go on from the last step, an array per name

Rotations are unit quaternions (w, x, y, z), 4 numbers in place of 9; a rotation matrix comes back to 1e-15.
Files grow chunk by chunk while a run goes on, and what has been written stays readable when it is killed.
"""

import contextlib
import dataclasses
import json
from pathlib import Path
from typing import Any

import equinox as eqx
import h5py
import jax.numpy as jnp
import numpy as np

from jaxshell.model.history import History
from jaxshell.model.loads import LOADS
from jaxshell.model.mesh import Mesh
from jaxshell.model.scene import Defaults, Initial, Scene
from jaxshell.model.sections import SECTIONS
from jaxshell.model.supports import Support
from jaxshell.numerics.checks import require_float64
from jaxshell.numerics.frozen import Frozen
from jaxshell.results.output import Output
from jaxshell.results.restart import named
from jaxshell.results.solution import RESULTS, Energy, Momentum, Solution, Stats
from jaxshell.version import version

FORMAT, SCHEMA = "jaxshell", 1
_KINDS = {kind.__name__: kind for kind in (Mesh, *SECTIONS, Support, History, Initial, *LOADS)}
_ENERGY = tuple(field.name for field in dataclasses.fields(Energy))
_MOMENTUM = tuple(field.name for field in dataclasses.fields(Momentum))
_INTERRUPTED = "The run was stopped before its end: the file holds the {steps} steps up to time {time:.6g}."


class ResultWriter(Output):
    """Write a run into an HDF5 file as it goes.

    Arguments:
        path: the file; an existing one is replaced when the run begins.

    A run that ends without `finish` (killed, or left by an exception) keeps everything appended so far.
    """

    def __init__(self, path):
        self.path = path
        self._file: Any = None

    def begin(self, scene: Scene, settings: dict) -> None:
        """Store the scene, which must be concrete (not traced by jit, grad or vmap), and the settings."""
        self._labels = [label for label, _, _ in scene.watch]
        self._file = _open(self.path, "w")
        self._file.attrs.update(format=FORMAT, schema=SCHEMA, jaxshell=version(), settings=_to_json(settings))
        _write_scene(self._file.create_group("scene"), scene)
        histories, frames = self._file.create_group("histories"), self._file.create_group("frames")
        names = ["times", *(f"watched/{_dataset_name(label)}" for label in self._labels)]
        for name in names + [f"energy/{name}" for name in _ENERGY]:
            _growing(histories, name, ())
        _growing(histories, "iterations", (), np.int64)
        for name in _MOMENTUM:
            _growing(histories, f"momentum/{name}", (3,))
        if settings.get("reactions"):
            _growing(histories, "reaction", (scene.held_dofs.size,))
        _growing(frames, "times", ())
        n = scene.mesh.n_nodes
        for name, width in (("displacements", 3), ("rotations", 4), ("velocities", 3)):
            _growing(frames, name, (n, width), compressed=True)
        self._file.flush()

    def append(self, part: Solution) -> None:
        """Add the steps and frames of `part`; its state replaces the last."""
        histories, frames = self._file["histories"], self._file["frames"]
        # Frames first: a run killed between the two then never has a step without its frame.
        _extend(frames["displacements"], part.displacements)
        _extend(frames["rotations"], matrices_to_quaternions(np.asarray(part.rotations)))
        _extend(frames["velocities"], part.velocities)
        _extend(frames["times"], part.frame_times)
        for label in self._labels:
            _extend(histories[f"watched/{_dataset_name(label)}"], part.watched[label])
        for name in _ENERGY:
            _extend(histories[f"energy/{name}"], getattr(part.energy, name))
        for name in _MOMENTUM:
            _extend(histories[f"momentum/{name}"], getattr(part.momentum, name))
        if part.reaction is not None:
            _extend(histories["reaction"], part.reaction)
        _extend(histories["iterations"], part.iterations)
        _extend(histories["times"], part.times)
        for name, leaf in {} if part.state is None else named(part.state).items():
            array = np.asarray(leaf)
            self._file.require_dataset(f"state/{name}", array.shape, array.dtype)[...] = array
        self._file.flush()

    def finish(self, result: str, message: str, stats: dict) -> None:
        """Record how the run ended: the name of a RESULTS item, its message, and the host-side figures."""
        if result not in result_names():
            raise ValueError(f"result must be one of {', '.join(result_names())}, but it is {result!r}.")
        self._file["stats"] = _to_json(stats)
        self._file.attrs.update(result=result, message=message)
        self._file.flush()

    def close(self) -> None:
        if self._file is not None:
            self._file.close()


def save_solution(solution: Solution, path) -> None:
    """Write a whole solution. Raises ValueError for a batch of solutions (made under `jax.vmap`)."""
    if np.ndim(solution.times) != 1:
        raise ValueError(
            f"A solution of one run can be saved, but its times have shape {np.shape(solution.times)}. "
            "Index the batch first."
        )
    with contextlib.closing(ResultWriter(path)) as writer:
        writer.begin(solution.scene, {**solution.stats, "reactions": solution.reaction is not None})
        writer.append(solution)
        writer.finish(result_name(solution.result), solution.message, solution.stats)


def load_solution(path) -> Solution:
    """Read a solution; of a run that was killed, what it had written (result `interrupted`, with a message).

    Raises FileNotFoundError, or ValueError for a file that is not ours, of another schema, or broken;
    RuntimeError when JAX has float64 switched off.
    """
    require_float64()
    with _open(path, "r") as file:
        scene = _read_scene(file, path)
        try:
            histories, frames = file["histories"], file["frames"]
            labels = [label for label, _, _ in scene.watch]
            watched = {label: histories[f"watched/{_dataset_name(label)}"] for label in labels}
            energy = {name: histories[f"energy/{name}"] for name in _ENERGY}
            momentum = {name: histories[f"momentum/{name}"] for name in _MOMENTUM}
            single = {name: histories[name] for name in ("times", "iterations", "reaction") if name in histories}
            # A killed run may have got through a part of its last append only.
            k = min(len(d) for group in (watched, energy, momentum, single) for d in group.values())
            f = min(len(frames[name]) for name in ("times", "displacements", "rotations", "velocities"))
            stats = json.loads(_text(file["stats"][()]) if "stats" in file else file.attrs["settings"])
            stats = Stats(_tuples(stats))
            ended = "result" in file.attrs
            message = file.attrs["message"] if ended else ""
            result = getattr(RESULTS, file.attrs["result"] if ended else "interrupted")
            times = jnp.asarray(single["times"][:k])
            if not ended:
                last = float(times[-1]) if k else float("nan")
                message = _INTERRUPTED.format(steps=max(k - 1, 0), time=last)
            return Solution(
                scene=scene,
                times=times,
                watched={label: jnp.asarray(d[:k]) for label, d in watched.items()},
                energy=Energy(**{name: jnp.asarray(d[:k]) for name, d in energy.items()}),
                momentum=Momentum(**{name: jnp.asarray(d[:k]) for name, d in momentum.items()}),
                iterations=jnp.asarray(single["iterations"][:k]),
                frame_times=jnp.asarray(frames["times"][:f]),
                displacements=jnp.asarray(frames["displacements"][:f]),
                rotations=jnp.asarray(quaternions_to_matrices(frames["rotations"][:f])),
                velocities=jnp.asarray(frames["velocities"][:f]),
                result=result,
                message=message,
                stats=stats,
                state={name: jnp.asarray(d[()]) for name, d in file["state"].items()} if "state" in file else None,
                reaction=jnp.asarray(single["reaction"][:k]) if "reaction" in single else None,
                analysis="static" if stats.get("method", "").startswith("Static(") else "time",
            )
        except (KeyError, OSError, AttributeError, json.JSONDecodeError) as error:
            raise ValueError(f"{path} is damaged: {error}. Run the scene again.") from error


def read_scene(path) -> Scene:
    """The scene of a result file, ready to run again. Raises as `load_solution`."""
    require_float64()
    with _open(path, "r") as file:
        return _read_scene(file, path)


def read_settings(path) -> dict:
    """How the run of a result file was asked for: its writer's `settings`. Raises as `load_solution`."""
    with _open(path, "r") as file:
        return json.loads(file.attrs["settings"])


def result_names() -> tuple[str, ...]:
    """Names of the items of RESULTS."""
    # equinox offers no public way to list an Enumeration.
    return tuple(RESULTS._name_to_item)  # pyright: ignore[reportAttributeAccessIssue]


def result_name(result) -> str:
    """The name of an item of RESULTS, such as "successful"."""
    return next(name for name in result_names() if bool(getattr(RESULTS, name) == result))


# --- the file --------------------------------------------------------------------------------------------


def _open(path, mode: str) -> Any:  # h5py.File, whose items the type checker cannot know
    path = Path(path)
    if mode == "r" and not path.is_file():
        raise FileNotFoundError(f"There is no file {path}.")
    try:
        file = h5py.File(path, mode)
    except BlockingIOError as error:
        raise ValueError(f"{path} is in use by another program, perhaps a run that writes it.") from error
    except OSError as error:
        if mode == "w":
            raise OSError(f"Cannot write {path}: {error}.") from error
        raise ValueError(f"{path} cannot be read as an HDF5 file ({error}).") from error
    if mode == "r":
        kind, schema = file.attrs.get("format"), file.attrs.get("schema")
        if kind != FORMAT or schema != SCHEMA:
            file.close()
            if kind != FORMAT:
                raise ValueError(f"{path} is an HDF5 file, but not one that jaxshell wrote.")
            raise ValueError(
                f"{path} has schema {schema}, and this version of jaxshell reads schema {SCHEMA}. "
                "Use the version that wrote it, or run the scene again."
            )
    return file


def _growing(group, name: str, shape: tuple[int, ...], dtype: Any = np.float64, compressed=False) -> None:
    """A dataset (0, *shape) that can grow along its first axis.

    Frames are compressed in HDF5 chunks of about 64 KiB, one frame at least. Histories are not: their last
    chunk is written again at every append, and a compressed one would change its size and leave holes.
    """
    rows = max(1, 2**16 // (8 * int(np.prod(shape)))) if compressed else 256
    filters = {"compression": "gzip", "compression_opts": 1, "shuffle": True} if compressed else {}
    group.create_dataset(name, (0, *shape), dtype, maxshape=(None, *shape), chunks=(rows, *shape), **filters)


def _extend(dataset, values) -> None:
    values = np.asarray(values)
    start = len(dataset)
    dataset.resize(start + len(values), axis=0)
    dataset[start:] = values


def _dataset_name(label: str) -> str:
    """A watch label as a name that HDF5 does not read as a path; different labels have different names."""
    return label.replace("%", "%25").replace("/", "%2F").replace(".", "%2E") or "%"


def _to_json(value) -> str:
    def other(item):
        return item.item() if np.ndim(item) == 0 and hasattr(item, "item") else np.asarray(item).tolist()

    return json.dumps(value, default=other, ensure_ascii=False)


def _text(value) -> str:
    return value.decode() if isinstance(value, bytes) else value


# --- the scene as a tree of groups -----------------------------------------------------------------------


def _write_scene(group, scene: Scene) -> None:
    for name in ("mesh", "section", "initial"):
        _write_field(group, name, getattr(scene, name))
    for name in ("supports", "loads"):
        items = group.create_group(name)
        for position, item in enumerate(getattr(scene, name)):
            _write_field(items, str(position), item)
    group.attrs.update(name=scene.name, watch=_to_json(scene.watch))
    if scene.defaults is not None:
        group.attrs["defaults"] = _to_json(scene.defaults._asdict())


def _write_field(group, name: str, value) -> None:
    if value is None:
        return
    if isinstance(value, eqx.Module):
        inner = group.create_group(name)
        inner.attrs["kind"] = type(value).__name__
        for field in dataclasses.fields(value):
            _write_field(inner, field.name, getattr(value, field.name))
    elif isinstance(value, Frozen):
        group[name] = value.array
    elif isinstance(value, str | tuple):
        group.attrs[name] = _to_json(value)
    else:
        group[name] = np.asarray(value)


def _read_scene(file, path) -> Scene:
    try:
        group = file["scene"]
        supports, loads = (
            tuple(_read_object(group[name][str(position)]) for position in range(len(group[name])))
            for name in ("supports", "loads")
        )
        defaults = group.attrs.get("defaults")
        return Scene(
            _read_object(group["mesh"]),
            _read_object(group["section"]),
            supports,
            loads,
            initial=_read_object(group["initial"]) if "initial" in group else None,
            name=group.attrs["name"],
            watch={label: (node, component) for label, node, component in json.loads(group.attrs["watch"])},
            defaults=None if defaults is None else Defaults(**_tuples(json.loads(defaults))),
        )
    except (KeyError, OSError, TypeError, json.JSONDecodeError) as error:
        raise ValueError(f"The scene in {path} is damaged: {error}.") from error


def _read_object(group) -> Any:
    kind = _KINDS[group.attrs["kind"]]
    fields = {name: _tuples(json.loads(text)) for name, text in group.attrs.items() if name != "kind"}
    for name, item in group.items():
        if isinstance(item, h5py.Group):
            fields[name] = _read_object(item)
        else:
            fields[name] = jnp.asarray(item[()]) if item.dtype.kind == "f" else item[()]
    if kind is Mesh:
        return Mesh(fields["nodes"], fields["connectivity"])
    return kind(**fields)


def _tuples(value) -> Any:
    """JSON's lists as the tuples that they were."""
    if isinstance(value, dict):
        return {name: _tuples(item) for name, item in value.items()}
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value


# --- rotations -------------------------------------------------------------------------------------------


def matrices_to_quaternions(matrices: np.ndarray) -> np.ndarray:
    """Unit quaternions (..., 4), (w, x, y, z), of rotation matrices (..., 3, 3).

    4 q qᵀ is linear in R; its column with the largest diagonal entry is q up to length (Shepperd 1978), which
    is well conditioned for every angle.
    """
    R = np.asarray(matrices, dtype=np.float64)
    trace = np.trace(R, axis1=-2, axis2=-1)
    outer = np.empty((*R.shape[:-2], 4, 4))
    outer[..., 0, 0] = 1 + trace
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        outer[..., a + 1, a + 1] = 1 - trace + 2 * R[..., a, a]
        outer[..., 0, a + 1] = outer[..., a + 1, 0] = R[..., c, b] - R[..., b, c]
        outer[..., b + 1, a + 1] = outer[..., a + 1, b + 1] = R[..., b, a] + R[..., a, b]
    largest = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    column = np.take_along_axis(outer, largest[..., None, None], axis=-1)[..., 0]
    return column / np.linalg.norm(column, axis=-1, keepdims=True)


def quaternions_to_matrices(quaternions: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) of unit quaternions (..., 4)."""
    w, x, y, z = np.moveaxis(np.asarray(quaternions), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)
