"""Natural frequencies and buckling factors on disk, with their mode shapes and the scene that they are of.

    /            the attributes of every result file, and holds ("modes" or "buckling")
    /settings, /scene   as in every result file
    /modes       values (c,): frequencies or load factors; shapes (c, n, 6)

Nodal displacements and spins of the shapes are as `jaxshell.Modes` and `jaxshell.BucklingModes` have them.
"""

import contextlib
import uuid
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxshell.model.scene import Scene
from jaxshell.numerics.checks import require_float64
from jaxshell.numerics.signals import held
from jaxshell.results import checked
from jaxshell.results.checked import reading, write_array, write_attribute, write_text
from jaxshell.results.claim import Claim
from jaxshell.results.hdf5 import holds_unfinished_run
from jaxshell.results.head import BUCKLING, MODES, RUN, check_schema, what_it_holds, write_head
from jaxshell.results.tree import read_scene_of, to_json


class Eigenmodes(NamedTuple):
    """What such a file holds."""

    kind: str
    """"modes" or "buckling"."""
    scene: Scene
    values: Float[jax.Array, " c"]
    shapes: Float[jax.Array, "c n 6"]


class EigenmodesFile:
    """A new file that takes its place when it is written; to be closed in any case.

    A file that holds a finished run is replaced. Raises ValueError where `path` holds something else and `overwrite` is
    not said, OSError where nothing can be written: before anything is computed.
    """

    def __init__(self, path, overwrite: bool = False):
        with held():
            self._claim = Claim(Path(path), overwrite, holds_unfinished_run)
            self._file = checked.create(self._claim.file)

    def write(self, found: Eigenmodes, settings: dict, stats: dict) -> None:
        """All of it; `settings` are the keys that ask for the same again, `stats` figures of the run."""
        with held():
            write_head(self._file, uuid.uuid4().hex, found.scene, settings, found.kind)
            group = self._file.create_group("modes")
            write_array(group, "values", np.asarray(found.values))
            write_array(group, "shapes", np.asarray(found.shapes))
            write_text(self._file, "message", "")
            write_text(self._file, "stats", to_json(stats))
            write_attribute(self._file, "result", "successful")
            self._file.flush()
            self._claim.file.commit(True)
            self._claim.publish()

    def close(self) -> None:
        """Let go of the file; it is gone where nothing was written."""
        with held():
            with contextlib.suppress(Exception):
                self._file.close()
            self._claim.release()


def save_eigenmodes(found: Eigenmodes, path) -> None:
    """Write a file that is read and drawn, and does not say how it was made. Raises as `EigenmodesFile`."""
    with contextlib.closing(EigenmodesFile(path)) as file:
        file.write(found, {}, {})


def eigenmodes_in(path) -> Eigenmodes | None:
    """Those in a result file, or None where it holds a run. Raises as `load_eigenmodes`."""
    with reading(path) as file:
        check_schema(file, path)
        kind = what_it_holds(file)
    return None if kind == RUN else load_eigenmodes(path)


def load_eigenmodes(path, kind: str | None = None) -> Eigenmodes:
    """Read a file, of one kind where `kind` says which.

    Raises FileNotFoundError; ValueError for a file that is not ours, damaged, or that holds something else.
    """
    require_float64()
    with reading(path) as file:
        held_kind = what_it_holds(file)
        check_schema(file, path, kind or (held_kind if held_kind in (MODES, BUCKLING) else MODES))
        scene = read_scene_of(file, path)
        values, shapes = (jnp.asarray(file[f"modes/{name}"][()]) for name in ("values", "shapes"))
        if values.ndim != 1 or shapes.shape != (len(values), scene.mesh.n_nodes, 6):
            raise RuntimeError(f"modes/shapes has shape {shapes.shape} for {len(values)} modes")
        return Eigenmodes(held_kind, scene, values, shapes)
