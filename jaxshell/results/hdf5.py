"""Results on disk: HDF5 files that hold a run's histories and frames, and the whole scene it was made from.

Layout (schema 2), every float in double precision, units those of the scene:

    /            attributes format, schema, jaxshell, run (a name that no other run has); result once the run has ended
    /settings    JSON text: how the run was asked for
    /message, /stats   texts, the second JSON, once the run has ended
    /scene       the scene as a tree: a group per object with its class in `kind`, a dataset per array or text
    /histories   times (k,), iterations (k,), watched/<label> (k,), momentum/{linear, angular} (k, 3),
                 energy/{kinetic, strain, external_work, dissipated} (k,); reaction (k, nh) and stable (k,) where
                 they were recorded
    /frames      times (f,), displacements (f, n, 3), velocities (f, n, 3), rotations (f, n, 4)
    /state       of a run in time, what its method needs to go on from the last step, an array per name
    /newton      of a run in time, what its iteration keeps from step to step, and the time of the state to which that
                 belongs: so a run goes on to the last bit. Of a large run that was killed it may be of an earlier
                 state; then it is not used, and the run goes on within the tolerance

Rotations are unit quaternions (w, x, y, z), 4 numbers in place of 9; a rotation matrix comes back to 1e-15. Files grow
while a run goes on, and outlive its death at any moment (`jaxshell.results.durable`); every byte that counts is under a
checksum (`jaxshell.results.checked`). Schema 1, of version 0.1, is read too.
"""

import contextlib
import dataclasses
import time
import uuid
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxshell.model.scene import Scene
from jaxshell.numerics.checks import require_float64
from jaxshell.numerics.signals import LostOutput, held
from jaxshell.results import checked
from jaxshell.results.checked import (
    dataset_name,
    extend,
    growing,
    has,
    read_text,
    reading,
    run_of,
    write_array,
    write_attribute,
    write_text,
)
from jaxshell.results.claim import Claim
from jaxshell.results.frames import StoredFrames
from jaxshell.results.head import RUN, check_schema, json_table, read_settings_of, write_head
from jaxshell.results.output import Output
from jaxshell.results.quaternions import matrices_to_quaternions
from jaxshell.results.restart import named, time_of
from jaxshell.results.solution import RESULTS, Energy, Momentum, Solution, Stats
from jaxshell.results.tree import read_scene_of, to_json, tuples

_ENERGY = tuple(field.name for field in dataclasses.fields(Energy))
_MOMENTUM = tuple(field.name for field in dataclasses.fields(Momentum))
_INTERRUPTED = "The run was stopped before its end: the file holds the {steps} steps up to time {time:.6g}."
_SHARE, _SOON, _BACKLOG = 50, 1.0, 2**23
"""What is written waits for the disk after so many times what the last wait took, but no less than so many seconds, or
when so many bytes wait."""
_LIGHT = 2**18
"""Bytes of what Newton keeps that are written with every part."""
_AT = "time"
"""Of the state to which what Newton keeps belongs."""


class ResultWriter(Output):
    """Write a run into an HDF5 file as it goes.

    Arguments:
        path: the file. One that holds a finished run is replaced, when the new run's first part is written.
        overwrite: replace a file also where it holds a run that did not end, or something else.

    What was appended stays, whatever ends the process; should power fail, all but the last seconds. A file that another
    run is writing is never replaced: `begin` raises ValueError, and OSError where nothing can be written.
    """

    def __init__(self, path, overwrite: bool = False):
        self.path, self.overwrite = Path(path), overwrite
        self._claim: Claim | None = None
        self._file: Any = None
        self._frames = self._steps = 0
        self._last, self._synced, self._pause = 0.0, 0.0, _SOON
        self._sound = False
        self._newton: dict[str, Any] | None = None
        self._newton_written = self._newton_pause = 0.0

    def begin(self, scene: Scene, settings: dict) -> None:
        """Make a file with the scene, which must be concrete (not traced by jit, grad or vmap), and the settings."""
        self._claim = Claim(self.path, self.overwrite, holds_unfinished_run)
        self._labels = [label for label, _, _ in scene.watch]
        self._run = uuid.uuid4().hex
        with held():
            self._file = checked.create(self._claim.file)
            write_head(self._file, self._run, scene, settings)
            self._make_datasets(scene, settings)

    def _make_datasets(self, scene: Scene, settings: dict) -> None:
        histories, frames = self._file.create_group("histories"), self._file.create_group("frames")
        names = ["times", *(f"watched/{dataset_name(label)}" for label in self._labels)]
        for name in names + [f"energy/{name}" for name in _ENERGY]:
            growing(histories, name, ())
        growing(histories, "iterations", (), np.int64)
        for name in _MOMENTUM:
            growing(histories, f"momentum/{name}", (3,))
        if settings.get("reactions"):
            growing(histories, "reaction", (scene.held_dofs.size,))
        growing(frames, "times", ())
        n = scene.mesh.n_nodes
        for name, width in (("displacements", 3), ("rotations", 4), ("velocities", 3)):
            growing(frames, name, (n, width), compressed=True)

    def append(self, part: Solution) -> None:
        """Add the steps and frames of `part`; its state replaces the last. Raises OSError where the disk is full."""
        with held():
            self._sound = False
            self._add(part)
            self._commit()
            self._sound = True
        self._steps += len(part.times)
        self._frames += len(part.frame_times)
        self._last = float(part.times[-1]) if len(part.times) else self._last

    def _add(self, part: Solution) -> None:
        histories, frames = self._file["histories"], self._file["frames"]
        if len(part.frame_times):
            extend(frames["displacements"], part.displacements)
            extend(frames["rotations"], matrices_to_quaternions(np.asarray(part.rotations)))
            extend(frames["velocities"], part.velocities)
            extend(frames["times"], part.frame_times)
        for label in self._labels:
            extend(histories[f"watched/{dataset_name(label)}"], part.watched[label])
        for name in _ENERGY:
            extend(histories[f"energy/{name}"], getattr(part.energy, name))
        for name in _MOMENTUM:
            extend(histories[f"momentum/{name}"], getattr(part.momentum, name))
        for name in ("reaction", "stable"):
            value = getattr(part, name)
            if value is not None:
                if name not in histories:
                    growing(histories, name, np.shape(value)[1:], np.asarray(value).dtype)
                extend(histories[name], value)
        extend(histories["iterations"], part.iterations)
        extend(histories["times"], part.times)
        self._put("state", part.state)
        if part.newton is not None and part.state is not None:
            self._newton = {**part.newton, _AT: time_of(part.state)}
            size = sum(np.asarray(leaf).nbytes for leaf in self._newton.values())
            if size <= _LIGHT or time.monotonic() - self._newton_written > self._newton_pause:
                self._write_newton()

    def _put(self, group: str, tree) -> None:
        """The arrays of a pytree in the place of those before."""
        for name, leaf in {} if tree is None else named(tree).items():
            place, array = f"{group}/{name}", np.asarray(leaf)
            if place in self._file:
                self._file[place][...] = array
            else:
                write_array(self._file, place, array)

    def _write_newton(self) -> None:
        """What Newton keeps. A large matrix is written when it costs little of the run, and at its end."""
        begun = time.monotonic()
        self._put("newton", self._newton)
        self._newton = None
        self._newton_written = time.monotonic()
        self._newton_pause = 2 * _SHARE * (self._newton_written - begun)

    def _commit(self, end: bool = False) -> None:
        """Bring to the disk what was added."""
        assert self._claim is not None
        begun = time.monotonic()
        file = self._claim.file
        sync = end or begun - self._synced > self._pause or file.backlog > _BACKLOG
        try:
            self._file.flush()
            file.commit(sync)
            self._claim.publish()
        except OSError as error:
            raise LostOutput(error.errno, self._lost(error)) from error
        if sync:
            self._synced = time.monotonic()
            self._pause = max(_SOON, _SHARE * (self._synced - begun))

    def _lost(self, error: OSError) -> str:
        """What a full disk leaves."""
        kept = f"{self.path} holds the {max(self._steps - 1, 0)} steps up to time {self._last:.6g}"
        if not self._steps:
            return f"Cannot write {self.path}: {error.strerror}."
        return f"Cannot write on: {error.strerror}. {kept}; make room and go on with --continue or restart=."

    def finish(self, result: str, message: str, stats: dict) -> None:
        """Record how the run ended: the name of a RESULTS item, its message, and the host-side figures."""
        if result not in result_names():
            raise ValueError(f"result must be one of {', '.join(result_names())}, but it is {result!r}.")
        assert self._claim is not None
        with held():
            if self._newton is not None:
                self._write_newton()
            write_text(self._file, "stats", to_json(stats))
            write_text(self._file, "message", message)
            write_attribute(self._file, "result", result)
            self._commit(end=True)

    def frames(self) -> StoredFrames:
        """What reads the frames back."""
        return StoredFrames(str(self.path.absolute()), self._run, self._frames)

    def close(self) -> None:
        if self._claim is None:
            return
        with held():
            # What is not committed by now is of a part that failed to be written, but for what Newton keeps.
            with contextlib.suppress(Exception):
                if self._sound and self._newton is not None:
                    self._write_newton()
                    self._commit(end=True)
            with contextlib.suppress(Exception):
                self._file.close()
            self._claim.release()
            self._claim = None


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

    Frames are read from the file when they are asked for. Raises FileNotFoundError, or ValueError for a file that is
    not ours, of another schema, or broken; RuntimeError when JAX has float64 switched off.
    """
    require_float64()
    with reading(path) as file:
        check_schema(file, path, RUN)
        scene = read_scene_of(file, path)
        return _solution(file, scene, path)


def _solution(file, scene: Scene, path) -> Solution:
    histories, frames = file["histories"], file["frames"]
    labels = [label for label, _, _ in scene.watch]
    watched = {label: histories[f"watched/{dataset_name(label)}"] for label in labels}
    energy = {name: histories[f"energy/{name}"] for name in _ENERGY}
    momentum = {name: histories[f"momentum/{name}"] for name in _MOMENTUM}
    optional = ("times", "iterations", "reaction", "stable")
    single = {name: histories[name] for name in optional if name in histories}
    # A run of version 0.1 that was killed may have got through a part of its last append only.
    k = min(len(d) for group in (watched, energy, momentum, single) for d in group.values())
    f = min(len(frames[name]) for name in ("times", "displacements", "rotations", "velocities"))
    if not k:
        raise RuntimeError("it holds no step, not even the start")
    _check_frames(frames, scene.mesh.n_nodes)
    ended = "result" in file.attrs
    stats = Stats(tuples(json_table(read_text(file, "stats" if has(file, "stats") else "settings"))))
    times = jnp.asarray(single["times"][:k])
    result = read_text(file, "result") if ended else "interrupted"
    if result not in result_names():
        raise RuntimeError(f"its result is {result!r}")
    message = read_text(file, "message") if ended else _INTERRUPTED.format(steps=k - 1, time=float(times[-1]))
    state, newton = (
        {name: jnp.asarray(d[()]) for name, d in file[group].items()} if group in file else None
        for group in ("state", "newton")
    )
    # What Newton kept may be of an earlier state, where the run was killed: then it is not used.
    newton = newton if newton is not None and state is not None and newton.pop(_AT) == time_of(state) else None
    return Solution(
        scene=scene,
        times=times,
        watched={label: jnp.asarray(d[:k]) for label, d in watched.items()},
        energy=Energy(**{name: jnp.asarray(d[:k]) for name, d in energy.items()}),
        momentum=Momentum(**{name: jnp.asarray(d[:k]) for name, d in momentum.items()}),
        iterations=jnp.asarray(single["iterations"][:k]),
        frame_times=jnp.asarray(frames["times"][:f]),
        frames=StoredFrames(str(Path(path).absolute()), run_of(file), f),
        result=getattr(RESULTS, result),
        message=message,
        stats=stats,
        state=state,
        newton=newton,
        reaction=jnp.asarray(single["reaction"][:k]) if "reaction" in single else None,
        stable=jnp.asarray(single["stable"][:k]) if "stable" in single else None,
        analysis="static" if str(stats.get("method", "")).startswith("Static(") else "time",
    )


def read_scene(path) -> Scene:
    """The scene of a result file, ready to run again. Raises as `load_solution`."""
    require_float64()
    with reading(path) as file:
        check_schema(file, path)
        return read_scene_of(file, path)


def read_settings(path) -> dict:
    """How the run of a result file was asked for: its writer's `settings`. Raises as `load_solution`."""
    with reading(path) as file:
        check_schema(file, path)
        return read_settings_of(file)


def holds_unfinished_run(path) -> bool | None:
    """Whether the file holds steps of a run that has not ended; None where it is no result file that can be read."""
    try:
        with reading(path) as file:
            check_schema(file, path)
            return "result" not in file.attrs and len(file["histories/times"]) > 1
    except (ValueError, OSError):
        return None


def result_names() -> tuple[str, ...]:
    """Names of the items of RESULTS."""
    # equinox offers no public way to list an Enumeration.
    return tuple(RESULTS._name_to_item)  # pyright: ignore[reportAttributeAccessIssue]


def result_name(result) -> str:
    """The name of an item of RESULTS, such as "successful"."""
    return next(name for name in result_names() if bool(getattr(RESULTS, name) == result))


def _check_frames(frames, n: int) -> None:
    for name, width in (("displacements", 3), ("rotations", 4), ("velocities", 3)):
        if frames[name].shape[1:] != (n, width):
            raise RuntimeError(f"frames/{name} has shape {frames[name].shape} for {n} nodes")
