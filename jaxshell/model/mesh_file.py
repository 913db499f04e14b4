"""Which reader a mesh file has, told by the end of its name."""

from pathlib import Path

from jaxshell.model.cells import Cells
from jaxshell.model.mesh_files import abaqus, gmsh, library, nastran, polygons, vtk
from jaxshell.model.mesh_files.files import is_file

_READERS = {
    ".msh": gmsh.read_cells,
    ".inp": abaqus.read_cells,
    **dict.fromkeys(nastran.ENDINGS, nastran.read_cells),
    ".vtk": vtk.read_cells,
    ".obj": polygons.read_obj,
    ".off": polygons.read_off,
}
"""The others are read by meshlane."""


def read_cells(path) -> Cells:
    """What a mesh file holds. Raises FileNotFoundError, and ValueError naming the file where it cannot be read."""
    if not isinstance(path, str | Path):
        raise ValueError(f"The mesh file must be given by its path, but it is {path!r}.")
    if not is_file(path):
        raise FileNotFoundError(f"There is no mesh file {path}.")
    known = sorted({*library.endings(), *_READERS})
    if not str(path).lower().endswith(tuple(known)):
        raise ValueError(f"{path} is of no kind that is read, which the name's end tells: {', '.join(known)}.")
    return _READERS.get(Path(path).suffix.lower(), library.read_cells)(path)
