"""The meshes of one scene, coarse to fine, and the shapes of its elements: what advice chooses from.

A scene of the library is made anew with other `divisions`; any other is refined and coarsened. Only meshes of the same
problem belong: where a function of the library puts its loads elsewhere on another mesh, or a coarser mesh carries
forces on other nodes, the mesh is left out, and the family says why.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from jaxshell.advice.references import Signals, signals
from jaxshell.model.corner_normals import CREASE
from jaxshell.model.edges import Edges
from jaxshell.model.loads import DeadLoad
from jaxshell.model.refinement import coarsen, refine
from jaxshell.model.scene import Scene
from jaxshell.model.sections.regions import Regions, region_of_elements
from jaxshell.scenes import default_divisions

FACTORS = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0)
"""Numbers of elements along an edge, over the scene's own."""
_ASPECT = 1.12
"""By so much the factors of a mesh's two directions may differ: an extrapolation takes them for one."""
_CLEARLY = 1.15
"""A member is finer than another by this factor at least."""
_LOADS = 0.02
"""Loads of two meshes of one problem agree to this fraction, the facets of a curved surface included."""
_TURNED = 1e-6
"""Neighbours whose normals differ by less than this are of one plane."""
_MULTIPLES = (1, 2, 4, 8)
"""Divisions must be multiples of one of these in some functions of the library."""


class Member(NamedTuple):
    """A mesh of the family."""

    scene: Scene
    factor: float
    """Elements along an edge over those of the scene that advice is asked for."""
    divisions: int | tuple[int, ...] | None = None
    """What the library's function makes it of; None for the scene's own mesh, refined or coarsened ones."""
    levels: int = 0
    """How often the scene is refined; negative: coarsened."""

    @property
    def label(self) -> str:
        return f"{self.scene.mesh.n_elements} triangles"


class Family:
    """Members by their factor, made when they are asked for.

    Arguments:
        scene: its own mesh is the member with factor 1.
        make: the function of the library that made it with default arguments; None for any other scene.
    """

    def __init__(self, scene: Scene, make: Callable[..., Scene] | None = None):
        self.scene, self.make = scene, make
        self.notes: list[str] = []
        """Which meshes were left out, and why."""
        self._made: dict[float, Member | None] = {1.0: Member(scene, 1.0)}
        self._common: Float[np.ndarray, "q 3"] | None = None

    def at(self, factor: float) -> Member | None:
        """The member with a factor of `FACTORS`, or about that; None where there is none."""
        if factor not in self._made:
            self._made[factor] = self._anew(factor) or self._by_levels(factor)
        return self._made[factor]

    def finer(self, factor: float) -> Member | None:
        """The next member that is clearly finer."""
        members = (self.at(f) for f in FACTORS if f > factor)
        return next((m for m in members if m is not None and m.factor > _CLEARLY * factor), None)

    def signals(self, scene: Scene, displacements: Float[np.ndarray, "k n 3"]) -> Signals:
        """What the answers of two members are compared by: `references.signals`, of all nodes at those that both have.

        Raises ValueError where a member has other nodes than the coarsest that was made.
        """
        found = signals(scene, displacements)
        if "displacements" not in found:
            return found
        x0 = np.asarray(scene.mesh.nodes)
        if self._common is None:
            made = [m.scene for m in self._made.values() if m is not None]
            self._common = np.asarray(min(made, key=lambda s: s.mesh.n_nodes).mesh.nodes)
        away, at = KDTree(x0).query(self._common)
        if np.max(away) > 1e-6 * np.ptp(x0, axis=0).max():
            raise ValueError("The meshes have no nodes in common: let the scene watch what counts (watch=).")
        return {"displacements": displacements[:, at].reshape(len(displacements), -1)}

    def _anew(self, factor: float) -> Member | None:
        """By the function of the library, where it makes the same problem."""
        if self.make is None:
            return None
        for multiple in _MULTIPLES:
            divisions = scaled_divisions(self.make, factor, multiple)
            if divisions is None:
                continue
            try:
                scene = self.make(divisions=divisions)
            except ValueError:
                continue
            if same_loads(self.scene, scene):
                ratio = np.sqrt(scene.mesh.n_elements / self.scene.mesh.n_elements)
                return Member(scene, float(ratio), divisions)
            self._note(f"divisions {divisions} are left out: the function puts the loads elsewhere there")
            return None
        return None

    def _by_levels(self, factor: float) -> Member | None:
        levels = round(np.log2(factor))
        if 2.0**levels != factor:
            return None
        towards = self.at(factor / 2.0 if levels > 0 else factor * 2.0)
        if towards is None or towards.divisions is not None:
            return None
        try:
            if levels > 0:
                return Member(refine(towards.scene), factor, None, levels)
            scene = coarsen(towards.scene)
            if not same_loads(towards.scene, refine(scene), nodes_too=True):
                self._note("it is not coarsened: forces on nodes would be on other nodes there")
                return None
            return Member(scene, factor, None, levels)
        except ValueError as error:
            self._note(f"it is not {'refined' if levels > 0 else 'coarsened'}: {error}")
            return None

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)


def scaled_divisions(make: Callable, factor: float, multiple: int = 1) -> int | tuple[int, ...] | None:
    """A library scene's default `divisions` times `factor`, as multiples; None where its elements become longer or
    shorter in one direction than in the other, and where nothing is changed."""
    default = default_divisions(make)
    counts = np.atleast_1d(default)
    found = np.maximum(1, np.round(factor * counts / multiple).astype(int)) * multiple
    ratios = found / counts
    if ratios.max() > _ASPECT * ratios.min() or not 0.8 < np.mean(ratios) / factor < 1.25 or np.all(ratios == 1):
        return None
    scaled = found.tolist()
    return tuple(scaled) if isinstance(default, tuple) else scaled[0]


def same_loads(one: Scene, other: Scene, nodes_too: bool = False) -> bool:
    """Whether two meshes carry the same dead loads: resultants, and if asked for what every node carries."""
    if len(one.loads) != len(other.loads):
        return False
    if nodes_too and one.mesh.n_nodes != other.mesh.n_nodes:
        return False
    for mine, theirs in zip(one.loads, other.loads, strict=True):
        if not (isinstance(mine, DeadLoad) and isinstance(theirs, DeadLoad)):
            continue
        (a, x), (b, y) = _nodal(one, mine), _nodal(other, theirs)
        allowed = _LOADS * np.abs(a).sum()
        apart = np.abs(_resultant(a, x) - _resultant(b, y))
        size = np.ptp(x, axis=0).max()
        if max(apart[:3].max(), apart[3:].max() / max(1.0, size)) > allowed:
            return False
        if nodes_too and np.abs(a - b[KDTree(y).query(x)[1]]).sum() > allowed:
            return False
    return True


def _resultant(on_nodes: Float[np.ndarray, "n 6"], x: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "6"]:
    """Force and moment about the origin."""
    turning = on_nodes[:, 3:] + np.cross(x, on_nodes[:, :3])
    return np.concatenate([on_nodes[:, :3].sum(axis=0), turning.sum(axis=0)])


def _nodal(scene: Scene, load: DeadLoad) -> tuple[Float[np.ndarray, "n 6"], Float[np.ndarray, "n 3"]]:
    """What a load puts on the nodes at factor 1, and where they are."""
    triangles = scene.mesh.triangles
    heavy = scene.section is not None and load.on_bending() is not None  # acts on masses
    masses = np.asarray(scene.section.area_masses(scene.mesh)) if heavy else np.zeros(len(triangles))
    return np.asarray(load.nodal(scene.mesh.nodes, triangles, masses)), np.asarray(scene.mesh.nodes)


def shapes_of(scene: Scene) -> tuple[str, ...]:
    """Shapes of elements to choose from, the scene's own first; flat and curved, where that makes a difference.

    None where regions have shapes of their own: they stay.
    """
    own = own_shapes(scene)
    if len(own) > 1:
        return ()
    smooth = ("flat", "curved") if is_curved(scene) else ()
    return tuple(dict.fromkeys((*own, *smooth)))


def own_shapes(scene: Scene) -> set[str]:
    """Of the elements of a scene's section, or of its regions'."""
    parts = scene.section.sections if isinstance(scene.section, Regions) else (scene.section,)
    return {getattr(part, "shape", "flat") for part in parts}


def is_curved(scene: Scene) -> bool:
    """Whether any two neighbours turn against each other, by no more than a crease does."""
    if scene.section is None or not scene.mesh.n_elements:
        return False
    triangles, across = scene.mesh.triangles, Edges(scene.mesh.triangles).neighbours()
    a, b, c = np.moveaxis(np.asarray(scene.mesh.nodes)[triangles], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    turn = np.linalg.norm(normals[across] - normals[:, None], axis=2)  # about the angle
    region = region_of_elements(scene.section, scene.mesh)
    same = True if region is None else region[across] == region[:, None]
    return bool(np.any((turn > _TURNED) & (turn < np.radians(CREASE)) & same))
