"""`refine`: every triangle in four, or some bisected, and the whole scene on the finer mesh."""

from typing import Any, TypeVar

import jax.numpy as jnp
import numpy as np

from jaxshell.model.corner_normals import CREASE
from jaxshell.model.edges import Edges
from jaxshell.model.gauge import gauge_of
from jaxshell.model.grids import MOST_TRIANGLES
from jaxshell.model.mesh import Mesh
from jaxshell.model.refinement import carry
from jaxshell.model.refinement.bisection import bisected_edges
from jaxshell.model.refinement.initial import carried_initial
from jaxshell.model.refinement.places import WAYS, middles
from jaxshell.model.refinement.split import Split
from jaxshell.model.refinement.supports import carried_supports
from jaxshell.model.scene import Scene
from jaxshell.model.sections.regions import region_of_elements
from jaxshell.model.sets import check_on_mesh, element_numbers
from jaxshell.model.surface import TrueSurface
from jaxshell.numerics.checks import check_choice, check_count, check_kind, check_within

MeshOrScene = TypeVar("MeshOrScene", Mesh, Scene)


def refine(
    of: MeshOrScene,
    levels: int = 1,
    surface: TrueSurface | str | None = None,
    crease: float = CREASE,
    elements: Any = None,
) -> MeshOrScene:
    """A scene, or a mesh, with every triangle cut in four, or with some of them bisected, `levels` times.

    Arguments:
        of: a `Scene` or a `Mesh`. Differentiable in all of its floats.
        levels: how often; none is 0.
        surface: where new nodes go. None: onto the mesh's true surface where it knows one, as those of generators do,
            else as "smooth". "smooth": onto curved patches through the nodes, across creases and along boundaries with
            tangents of their own. "flat": onto the middle of the edges; the shell stays the polyhedron that it is. Or a
            surface of `jaxshell.model.surface`, which the new mesh remembers.
        crease: angle [degrees] between neighbours above which "smooth" keeps the fold between them.
        elements: which triangles to bisect at their longest edges, by their numbers or the name of a set of them, and
            what comes of them `levels` times; two of these halve their edges. Neighbours with longer edges are cut too,
            so that all edges meet, and no angle falls below half of the smallest. None: every triangle in four. Which
            edges are cut follows from the places of the nodes, and so is no function that jax.jit can trace.

    Old nodes stay, with their numbers, and the children of a triangle stand together where it stood: 4k to 4k + 3 of
    triangle k where all are cut in four. Loads keep their resultants, sets,
    supports and whatever joins nodes take in what lies between, and an initial state moves on as it did. What a node
    carries (forces, masses, springs) stays there. docs/refinement.md says what becomes of each, and by which rule.

    Raises ValueError naming what cannot be carried over, for elements that there are not, and for more than two million
    triangles.
    """
    check_kind("refine's first argument", of, Mesh | Scene, "a jaxshell.Scene or a jaxshell.Mesh")
    check_count("levels", levels, least=0)
    check_within("crease", crease, 0.0, 180.0)
    if surface is not None and not isinstance(surface, TrueSurface):
        check_choice("surface", surface, WAYS)
    chosen, split = None if elements is None else _chosen(of if isinstance(of, Mesh) else of.mesh, elements), None
    for _ in range(levels):
        of, split = refined_once(of, chosen, split, surface, crease)
        chosen = None if chosen is None else split.elements(chosen)
    return of


def refined_once(
    of: MeshOrScene,
    elements: np.ndarray | None = None,
    before: Split | None = None,
    surface: TrueSurface | str | None = None,
    crease: float = CREASE,
) -> tuple[MeshOrScene, Split]:
    """All triangles in four, or those of these numbers bisected, and the tables of that.

    `before` are those of the mesh that it comes of, by which sets and supports go on as they began.
    """
    mesh = of if isinstance(of, Mesh) else of.mesh
    cut = longest = None
    if elements is not None:
        edges = Edges(mesh.triangles)
        joined = None if isinstance(of, Mesh) else carry.joined_edges(of.connectors, edges)
        cut, longest = bisected_edges(mesh.nodes, edges, elements, joined)
    split = Split(mesh, cut, longest, before)
    if isinstance(of, Mesh):
        return _refined_mesh(of, split, surface, crease), split
    return _refined(of, split, surface, crease), split


def _chosen(mesh: Mesh, elements: Any) -> np.ndarray:
    """Numbers of elements. Raises ValueError for those that there are not."""
    if isinstance(elements, str):
        return mesh.element_set(elements)
    numbers = element_numbers("elements", elements).array
    check_on_mesh("elements", "element", numbers, mesh.n_elements)
    return numbers


def _refined(scene: Scene, split: Split, surface: TrueSurface | str | None, crease: float) -> Scene:
    mesh = _refined_mesh(scene.mesh, split, surface, crease, region_of_elements(scene.section, scene.mesh))
    new = mesh.nodes[split.n_shell : split.n_shell + len(split.cut)]
    connectors = _carried("connector", carry.carried_connector, scene.connectors, split)
    return Scene(
        mesh,
        carry.carried_section(scene.section, split),
        carried_supports(scene.supports, split),
        _carried("load", carry.carried_load, scene.loads, split),
        initial=carried_initial(scene.initial, split, scene.mesh.nodes, new),
        name=scene.name,
        watch=[_carried_watch(entry, split) for entry in scene.watch],
        defaults=scene.defaults,
        damping=carry.carried_damping(scene.damping, split),
        masses=_carried("mass", carry.carried_mass, scene.masses, split),
        connectors=[item for found in connectors for item in found],
        obstacles=_carried("obstacle", carry.carried_obstacle, scene.obstacles, split),
    )


def _refined_mesh(mesh: Mesh, split: Split, surface, crease: float, groups=None) -> Mesh:
    """The mesh with its triangles cut; `groups` (m,) differ where the surface has a crease."""
    if len(split.triangles) > MOST_TRIANGLES:
        raise ValueError(
            f"Refined, the mesh has {len(split.triangles)} triangles, more than the {MOST_TRIANGLES} that are "
            "generated: choose fewer levels."
        )
    known = mesh.surface if surface is None else surface if isinstance(surface, TrueSurface) else None
    way = "smooth" if surface is None else surface
    new = middles(mesh.nodes, split.edges, split.cut, way if known is None else known, crease, groups)
    n = split.n_shell
    return Mesh(
        jnp.concatenate([mesh.nodes[:n], new, mesh.nodes[n:]]),
        split.triangles,
        coincident="allow",
        node_sets={name: _set_of_nodes(name, nodes, split) for name, nodes in mesh.node_sets.items()},
        element_sets={name: split.elements(numbers) for name, numbers in mesh.element_sets.items()},
        side_sets={name: split.halves(pairs) for name, pairs in mesh.side_sets.items()},
        points=mesh.points,
        surface=known,
    )


def _set_of_nodes(name: str, nodes: np.ndarray, split: Split) -> np.ndarray:
    try:
        return carry.with_between(nodes, split).array
    except ValueError as error:
        raise ValueError(f"node_sets {name!r}: {error}") from error


def _carried(what: str, carried, items, split: Split) -> list:
    """What becomes of each. Raises ValueError naming the one that cannot be carried over."""
    found = []
    for position, item in enumerate(items):
        try:
            found.append(carried(item, split))
        except ValueError as error:
            raise ValueError(f"{what} {position}: {error}") from error
    return found


def _carried_watch(entry: tuple, split: Split) -> tuple:
    """A node is where it was; of an element at the child that its gauge goes to; what has a name keeps it."""
    label, number, component = entry
    if isinstance(number, str):
        return entry
    if gauge_of(component) is not None:
        return label, split.gauged(number), component
    return label, int(split.nodes(np.array(number))), component
