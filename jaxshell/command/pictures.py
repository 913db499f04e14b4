"""Pictures of a run: what they wait for is loaded while the run goes on."""

import contextlib
import threading

from jaxshell.results.output import Output


class PicturesAhead(Output):
    """Writes nothing: loads what pictures need, in a thread, from the run's second part on.

    Then the run's program is compiled, and Python waits for it; before, the thread would only slow down the tracing.
    """

    def __init__(self, wanted: bool):
        self._wanted, self._parts = wanted, 0
        self._thread = threading.Thread(target=_load, daemon=True)

    def begin(self, scene, settings) -> None:
        pass

    def append(self, part) -> None:
        self._parts += 1
        if self._wanted and self._parts == 2:
            self._thread.start()

    def finish(self, result, message, stats) -> None:
        pass

    def close(self) -> None:
        pass

    def wait(self) -> None:
        """Wait until everything is loaded that was begun."""
        if self._thread.ident is not None:
            self._thread.join()


def _load() -> None:
    from jaxshell.plotting.ahead import draw_one

    with contextlib.suppress(Exception):  # the pictures themselves say what they lack
        draw_one()
