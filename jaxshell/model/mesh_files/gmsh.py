"""Gmsh's mesh files, MSH 2.2 and 4.1: nodes and elements through meshlane, physical groups from the file itself.

meshlane 5.5 loses groups that share a name or an entity, and refuses files in which an entity has none. A group is
called by its name, or by its number where it has none.
"""

import re
import tempfile
from pathlib import Path

import numpy as np

from jaxshell.model.cells import Cells
from jaxshell.model.mesh_files.library import broken, cells_of, read

_SAVED = "Save it in another: gmsh mesh.msh -save -format msh41 -o other.msh."
_NODES = {15: 1, 1: 2, 2: 3, 3: 4, 4: 4, 5: 8, 6: 6, 7: 5, 8: 3, 9: 6, 10: 9, 11: 10, 16: 8}
"""How many nodes the elements of a type have."""
_DIMENSION = {"vertex": 0, "line": 1, "triangle": 2, "quad": 2}


def read_cells(path) -> Cells:
    """What a file holds. Raises ValueError, also for other versions of the format and for partitions."""
    path = Path(path)
    data = path.read_bytes()
    if not data.lstrip().startswith(b"$"):
        return cells_of(*read(path, "ansys"))
    try:
        version, binary, size = _version(data)
    except Exception as error:
        raise broken(path, "it does not begin with $MeshFormat") from error
    if version not in ("2.2", "4.1"):
        raise ValueError(f"{path} is of MSH version {version}; versions 2.2 and 4.1 are read. {_SAVED}")
    if b"$PartitionedEntities" in data:
        raise ValueError(f"{path} is partitioned; only whole meshes are read. Save it in one piece.")
    for section in (b"Nodes", b"Elements"):
        if b"$End" + section not in data:
            raise broken(path, f"it has no section ${section.decode()}, or ends within it")
    try:
        names = _names(_section(data, b"PhysicalNames")[0])
        entities, rest = _section(data, b"Entities")
        groups = _entities(entities, binary, size) if entities else {}
    except Exception as error:
        raise broken(path, "its $PhysicalNames or $Entities") from error
    if version == "2.2" and not binary:
        _check_rows(path, data)
    found, notes = _read_rest(path, _section(rest, b"PhysicalNames")[1])
    try:
        return _with_groups(found, notes, names, groups, version)
    except ValueError as error:
        raise broken(path, "its elements") from error


def _check_rows(path: Path, data: bytes) -> None:
    """Of a row with a number missing meshlane takes a tag for a node."""
    for row in _section(data, b"Elements")[0].splitlines()[1:]:
        words = row.split()
        wanted = _NODES.get(int(words[1]), 0) if len(words) > 2 and words[1].isdigit() else 0
        if wanted and words[2].isdigit() and len(words) != 3 + int(words[2]) + wanted:
            raise broken(path, f"the element {row.decode(errors='replace').strip()!r} should have {wanted} nodes")


def _version(data: bytes) -> tuple[str, bool, int]:
    """The version of the format, whether it is binary, and the size of its large numbers."""
    if data.lstrip().startswith(b"$NOD"):
        return "1", False, 8
    words = _section(data, b"MeshFormat")[0].split(maxsplit=3)
    return words[0].decode(), words[1] == b"1", int(words[2])


def _section(data: bytes, name: bytes) -> tuple[bytes, bytes]:
    """The content of a section, and the data without it."""
    begin = re.search(rb"^\$" + name + rb"[ \t]*\r?\n", data, re.MULTILINE)
    if begin is None:
        return b"", data
    end = data.index(b"$End" + name, begin.end())
    after = data.find(b"\n", end) + 1 or len(data)
    return data[begin.end() : end], data[: begin.start()] + data[after:]


def _names(section: bytes) -> dict[tuple[int, int], str]:
    """(dimension, number) → name of a physical group."""
    found = re.findall(r'^\s*(\d+)\s+(-?\d+)\s+"(.*)"\s*$', section.decode("utf-8", "replace"), re.MULTILINE)
    return {(int(dimension), int(number)): name for dimension, number, name in found if name}


def _entities(section: bytes, binary: bool, size: int) -> dict[tuple[int, int], list[int]]:
    """(dimension, entity) → its physical groups, of a section $Entities of MSH 4.1."""
    take = _Binary(section, size) if binary else _Words(section)
    counts = [take.large() for _ in range(4)]
    groups = {}
    for dimension, count in enumerate(counts):
        for _ in range(count):
            entity = take.whole()
            take.skip_reals(6 if dimension else 3)
            groups[dimension, entity] = [abs(take.whole()) for _ in range(take.large())]
            for _ in range(take.large() if dimension else 0):
                take.whole()
    return groups


class _Words:
    """Numbers of a text, one after the other."""

    def __init__(self, section: bytes):
        self.words = iter(section.split())

    def whole(self) -> int:
        return int(next(self.words))

    large = whole

    def skip_reals(self, count: int) -> None:
        for _ in range(count):
            next(self.words)


class _Binary:
    """Numbers of bytes, one after the other."""

    def __init__(self, section: bytes, size: int):
        self.section, self.size, self.at = section, size, 0

    def _taken(self, size: int) -> int:
        if self.at + size > len(self.section):
            raise ValueError("The section ends too early.")
        self.at += size
        return int.from_bytes(self.section[self.at - size : self.at], "little", signed=True)

    def whole(self) -> int:
        return self._taken(4)

    def large(self) -> int:
        return self._taken(self.size)

    def skip_reals(self, count: int) -> None:
        self.at += 8 * count


def _read_rest(path: Path, data: bytes):
    """Nodes and elements, through a file without the sections on groups."""
    with tempfile.TemporaryDirectory() as folder:
        rest = Path(folder) / "rest.msh"
        rest.write_bytes(data)
        return read(path, "gmsh", rest)


def _with_groups(found, notes: tuple[str, ...], names: dict, groups: dict, version: str) -> Cells:
    blocks = [(block.type, np.asarray(block.data)) for block in found.cells]
    dimension = np.concatenate([np.full(len(block), _dimension(kind)) for kind, block in blocks])
    key = "gmsh:physical" if version == "2.2" else "gmsh:geometrical"
    tags = np.concatenate([np.asarray(part, np.int64) for part in found.cell_data.get(key, [])] or [dimension * 0])
    if tags.shape != dimension.shape:
        raise ValueError("Some elements have no tags.")
    members: dict[tuple[int, int], list[np.ndarray]] = {}
    for at in sorted(set(zip(dimension.tolist(), tags.tolist(), strict=True))):
        cells = np.flatnonzero((dimension == at[0]) & (tags == at[1]))
        numbers = groups.get(at, []) if version == "4.1" else [abs(at[1])] * (at[1] != 0)
        for number in numbers:
            members.setdefault((at[0], number), []).append(cells)
    if version == "2.2":
        blocks, moved = _once(blocks, tags)
        members = {at: [moved[part] for part in parts] for at, parts in members.items()}
    for at in names:
        members.setdefault(at, [np.zeros(0, np.int64)])
    sets: dict[str, list[np.ndarray]] = {}
    for at, parts in members.items():
        sets.setdefault(_called(at, names, members), []).extend(parts)
    return Cells(found.points, blocks, element_sets={n: np.concatenate(p) for n, p in sets.items()}, notes=notes)


def _dimension(kind: str) -> int:
    return _DIMENSION.get(kind.rstrip("0123456789"), 3)


def _called(at: tuple[int, int], names: dict, members: dict) -> str:
    """A group's name; without one its number, which a curve and a point may share."""
    dimension, number = at
    return names.get(at) or (f"point {number}" if dimension == 0 and (1, number) in members else str(number))


def _once(blocks: list, tags: np.ndarray) -> tuple[list, np.ndarray]:
    """Elements that MSH 2.2 repeats for each of their groups are kept once; and (c,) where each cell is now."""
    first: dict[tuple, int] = {}
    moved, kept = np.zeros(len(tags), np.int64), []
    number, cell = 0, 0
    for kind, block in blocks:
        rows = []
        for corners in block.tolist():
            same = first.get((kind, *sorted(corners)))
            if same is not None and tags[same] != tags[cell]:
                moved[cell] = moved[same]
            else:
                first[kind, *sorted(corners)] = cell
                moved[cell] = number
                rows.append(corners)
                number += 1
            cell += 1
        kept.append((kind, np.array(rows, np.int64).reshape(-1, block.shape[1])))
    return kept, moved
