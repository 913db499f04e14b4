"""Signals that end a run: asked to stop, a process finishes what it writes, and leaves with 128 + the signal's number.

A handler of Python's runs between two instructions of Python's, and so also inside the functions through which HDF5
writes, which an exception must not leave. `held` keeps signals back until the file is whole.
"""

import contextlib
import signal
import threading

_ENDING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


class Stopped(KeyboardInterrupt):
    """A signal asked the process to end."""

    def __init__(self, number: int):
        super().__init__(signal.Signals(number).name)
        self.number = number


@contextlib.contextmanager
def raising():
    """Within it SIGTERM and SIGHUP raise `Stopped`, as Ctrl-C raises KeyboardInterrupt. What is ignored stays so."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number, _):
        raise Stopped(number)

    before = {}
    for number in _ENDING:
        if number != signal.SIGINT and signal.getsignal(number) is signal.SIG_DFL:
            before[number] = signal.signal(number, stop)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def held():
    """Within it no handler of these signals runs; what came meanwhile is delivered at its end."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    before = {}
    for number in _ENDING:
        # Handlers that Python knows; the system's own (an end without a word) need no care: the file outlives them.
        if callable(signal.getsignal(number)):
            before[number] = signal.signal(number, lambda number, _: came.append(number))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number in came[:1]:
            signal.raise_signal(number)


def exit_status(stopped: KeyboardInterrupt) -> int:
    """128 and the signal's number, as a shell has it."""
    return 128 + (stopped.number if isinstance(stopped, Stopped) else signal.SIGINT)


class LostOutput(OSError):
    """Results could not be written on; the run has ended, and what was written before is whole."""
