"""The scene: everything that the user states about a shell, as one pytree whose floats are differentiable."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxshell.model.connectors import Connector, RigidBody
from jaxshell.model.connectors.rigid_body import check_bodies
from jaxshell.model.contribution import Contribution
from jaxshell.model.damping import RayleighDamping
from jaxshell.model.gauge import check_gauge, gauge_of
from jaxshell.model.history import History
from jaxshell.model.initial import Initial
from jaxshell.model.items import Item, check_names, check_quantity, named
from jaxshell.model.loads import Centrifugal, InitialStrains, Load
from jaxshell.model.masses import Masses, PointMass, beside_shell
from jaxshell.model.mesh import Mesh
from jaxshell.model.obstacles import Obstacle
from jaxshell.model.quantities import QUANTITIES
from jaxshell.model.sections import AnySection, Regions, Section
from jaxshell.model.sets import check_on_mesh
from jaxshell.model.supports import DOFS, Support, slanted_axes
from jaxshell.numerics.checks import (
    check_choice,
    check_count,
    check_kind,
    check_number,
    check_positive_number,
    check_text,
    shown,
)
from jaxshell.numerics.frozen import Frozen

WATCHABLE = ("ux", "uy", "uz", "vx", "vy", "vz")


class Defaults(NamedTuple):
    """How a scene is usually run and shown; the command line starts from it."""

    dt: float | None = None
    """None where the scene says none, as one that is not run in time."""
    t_end: float | None = None
    save_every: int = 1
    picture_times: tuple[float, ...] = ()
    methods: tuple[tuple[str, float, float], ...] = (("EMC", 1.0, 0.0),)
    """(name, spectral_radius, dissipation) of each of the paper's runs; the first is the default."""
    units: str = ""
    """"SI" puts units (s, m, J, ...) on the pictures' axes; empty leaves them plain."""
    axes: tuple[tuple[str, float, str], ...] = ()
    """(watch label, divisor, axis label) of watched quantities that pictures show as multiples of something."""
    method: tuple[str, ...] | None = None
    """Names of methods, such as ("exact",), where the scene is not usually run with the first of `methods`."""


class Scene(eqx.Module):
    """A shell with its supports and loads.

    Arguments:
        mesh, section: the shell. The section is one for all of it, or {name of an element set: section}, or a list of
            (elements, section) with numbers or names of sets: every element in one of them. None for a mesh of points
            alone (`Mesh.of_points`).
        supports, loads: sequences, possibly empty. Names of sets become the numbers that the mesh has under them.
        initial: the state at the start; None is rest.
        name: for files and pictures.
        watch: {label: (node, component)}, component out of ux, uy, uz, vx, vy, vz, or {label: (element, component)} for
            a stress or section force such as "von mises top", "sxx bottom", "s11 ply 0", "Mxx" (`jaxshell.model.gauge`
            lists them); kept at every step. The name of a set that holds one node or element may stand for it.
            {label: (name of a connector or an obstacle, component)} for what it measures, such as "force"
            (`jaxshell.model.quantities`). Or the same as (label, number, component), as a scene has it: so
            `dataclasses.replace` makes a scene that differs in a part.
        defaults: suggested time step, duration and methods (used by the command line only).
        damping: `RayleighDamping`, or None. Runs in time have it; statics and frequencies do not look at it.
        masses: `PointMass` at nodes.
        connectors: what joins nodes with each other or with points of space: springs, dashpots, joints, rigid bodies.
            The mesh of the scene has the references of rigid bodies as points: see `Mesh.with_points`.
        obstacles: what the shell touches.

    Units are the user's, consistently. Raises ValueError for loads and supports on nodes that do not
    exist, for a degree of freedom prescribed twice, for values per element or node of another length.
    """

    mesh: Mesh
    section: AnySection
    supports: tuple[Support, ...]
    loads: tuple[Load, ...]
    initial: Initial | None
    name: str = eqx.field(static=True)
    watch: tuple[tuple[str, int | str, str], ...] = eqx.field(static=True)
    defaults: Defaults | None = eqx.field(static=True)
    damping: RayleighDamping | None
    masses: tuple[PointMass, ...]
    connectors: tuple[Connector, ...]
    obstacles: tuple[Obstacle, ...]

    def __init__(
        self,
        mesh: Mesh,
        section: AnySection | Mapping[str, AnySection] | Sequence[tuple[Any, AnySection]] | None,
        supports: Sequence[Support] = (),
        loads: Sequence[Load] = (),
        initial: Initial | None = None,
        name: str = "scene",
        watch: Mapping[str, tuple[int | str, str]] | Sequence[tuple[str, int | str, str]] | None = None,
        defaults: Defaults | None = None,
        damping: RayleighDamping | None = None,
        masses: Sequence[PointMass] = (),
        connectors: Sequence[Connector] = (),
        obstacles: Sequence[Obstacle] = (),
    ):
        check_kind("mesh", mesh, Mesh, "a jaxshell.Mesh")
        if section is None and isinstance(mesh, Mesh) and not mesh.n_elements:
            section = Section(1.0, 1.0, 0.0, 1.0)  # of no element
        if isinstance(section, Mapping | list | tuple):
            section = Regions.of(mesh, section)
        check_kind("section", section, AnySection, "a section such as jaxshell.Section")
        mesh, connectors = _with_references(mesh, connectors)
        self.mesh = mesh
        self.section = cast(AnySection, section)
        self.supports = _placed("support", _objects("supports", supports, Support, "jaxshell.Support"), mesh)
        self.loads = _placed("load", _objects("loads", loads, Load, "loads such as jaxshell.NodalForce"), mesh)
        bodies = [item for item in connectors if isinstance(item, RigidBody)]
        self.initial = initial.completed(mesh, bodies) if isinstance(initial, Initial) else initial
        self.name = name
        self.defaults = defaults
        self.damping = damping
        self.masses = _placed("mass", _objects("masses", masses, PointMass, "jaxshell.PointMass"), mesh)
        self.connectors = connectors
        self.obstacles = _placed("obstacle", _objects("obstacles", obstacles, Obstacle, "jaxshell.Plane"), mesh)
        self.watch = _watched(watch, mesh, {item.name for item in self.items})

    def __check_init__(self):
        n = self.mesh.n_nodes
        check_text("A scene's name", self.name)
        check_kind("initial", self.initial, Initial | None, "a jaxshell.Initial or None")
        _check_defaults(self.defaults)
        self.section.check(self.mesh)
        check_kind("damping", self.damping, RayleighDamping | None, "a jaxshell.RayleighDamping or None")
        if self.damping is not None:
            self.damping.check(self.mesh)
        for kind, objects in (("support", self.supports), ("load", self.loads)):
            for position, item in enumerate(objects):
                nodes = getattr(item, "nodes", None)
                if nodes is not None:
                    check_on_mesh(f"{kind} {position}", "node", nodes.array, n)
        self._check_items()
        if len(self.spins) > 1:
            raise ValueError("A scene's axes spin in one way: give one Centrifugal load.")
        for label, number, component in self.watch:
            self._check_watched(f"watch {label!r}", number, component)
        if self.initial is not None:
            self.initial.check(n)
        self._check_prescribed_once()
        slanted_axes(self.supports)
        check_bodies(self.bodies, self.supports)

    def _check_items(self):
        check_names(self.items)
        kinds = {"load": self.loads, "mass": self.masses}
        kinds |= {"connector": self.connectors, "obstacle": self.obstacles}
        for kind, items in kinds.items():
            for position, item in enumerate(items):
                try:
                    item.check(self.mesh)
                    if isinstance(item, InitialStrains):
                        item.check_section(self.section, self.mesh)
                    if isinstance(item, Obstacle):
                        item.check_passing(beside_shell(self.point_masses, self.masters, self.mesh))
                        item.check_start(self.section, self.mesh, *self.start)
                except ValueError as error:
                    raise ValueError(f"{kind} {position}: {error}") from error

    @property
    def start(self) -> tuple[Any, bool]:
        """Where the nodes start (n, 3), and whether that is given."""
        moved = None if self.initial is None else self.initial.displacements
        return (self.mesh.nodes, False) if moved is None else (self.mesh.nodes + moved, True)

    def _check_watched(self, what: str, number: int | str, component):
        if isinstance(number, str):
            check_quantity(what, named(what, self.items, number), component, self.mesh.triangles)
            return
        gauge = gauge_of(component)
        if gauge is None:
            check_on_mesh(what, "node", np.array([number]), self.mesh.n_nodes)
            if not isinstance(component, str) or component not in WATCHABLE:
                raise ValueError(
                    f"{what} names {shown(component)}; choose out of {', '.join(WATCHABLE)} of a node, of an "
                    'element a stress or section force such as "von mises top", "sxx bottom", "Mxx", or of a connector '
                    f"or an obstacle, by its name, one of {', '.join(QUANTITIES)}."
                )
            return
        check_on_mesh(what, "element", np.array([number]), self.mesh.n_elements)
        check_gauge(what, gauge, self.section, self.mesh, [number])

    def _check_prescribed_once(self):
        moved = [s.dof_numbers.ravel() for s in self.supports if s.moves]
        held = [s.dof_numbers.ravel() for s in self.supports if not s.moves]
        if moved:
            numbers = np.concatenate(moved)
            both = np.intersect1d(numbers, np.concatenate([*held, np.zeros(0, int)]))
            repeated = np.concatenate([both, _repeats(numbers)])
            if repeated.size:
                node, dof = divmod(int(repeated[0]), 6)
                raise ValueError(f"Degree of freedom {DOFS[dof]} of node {node} is prescribed by two supports.")

    @property
    def items(self) -> tuple[Item, ...]:
        """What may have a name by which it is watched: connectors and obstacles."""
        return (*self.connectors, *self.obstacles)

    @property
    def contributions(self) -> tuple[Contribution, ...]:
        """What follows the motion: loads, connectors, obstacles, what loads do to point masses, in that order."""
        masses = self.point_masses if self.spins else None
        spun = () if masses is None else tuple(load.on_masses_of(masses) for load in self.spins)
        return (*(part for item in self._contributing for part in item.parts()), *spun)

    @property
    def spins(self) -> tuple[Centrifugal, ...]:
        """The loads that say that the scene's axes spin."""
        return tuple(load for load in self.loads if isinstance(load, Centrifugal))

    def contributions_of(self, item: Item) -> range:
        """Which of them are parts of an item."""
        counts = [len(other.parts()) for other in self._contributing]
        position = next(i for i, other in enumerate(self._contributing) if other is item)
        return range(sum(counts[:position]), sum(counts[: position + 1]))

    @property
    def _contributing(self) -> tuple[Contribution | Item, ...]:
        return (*(load for load in self.loads if isinstance(load, Contribution)), *self.items)

    @property
    def histories(self) -> list[History]:
        """Of everything that varies in time."""
        stated = (*self.loads, *self.supports, *self.items)
        return [history for item in stated if (history := getattr(item, "history", None)) is not None]

    @property
    def initial_strains(self) -> tuple[InitialStrains, ...]:
        """What changes the stress-free state, in the order of the loads."""
        return tuple(load for load in self.loads if isinstance(load, InitialStrains))

    @property
    def bodies(self) -> tuple[RigidBody, ...]:
        """The connectors that are rigid bodies."""
        return tuple(item for item in self.connectors if isinstance(item, RigidBody))

    @property
    def point_masses(self) -> Masses | None:
        """The masses at nodes, those of rigid bodies among them; None where there are none."""
        items = (*self.masses, *self.bodies)
        if not items:
            return None
        nodes = [item.nodes.array for item in self.masses] + [np.array([body.master]) for body in self.bodies]
        mass = [jnp.broadcast_to(item.mass, (len(n),)) for item, n in zip(items, nodes, strict=True)]
        turning = [(i.inertia, n) for i, n in zip(items, nodes, strict=True) if i.inertia is not None]
        tensors = [jnp.broadcast_to(inertia, (len(n), 3, 3)) for inertia, n in turning]
        return Masses(
            Frozen(np.concatenate(nodes)),
            jnp.concatenate(mass),
            Frozen(np.concatenate([np.zeros(0, int), *(n for _, n in turning)])),
            jnp.concatenate([jnp.zeros((0, 3, 3)), *tensors]),
        )

    @property
    def masters(self) -> Frozen | None:
        """(n,) the node that each node follows: itself, or the reference of its rigid body; None without bodies."""
        if not self.bodies:
            return None
        masters = np.arange(self.mesh.n_nodes)
        for body in self.bodies:
            masters[body.followers] = body.master
        return Frozen(masters)

    @property
    def turned(self) -> Frozen | None:
        """The nodes with axes of their own, and the nodes of rigid bodies whose references have some; None without."""
        nodes, _ = self._slanted
        return Frozen(nodes) if nodes.size else None

    @property
    def axes(self) -> Float[jax.Array, "s 3 3"]:
        """Theirs, as columns."""
        return self._slanted[1]

    @property
    def _slanted(self) -> tuple[np.ndarray, Float[jax.Array, "s 3 3"]]:
        nodes, axes = slanted_axes(self.supports)
        if not nodes.size or self.masters is None:
            return nodes, axes
        masters = self.masters.array
        every = np.flatnonzero(np.isin(masters, nodes))
        return every, axes[np.searchsorted(nodes, masters[every])]

    @property
    def held_dofs(self) -> np.ndarray:
        """Sorted numbers 6·node + dof of all degrees of freedom that supports hold or move."""
        numbers = [support.dof_numbers.ravel() for support in self.supports]
        if self.mesh.points:
            numbers.append(self._rotations_of_points)
        return np.unique(np.concatenate(numbers)) if numbers else np.zeros(0, np.int64)

    @property
    def _rotations_of_points(self) -> np.ndarray:
        """Rotations of points at which nothing looks: they have no stiffness and no inertia, and are held."""
        turning = [item.turning for item in self.connectors]
        turning += [item.nodes.array for item in self.masses if item.inertia is not None]
        points = np.arange(self.mesh.n_nodes - self.mesh.points, self.mesh.n_nodes)
        points = np.setdiff1d(points, np.concatenate([*turning, np.zeros(0, int)]))
        return (6 * points[:, None] + np.arange(3, 6)).ravel()

    @property
    def held(self) -> Frozen:
        return Frozen(self.held_dofs)


def _objects(name: str, value, kind: type, public: str) -> tuple[Any, ...]:
    """One object or a sequence of them as a tuple. Raises ValueError for any that is no `kind`."""
    if isinstance(value, kind):
        return (value,)
    if not isinstance(value, list | tuple):
        raise ValueError(f"{name} must be a list of {public}, but it is {shown(value)}.")
    for position, item in enumerate(value):
        check_kind(f"{name}[{position}]", item, kind, f"one of {public}")
    return tuple(value)


def _with_references(mesh: Mesh, connectors) -> tuple[Mesh, tuple[Connector, ...]]:
    """The mesh with the references of rigid bodies as points, and the connectors with their numbers."""
    found = []
    for item in _objects("connectors", connectors, Connector, "connectors such as jaxshell.Spring"):
        try:
            item, mesh = item.placed(mesh, len(found))
        except ValueError as error:
            raise ValueError(f"connector {len(found)}: {error}") from error
        found.append(item)
    return mesh, tuple(found)


def _placed(what: str, items: tuple[Any, ...], mesh: Mesh) -> tuple[Any, ...]:
    """The items with numbers in place of names of sets. Raises ValueError naming the item whose set there is not."""
    found = []
    for position, item in enumerate(items):
        try:
            found.append(item.on(mesh))
        except ValueError as error:
            raise ValueError(f"{what} {position}: {error}") from error
    return tuple(found)


def _watched(watch, mesh: Mesh, names: set[str | None]) -> tuple[tuple[str, int | str, str], ...]:
    """What is watched, as a scene keeps it; `names` are those of connectors and obstacles.

    Raises ValueError for anything but labels, nodes and components.
    """
    if watch is None:
        return ()
    if isinstance(watch, Mapping):
        watch = [(label, *what) if isinstance(what, list | tuple) else what for label, what in watch.items()]
    if not isinstance(watch, list | tuple):
        raise ValueError(f"watch must be {{label: (node, component)}}, but it is {shown(watch)}.")
    found = []
    for entry in watch:
        if not isinstance(entry, list | tuple) or len(entry) != 3:
            raise ValueError(f"watch must be {{label: (node, component)}}, but an entry of it is {shown(entry)}.")
        label, node, component = entry
        if not isinstance(label, str):
            raise ValueError(f"A watch label must be text, but it is {shown(label)}.")
        of_item = isinstance(component, str) and component not in WATCHABLE and gauge_of(component) is None
        if isinstance(node, str) and of_item and (node in names or component in QUANTITIES):
            found.append((label, node, component))
            continue
        if isinstance(node, str):
            chosen = mesh.node_set if gauge_of(component) is None else mesh.element_set
            node = _only_one(f"watch {label!r}", node, chosen)
        if isinstance(node, bool) or not isinstance(node, int | np.integer):
            raise ValueError(f"watch {label!r} names node {shown(node)}, which is no whole number.")
        found.append((label, int(node), component))
    if len({label for label, _, _ in found}) < len(found):
        raise ValueError(f"watch uses a label twice: {', '.join(label for label, _, _ in found)}.")
    return tuple(found)


def _only_one(what: str, name: str, chosen: Callable[[str], np.ndarray]) -> int:
    """The number in a set. Raises ValueError for a set that there is not, and for one that holds more."""
    try:
        numbers = chosen(name)
    except ValueError as error:
        raise ValueError(f"{what}: {error}") from error
    if len(numbers) > 1:
        raise ValueError(f"{what} names the set {name!r}, which holds {len(numbers)}; one is watched at a time.")
    return int(numbers[0])


def _check_defaults(defaults) -> None:
    if defaults is None:
        return
    check_kind("defaults", defaults, Defaults, "a jaxshell.Defaults or None")
    for name in ("dt", "t_end"):
        if getattr(defaults, name) is not None:
            check_positive_number(name, getattr(defaults, name))
    check_count("save_every", defaults.save_every)
    check_choice("units", defaults.units, ("", "SI"))
    for name in ("picture_times", "methods", "axes", "method"):
        if not isinstance(getattr(defaults, name), tuple) and (name, defaults.method) != ("method", None):
            raise ValueError(f"defaults.{name} must be a tuple, but it is {shown(getattr(defaults, name))}.")
    for time in defaults.picture_times:
        check_number("picture_times", time)


def _repeats(numbers: np.ndarray) -> np.ndarray:
    values, count = np.unique(numbers, return_counts=True)
    return values[count > 1]
