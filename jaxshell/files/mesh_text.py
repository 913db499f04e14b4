"""A mesh with its sets as an input file that `Mesh.read` reads to the last bit, where a model's own file is none."""

import numpy as np

from jaxshell.model.mesh import Mesh


def mesh_text(mesh: Mesh) -> str:
    """Nodes, triangles and sets of nodes and elements as cards of an Abaqus input file, counted from 1."""
    nodes = [f"{i + 1}, {x!r}, {y!r}, {z!r}" for i, (x, y, z) in enumerate(np.asarray(mesh.nodes).tolist())]
    triangles = [f"{i + 1}, {a + 1}, {b + 1}, {c + 1}" for i, (a, b, c) in enumerate(mesh.triangles.tolist())]
    sets = [
        [f'*{card}, {card}="{name}"', *_rows(numbers)]
        for card, of in (("NSET", mesh.node_sets), ("ELSET", mesh.element_sets))
        for name, numbers in of.items()
    ]
    return (
        "\n".join(["*NODE", *nodes, "*ELEMENT, TYPE=S3", *triangles, *(line for block in sets for line in block)])
        + "\n"
    )


def _rows(numbers: np.ndarray) -> list[str]:
    texts = [str(number + 1) for number in numbers.tolist()]
    return [", ".join(texts[at : at + 16]) for at in range(0, len(texts), 16)]
