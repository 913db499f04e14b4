"""What a run gives back: histories at every step, frames, and how it ended."""

from typing import Any

import equinox as eqx
from jaxtyping import Bool, Float, Int

from jaxshell.model.scene import Scene
from jaxshell.results.frames import Array, Frames, JoinedFrames, StoredFrames


class RESULTS(eqx.Enumeration):
    """How a run ended; the text says what to do next."""

    successful = ""
    diverged = (
        "Newton's iteration diverged. Reduce the time step, or use StepControl; "
        "check loads and supports if it is the first step."
    )
    stagnated = (
        "Newton's iteration did not reach the tolerance within max_iterations. "
        "Reduce the time step, raise max_iterations, or loosen the tolerance."
    )
    singular = (
        "The tangent stiffness is singular: the linear solver returned no usable solution. "
        "Look for a mechanism (unsupported motion in statics, loose parts) or a far too large step."
    )
    step_too_small = "Step control reached its smallest step. Loosen the tolerance or lower `smallest`."
    interrupted = "The run was stopped before its end; what it had computed is kept."
    unstable = "The explicit method became unstable. Use a time step below the critical one."
    not_at_rest = "Allow more steps, or a larger tolerance; a shell that nothing holds moves on for ever."


class Energy(eqx.Module):
    """Energies at every step [force·length], each (k,)."""

    kinetic: Float[Array, " k"]
    strain: Float[Array, " k"]
    external_work: Float[Array, " k"]
    """Work of the loads and of moving supports since the start."""
    dissipated: Float[Array, " k"]
    """Energy that the scene's damping removed, and the method's numerical dissipation where it accounts for it."""

    @property
    def total(self) -> Float[Array, " k"]:
        """Kinetic plus strain energy."""
        return self.kinetic + self.strain


class Momentum(eqx.Module):
    """Momenta at every step, each (k, 3), about the origin."""

    linear: Float[Array, "k 3"]
    angular: Float[Array, "k 3"]


class Stats(dict):
    """A dict of figures that hashes by content, so that it can stand in the static part of a solution."""

    def __hash__(self) -> int:
        return hash(frozenset(self.items()))


class Solution(eqx.Module):
    """A run: histories at every step (k of them, the start first) and frames (f of them).

    Units are the scene's. `result` says whether the run ended as asked; everything computed until then is here.
    Frames of a run with a result file are read from it when they are asked for: all of them by `displacements`,
    `rotations` and `velocities`, some of them by `frame`.
    """

    scene: Scene
    times: Float[Array, " k"]
    watched: dict[str, Float[Array, " k"]]
    energy: Energy
    momentum: Momentum
    iterations: Int[Array, " k"]
    frame_times: Float[Array, " f"]
    frames: Frames | StoredFrames | JoinedFrames
    result: RESULTS
    message: str = eqx.field(static=True)
    """For a failed run: step, time and what to try; empty otherwise."""
    stats: "Stats" = eqx.field(static=True)
    """Host-side figures: method and its parameters, wall time, steps, iterations, factorizations, solver, ..."""
    state: Any
    """The method's state at the end, from which `simulate(restart=...)` goes on. Of a file, a dict of its arrays."""
    reaction: Float[Array, "k nh"] | None
    """Of a run with reactions=True: what the supports carry at the held degrees of freedom [force, force·length], which
    `jaxshell.reactions` sorts by nodes."""
    analysis: str = eqx.field(static=True)
    """"time", or "static" where the times are load factors."""
    newton: Any
    """What Newton's iteration keeps from step to step: a run that goes on with it does so to the last bit."""
    stable: Bool[Array, " k"] | None
    """In statics, whether the equilibrium is stable."""

    def __init__(
        self,
        scene,
        times,
        watched,
        energy,
        momentum,
        iterations,
        frame_times,
        displacements=None,
        rotations=None,
        velocities=None,
        result=RESULTS.successful,
        message="",
        stats=None,
        state=None,
        reaction=None,
        analysis="time",
        frames=None,
        newton=None,
        stable=None,
    ):
        given = {"displacements": displacements, "rotations": rotations, "velocities": velocities}
        if any(value is not None for value in given.values()):
            own = {name: getattr(frames, name) if value is None else value for name, value in given.items()}
            frames = Frames(**own)
        if frames is None:
            raise TypeError("A solution needs its frames, or displacements, rotations and velocities.")
        self.scene, self.times, self.watched = scene, times, watched
        self.energy, self.momentum, self.iterations = energy, momentum, iterations
        self.frame_times, self.frames = frame_times, frames
        self.result, self.message, self.stats = result, message, Stats() if stats is None else stats
        self.state, self.newton, self.analysis = state, newton, analysis
        self.reaction, self.stable = reaction, stable

    @property
    def displacements(self) -> Float[Array, "f n 3"]:
        """Displacements of all nodes in every frame."""
        return self.frames.displacements

    @property
    def rotations(self) -> Float[Array, "f n 3 3"]:
        """Rotation matrices of all nodes in every frame."""
        return self.frames.rotations

    @property
    def velocities(self) -> Float[Array, "f n 3"]:
        """Velocities of all nodes in every frame."""
        return self.frames.velocities

    def frame(self, which) -> Frames:
        """Displacements, rotations and velocities of one frame, by its number, or of several, by a list of numbers.

        Of a run with a result file nothing else is read.
        """
        return self.frames.at(which)

    @property
    def step_sizes(self) -> Float[Array, " steps"]:
        """Sizes of the steps taken, e.g. to differentiate a run under step control with its steps frozen."""
        return self.times[1:] - self.times[:-1]

    def save(self, path) -> None:
        """Write the run and its scene to an HDF5 file; one that holds a finished run is replaced.

        Raises ValueError where the file holds a run that did not end, or something else; OSError where nothing can be
        written.
        """
        from jaxshell.results import hdf5 as storage  # which imports this file

        storage.save_solution(self, path)

    def to_vtkhdf(self, path, fields="default", *, axes="global", failure=None, overwrite: bool = False) -> None:
        """Write mesh, fields and energies at all frames to a VTKHDF file (*.vtkhdf), which ParaView opens.

        Arguments:
            path: the file; one that jaxshell wrote is replaced, another one with `overwrite` only.
            fields: "default", "all", or a list of them: displacement, rotation, velocity; N, M, stress top, stress
                bottom, von mises top, von mises bottom, thickness; strain, curvature, normal, element strain energy,
                mesh error; a gauge's text such as "s11 ply 0 top". docs/export.md says what each is. Sets are always
                written.
            axes: of N, M, stress, strain and curvature: "global", tensors in space; "element", "material" or a vector,
                components in the elements' planes, as of `jaxshell.section_forces`.
            failure: {criterion: strengths} as of `jaxshell.failure_index`; a field for each.

        Frames are read and written a few at a time. Raises ValueError for a batch of solutions, for a field that the
        scene does not have and for a file that must stay; OSError where nothing can be written.
        """
        from jaxshell.results.export.vtkhdf import save_vtkhdf

        save_vtkhdf(self, path, fields, axes=axes, failure=failure, overwrite=overwrite)

    def to_csv(self, path) -> None:
        """Write the histories as a table: a line for every step below one of names, with units for scenes in SI.

        An existing file is replaced. Raises ValueError for a batch of solutions; OSError where nothing can be written.
        """
        from jaxshell.results.export.table import save_csv

        save_csv(self, path)

    def to_xarray(self, fields=("displacement", "rotation", "velocity"), *, axes="global", failure=None):
        """An `xarray.Dataset` of histories and frames, with labelled dimensions and, for scenes in SI, units.

        `fields`, `axes` and `failure` are those of `to_vtkhdf`; all frames of them are read into memory. Raises
        ImportError without xarray, ValueError for a batch of solutions and as `to_vtkhdf`.
        """
        from jaxshell.results.export.labelled import to_xarray

        return to_xarray(self, fields, axes=axes, failure=failure)

    @classmethod
    def load(cls, path) -> "Solution":
        """Read a file that `save` or `simulate(output=...)` wrote; of a run that was killed, what it had written.

        Raises FileNotFoundError, or ValueError for a file that is not ours, of another schema, or damaged.
        """
        from jaxshell.results import hdf5 as storage

        return storage.load_solution(path)
