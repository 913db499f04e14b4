"""Initial strains: a shell whose own stress-free state changes, by heat or by how it was made.

An element's stresses are K̂ (e - e⁰), with e⁰ the deformations at which it is free of stress: those of the strain ε⁰ and
the curvature κ⁰ that an element alone would take. They are no forces: what they do to the shell is in its strain
energy ½(e - e⁰)ᵀ K̂ (e - e⁰), which vanishes where every element has its own. Linear and angular momentum are left
alone. While e⁰ changes in time, the work -Δe⁰·f, f the stresses, is done on the shell; it is counted as external work.
"""

import abc
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.model.history import History
from jaxshell.model.loads.base import Load, given_history, number_of_elements
from jaxshell.model.materials.base import strain_rotation
from jaxshell.model.mesh import Mesh
from jaxshell.model.sections import AnySection, Layers
from jaxshell.model.sections.direction import angles, check_direction, given_direction
from jaxshell.model.sets import SetName, elements_or_name
from jaxshell.numerics.checks import check_finite, check_one_or_each, float_array
from jaxshell.numerics.frozen import Frozen

_UNKNOWN = "Thermal needs a section that knows its expansion; GeneralSection has thermal= for it."


class InitialStrains(Load):
    """What gives every element a strain and a curvature at which it is free of stress, times a history."""

    acts_on: ClassVar[str] = "shell"
    sets: ClassVar[dict[str, str]] = {"elements": "element"}

    elements: eqx.AbstractVar[Frozen | SetName | None]

    def _on_all(self, values: Float[Array, "*m c"], mesh: Mesh) -> Float[Array, "m c"]:
        """Values of the elements that are meant, one or one for each, as those of all: zero at the others."""
        if self.elements is None:
            return jnp.broadcast_to(values, (mesh.n_elements, values.shape[-1]))
        return jnp.zeros((mesh.n_elements, values.shape[-1])).at[self.elements.array].set(values)

    def check_section(self, section: AnySection, mesh: Mesh) -> None:
        """Raise ValueError where it has nothing to act on in the section."""

    @abc.abstractmethod
    def strains(self, section: AnySection, mesh: Mesh) -> tuple[Float[Array, "m 3"], Float[Array, "m 3"]]:
        """(εxx, εyy, γxy) and (κxx, κyy, 2κxy) of every element alone, in its own axes, for factor 1."""

    @abc.abstractmethod
    def in_layers(self, mesh: Mesh, layers: Layers, z: Float[Array, "m p"]) -> Float[Array, "m p 3"]:
        """The strains at which the material at a height z of every layer is free of stress, in the elements' axes, for
        factor 1."""


class InitialStrain(InitialStrains):
    """A strain and a curvature that the sheet was made with: prestretch, or a strip that was formed to a radius.

    Arguments:
        strain: (εxx, εyy, γxy) of the free sheet against the mesh, (3,) or (m, 3) one per element.
        curvature: (κxx, κyy, 2κxy) likewise [1/length]; a fibre at z along the normal is strained by z κ. A free strip
            with κxx alone becomes a circle of radius 1/κxx about the side against which the normals point.
        history: factor in time; None is 1 from the start.
        direction: the axis x of the components, as in `jaxshell.Laminate`.
        elements: numbers of the elements that have it, or the name of a set; None is all. Values are then one, or one
            for each of them.

    All floats differentiate. Raises ValueError for other shapes, NaN, and a direction normal to an element.
    """

    kind: ClassVar[str] = "initial strain"
    value: ClassVar[str] = "strain"

    strain: Float[jax.Array, "*m 3"]
    curvature: Float[jax.Array, "*m 3"]
    history: History
    direction: Any
    elements: Frozen | SetName | None = eqx.field(static=True)

    def __init__(
        self,
        strain=(0.0, 0.0, 0.0),
        curvature=(0.0, 0.0, 0.0),
        history: History | None = None,
        direction=(1.0, 0.0, 0.0),
        elements=None,
    ):
        self.strain, self.curvature = float_array(strain, "strain"), float_array(curvature, "curvature")
        self.history = given_history(history)
        self.direction = given_direction(direction)
        self.elements = elements_or_name(elements)

    def __check_init__(self):
        for name in ("strain", "curvature"):
            value = getattr(self, name)
            if value.ndim not in (1, 2) or value.shape[-1] != 3:
                raise ValueError(f"{name} must have shape (3,) or (m, 3), but it has shape {value.shape}.")
            check_finite(name, value)

    def check(self, mesh: Mesh) -> None:
        count = number_of_elements(self.elements, mesh)
        for name in ("strain", "curvature"):
            value = getattr(self, name)
            if value.shape not in ((3,), (count, 3)):
                raise ValueError(f"{name} must be one (3,) or {count} of them, but it has shape {value.shape}.")
        check_direction(self.direction, mesh)

    def strains(self, section: AnySection | None, mesh: Mesh):
        turn = jax.vmap(strain_rotation)(-angles(self.direction, mesh))
        return tuple(
            jnp.einsum("mij,mj->mi", turn, self._on_all(value, mesh)) for value in (self.strain, self.curvature)
        )

    def in_layers(self, mesh: Mesh, layers: Layers, z: Float[Array, "m p"]) -> Float[Array, "m p 3"]:
        strain, curvature = self.strains(None, mesh)
        return strain[:, None] + z[:, :, None] * curvature[:, None]


class Thermal(InitialStrains):
    """A temperature above that at which the shell is free of stress: T + g z, with the materials' expansion.

    Arguments:
        temperature: T on the surface of the nodes, one value or (m,) one per element [temperature].
        gradient: g through the thickness, along the normals, likewise [temperature/length].
        history: factor in time; None is 1 from the start.
        elements: numbers of the elements that are heated, or the name of a set; None is all.

    Differentiable in all floats. Raises ValueError for a section that does not know its expansion.
    """

    kind: ClassVar[str] = "thermal"
    value: ClassVar[str] = "temperature"

    temperature: Float[jax.Array, "*m"]
    gradient: Float[jax.Array, "*m"]
    history: History
    elements: Frozen | SetName | None = eqx.field(static=True)

    def __init__(self, temperature, gradient=0.0, history: History | None = None, elements=None):
        self.temperature, self.gradient = float_array(temperature, "temperature"), float_array(gradient, "gradient")
        self.history = given_history(history)
        self.elements = elements_or_name(elements)

    def __check_init__(self):
        for name in ("temperature", "gradient"):
            check_one_or_each(name, getattr(self, name))
            check_finite(name, getattr(self, name))

    def check(self, mesh: Mesh) -> None:
        self._each(mesh)

    def check_section(self, section: AnySection, mesh: Mesh) -> None:
        expands = section.expands(mesh)
        if expands is None:
            raise ValueError(_UNKNOWN)
        if not expands:
            raise ValueError("Thermal needs a material with an expansion, but that of all of them is zero.")

    def strains(self, section: AnySection, mesh: Mesh):
        thermal = _thermal_resultants(section, mesh)
        T, g = self._each(mesh)
        N = T[:, None] * thermal[:, 0] + g[:, None] * thermal[:, 1]
        M = T[:, None] * thermal[:, 1] + g[:, None] * thermal[:, 2]
        resultants = section.resultants(mesh)
        if resultants.B is None:
            return _solved(resultants.A, N), _solved(resultants.D, M)
        both = _solved(resultants.matrix, jnp.concatenate([N, M], axis=1))
        return both[:, :3], both[:, 3:]

    def in_layers(self, mesh: Mesh, layers: Layers, z: Float[Array, "m p"]) -> Float[Array, "m p 3"]:
        T, g = self._each(mesh)
        return (T[:, None] + g[:, None] * z)[:, :, None] * layers.expansion

    def _each(self, mesh: Mesh) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
        count, found = number_of_elements(self.elements, mesh), []
        for name in ("temperature", "gradient"):
            value = getattr(self, name)
            if value.shape not in ((), (count,)):
                raise ValueError(f"{name} must be one value or {count}, but it has shape {value.shape}.")
            found.append(self._on_all(value[..., None], mesh)[:, 0])
        return found[0], found[1]


def _thermal_resultants(section: AnySection, mesh: Mesh) -> Float[Array, "m 3 3"]:
    found = section.thermal_resultants(mesh)
    if found is None:
        raise ValueError(_UNKNOWN)
    return found


def _solved(matrices: Float[Array, "m k k"], right: Float[Array, "m k"]) -> Float[Array, "m k"]:
    """Solutions of small systems whose rows may have different units."""
    scale = 1.0 / jnp.sqrt(jnp.diagonal(matrices, axis1=1, axis2=2))
    posed = scale[:, :, None] * matrices * scale[:, None, :]
    return scale * jnp.linalg.solve(posed, (scale * right)[:, :, None])[:, :, 0]
