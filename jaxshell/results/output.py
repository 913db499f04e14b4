"""Outputs: what receives a run as it goes. The result file is one (`jaxshell.results.hdf5.ResultWriter`)."""

import abc

from jaxshell.model.scene import Scene
from jaxshell.results.frames import StoredFrames
from jaxshell.results.solution import Solution


class Output(abc.ABC):
    """Receives the parts of a run while it goes on; pass it as `simulate(..., output=...)`.

    Each part is a short `Solution` with the steps and frames that are new, and the state at their end: a part may hold
    no frame. What it writes should be of use when the run is stopped after any part.
    """

    @abc.abstractmethod
    def begin(self, scene: Scene, settings: dict) -> None:
        """The run starts; `settings` say how it is run (method, dt, ...), in what JSON can hold."""

    @abc.abstractmethod
    def append(self, part: Solution) -> None:
        """Steps were finished. The first part is the start."""

    @abc.abstractmethod
    def finish(self, result: str, message: str, stats: dict) -> None:
        """The run has ended: the name of an item of RESULTS, its message, and the figures of the run."""

    def frames(self) -> StoredFrames | None:
        """What reads the frames back that were appended, of an output that keeps them; the run then keeps none."""
        return None

    @abc.abstractmethod
    def close(self) -> None:
        """Let go of files; called at the end in any case, also of a run that was stopped."""
