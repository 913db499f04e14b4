"""A file that outlives its writer: what HDF5 writes is kept back and committed whole, through a journal.

HDF5 changes what it has written (headers, indices, chunks that are not full), so that a file is broken between two of
its writes. `DurableFile` stands between: h5py's `fileobj` driver writes into pages in memory, and `commit` brings them
to the disk so that after any part of its own writes the file is the one before or the one after.

    1. Pages beyond the committed end go to their places, where nothing refers to them yet.
    2. Pages that change committed bytes go to a journal behind the end.
    3. A slot in the file's first page says where the journal lies, with a checksum of all this. From here on the
       commit holds: whoever opens the file sees the journal's pages in place of the old ones.
    4. The changed pages go to their places, and the slot of the next number says that there is no journal.

The two slots are written in turn. Step 4 waits for the disk, and is left out where it is not time for that, or while
somebody reads, so that what is read does not change: the next commit's journal then holds the pages of both, behind the
one before. Should power fail, what has not reached the disk fails its checksum, and the file is the one of the last
step 4. The first page is HDF5's user block, which it skips: without a journal the file is plain HDF5.
"""

import contextlib
import io
import os
import struct
import zlib
from pathlib import Path

from jaxshell.results.locks import OWNER, READERS, try_lock, unlock

PAGE = 4096
"""Bytes of a page, and of the user block."""
_SLOT = struct.Struct("<8sQQQQQII")
"""Mark, number, first byte and size of what was appended, journal's first byte and size, their checksum, the slot's."""
_MARK, _SLOTS_AT = b"jxcommit", (1024, 2048)
_ENTRY = struct.Struct("<Q")


class _Seekable(io.RawIOBase):
    """An open file of the system's with a place in it, as h5py's `fileobj` driver wants one."""

    _fd = -1

    def __init__(self, fd: int, size: int):
        super().__init__()
        self._fd, self._size, self._position = fd, size, 0

    def readable(self):
        return True

    def seekable(self):
        return True

    def seek(self, offset, whence=os.SEEK_SET):
        self._position = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: self._size}[whence]
        return self._position

    def tell(self):
        return self._position

    def close(self):
        """Let go of the file. What a writer has not committed is forgotten."""
        if not self.closed and self._fd >= 0:
            os.close(self._fd)
        super().close()


class DurableFile(_Seekable):
    """A new file at `path`, which must not exist, for h5py to write into with a user block of `PAGE` bytes."""

    def __init__(self, path):
        # Of no size: HDF5 makes a file where it finds none.
        super().__init__(os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666), 0)
        try_lock(self._fd, OWNER)
        os.pwrite(self._fd, b"\0" * PAGE, 0)
        self._committed = self._reached = PAGE
        """Bytes of the file, and the most that it ever had: HDF5 gives bytes at the end back, and takes them again."""
        self._dirty: dict[int, bytearray] = {}
        """Pages as HDF5 wants them, not committed."""
        self._waiting: dict[int, bytes] = {}
        """Pages that are committed and stand in the journal only."""
        self._journal = (0, 0)
        self._number = 0

    # --- what h5py calls ----------------------------------------------------------------------------------

    def writable(self):
        return True

    def readinto(self, buffer):
        view = memoryview(buffer).cast("B")
        for page, start, stop, at in _parts(self._position, len(view)):
            view[at : at + stop - start] = self._page(page)[start:stop]
        self._position += len(view)
        return len(view)

    def write(self, data):
        view = memoryview(data).cast("B")
        for page, start, stop, at in _parts(self._position, len(view)):
            changed = self._dirty.get(page)
            if changed is None:
                whole = stop - start == PAGE
                changed = self._dirty[page] = bytearray(PAGE) if whole else bytearray(self._page(page))
            changed[start:stop] = view[at : at + stop - start]
        self._position += len(view)
        self._size = max(self._size, self._position)
        return len(view)

    def truncate(self, size=None):
        self._size = self._position if size is None else size
        return self._size

    def flush(self):
        """Nothing: `commit` decides what reaches the disk."""

    # --- bringing it to the disk --------------------------------------------------------------------------

    @property
    def backlog(self) -> int:
        """Bytes that step 4 has still to bring to their places."""
        return PAGE * len(self._waiting)

    def commit(self, sync: bool = True) -> None:
        """Make what was written part of the file, wholly or, should anything end the process, not at all.

        With `sync` it is on the disk when this returns. Raises OSError where the disk takes no more; the file is then
        that of the commit before.
        """
        limit, (low, high) = -(-self._reached // PAGE), self._journal
        changed = dict(self._waiting)
        appended = {}
        for page, content in sorted(self._dirty.items()):
            free = page >= limit and ((page + 1) * PAGE <= low or page * PAGE >= high)
            (appended if free else changed)[page] = bytes(content)
        first, end = limit * PAGE, _aligned(self._size)
        for page, content in _runs(appended):
            _write(self._fd, content, page * PAGE)
        if changed:
            self._commit_by_journal(changed, appended, first, max(end, high))
        else:
            os.fdatasync(self._fd)
            self._write_slot(0, 0, 0, 0, 0)
        self._dirty.clear()
        self._committed = self._size
        self._reached = max(self._reached, self._size)
        if changed and sync:
            os.fdatasync(self._fd)
            self._put_in_place(changed)

    def _commit_by_journal(self, changed, appended, first: int, at: int) -> None:
        """Steps 2 and 3."""
        journal = b"".join(_ENTRY.pack(page) + content for page, content in changed.items())
        _write(self._fd, journal, at)
        # Where something else lies between appended pages (an older journal), the checksum covers what is there.
        size = (max(appended) + 1) * PAGE - first if appended else 0
        checksum = zlib.crc32(journal, _checksum(self._fd, first, size))
        self._write_slot(first, size, at, len(journal), checksum)
        self._waiting, self._journal = changed, (at, at + len(journal))

    def _put_in_place(self, changed) -> None:
        """Step 4, unless somebody reads."""
        if not try_lock(self._fd, READERS):
            return
        try:
            for page, content in _runs(changed):
                _write(self._fd, content, page * PAGE)
            os.fdatasync(self._fd)
            self._write_slot(0, 0, 0, 0, 0)
            self._waiting, self._journal = {}, (0, 0)
        finally:
            unlock(self._fd, READERS)

    def settle(self) -> None:
        """After the last commit: no journal, and the file as long as it must be; where a reader allows it."""
        if self._waiting:
            os.fdatasync(self._fd)
            self._put_in_place(self._waiting)
        if not self._waiting:
            os.ftruncate(self._fd, self._committed)
            os.fsync(self._fd)

    def _write_slot(self, *where) -> None:
        self._number += 1
        body = _SLOT.pack(_MARK, self._number, *where, 0)[:-4]
        _write(self._fd, body + struct.pack("<I", zlib.crc32(body)), _SLOTS_AT[self._number % 2])

    def _page(self, page: int) -> bytes | bytearray:
        for pages in (self._dirty, self._waiting):
            if page in pages:
                return pages[page]
        if page * PAGE >= self._reached:
            return b"\0" * PAGE
        return os.pread(self._fd, PAGE, page * PAGE).ljust(PAGE, b"\0")


class DurableReader(_Seekable):
    """What was committed into a file, as it was when it was opened; any other file as it is. A reader only."""

    def __init__(self, path):
        fd = os.open(path, os.O_RDONLY)
        try:
            try_lock(fd, READERS, shared=True, wait=True)
            self._pages = _journal_pages(fd)
            super().__init__(fd, os.fstat(fd).st_size)
        except BaseException:
            os.close(fd)
            raise

    def readinto(self, buffer):
        view = memoryview(buffer).cast("B")
        done = 0
        while done < len(view):
            found = os.preadv(self._fd, [view[done:]], self._position + done)
            if not found:
                view[done:] = bytes(len(view) - done)
                break
            done += found
        for page, start, stop, at in _parts(self._position, len(view)) if self._pages else ():
            if page in self._pages:
                view[at : at + stop - start] = self._pages[page][start:stop]
        self._position += len(view)
        return len(view)


def in_use(path) -> bool:
    """Whether a run writes the file."""
    with contextlib.closing(io.FileIO(os.open(path, os.O_RDWR))) as file:
        return not try_lock(file.fileno(), OWNER)


def _journal_pages(fd: int) -> dict[int, bytes]:
    """The pages of a committed journal that may not be in their places; none where there is no such journal."""
    slots = []
    for at in _SLOTS_AT:
        found = os.pread(fd, _SLOT.size, at)
        if found[:8] == _MARK and len(found) == _SLOT.size and zlib.crc32(found[:-4]) == _SLOT.unpack(found)[-1]:
            slots.append(_SLOT.unpack(found)[1:-1])
    if not slots:
        return {}
    _, first, size, at, length, checksum = max(slots)
    if not length or at + length > os.fstat(fd).st_size:
        return {}
    journal = os.pread(fd, length, at)
    if zlib.crc32(journal, _checksum(fd, first, size)) != checksum:
        return {}
    entry = _ENTRY.size + PAGE
    return {_ENTRY.unpack_from(journal, k)[0]: journal[k + _ENTRY.size : k + entry] for k in range(0, length, entry)}


def _checksum(fd: int, first: int, size: int) -> int:
    found = 0
    for at in range(first, first + size, 2**20):
        found = zlib.crc32(os.pread(fd, min(2**20, first + size - at), at), found)
    return found


def _parts(position: int, size: int):
    """(page, start and stop in it, offset in the whole) of the pieces of `size` bytes from `position`."""
    done = 0
    while done < size:
        page, start = divmod(position + done, PAGE)
        stop = min(PAGE, start + size - done)
        yield page, start, stop, done
        done += stop - start


def _runs(pages: dict[int, bytes]):
    """(first page, content) of pages that follow each other, as one."""
    run: list[bytes] = []
    first = 0
    for page in sorted(pages):
        if run and page != first + len(run):
            yield first, b"".join(run)
            run = []
        if not run:
            first = page
        run.append(pages[page])
    if run:
        yield first, b"".join(run)


def _write(fd: int, content: bytes, at: int) -> None:
    """All of `content`: the system may take a part of it at a time."""
    view = memoryview(content)
    while view:
        done = os.pwrite(fd, view, at)
        view, at = view[done:], at + done


def _aligned(size: int) -> int:
    return -(-size // PAGE) * PAGE


def sync_folder(path: Path) -> None:
    """Make a renaming in the folder of `path` durable, where the system can."""
    with contextlib.suppress(OSError):
        fd = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(fd)
        finally:
            os.close(fd)
