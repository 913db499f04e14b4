"""The laminate: plies on each other, each with its material, thickness and angle."""

from collections.abc import Sequence
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.materials import Material
from jaxshell.model.materials.base import rotated, strain_rotation
from jaxshell.model.mesh import Mesh
from jaxshell.model.sections.base import (
    SHAPES,
    AnySection,
    Layers,
    Patch,
    Resultants,
    check_bearable,
    given_shape,
    off_centre,
    optimal_beta0,
)
from jaxshell.model.sections.direction import angles, check_direction, given_direction
from jaxshell.model.sections.layup import read_layup
from jaxshell.model.sections.ply import Ply
from jaxshell.numerics.checks import (
    check_finite,
    check_for_each,
    check_kind,
    check_one_or_each,
    check_positive,
    check_shape,
    check_switch,
    float_array,
    for_each,
    is_concrete,
    shown,
)


class Laminate(AnySection):
    """Classical laminate theory: plies that are bonded, normals that stay straight.

    Arguments:
        plies: `Ply`s from the bottom up, which is the direction of the elements' normals. `Laminate.from_layup` reads
            them from text.
        direction: from where the plies' angles are counted: a vector (3,), one for each element (m, 3), or a
            `jaxshell.Cylindrical`; projected onto the elements.
        offset: z of the laminate's middle surface, from the surface of the nodes along the normals [length].
        symmetric: the plies are the lower half, and the upper one mirrors them. Then membrane and bending do not
            couple, and no coupling is compiled; a list of all plies that is symmetric by its numbers has B = 0 by them.
        shape: "flat" for the triangles as they are, the paper's element. "curved" and "relaxed" for elements that stand
            for a smooth surface through the nodes: the one nearer where the mesh resolves the waves of the shell, as in
            dynamics; the other where a thin shell on a coarse mesh bends almost without stretching (docs/accuracy.md).

    A, B, D = Σ_k Q̄_k ∫ (1, z, z²) dz. Differentiable in every float. Source: R. M. Jones, Mechanics of Composite
    Materials (1999), chapter 4.

    Raises ValueError for no plies, for values of another length, for a direction normal to an element, naming it.
    """

    kind: ClassVar[str] = "laminate"

    plies: tuple[Ply, ...]
    direction: object
    offset: Float[jax.Array, ""] | None
    symmetric: bool = eqx.field(static=True)
    shape: str = eqx.field(static=True)

    def __init__(
        self,
        plies: Sequence[Ply],
        direction=(1.0, 0.0, 0.0),
        offset=0.0,
        symmetric: bool = False,
        shape: str = "flat",
    ):
        if isinstance(plies, Ply):
            plies = [plies]
        if not isinstance(plies, list | tuple) or not plies:
            raise ValueError(f"plies must be a list of jaxshell.Ply, at least one, but it is {shown(plies)}.")
        for position, ply in enumerate(plies):
            check_kind(f"plies[{position}]", ply, Ply, "a jaxshell.Ply")
        check_switch("symmetric", symmetric)
        self.plies = tuple(plies)
        self.direction = given_direction(direction)
        # The plain number 0 leaves the offset out of the compiled program.
        none = offset is None or (isinstance(offset, int | float) and not isinstance(offset, bool) and offset == 0)
        self.offset = None if none else float_array(offset, "offset")
        self.symmetric = symmetric
        self.shape = given_shape(shape)

    def __check_init__(self):
        if self.offset is not None:
            check_shape("offset", self.offset, ())
            check_finite("offset", self.offset)

    @classmethod
    def from_layup(
        cls,
        layup: str,
        material: Material,
        ply_thickness,
        direction=(1.0, 0.0, 0.0),
        offset=0.0,
        shape: str = "flat",
    ) -> "Laminate":
        """Plies of one material and thickness [length] with the angles of a text such as "[45/-45/0/90]s".

        `jaxshell.model.sections.layup.read_layup` says what may stand in the text. Of one that ends in s the plies
        of the lower half are kept, and the others mirror them.
        """
        angles, symmetric = read_layup(layup)
        thickness = float_array(ply_thickness, "ply_thickness")
        check_one_or_each("ply_thickness", thickness)
        check_positive("ply_thickness", thickness)
        return cls([Ply(material, thickness, angle) for angle in angles], direction, offset, symmetric, shape)

    @property
    def all_plies(self) -> tuple[Ply, ...]:
        """From the bottom to the top, with those that mirror others."""
        return self.plies + self.plies[::-1] if self.symmetric else self.plies

    @property
    def thickness(self) -> Float[Array, "*m"]:
        """Of all plies together [length]."""
        return sum((ply.thickness for ply in self.all_plies), jnp.zeros(()))

    def direction_angles(self, mesh: Mesh | Patch) -> Float[Array, " m"]:
        return angles(self.direction, mesh)

    def layers(self, mesh: Mesh | Patch) -> Layers:
        plies = self.all_plies
        thickness = self._each("thickness", mesh.n_elements)
        angle = self.direction_angles(mesh)[:, None] + jnp.deg2rad(self._each("angle", mesh.n_elements))
        top = jnp.cumsum(thickness, axis=1) - 0.5 * jnp.sum(thickness, axis=1, keepdims=True)
        if self.offset is not None:
            top = top + self.offset
        Q = jnp.stack([ply.material.stiffness() for ply in plies])
        free = jnp.stack([jnp.append(ply.material.expansions(), 0.0) for ply in plies])
        density = jnp.stack([ply.material.density for ply in plies])

        def turned(Q, free, angle):  # of one layer
            return rotated(Q, angle), strain_rotation(-angle) @ free

        C, expansion = jax.vmap(jax.vmap(turned), (None, None, 0))(Q, free, angle)
        return Layers(
            z=jnp.stack([top - thickness, top], axis=-1),
            C=C,
            angle=angle,
            expansion=expansion,
            density=jnp.broadcast_to(density, angle.shape),
        )

    def resultants(self, mesh: Mesh | Patch) -> Resultants:
        layers = self.layers(mesh)
        A, B, D = (layers.integral(layers.C, power) for power in range(3))
        mass, first, second = (layers.integral(layers.density, power) for power in range(3))
        even = self.symmetric and self.offset is None
        return Resultants(
            A=A,
            D=D,
            mass_per_area=mass,
            rotary_inertia=second,
            beta0=jax.vmap(optimal_beta0)(A),
            B=None if even else B,
            first_moment=None if even else first,
        )

    def shapes(self, mesh: Mesh | Patch) -> np.ndarray:
        return np.full(mesh.n_elements, SHAPES.index(self.shape))

    def check(self, mesh: Mesh | Patch) -> None:
        for position, ply in enumerate(self.plies):
            for name in ("thickness", "angle"):
                check_for_each(f"ply {position}: {name}", getattr(ply, name), mesh.n_elements)
        check_direction(self.direction, mesh)
        if self._is_known:
            bottom, top, density = self._heights_and_densities()
            stiffness = np.array([np.trace(np.asarray(ply.material.stiffness())) for ply in self.all_plies])
            with np.errstate(all="ignore"):
                cubes = (top**3 - bottom**3) / 3
                check_bearable("bending stiffness tr D", np.sum(stiffness * cubes, axis=1))
                check_bearable("rotary inertia ∫ρ z² dz", np.sum(density * cubes, axis=1))

    def has_first_moment(self, mesh: Mesh | Patch) -> bool:
        if not self._is_known:
            return False
        bottom, top, density = self._heights_and_densities()
        moments = [np.sum(density * (top**k - bottom**k) / k, axis=1) for k in (1, 2, 3)]
        return off_centre(moments[1], moments[0], moments[2])

    def expands(self, mesh: Mesh | Patch) -> bool:
        expansions = [ply.material.expansions() for ply in self.plies]
        return any(not is_concrete(strains) or bool(np.any(np.asarray(strains))) for strains in expansions)

    @property
    def _is_known(self) -> bool:
        return all(map(is_concrete, jax.tree.leaves((self.plies, self.offset))))

    def _heights_and_densities(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bottom and top z (1 or m, p) and densities (p,) of all plies, of known values; no program is compiled."""
        plies = self.all_plies
        columns = np.broadcast_arrays(*(np.atleast_1d(np.asarray(ply.thickness)) for ply in plies))
        thickness = np.stack(columns, axis=1)
        middle = 0.0 if self.offset is None else float(self.offset)
        top = np.cumsum(thickness, axis=1) - 0.5 * np.sum(thickness, axis=1, keepdims=True) + middle
        return top - thickness, top, np.array([float(ply.material.density) for ply in plies])

    def _each(self, name: str, n_elements: int) -> Float[Array, "m p"]:
        """Thicknesses or angles of all plies in every element."""
        columns = [
            for_each(f"ply {position}: {name}", getattr(ply, name), n_elements)
            for position, ply in enumerate(self.all_plies)
        ]
        return jnp.stack(columns, axis=1)
