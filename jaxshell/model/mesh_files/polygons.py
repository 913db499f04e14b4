"""Files of polygons, as graphics programs write them: Wavefront OBJ with its groups and objects, and OFF.

meshlane 5.5 loses OBJ's names, takes numbers that count backwards for broken ones, and refuses OFF files of quads.
"""

from pathlib import Path

import numpy as np

from jaxshell.model.cells import Cells
from jaxshell.model.mesh_files.files import text_of
from jaxshell.model.mesh_files.library import broken

_KINDS = {1: "vertex", 2: "line", 3: "triangle", 4: "quad"}


def read_obj(path) -> Cells:
    """What an OBJ file holds; each group (g) and object (o) is an element set. Raises ValueError."""
    points: list[list[float]] = []
    faces: list[list[int]] = []
    sets: dict[str, list[int]] = {}
    objects, groups = [], []
    for number, line in enumerate(text_of(Path(path)).splitlines(), 1):
        key, *words = line.split("#", 1)[0].split() or [""]
        try:
            if key == "v":
                points.append([float(word) for word in words[:3]])
                if len(words) < 3:
                    raise ValueError("A vertex has three coordinates.")
            elif key in ("f", "l", "p"):
                corners = [_corner(word, len(points)) for word in words]
                found = [corners] if key == "f" else _pieces(corners, 2 if key == "l" else 1)
                for name in dict.fromkeys([*objects, *groups]):
                    sets.setdefault(name, []).extend(range(len(faces), len(faces) + len(found)))
                faces += found
        except ValueError as error:
            raise broken(path, f"line {number}, {line.strip()[:60]!r}") from error
        if key == "o":
            objects = [" ".join(words)] if words else []
        elif key == "g":
            groups = words
    return _cells(points, faces, {name: np.array(cells, np.int64) for name, cells in sets.items()})


def _corner(word: str, count: int) -> int:
    """A vertex, counted from 1, or backwards from the last one with -1."""
    number = int(word.split("/")[0])
    return number - 1 if number > 0 else count + number


def _pieces(corners: list[int], size: int) -> list[list[int]]:
    return [corners[at : at + size] for at in range(len(corners) - size + 1)]


def read_off(path) -> Cells:
    """What an OFF file holds. Raises ValueError."""
    lines = [line.split("#", 1)[0].split() for line in text_of(Path(path)).splitlines()]
    lines = [words for words in lines if words]
    try:
        head = lines.pop(0)
        if head[0] != "OFF":
            raise ValueError("The file does not begin with OFF.")
        n_points, n_faces = map(int, (head[1:] or lines.pop(0))[:2])
        points = [[float(word) for word in words[:3]] for words in lines[:n_points]]
        rows = [[int(word) for word in words[: int(words[0]) + 1]] for words in lines[n_points : n_points + n_faces]]
        if len(rows) < n_faces or any(len(row) != row[0] + 1 for row in rows) or any(len(x) != 3 for x in points):
            raise ValueError("The file ends too early.")
    except (ValueError, IndexError) as error:
        raise broken(path) from error
    return _cells(points, [row[1:] for row in rows], {})


def _cells(points: list, faces: list[list[int]], sets: dict[str, np.ndarray]) -> Cells:
    """Blocks of neighbouring faces with as many corners."""
    blocks: list[tuple[str, list[list[int]]]] = []
    for face in faces:
        if not blocks or len(blocks[-1][1][-1]) != len(face):
            blocks.append((_KINDS.get(len(face), "polygon"), []))
        blocks[-1][1].append(face)
    arrays = [(kind, np.array(rows, np.int64)) for kind, rows in blocks]
    return Cells(np.array(points, float).reshape(-1, 3), arrays, element_sets=sets)
