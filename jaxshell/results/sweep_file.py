"""Sweeps on disk: one HDF5 file that grows by batches of members, and outlives its writer at any moment.

Layout (schema 1), every float in double precision, units those of the scene:

    /            attributes format, schema, jaxshell
    /settings    JSON text: how the sweep was asked for, with the names of parameters, watched quantities and functions
    /scene       the first member's scene, as in a result file
    /parameters  0, 1, ...: (N, ...) values of every member, or JSON of texts; their names are attributes
    /times       (k,) of the histories
    /members     a row for each member that has been run, in the order in which they ended:
                 number (M,), result (M,) names, steps (M,), watched (M, labels, k); minimum, maximum, time_of_minimum,
                 time_of_maximum and end (M, labels); energy (M, 4), energy_balance (M,); "quantity <name>" (M, ...);
                 and where frames are kept "frame times" (M, f), "frame displacements" and "frame velocities"
                 (M, f, n, 3), "frame rotations" (M, f, n, 4), unit quaternions
    /messages    bytes of JSON lines [member, why it failed]

The file is written as result files are (`jaxshell.results.durable`, `jaxshell.results.checked`).
"""

import contextlib
import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxshell.model.scene import Scene
from jaxshell.numerics.checks import require_float64
from jaxshell.numerics.signals import LostOutput, held
from jaxshell.results import checked
from jaxshell.results.checked import extend, growing, read_text, reading, write_array, write_attribute, write_text
from jaxshell.results.claim import Claim
from jaxshell.results.durable import in_use
from jaxshell.results.head import SWEEP
from jaxshell.results.quaternions import matrices_to_quaternions, quaternions_to_matrices
from jaxshell.results.sweep import ENERGIES, EXTREMES, Sweep
from jaxshell.results.tree import read_scene_of, to_json, tuples, write_scene
from jaxshell.version import version

SCHEMA = 1
_NAME = np.dtype("S16")
_SOON = 1.0
"""Seconds between two waits for the disk."""
_MESSAGE, _NUMBER, _RESULT = "message", "number", "result"
_SINGLE = ("steps", "energy_balance")
_FRAMES = ("times", "displacements", "rotations", "velocities")

Rows = Mapping[str, np.ndarray]


class SweepWriter:
    """A new file at `path` for members as they end. What was appended stays, whatever ends the process.

    What lies there is replaced when the first members are written; whether it may be is `check_replaceable`'s to say.
    """

    def __init__(self, path, scene: Scene, settings: dict, parameters: Mapping[str, np.ndarray], times: np.ndarray):
        self.path = Path(path)
        self._claim = Claim(self.path, True, lambda _: False)
        self._synced = 0.0
        with held():
            self._file: Any = checked.create(self._claim.file)
            for name, text in {"format": SWEEP, "jaxshell": version()}.items():
                write_attribute(self._file, name, text)
            self._file.attrs["schema"] = SCHEMA
            write_text(self._file, "settings", to_json(settings))
            write_scene(self._file.create_group("scene"), scene)
            group = self._file.create_group("parameters")
            for position, (name, values) in enumerate(parameters.items()):
                if values.dtype.kind == "U":
                    write_text(group, str(position), to_json(values.tolist()))
                else:
                    write_array(group, str(position), values)
                write_attribute(group[str(position)], "name", name)
            write_array(self._file, "times", times)
            self._members = self._file.create_group("members")
            growing(self._file, "messages", (), np.uint8)

    def append(self, rows: Rows) -> None:
        """Add members; an array of `rows` has a row for each. Raises OSError where the disk takes no more."""
        with held():
            said = zip(rows[_NUMBER], rows[_MESSAGE], strict=True)
            lines = [to_json([int(number), message]) for number, message in said if message]
            for name, values in rows.items():
                if name == _MESSAGE:
                    continue
                values = values.astype(_NAME) if name == _RESULT else values
                if name not in self._members:
                    wide = values.ndim > 1
                    growing(self._members, name, values.shape[1:], values.dtype, compressed=wide)
                extend(self._members[name], values)
            extend(self._file["messages"], np.frombuffer("".join(f"{line}\n" for line in lines).encode(), np.uint8))
            self._commit()

    def _commit(self, end: bool = False) -> None:
        sync = end or time.monotonic() - self._synced > _SOON
        try:
            self._file.flush()
            self._claim.file.commit(sync)
            self._claim.publish()
        except OSError as error:
            raise LostOutput(
                error.errno,
                f"Cannot write {self.path}: {error.strerror}. It holds the members that were written before; make room "
                "and run the same sweep again.",
            ) from error
        if sync:
            self._synced = time.monotonic()

    def close(self) -> None:
        with held():
            with contextlib.suppress(Exception):
                self._file.close()
            self._claim.release()


def check_replaceable(path, overwrite: bool) -> bool:
    """Whether `path` holds a sweep that may go on; False for nothing, or what is to be replaced.

    Raises ValueError for a file that is being written, and without `overwrite` for one that holds no sweep.
    """
    path = Path(path)
    if not path.exists():
        if not path.parent.is_dir():
            raise ValueError(f"Cannot write {path}: there is no folder {path.parent}.")
        return False
    if not path.is_file():
        raise ValueError(f"Cannot write {path}: it is no file.")
    if in_use(path):
        raise ValueError(f"{path} is in use: a sweep or a run is writing it. Wait for its end, or choose another name.")
    if overwrite:
        return False
    try:
        with reading(path) as file:
            _check_schema(file, path)
    except ValueError as error:
        raise ValueError(
            f"{path} exists and holds no sweep that can go on ({str(error).rstrip('.')}). Choose another name, or "
            "replace it with --overwrite, sweep(..., overwrite=True)."
        ) from error
    return True


def load_sweep(path) -> Sweep:
    """Read a sweep. Raises as `Sweep.load`."""
    require_float64()
    with reading(path) as file:
        _check_schema(file, path)
        scene = read_scene_of(file, path)
        settings = tuples(json.loads(read_text(file, "settings")))
        group = file["parameters"]
        parameters = {read_text(group[str(i)], "name"): _parameter(group[str(i)], group, i) for i in range(len(group))}
        size = len(next(iter(parameters.values())))
        rows = {name: dataset[()] for name, dataset in file["members"].items()}
        lines = bytes(file["messages"][()]).decode().splitlines()
        messages = {int(number): str(text) for number, text in map(json.loads, lines)}
        return sweep_of(scene, settings, parameters, file["times"][()], placed(rows, size), messages)


def _parameter(dataset, group, position: int) -> np.ndarray:
    if dataset.dtype == np.uint8:
        return np.asarray(json.loads(read_text(group, str(position))))
    return dataset[()]


def placed(rows: Rows, size: int) -> dict[str, np.ndarray]:
    """{name: (N, ...)} of rows of some members; NaN, 0 or "" for the others."""
    numbers = rows.get(_NUMBER, np.zeros(0, int))
    found = {}
    for name, values in rows.items():
        if name in (_NUMBER, _MESSAGE):
            continue
        if name == _RESULT:
            whole = np.full(size, "", dtype="U16")
        else:
            whole = np.full((size, *values.shape[1:]), np.nan if values.dtype.kind == "f" else 0, values.dtype)
        whole[numbers] = values.astype(str) if values.dtype.kind == "S" else values
        found[name] = whole
    return found


def sweep_of(
    scene: Scene,
    settings: dict,
    parameters: dict[str, np.ndarray],
    times: np.ndarray,
    table: dict[str, np.ndarray],
    messages: dict[int, str],
) -> Sweep:
    """The sweep that a table of all members, as `placed` makes it, stands for."""
    size = len(next(iter(parameters.values())))
    labels, k = list(settings["labels"]), len(times)

    def column(name: str, *shape: int) -> np.ndarray:
        return table[name] if name in table else np.full((size, *shape), np.nan)

    by_label = {name: dict(zip(labels, np.moveaxis(column(name, len(labels)), 1, 0), strict=True)) for name in EXTREMES}
    frames = None
    if "frame times" in table:
        frames = {name: table[f"frame {name}"] for name in _FRAMES}
        frames["rotations"] = quaternions_to_matrices(frames["rotations"])
    return Sweep(
        scene=scene,
        kind=settings["kind"],
        parameters=parameters,
        result=table.get(_RESULT, np.full(size, "", dtype="U16")),
        messages=messages,
        times=times,
        watched=dict(zip(labels, np.moveaxis(column("watched", len(labels), k), 1, 0), strict=True)),
        **by_label,
        energy=dict(zip(ENERGIES, column("energy", len(ENERGIES)).T, strict=True)),
        energy_balance=column("energy_balance"),
        steps=table.get("steps", np.zeros(size, int)),
        quantities={name: column(f"quantity {name}") for name in settings["quantities"]},
        frames=frames,
        settings=settings,
    )


def rows_of(sweep: Sweep) -> dict[str, np.ndarray]:
    """The rows of a sweep's members that are done, as `SweepWriter.append` takes them."""
    done = np.flatnonzero(sweep.done)

    def stacked(values: Mapping[str, np.ndarray]) -> np.ndarray:
        return np.stack([array[done] for array in values.values()], 1) if values else np.zeros((len(done), 0))

    empty = np.zeros((len(done), 0, len(sweep.times)))
    rows = {
        _NUMBER: done,
        _RESULT: sweep.result[done],
        _MESSAGE: np.array([sweep.messages.get(int(number), "") for number in done], object),
        "watched": stacked(sweep.watched) if sweep.watched else empty,
        "energy": stacked(sweep.energy),
        **{name: stacked(getattr(sweep, name)) for name in EXTREMES},
        **{name: getattr(sweep, name)[done] for name in _SINGLE},
        **{f"quantity {name}": values[done] for name, values in sweep.quantities.items()},
    }
    if sweep.frames is not None:
        rows |= {f"frame {name}": sweep.frames[name][done] for name in _FRAMES}
        rows["frame rotations"] = matrices_to_quaternions(rows["frame rotations"])
    return rows


def save_sweep(sweep: Sweep, path, overwrite: bool = False) -> None:
    """Write a whole sweep."""
    if check_replaceable(path, overwrite):
        raise ValueError(f"{path} holds a sweep: choose another name, or replace it with overwrite=True.")
    with contextlib.closing(SweepWriter(path, sweep.scene, sweep.settings, sweep.parameters, sweep.times)) as writer:
        writer.append(rows_of(sweep))
        writer._commit(end=True)


def _check_schema(file, path) -> None:
    kind = read_text(file, "format") if "format" in file.attrs else None
    if kind != SWEEP:
        raise ValueError(f"{path} is an HDF5 file, but no sweep of jaxshell's.")
    if file.attrs.get("schema") != SCHEMA:
        raise ValueError(
            f"{path} has schema {file.attrs.get('schema')}, and this version of jaxshell reads sweeps of {SCHEMA}."
        )
