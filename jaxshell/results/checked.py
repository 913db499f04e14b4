"""Arrays, texts and whole files of HDF5 whose every byte is under a checksum, and the reading of files from strangers.

Written in the format of HDF5 1.10, headers and indices carry checksums, and small arrays lie in headers. Larger ones
lie in chunks with the filter fletcher32. A byte that was flipped is then an error, never another number.

Before anything is read of a file, all of it is looked through: no link that leaves the file, no cycle, no array larger
than what the file stores can hold.
"""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from jaxshell.results.durable import PAGE, DurableFile, DurableReader

_info: Any = h5py.h5o.get_info  # pyright: ignore[reportAttributeAccessIssue]
_SMALL = 1024
"""Bytes that an object's header takes."""
_CHUNK = 2**20
"""Bytes of a chunk of an array that does not grow."""
_COMPRESSION = 1100
"""No filter of HDF5's makes bytes this many times fewer."""
_DAMAGE = (LookupError, OSError, AttributeError, TypeError, RuntimeError, ArithmeticError, UnicodeError, MemoryError)
"""What broken content makes of h5py, NumPy and our own reading."""
_DEEP, _MANY = 8, 100_000
"""Levels of groups and objects that no file of ours has."""


def create(file: DurableFile) -> Any:  # h5py.File, whose items the type checker cannot know
    """An empty HDF5 file in `file`."""
    return h5py.File(file, "w", userblock_size=PAGE, libver=("v110", "v110"))


def write_array(group, name: str, value) -> Any:
    """A dataset that does not grow."""
    array = np.asarray(value)
    if array.nbytes <= _SMALL:
        layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        layout.set_layout(h5py.h5d.COMPACT)
        if not array.ndim:
            return _single(group, name, array, layout)
        return group.create_dataset(name, data=array, dcpl=layout)
    rows = max(1, min(len(array), _CHUNK * len(array) // array.nbytes))
    return group.create_dataset(name, data=array, chunks=(rows, *array.shape[1:]), fletcher32=True)


def _single(group, name: str, array: np.ndarray, layout) -> Any:
    """A single value in its object's header, which has a checksum: h5py would put it beside, where nothing looks."""
    kind, space = h5py.h5t.py_create(array.dtype, logical=True), h5py.h5s.create(h5py.h5s.SCALAR)
    link = h5py.h5p.create(h5py.h5p.LINK_CREATE)
    link.set_create_intermediate_group(True)
    dataset = h5py.Dataset(h5py.h5d.create(group.id, name.encode(), kind, space, layout, link))
    dataset[()] = array
    return dataset


def write_text(group, name: str, text: str) -> None:
    """A text as a dataset of its UTF-8 bytes."""
    write_array(group, name, np.frombuffer(text.encode(), np.uint8))


def write_attribute(item, name: str, text: str) -> None:
    """A short text as an attribute of fixed length, which lies in the object's header."""
    content = text.encode() or b"\0"
    item.attrs.create(name, content, dtype=h5py.string_dtype("utf-8", len(content)))


def read_text(group, name: str) -> str:
    """A text that `write_text` or `write_attribute` wrote, or an attribute of version 0.1. Raises KeyError."""
    value = group[name][()] if name in group else group.attrs[name]
    if isinstance(value, np.ndarray):
        value = value.tobytes()
    return value.decode().rstrip("\0") if isinstance(value, bytes) else str(value)


def has(group, name: str) -> bool:
    """Whether there is such a text or dataset."""
    return name in group or name in group.attrs


def run_of(file) -> str:
    """The name of the run in a file; version 0.1 gave none."""
    return read_text(file, "run") if "run" in file.attrs else ""


def growing(group, name: str, shape: tuple[int, ...], dtype: Any = np.float64, compressed: bool = False) -> None:
    """A dataset (0, *shape) that can grow along its first axis.

    Frames are compressed in HDF5 chunks of about 64 KiB, one frame at least. Histories are not: their last
    chunk is written again at every append, and a compressed one would change its size and leave holes.
    """
    rows = max(1, 2**16 // max(1, 8 * int(np.prod(shape)))) if compressed else 256
    filters = {"compression": "gzip", "compression_opts": 1, "shuffle": True} if compressed else {}
    chunks = (rows, *(max(1, n) for n in shape))
    group.create_dataset(name, (0, *shape), dtype, maxshape=(None, *shape), chunks=chunks, fletcher32=True, **filters)


def extend(dataset, values) -> None:
    """Rows at the end of a growing dataset."""
    values = np.asarray(values)
    start = len(dataset)
    dataset.resize(start + len(values), axis=0)
    dataset[start:] = values


def dataset_name(label: str) -> str:
    """A label as a name that HDF5 does not read as a path; different labels have different names."""
    return label.replace("%", "%25").replace("/", "%2F").replace(".", "%2E") or "%"


@contextlib.contextmanager
def reading(path) -> Iterator[Any]:
    """The HDF5 file at `path`, looked through, as it was committed last; a run that writes it goes on.

    Raises FileNotFoundError; ValueError for what is no sound HDF5 file, also for what is found while it is read.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"There is no file {path}.")
    try:
        content = DurableReader(path)
    except OSError as error:
        raise ValueError(f"{path} cannot be read: {error.strerror or error}.") from error
    with contextlib.closing(content):
        try:
            file = h5py.File(content, "r")
        except (OSError, RuntimeError, ValueError, OverflowError) as error:
            raise ValueError(f"{path} cannot be read as an HDF5 file ({_short(error)}).") from error
        try:
            if "VTKHDF" in file:
                raise ValueError(f"{path} is a VTKHDF file, for ParaView: name the result file that it was made of.")
            _look_through(file, path.stat().st_size)
            yield file
        except _DAMAGE as error:
            raise ValueError(f"{path} is damaged: {_short(error)}. Run the scene again.") from error
        finally:
            with contextlib.suppress(Exception):
                file.close()


def _short(error: BaseException) -> str:
    """An error of HDF5's in one line, without its own full stop."""
    text = " ".join(str(error.args[0] if error.args else error).split()) or type(error).__name__
    return text.rstrip(".")


def _look_through(file, size: int) -> None:
    """Raise RuntimeError for a file that no jaxshell wrote and that would lead its reader astray."""
    waiting, seen = [(file, "", 0)], set()
    while waiting:
        group, where, depth = waiting.pop()
        for name in group:
            link = group.get(name, getlink=True)
            if not isinstance(link, h5py.HardLink):
                raise RuntimeError(f"{where}/{name} is a link to somewhere else")
            item = group[name]
            address = _info(item.id).addr
            if address in seen or depth > _DEEP or len(seen) > _MANY:
                raise RuntimeError(f"{where}/{name} is reached twice, or too deep")
            seen.add(address)
            if isinstance(item, h5py.Group):
                waiting.append((item, f"{where}/{name}", depth + 1))
            elif isinstance(item, h5py.Dataset):
                _check_dataset(item, f"{where}/{name}", size)
            else:
                raise RuntimeError(f"{where}/{name} is neither a group nor an array")


def _check_dataset(item, where: str, size: int) -> None:
    if item.is_virtual or item.external:
        raise RuntimeError(f"{where} keeps its numbers outside the file")
    if item.dtype.kind not in "fiubOS" or (item.dtype.kind == "f" and item.dtype != np.dtype("<f8")):
        raise RuntimeError(f"{where} holds {item.dtype}, not numbers of ours")
    if item.dtype.kind == "O" and item.shape != ():
        raise RuntimeError(f"{where} holds {item.shape} texts")
    stored = min(item.id.get_storage_size(), size)
    if item.shape is None or item.size * item.dtype.itemsize > _COMPRESSION * stored + _SMALL:
        raise RuntimeError(f"{where} says it has shape {item.shape}, more than the file can hold")
