"""Supports on a mesh whose triangles are cut: what they hold between the nodes that they held."""

import dataclasses
import warnings
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxshell.model.edges import Edges
from jaxshell.model.refinement.initial import halfway
from jaxshell.model.refinement.split import Split
from jaxshell.model.supports import Support
from jaxshell.numerics.directions import across
from jaxshell.numerics.frozen import Frozen


def carried_supports(supports: Sequence[Support], split: Split) -> list[Support]:
    """The supports with the new nodes between theirs, and further ones for those between two supports.

    Raises ValueError naming the supports where it cannot be told what is held.
    """
    found, done = [], [np.zeros(len(split.edges), bool) for _ in supports]
    for position, support in enumerate(supports):
        nodes = support.nodes.array
        try:
            between = split.between(nodes)
        except ValueError as error:
            raise ValueError(f"support {position}: {error}") from error
        if split.may_mean_lines(nodes):
            warnings.warn(
                f"support {position} has all nodes of elements that lie between edges of the shell, and the new ones "
                "inside of them are held too. If the edges alone are meant, refine the mesh first and state the "
                "support on that.",
                stacklevel=5,
            )
        done[position] = split.membership(nodes).edges
        found.append(_extended(support, between, split))
    return found + _between_supports(supports, done, split)


def _extended(support: Support, between: np.ndarray, split: Split) -> Support:
    """With new nodes, whose prescribed displacements are the means of those at the ends of their edges."""
    nodes, changed = support.nodes.array, {}
    for name in ("displacement", "acceleration"):
        value = getattr(support, name)
        if value is not None and value.ndim == 2:
            row = {int(node): k for k, node in enumerate(nodes)}
            ends = np.array([[row[int(node)] for node in pair] for pair in split.edges.ends[between]], int)
            changed[name] = jnp.concatenate([value, 0.5 * value[ends.reshape(-1, 2)].sum(axis=1)])
    numbers = Frozen(np.concatenate([split.nodes(nodes), split.middle[between]]))
    return dataclasses.replace(support, nodes=numbers, **changed)


def _between_supports(supports: Sequence[Support], done: list[np.ndarray], split: Split) -> list[Support]:
    """Supports for the middles of lines' edges whose ends are held by two supports, and not yet by either."""
    edges, found = split.edges, []
    at: dict[int, list[int]] = {}
    for position, support in enumerate(supports):
        for node in np.unique(support.nodes.array).tolist():
            at.setdefault(node, []).append(position)
    runs = _runs(supports, done, at, edges)
    for edge in split.cut[edges.is_line[split.cut]]:
        first, second = edges.ends[edge].tolist()
        held: dict[str, Any] = {}
        for one in at.get(first, []):
            for other in at.get(second, []):
                if one == other:
                    continue
                a, b = supports[one], supports[other]
                common = tuple(dof for dof in a.dofs if dof in b.dofs)
                of_line = runs[one][first] or runs[other][second] or set(a.dofs) == set(b.dofs)
                already = {dof for k, support in enumerate(supports) if done[k][edge] for dof in support.dofs}
                common = tuple(dof for dof in common if dof not in already)
                if common and of_line:
                    axes = _common_axes(a, b, (one, other), (first, second))
                    held |= dict.fromkeys((dof for dof in common if dof not in held), axes)
        by_axes: dict[int, tuple[list[str], Any]] = {}
        for dof, axes in held.items():
            by_axes.setdefault(id(axes), ([], axes))[0].append(dof)
        found += [Support(Frozen([split.middle[edge]]), tuple(dofs), axes=axes) for dofs, axes in by_axes.values()]
    return found


def _runs(
    supports: Sequence[Support], done: list[np.ndarray], at: dict[int, list[int]], edges: Edges
) -> list[np.ndarray]:
    """For each support (n,), the nodes that it has on lines together with others; `at` are the supports of nodes."""
    size = int(edges.triangles.max(initial=-1)) + 1
    runs = [np.isin(np.arange(size), edges.ends[held & edges.is_line]) for held in done]
    for first, second in edges.ends[edges.is_line].tolist():  # on from one support to a like one
        for one in at.get(first, []):
            for other in at.get(second, []):
                if one != other and set(supports[one].dofs) == set(supports[other].dofs):
                    runs[one][first] = runs[other][second] = True
    return runs


def _common_axes(a: Support, b: Support, positions: tuple[int, int], ends: tuple[int, int]):
    """The axes of what is between nodes that two supports hold; None is the global ones.

    Raises ValueError naming the supports where they move, or where one alone is slanted.
    """
    where = f"supports {positions[0]} and {positions[1]} hold nodes {ends[0]} and {ends[1]}, the ends of an edge"
    if a.moves or b.moves:
        raise ValueError(
            f"{where}, and move them: how the node between them moves cannot be told. Make them one support, with a "
            "displacement for each node, or refine the mesh first and state the support on that."
        )
    if (a.axes is None) != (b.axes is None):
        raise ValueError(
            f"{where}, along different axes: whether the node between them is held cannot be told. Refine the mesh "
            "first and state the supports on that."
        )
    if a.axes is None or b.axes is None or a.axes is b.axes:
        return a.axes
    if all((y in dofs) == (z in dofs) for dofs in (a.dofs, b.dofs) for y, z in (("uy", "uz"), ("ry", "rz"))):
        return across(a.axes[0] + b.axes[0])  # only x has a meaning, as in a support by its normal
    return halfway(a.axes.T[None], b.axes.T[None])[0].T
