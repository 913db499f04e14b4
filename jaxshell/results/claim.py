"""The place of a result file: a new one is made beside it, and takes it when it holds something.

Until then whatever lies there is untouched. Nothing is taken from a run that writes, or that did not end.
"""

import contextlib
import os
import uuid
from collections.abc import Callable
from pathlib import Path

from jaxshell.results.durable import DurableFile, in_use, sync_folder

_UNFINISHED = (
    "{path} holds a run that did not end. Go on with it (`jaxshell run {path} --continue`, or simulate(restart="
    "Solution.load(...))), or replace it with --overwrite (in Python overwrite=True)."
)
_FOREIGN = (
    "{path} exists and holds no results of jaxshell that can be read. Choose another name, or replace it with "
    "--overwrite (in Python overwrite=True)."
)
_IN_USE = (
    "{path} is in use: a run is writing it. Wait for its end, or choose another name; when it was stopped, --continue "
    "goes on with it and --overwrite replaces it."
)


class Claim:
    """A new file that is to become `path`.

    Arguments:
        path: where it is to be.
        overwrite: replace what is there, but for a file in use.
        unfinished: of an existing file, whether it holds a run that did not end; None for none of ours.

    Raises ValueError where what is there must stay, OSError where no file can be made.
    """

    def __init__(self, path: Path, overwrite: bool, unfinished: Callable[[Path], bool | None]):
        self.path, self.overwrite, self._unfinished = path, overwrite, unfinished
        self._check()
        self._remove_leftovers()
        self._beside: Path | None = path.with_name(f".{path.name}.{uuid.uuid4().hex[:12]}.part")
        try:
            self.file = DurableFile(self._beside)
        except OSError as error:
            raise OSError(error.errno, f"Cannot write {path}: {error.strerror}.") from error

    def _check(self) -> None:
        """Raise ValueError where the file that is there must stay."""
        if not os.path.lexists(self.path):
            return
        if not self.path.is_file():
            raise ValueError(f"Cannot write {self.path}: it is no file.")
        try:
            if in_use(self.path):
                raise ValueError(_IN_USE.format(path=self.path))
        except OSError as error:
            raise OSError(error.errno, f"Cannot write {self.path}: {error.strerror}.") from error
        if not self.overwrite:
            state = self._unfinished(self.path) if self.path.stat().st_size else False
            if state is not False:
                raise ValueError((_FOREIGN if state is None else _UNFINISHED).format(path=self.path))

    def publish(self) -> None:
        """Take the place, once; the file holds something by now."""
        if self._beside is None:
            return
        if os.path.lexists(self.path):
            self._check()  # another run may have come first
            os.replace(self._beside, self.path)
        else:
            try:
                os.link(self._beside, self.path)
                os.unlink(self._beside)
            except FileExistsError:
                self._check()
                os.replace(self._beside, self.path)
            except OSError:  # a file system without links
                os.replace(self._beside, self.path)
        self._beside = None
        sync_folder(self.path)

    def release(self) -> None:
        """The end: in good order on the disk, or gone where it never took its place."""
        with contextlib.suppress(OSError):
            self.file.settle()
        self.file.close()
        if self._beside is not None:
            with contextlib.suppress(OSError):
                os.unlink(self._beside)
            self._beside = None

    def _remove_leftovers(self) -> None:
        """Of runs that were killed before they took the place."""
        for leftover in self.path.parent.glob(f".{self.path.name}.*.part"):
            with contextlib.suppress(OSError):
                if not in_use(leftover):
                    os.unlink(leftover)
