"""The imperfection of a scene file's mesh, from modes of the scene itself or as a random field.

    [mesh.imperfection]     kind = "buckling" or "vibration", mode (a number from 1, or several) and amplitude (one for
                            each): modes of the file's scene on the mesh without imperfection; or
                            kind = "random", amplitude (the standard deviation), correlation_length, seed
    [[mesh.imperfection]]   several, which add up

Nodes and elements are chosen by their places on the mesh without imperfection.
"""

from typing import Any

import numpy as np

from jaxshell.files.sections import chosen_kind
from jaxshell.files.tables import Table
from jaxshell.model.imperfection import RandomField
from jaxshell.model.mesh import Mesh
from jaxshell.model.scene import Scene
from jaxshell.numerics.checks import check_count

IMPERFECTION = "imperfection"
KEYS = {
    "buckling": ("amplitude", "mode"),
    "vibration": ("amplitude", "mode"),
    "random": ("amplitude", "correlation_length", "seed"),
}
"""Of every kind."""


def imperfect_mesh(table: Table, scene: Scene) -> Mesh:
    """The mesh of `scene` with the imperfections of the table [mesh]. Raises ValueError for what does not fit."""
    several = isinstance(table.content[IMPERFECTION], list)
    tables = table.tables(IMPERFECTION) if several else [table.table(IMPERFECTION)]
    shapes, amplitudes = [], []
    for each in tables:
        kind = chosen_kind(each, KEYS)
        each.only("kind", *KEYS[kind])
        found = [_field(each)] if kind == "random" else _modes(each, kind, scene)
        given = each.get("amplitude")
        sizes = given if isinstance(given, list) else [given]
        if len(sizes) != len(found):
            raise ValueError(f"{each.name} amplitude must be {len(found)}, one for each mode, but is {len(sizes)}.")
        shapes += found
        amplitudes += sizes
    return table.call(scene.mesh.with_imperfection, shapes, amplitudes)


def _field(table: Table) -> RandomField:
    return table.call(RandomField, table.get("correlation_length"), table.content.get("seed", 0))


def _modes(table: Table, kind: str, scene: Scene) -> list[Any]:
    """The shapes of the modes that the table names, of the scene as it is."""
    # Through the public name: modes are found by a room above this one.
    import jaxshell as js

    given = table.content.get("mode", 1)
    numbers = given if isinstance(given, list) else [given]
    for number in numbers:
        table.call(check_count, "mode", number)
    count = max(numbers, default=1)
    if kind == "buckling":
        found = table.call(js.linear_buckling, scene, count)
        exists, why = np.isfinite(found.load_factors), "the scene's loads have no buckling factor of this number"
    else:
        found = table.call(js.natural_frequencies, scene, count)
        exists, why = np.asarray(found.frequencies) != 0, "it is a motion as a rigid body"
    for number in numbers:
        if not exists[number - 1]:
            raise ValueError(f"{table.name} mode {number} of {kind} is no imperfection: {why}.")
    return [found.shapes[number - 1] for number in numbers]
