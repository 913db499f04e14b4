"""Triangle meshes: nodes, connectivity, the checks that a shell needs, selections, sets, and import of mesh files."""

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxshell.model import repair
from jaxshell.model.cells import Cells, Numbering, surface
from jaxshell.model.imperfection import moved
from jaxshell.model.mesh_checks import check_coincident, check_connectivity, check_indices, check_shapes, check_sides
from jaxshell.model.mesh_file import read_cells
from jaxshell.model.sets import Sets
from jaxshell.model.surface import TrueSurface
from jaxshell.numerics.checks import (
    check_choice,
    check_count,
    check_finite,
    check_kind,
    check_positive_number,
    check_shape,
    check_switch,
    float_array,
    is_concrete,
    require_float64,
    shown,
    whole_array,
)
from jaxshell.numerics.frozen import Frozen


class _OfMeshOrArrays:
    """A cure as a method: `Mesh.cure(nodes, triangles, ...)`, or `mesh.cure(...)` of a mesh that exists, whose sets it
    keeps."""

    def __init__(self, function):
        self.function, self.__doc__ = function, function.__doc__

    def __get__(self, instance, owner) -> Any:
        if instance is None:
            return self.function
        if instance.points:
            raise ValueError("The mesh has points besides its triangles: mend it before with_points.")
        sets = {name: getattr(instance, name) for name in ("node_sets", "element_sets", "side_sets", "surface")}
        return lambda *arguments, **named: self.function(
            instance.nodes, instance.triangles, *arguments, **(sets | named)
        )


def _merged(
    nodes, triangles, tolerance, *, orient: bool = False, coincident: str = "error", node_sets: Mapping | None = None,
    element_sets: Mapping | None = None, side_sets: Mapping | None = None, surface: TrueSurface | None = None,
) -> "Mesh":  # fmt: skip
    """The mesh with all nodes no further than `tolerance` [length] apart made one, at the place of the first.

    For faces that touch without sharing nodes, as CAD programs write them. Nodes that no triangle uses are dropped.
    `orient` and `coincident` as in `Mesh.read`, sets as in `Mesh`: they follow. Raises ValueError where the tolerance
    reaches an edge.
    """
    check_positive_number("tolerance", tolerance)
    check_switch("orient", orient)
    nodes, triangles = _arrays(nodes, triangles)
    node_sets, side_sets = Sets("node", node_sets, len(nodes)), Sets("side", side_sets, len(nodes), ends=2)
    nodes, triangles, number = repair.merged(nodes, triangles, float(tolerance))
    return Mesh(
        nodes,
        repair.oriented(triangles) if orient else triangles,
        coincident=coincident,
        node_sets=_renumbered(node_sets, number),
        element_sets=element_sets,
        side_sets=_renumbered(side_sets, number),
        surface=surface,
    )


def _renumbered(sets: Mapping, number: np.ndarray) -> dict[str, np.ndarray]:
    """Sets of nodes, or of pairs of them, by the nodes' new numbers; without those that have none (-1)."""
    found = {name: number[np.asarray(nodes)] for name, nodes in sets.items()}
    return {name: nodes[(nodes.reshape(len(nodes), -1) >= 0).all(axis=1)] for name, nodes in found.items()}


def _oriented(
    nodes, triangles, *, coincident: str = "error", node_sets: Mapping | None = None,
    element_sets: Mapping | None = None, side_sets: Mapping | None = None, surface: TrueSurface | None = None,
) -> "Mesh":  # fmt: skip
    """The mesh with triangles turned where neighbours disagree on the normal; each part goes by its first triangle.

    Sets as in `Mesh`. Raises ValueError for a surface that has no orientation, such as a Möbius strip.
    """
    nodes, triangles = _arrays(nodes, triangles)
    return Mesh(
        nodes,
        repair.oriented(triangles),
        coincident=coincident,
        node_sets=node_sets,
        element_sets=element_sets,
        side_sets=side_sets,
        surface=surface,
    )


class Mesh(eqx.Module):
    """A surface mesh of three-node triangles.

    Arguments:
        nodes: (n, 3) coordinates of the stress-free shape, in the user's unit of length. Differentiable.
        triangles: (m, 3) node indices, counted from 0. The right-hand rule gives the element's normal;
            neighbours must agree on it. The element's first axis is parallel to its edge 1-2.
        coincident: what is done where nodes lie in one place (closer than 1e-6 of the edges there) and no triangle
            joins them: "error", since two faces that only seem to be one fall apart, or "allow" where it is meant, as
            at the lips of a slit.
        node_sets, element_sets: {name: numbers (k,)}. Whatever takes nodes or elements takes a set's name. Sets may
            overlap.
        side_sets: {name: edges (k, 2) by the nodes at their ends}, for what acts on edges.
        points: how many of the last nodes belong to no triangle: references of rigid bodies, anchors, ...; see
            `with_points`.
        surface: the true surface that the nodes are on (`jaxshell.model.surface`), or None where it is not known. It
            says where `refine` puts new nodes; generators give it. Its floats are differentiable.

    `Mesh.merged` joins coincident nodes and `Mesh.oriented` turns triangles, both from the same arrays.

    Raises ValueError for indices out of range, repeated nodes or triangles, zero areas, slivers (longest edge over
    height above 2.5e4), neighbours with opposite normals, coincident and unused nodes, NaN, empty sets and sides that
    are no edge of a triangle; RuntimeError when JAX has float64 switched off.
    """

    nodes: Float[jax.Array, "n 3"] = eqx.field(converter=float_array)
    connectivity: Frozen = eqx.field(static=True)
    node_sets: Sets = eqx.field(static=True)
    element_sets: Sets = eqx.field(static=True)
    side_sets: Sets = eqx.field(static=True)
    points: int = eqx.field(static=True)
    surface: TrueSurface | None

    merged = _OfMeshOrArrays(_merged)
    oriented = _OfMeshOrArrays(_oriented)

    def __init__(
        self,
        nodes,
        triangles,
        *,
        coincident: str = "error",
        node_sets: Mapping | None = None,
        element_sets: Mapping | None = None,
        side_sets: Mapping | None = None,
        points: int = 0,
        surface: TrueSurface | None = None,
    ):
        require_float64()
        self.nodes = float_array(nodes, "nodes")
        triangles = (
            triangles.array if isinstance(triangles, Frozen) else whole_array("triangles", triangles, "integers")
        )
        self.connectivity = Frozen(triangles)
        check_choice("coincident", coincident, ("error", "allow"))
        check_shape("nodes", self.nodes, (None, 3))
        check_shape("triangles", self.triangles, (None, 3))
        check_finite("nodes", self.nodes)
        check_count("points", points, least=0)
        self.points = int(points)
        check_kind("surface", surface, TrueSurface | None, "a surface of jaxshell.model.surface or None")
        self.surface = surface
        check_connectivity(self.triangles, self.n_nodes, self.points)
        self.node_sets = Sets("node", node_sets, self.n_nodes)
        self.element_sets = Sets("element", element_sets, self.n_elements)
        self.side_sets = Sets("side", side_sets, self.n_nodes, ends=2)
        check_sides(self.side_sets, self.triangles)
        if is_concrete(self.nodes) and self.n_elements:
            check_shapes(np.asarray(self.nodes)[: self.n_nodes - self.points], self.triangles)
            if coincident == "error":
                check_coincident(np.asarray(self.nodes), self.triangles)

    @property
    def triangles(self) -> np.ndarray:
        """(m, 3) node indices of the elements."""
        return self.connectivity.array

    @property
    def n_nodes(self) -> int:
        return self.nodes.shape[0]

    @property
    def n_elements(self) -> int:
        return self.triangles.shape[0]

    def element_set(self, name: str) -> np.ndarray:
        """Numbers of the elements of a set. Raises ValueError that lists the sets that there are."""
        return self.element_sets.chosen(name)

    def node_set(self, name: str) -> np.ndarray:
        """Indices of the nodes of a set. Raises ValueError that lists the sets that there are."""
        return self.node_sets.chosen(name)

    def side_set(self, name: str) -> np.ndarray:
        """(k, 2) ends of the edges of a set. Raises ValueError that lists the sets that there are."""
        return self.side_sets.chosen(name)

    def with_sets(
        self, node_sets: Mapping | None = None, element_sets: Mapping | None = None, side_sets: Mapping | None = None
    ) -> "Mesh":
        """The mesh with these sets besides its own; one of the same name takes the place of the old one.

        Raises ValueError as `Mesh` for sets that do not fit.
        """
        given = {"node_sets": node_sets, "element_sets": element_sets, "side_sets": side_sets}
        merged = {name: {**getattr(self, name), **({} if new is None else new)} for name, new in given.items()}
        return self._again(**merged)

    def with_points(self, points: Mapping[str, Any]) -> "Mesh":
        """The mesh with nodes that belong to no triangle, {name: place (3,)}, each in a set of its name.

        References of rigid bodies, anchors of springs, masses beside the shell. They follow the other nodes. Raises
        ValueError for a name that a set of nodes has already.
        """
        if not isinstance(points, Mapping) or not points:
            raise ValueError(f"points must be {{name: place (3,)}}, but it is {shown(points)}.")
        places = []
        for name, place in points.items():
            if name in self.node_sets:
                raise ValueError(f"The point {shown(name)} needs another name: a set of nodes has it.")
            places.append(float_array(place, f"point {name!r}"))
            check_shape(f"point {name!r}", places[-1], (3,))
        numbers = {name: [self.n_nodes + k] for k, name in enumerate(points)}
        return self._again(
            nodes=jnp.concatenate([self.nodes, jnp.stack(places)]),
            node_sets={**self.node_sets, **numbers},
            points=self.points + len(places),
        )

    def on_surface(self, surface: TrueSurface | None) -> "Mesh":
        """The mesh with another true surface, for `refine`; None forgets the one that it has. Its nodes stay."""
        return self._again(surface=surface)

    def _again(self, **changed) -> "Mesh":
        """The mesh with some of what it is made of changed."""
        kept = {name: getattr(self, name) for name in ("node_sets", "element_sets", "side_sets", "points", "surface")}
        return Mesh(changed.pop("nodes", self.nodes), self.connectivity, coincident="allow", **(kept | changed))

    @classmethod
    def of_points(cls, points: Mapping[str, Any]) -> "Mesh":
        """A mesh without a shell, for scenes of rigid bodies and point masses: points as in `with_points`."""
        return cls(np.zeros((0, 3)), np.zeros((0, 3), int)).with_points(points)

    def with_imperfection(self, mode, amplitude) -> "Mesh":
        """The mesh with its nodes moved: the stress-free shape of a shell that was not made as it was drawn.

        Arguments:
            mode: displacements (n, 3), or (n, 6) with rotations, which are left aside: such as `modes.shapes[0]` of
                `linear_buckling` or `natural_frequencies`, whose sign is nobody's choice; or a `RandomField`. Or
                several of them, as a list.
            amplitude: [length] of the largest displacement, of a `RandomField` the standard deviation; of several
                modes one for each. Negative ones move the other way.

        Sets stay; the true surface is forgotten. Differentiable in nodes, mode and amplitude, but where two nodes share
        the largest displacement. Raises ValueError for other shapes, NaN, a mode that moves nothing, and where
        triangles become slivers.
        """
        nodes = moved(self.nodes, self.triangles, mode, amplitude)
        return self._again(nodes=nodes, surface=None)

    def nodes_where(self, condition: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Indices of the nodes whose coordinates fulfil `condition(x)`, x of shape (3, n).

        Raises ValueError when there is none, and for a condition that is not true or false at every node.
        """
        if not callable(condition):
            raise ValueError(f"nodes_where needs a function of x (3, n), but it is {shown(condition)}.")
        mask = np.asarray(condition(np.asarray(self.nodes).T))
        if mask.shape != (self.n_nodes,) or mask.dtype != bool:
            raise ValueError(
                f"nodes_where: the condition must give true or false for {self.n_nodes} nodes, but it gives an array "
                f"of shape {mask.shape} and type {mask.dtype}."
            )
        found = np.flatnonzero(mask)
        if found.size == 0:
            raise ValueError("nodes_where: no node fulfils the condition; widen its tolerance or check it.")
        return found

    def nearest_node(self, point) -> int:
        """Index of the node nearest to `point` (3,). Raises ValueError for anything but three finite numbers."""
        return _nearest(np.asarray(self.nodes), point)

    def nearest_element(self, point) -> int:
        """Index of the element whose middle is nearest to `point` (3,). Raises ValueError as `nearest_node`."""
        return _nearest(np.asarray(self.nodes)[self.triangles].mean(axis=1), point)

    def boundary_edges(self) -> np.ndarray:
        """(k, 2) node indices of the edges that belong to one triangle only."""
        number, count, _ = repair.numbered_edges(self.triangles)
        alone = np.sort(repair.edges_of(self.triangles)[count[number] == 1], axis=1)
        return alone[np.lexsort(alone.T[::-1])]

    def inner_edges(self) -> np.ndarray:
        """(k, 2) node indices of the edges that triangles share."""
        number, count, _ = repair.numbered_edges(self.triangles)
        return np.unique(np.sort(repair.edges_of(self.triangles)[count[number] > 1], axis=1), axis=0)

    @classmethod
    def read(
        cls,
        path,
        *,
        quads: str = "split",
        second_order: str = "error",
        merge: float | None = None,
        orient: bool = False,
        coincident: str = "error",
    ) -> "Mesh":
        """Read the triangles and quads of a mesh file (Gmsh, Abaqus, Nastran, VTK, STL, ...) and its sets.

        Arguments:
            quads: "split" cuts each along its shorter diagonal, "error" refuses a file that has any.
            second_order: "split" cuts cells of 6, 8 and 9 nodes into triangles along the nodes on their sides, "error"
                refuses a file that has any.
            merge: a tolerance [length] within which nodes are made one, as `Mesh.merged` does; None merges none.
            orient: turn triangles so that neighbours agree on the normal, as `Mesh.oriented` does.
            coincident: as in `Mesh`.

        Nodes that belong to no triangle are dropped, elements keep the file's order, and sets follow:
        `docs/meshes.md` lists where each kind of file has them. A warning names what of the file is left out. Raises
        FileNotFoundError, and ValueError naming the file for a broken one, for other cells (second order, solids) and
        for one without triangles.
        """
        return mesh_of_cells(
            read_cells(path),
            str(path),
            quads=quads,
            second_order=second_order,
            merge=merge,
            orient=orient,
            coincident=coincident,
            stacklevel=2,
        )[0]


def mesh_of_cells(
    cells: Cells,
    where: str,
    *,
    quads: str = "split",
    second_order: str = "error",
    merge: float | None = None,
    orient: bool = False,
    coincident: str = "error",
    stacklevel: int = 1,
) -> tuple[Mesh, Numbering]:
    """The mesh that a file's cells make, as `Mesh.read` makes it, and where the file's points and cells are in it.

    `where` names the file in messages; a warning of what is left out points `stacklevel` callers up.
    """
    check_choice("quads", quads, ("split", "error"))
    check_choice("second_order", second_order, ("split", "error"))
    check_choice("coincident", coincident, ("error", "allow"))
    check_switch("orient", orient)
    if merge is not None:
        check_positive_number("merge", merge)
    found = surface(
        cells, where, quads=quads, second_order=second_order, merge=merge, orient=orient, stacklevel=stacklevel + 1
    )
    try:
        mesh = Mesh(
            found.nodes,
            found.triangles,
            coincident=coincident,
            node_sets=found.node_sets,
            element_sets=found.element_sets,
            side_sets=found.side_sets,
        )
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
    return mesh, found.numbering


def _nearest(places: np.ndarray, point) -> int:
    point = float_array(point, "point")
    check_shape("point", point, (3,))
    check_finite("point", point)
    return int(np.argmin(np.linalg.norm(places - np.asarray(point), axis=1)))


def _triangles(triangles) -> np.ndarray:
    return triangles.array if isinstance(triangles, Frozen) else whole_array("triangles", triangles, "integers")


def _arrays(nodes, triangles) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (n, 3) and triangles (m, 3), to be cured. Raises ValueError for other shapes and missing nodes."""
    nodes = float_array(nodes, "nodes")
    if not is_concrete(nodes):
        raise ValueError("nodes must be known where a mesh is mended, but JAX is tracing them.")
    triangles = _triangles(triangles)
    check_shape("nodes", nodes, (None, 3))
    check_shape("triangles", triangles, (None, 3))
    check_finite("nodes", nodes)
    check_indices(triangles, len(nodes))
    return np.asarray(nodes), triangles
