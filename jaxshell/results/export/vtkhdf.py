"""VTKHDF: one file of a mesh and its fields at all frames, which VTK and ParaView open. h5py alone writes it.

Layout (VTKHDF 2.2, an UnstructuredGrid in one part; https://docs.vtk.org, "VTKHDF File Format"):

    /VTKHDF              Points (n, 3), Connectivity (3m,), Offsets (m + 1,), Types (m,): the mesh, once
    /VTKHDF/PointData    fields of nodes (f n, ...), sets of nodes (n,)
    /VTKHDF/CellData     fields of elements (f m, ...), sets of elements and the thickness (m,)
    /VTKHDF/FieldData    energies, momenta and what is watched at the frames (f, ...)
    /VTKHDF/Steps        Values (f,): the frames' times; where each frame begins in the arrays
    /jaxshell            attributes: what wrote it, the scene's name, units; result and message once the run has ended

Arrays that do not change are stored once: all steps begin at their first entry. What says so is one dataset under many
names. The file is written through a journal (`jaxshell.results.durable`), so that another program finds the frames of
the last commit while the run goes on, and after it was stopped or killed.
"""

import contextlib
import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from jaxshell.model.scene import Scene
from jaxshell.numerics.signals import LostOutput, held
from jaxshell.results import checked
from jaxshell.results.checked import dataset_name, extend, growing, write_array, write_attribute
from jaxshell.results.claim import Claim
from jaxshell.results.durable import DurableReader
from jaxshell.results.export.fields import Chosen, Evaluator, check_one_run, choose, thickness
from jaxshell.results.export.frames import at_frames, in_parts
from jaxshell.results.export.histories import histories, watched
from jaxshell.results.frames import Frames
from jaxshell.results.hdf5 import result_name
from jaxshell.results.output import Output
from jaxshell.results.solution import Solution
from jaxshell.version import version

VERSION = (2, 2)
"""Of the format: all that is used here is in it, and VTK 9.3 and ParaView 5.12 read it."""
_TRIANGLE = 5
"""VTK's number of the cell."""
_EVERY = 1.0
"""Seconds between two writes, no less."""
_CHUNK = 2**16
"""Bytes of an HDF5 chunk, about; one frame at least."""
_PLACES = "jaxshell/places"
"""Where frames begin in the arrays, as `Steps` shows it under VTK's names."""
_GROUPS = {"node": "PointData", "element": "CellData"}


class VTKHDFWriter(Output):
    """Write a run into a VTKHDF file as it goes, or, with `save_vtkhdf`, a solution.

    Arguments:
        path: the file, *.vtkhdf. One that jaxshell wrote is replaced, when the first frames are written.
        fields, axes, failure: what is written; see `jaxshell.results.export.fields.choose`.
        overwrite: replace another file too.

    Frames are written about every second: a run that was stopped leaves all of them, one that was killed all but those
    of the last seconds. `begin` raises ValueError for fields that the scene does not have and for a file that must
    stay, OSError where nothing can be written.
    """

    def __init__(self, path, fields: Any = "default", *, axes: Any = "global", failure=None, overwrite: bool = False):
        self.path, self.overwrite = Path(path), overwrite
        self._asked: Mapping[str, Any] = {"fields": fields, "axes": axes, "failure": failure}
        self._claim: Claim | None = None
        self._file: Any = None
        self._evaluate: Evaluator | None = None
        self._waiting: list[tuple] = []
        """(times, frames, values of the field data) of parts that are not written yet."""
        self._times: list[float] = []
        self._written = -math.inf
        self._sound = False

    def begin(self, scene: Scene, settings: dict) -> None:
        """Make a file with the mesh, which must be concrete (not traced by jit, grad or vmap), and its sets."""
        self._scene, self._chosen = scene, choose(scene, **self._asked)
        self._claim = Claim(self.path, self.overwrite, _unfinished)
        with held():
            self._file = checked.create(self._claim.file)
            about = self._file.create_group("jaxshell")
            units = "" if scene.defaults is None else scene.defaults.units
            for name, text in {"version": version(), "scene": scene.name, "units": units}.items():
                write_attribute(about, name, text)
            _write_mesh(self._file, scene)
            _write_constants(self._file["VTKHDF"], scene, self._chosen)

    def _make_arrays(self, part: Solution) -> None:
        """The datasets that grow, and those of a frame's place in them."""
        vtk, chosen = self._file["VTKHDF"], self._chosen
        steps, places = vtk["Steps"], self._file.create_group(_PLACES)
        growing(steps, "Values", ())
        for name in ("zero", "one", "frame", *_GROUPS):
            growing(places, name, (), np.int64)
        for name, width in (("cell", 1), ("scalar", 2), ("vector", 2)):
            growing(places, name, (width,), np.int64)
        steps["CellOffsets"] = steps["ConnectivityIdOffsets"] = places["cell"]
        steps["PointOffsets"] = steps["PartOffsets"] = places["zero"]
        steps["NumberOfParts"] = places["one"]
        for place, group in _GROUPS.items():
            offsets = steps.create_group(f"{group}Offsets")
            for name in vtk[group]:
                offsets[name] = places["zero"]
            for name in (name for name in chosen.changing if chosen.place(name) == place):
                _growing_rows(vtk[group], name, self._count(place), chosen.shape(name))
                offsets[name] = places[place]
        self._globals = {name: np.shape(values)[1:] for name, values in self._field_data(part).items()}
        for name, shape in self._globals.items():
            growing(vtk, f"FieldData/{name}", shape)
            steps[f"FieldDataOffsets/{name}"] = places["frame"]
            steps[f"FieldDataSizes/{name}"] = places["vector" if shape else "scalar"]
        steps.attrs.create("NSteps", 0, dtype=np.int64)

    def _count(self, place: str) -> int:
        return self._scene.mesh.n_nodes if place == "node" else self._scene.mesh.n_elements

    @property
    def frames_at_once(self) -> int:
        """So many are computed and written together."""
        return self._chosen.at_once(self._scene)

    def append(self, part: Solution) -> None:
        """Add the frames of `part`. Raises OSError where the disk is full."""
        if self._evaluate is None:
            self._evaluate = Evaluator(self._scene, self._chosen, part.analysis == "static")
            with held():
                self._make_arrays(part)
        if len(part.frame_times):
            self._waiting.append((np.asarray(part.frame_times), part.frames, self._field_data(part)))
        count = sum(len(times) for times, _, _ in self._waiting)
        if count >= self.frames_at_once or time.monotonic() - self._written > _EVERY:
            self._write()

    def _field_data(self, part: Solution) -> dict[str, np.ndarray]:
        """Energies, momenta and what is watched, at the frames of a part."""
        part = at_frames(part)
        named = {f"watched {dataset_name(label)}": history for label, history in watched(part).items()}
        found = {name: np.asarray(history.values) for name, history in (histories(part) | named).items()}
        return found | ({"load factor": np.asarray(part.times)} if part.analysis == "static" else {})

    def _write(self) -> None:
        """What waits, part by part of what is computed at a time, and commit it."""
        if not self._waiting:
            return
        times, frames, data = zip(*self._waiting, strict=True)
        together = [
            np.concatenate([np.asarray(getattr(each, name)) for each in frames])
            for name in ("displacements", "rotations", "velocities")
        ]
        times = np.concatenate(times)
        data = {name: np.concatenate([each[name] for each in data]) for name in self._globals}
        assert self._evaluate is not None
        self._waiting.clear()
        for start in range(0, len(times), self.frames_at_once):
            rows = slice(start, start + self.frames_at_once)
            values = self._evaluate(times[rows], Frames(*(each[rows] for each in together)))
            with held():
                self._sound = False
                self._add(times[rows], values, {name: each[rows] for name, each in data.items()})
                self._sound = True
        with held():
            self._commit()
        self._written = time.monotonic()

    def _add(self, times, values, data) -> None:
        """Arrays first, then where they begin, then how many there are."""
        vtk = self._file["VTKHDF"]
        for name, value in values.items():
            place = self._chosen.place(name)
            extend(vtk[_GROUPS[place]][name], value.reshape(-1, *self._chosen.shape(name)))
        for name, value in data.items():
            extend(vtk["FieldData"][name], value)
        steps, places, numbers = vtk["Steps"], self._file[_PLACES], len(self._times) + np.arange(len(times))
        for name, value in {"zero": 0 * numbers, "one": 0 * numbers + 1, "frame": numbers}.items():
            extend(places[name], value)
        for place in _GROUPS:
            extend(places[place], numbers * self._count(place))
        for name, value in {"cell": (0,), "scalar": (1, 1), "vector": (3, 1)}.items():  # components, tuples
            extend(places[name], np.full((len(times), len(value)), value))
        self._times += np.asarray(times).tolist()
        extend(steps["Values"], times)
        if np.any(np.diff(self._times) <= 0):  # VTK's times ascend
            steps["Values"][:] = np.arange(len(self._times))
        steps.attrs.modify("NSteps", len(self._times))

    def _commit(self) -> None:
        assert self._claim is not None
        try:
            self._file.flush()
            self._claim.file.commit()
            self._claim.publish()
        except OSError as error:
            raise LostOutput(error.errno, f"Cannot write {self.path} on: {error.strerror}.") from error

    def finish(self, result: str, message: str, stats: dict) -> None:
        """Write what waits, and how the run ended."""
        self._write()
        with held():
            write_attribute(self._file["jaxshell"], "result", result)
            write_attribute(self._file["jaxshell"], "message", message)
            self._commit()

    def close(self) -> None:
        if self._claim is None:
            return
        with contextlib.suppress(Exception):
            if self._sound:  # of a run that was stopped
                self._write()
                with held():
                    self._commit()
        with held():
            with contextlib.suppress(Exception):
                self._file.close()
            self._claim.release()
            self._claim = None


def save_vtkhdf(solution: Solution, path, fields="default", *, axes="global", failure=None, overwrite=False) -> None:
    """Write a solution, some frames at a time. Raises as `VTKHDFWriter`, and ValueError for a batch of solutions."""
    check_one_run(solution, "to_vtkhdf")
    with contextlib.closing(VTKHDFWriter(path, fields, axes=axes, failure=failure, overwrite=overwrite)) as writer:
        writer.begin(solution.scene, dict(solution.stats))
        for part in in_parts(solution, writer.frames_at_once):
            writer.append(part)
        writer.finish(result_name(solution.result), solution.message, solution.stats)


def _write_mesh(file, scene: Scene) -> None:
    """The mesh and its sets."""
    mesh = scene.mesh
    m = mesh.n_elements
    vtk = file.create_group("VTKHDF")
    vtk.attrs.create("Version", VERSION, dtype=np.int64)
    vtk.attrs.create("Type", b"UnstructuredGrid", dtype=h5py.string_dtype("ascii", 16))
    for name, count in (("Points", mesh.n_nodes), ("Cells", m), ("ConnectivityIds", 3 * m)):
        write_array(vtk, f"NumberOf{name}", np.array([count], np.int64))
    write_array(vtk, "Points", np.asarray(mesh.nodes))
    write_array(vtk, "Connectivity", np.asarray(mesh.triangles, np.int64).ravel())
    write_array(vtk, "Offsets", np.arange(0, 3 * m + 1, 3, dtype=np.int64))
    write_array(vtk, "Types", np.full(m, _TRIANGLE, np.uint8))
    for name in ("PointData", "CellData", "FieldData", "Steps"):
        vtk.create_group(name)


def _write_constants(vtk, scene: Scene, chosen: Chosen) -> None:
    """Sets, as 1 in them and 0 elsewhere, and what else does not change."""
    mesh = scene.mesh
    for name, elements in mesh.element_sets.items():
        write_array(vtk["CellData"], f"set {dataset_name(name)}", _inside(mesh.n_elements, elements))
    for name, nodes in mesh.node_sets.items():
        write_array(vtk["PointData"], f"set {dataset_name(name)}", _inside(mesh.n_nodes, nodes))
    for name, sides in mesh.side_sets.items():
        write_array(vtk["PointData"], f"sides {dataset_name(name)}", _inside(mesh.n_nodes, sides))
    if "thickness" in chosen.names:
        write_array(vtk["CellData"], "thickness", np.asarray(thickness(scene)))


def _inside(count: int, numbers) -> np.ndarray:
    return np.isin(np.arange(count), numbers).astype(np.int8)


def _growing_rows(group, name: str, rows: int, shape: tuple[int, ...]) -> None:
    """An array of frames below each other, each of so many rows. Not compressed: stresses become 3 % smaller."""
    frames = max(1, _CHUNK // max(1, 8 * rows * int(np.prod(shape))))
    group.create_dataset(name, (0, *shape), np.float64, maxshape=(None, *shape), chunks=(rows * frames, *shape))


def _unfinished(path: Path) -> bool | None:
    """False for a file that is one of ours; None for another."""
    try:
        with contextlib.closing(DurableReader(path)) as content, h5py.File(content, "r") as file:
            return False if "VTKHDF" in file and "version" in file["jaxshell"].attrs else None
    except (OSError, KeyError, RuntimeError):
        return None
