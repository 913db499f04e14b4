"""Locks on a result file: who writes it, and who reads it at the moment. They end with the process that holds them."""

import contextlib
import struct

try:
    import fcntl
except ImportError:  # a system without them: nothing is locked
    fcntl = None

OWNER, READERS = 0, 1
"""The bytes that are locked. Nothing is read or written there: a lock is a name."""
_FLOCK = struct.Struct("@hhqqi4x")


def try_lock(fd: int, byte: int, *, shared: bool = False, wait: bool = False) -> bool:
    """Lock a byte of an open file for this file description; False where another's lock stands against it.

    True too where the system has no such locks.
    """
    if fcntl is None:
        return True
    kind = fcntl.F_RDLCK if shared else fcntl.F_WRLCK
    try:
        if hasattr(fcntl, "F_OFD_SETLK"):  # of the open file, not of the process
            fcntl.fcntl(fd, fcntl.F_OFD_SETLKW if wait else fcntl.F_OFD_SETLK, _FLOCK.pack(kind, 0, byte, 1, 0))
        else:
            how = (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | (0 if wait else fcntl.LOCK_NB)
            fcntl.lockf(fd, how, 1, byte)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return True
    return True


def unlock(fd: int, byte: int) -> None:
    """Let go of a byte."""
    if fcntl is None:
        return
    with contextlib.suppress(OSError):
        if hasattr(fcntl, "F_OFD_SETLK"):
            fcntl.fcntl(fd, fcntl.F_OFD_SETLK, _FLOCK.pack(fcntl.F_UNLCK, 0, byte, 1, 0))
        else:
            fcntl.lockf(fd, fcntl.LOCK_UN, 1, byte)
