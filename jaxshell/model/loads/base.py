"""What every load offers: its value, its history, and how scene files write it."""

import abc
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.model.contribution import Contribution
from jaxshell.model.history import History
from jaxshell.model.mesh import Mesh
from jaxshell.model.sets import OfSets, SetName, check_on_mesh, elements_or_name
from jaxshell.numerics.checks import check_finite, check_kind, check_one_or_each, check_shape, float_array
from jaxshell.numerics.frozen import Frozen


class Load(OfSets):
    """A load of a scene, scaled by its history: a `DeadLoad`, or a `Contribution` that follows the motion."""

    kind: ClassVar[str]
    """Its name in scene files."""
    value: ClassVar[str]
    """The field, and the key in scene files, that holds its full value."""
    acts_on: ClassVar[str] = "nodes"
    """What scene files choose for it: "nodes", "edges", or "shell" for all of it."""
    in_time: ClassVar[bool] = True
    """Whether runs in time can have it."""

    history: eqx.AbstractVar[History]

    def check(self, mesh: Mesh) -> None:
        """Raise ValueError where the load does not fit the mesh; called when the scene is made."""

    def for_statics(self) -> "Load":
        """The load with what varies in time besides `history` as it is in the end: there the load factor scales it."""
        return self


class DeadLoad(Load):
    """A load whose nodal forces and moments keep their direction and size, but for the history."""

    @abc.abstractmethod
    def nodal(self, x0, triangles, mass_per_area) -> Float[Array, "n 6"]:
        """(n, 6) force and moment on each node for factor 1.

        `x0` (n, 3) are the nodes of the stress-free shape, `triangles` (m, 3), `mass_per_area` (m,).
        """

    def on_masses(self, mass: Float[Array, " k"]) -> Float[Array, "k 3"] | None:
        """Forces on point masses for factor 1; None where it does not act on them."""
        return None

    def on_bending(self) -> Contribution | None:
        """What it adds where masses follow the rotations of the nodes; None of what does not act on masses."""
        return None


class OnElements(Load):
    """A pressure on elements: one value, or one for each of those that it acts on."""

    value: ClassVar[str] = "pressure"
    acts_on: ClassVar[str] = "shell"
    sets: ClassVar[dict[str, str]] = {"elements": "element"}

    pressure: Float[jax.Array, "*m"]
    history: History
    elements: Frozen | SetName | None = eqx.field(static=True)

    def __init__(self, pressure, history: History | None = None, elements=None):
        self.pressure = float_array(pressure, self.kind)
        self.history = given_history(history)
        self.elements = elements_or_name(elements)

    def __check_init__(self):
        check_one_or_each(self.kind, self.pressure)
        check_finite(self.kind, self.pressure)

    def check(self, mesh: Mesh) -> None:
        count = number_of_elements(self.elements, mesh)
        if self.pressure.shape not in ((), (count,)):
            raise ValueError(f"{self.kind} must be one value or {count}, but has shape {self.pressure.shape}.")


def given_history(history: History | None) -> History:
    """`history`, or a constant one. Raises ValueError for anything else."""
    if history is None:
        return History.constant()
    check_kind("history", history, History, "a jaxshell.History or None")
    return history


def check_vectors(name: str, value: Any, count: int | None) -> None:
    """Raise ValueError unless `value` is one finite vector (3,) or one for each of `count`, where that is known."""
    check_finite(name, value)
    if count is None:
        check_shape(name, value, (3,) if value.ndim < 2 else (None, 3))
    elif value.shape not in ((3,), (count, 3)):
        raise ValueError(f"{name} must have shape (3,) or ({count}, 3), but it has shape {value.shape}.")


def number_of_elements(elements: Frozen | SetName | None, mesh: Mesh) -> int:
    """How many elements of the mesh are meant; None is all. Raises ValueError for one that the mesh does not have."""
    if elements is None:
        return mesh.n_elements
    check_on_mesh("elements", "element", elements.array, mesh.n_elements)
    return len(elements.array)


def on_corners(share: Float[Array, "k 3"], triangles, n_nodes: int) -> Float[Array, "n 6"]:
    """The same force on all three corners of each of k elements, as forces and moments on all nodes."""
    forces = jnp.zeros((n_nodes, 6))
    for corner in range(3):
        forces = forces.at[triangles[:, corner], :3].add(share)
    return forces


def chosen(elements: Frozen | SetName | None, values):
    """Of an array with one row for each element of the mesh the rows of those that are meant; None is all."""
    return values if elements is None else values[elements.array]
