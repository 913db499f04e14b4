"""One element: what it needs of its stress-free shape and section. Its deformations are those of `corotational`."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.elements.bending import bending_stiffness, bending_strains
from jaxshell.elements.membrane import membrane_stiffness, membrane_strains
from jaxshell.elements.shape import Relief, Shape, Tangents, tangent_slopes
from jaxshell.model.sections import Resultants
from jaxshell.numerics.triangles import local_frame

# Rows of the 9×9 membrane (u, v, θz per node) and bending (w, θx, θy per node) stiffness that are kept.
_MEMBRANE_KEPT = np.array([3, 6, 7, 2, 5, 8])


_BENDING_KEPT = np.array([1, 2, 4, 5, 7, 8])


class Element(eqx.Module):
    """What one element needs of its stress-free shape and section."""

    coordinates: Float[Array, "3"]
    """l⁰, b̄x⁰, b̄y⁰ [length]."""
    frame: Float[Array, "3 3"]
    """T_GE0: rows e1⁰, e2⁰, e3⁰."""
    K_membrane: Float[Array, "6 6"]
    K_bending: Float[Array, "6 6"]
    area: Float[Array, ""]
    section: Resultants
    """What it was built from, in its own axes."""
    K_coupling: Float[Array, "6 6"] | None = None
    """Of a section that couples membrane (rows) and bending (columns); else None."""
    rest: Float[Array, "12"] | None = None
    """The deformations at which it is free of stress, where initial strains act; else None."""
    shape: Shape | None = None
    """The curvature of its surface; None where it has none."""
    relief: Relief | None = None
    """Of its higher-order membrane strains; None where there is none."""
    mass: Float[Array, "12 12"] | None = None
    """Of `jaxshell.elements.cubic_inertia`, where a method asks for it."""

    @classmethod
    def build(cls, x0: Float[Array, "3 3"], section: Resultants, tangents: Tangents | None = None) -> "Element":
        """From nodal positions x0 of the stress-free shape and the section's resultants.

        `tangents` are of the surface that the element stands for; with None the triangle is the surface.
        """
        frame, coordinates = local_frame(x0)
        xy = corners(coordinates)
        stretched = membrane_stiffness(xy, section.A, section.beta0)[_MEMBRANE_KEPT][:, _MEMBRANE_KEPT]
        bent = bending_stiffness(xy, section.D)[_BENDING_KEPT][:, _BENDING_KEPT]
        area = 0.5 * coordinates[0] * coordinates[2]
        element = cls(coordinates, frame, stretched, bent, area, section)
        if section.B is None and tangents is None:
            return element
        element = element.shaped(tangents)
        membrane, bending = strain_matrices(element)
        if element.relief is not None:  # which makes the membrane's strains depend on the bending deformations too
            across = jnp.sum(jnp.swapaxes(membrane, 1, 2) @ section.A @ membrane, axis=0)
            stretched, bent = area / 3.0 * across[:6, :6], bent + area / 3.0 * across[6:, 6:]
            coupling = area / 3.0 * across[:6, 6:]
        else:
            coupling = jnp.zeros((6, 6))
        if section.B is not None:
            mixed = area / 3.0 * jnp.sum(jnp.swapaxes(membrane, 1, 2) @ section.B @ bending, axis=0)
            coupling = coupling + mixed[:6]
            if element.relief is not None:
                bent = bent + mixed[6:] + mixed[6:].T
        shape = element.shape
        if shape is not None:
            means = jnp.mean(membrane, axis=0), jnp.mean(bending, axis=0)
            shape = shape.stiffened(area, section.A, means[0][:, :6], section.B, means[1])
        return eqx.tree_at(
            lambda e: (e.K_membrane, e.K_bending, e.K_coupling, e.shape),
            element,
            (stretched, bent, None if section.B is None and element.relief is None else coupling, shape),
            is_leaf=lambda leaf: leaf is None,
        )

    def shaped(self, tangents: Tangents | None) -> "Element":
        """The same with what its strains need of the surface that it stands for."""
        if tangents is None:
            return self
        xy, slopes = corners(self.coordinates), tangent_slopes(self.frame, tangents.normals)
        shape = None if tangents.curved is None else Shape.build(xy, slopes, tangents.curved)
        relief = None
        if tangents.relaxed is not None:
            thickness = jnp.sqrt(12.0 * jnp.trace(self.section.D) / jnp.trace(self.section.A))
            relief = Relief.build(xy, slopes, thickness, tangents.relaxed)
        return eqx.tree_at(lambda e: (e.shape, e.relief), self, (shape, relief), is_leaf=lambda leaf: leaf is None)

    def resting_at(self, rest: Float[Array, "*m 12"]) -> "Element":
        """The same with other deformations at which it is free of stress."""
        return eqx.tree_at(lambda element: element.rest, self, rest, is_leaf=lambda leaf: leaf is None)

    @property
    def mass_per_area(self) -> Float[Array, "*m"]:
        """M_ρ = ρh, eq. (30)."""
        return self.section.mass_per_area

    @property
    def first_moment(self) -> Float[Array, "*m"] | None:
        """∫ρ z dz, which couples translation and director; None where it vanishes."""
        return self.section.first_moment

    @property
    def rotary_inertia(self) -> Float[Array, "*m"]:
        """ρh³/12, the two equal entries of I_ρ⁰, eq. (32)."""
        return self.section.rotary_inertia


def corners(coordinates: Float[Array, "3"]) -> Float[Array, "3 2"]:
    """The corners in the element's plane, from l, b̄x, b̄y."""
    length, bx, by = coordinates
    zero = jnp.zeros_like(length)
    return jnp.stack([zero, zero, length, zero, bx, by]).reshape(3, 2)


def strain_matrices(element: Element) -> tuple[Float[Array, "3 3 d"], Float[Array, "3 3 6"]]:
    """Membrane strains and curvatures at mid-edges 12, 23, 31, linear in the deformations.

    The curvatures follow from the last six deformations, and the membrane strains from the first six, of a relaxed
    element from all twelve. Those of a curved element have w̄ besides.
    """
    xy = corners(element.coordinates)
    membrane = membrane_strains(xy, element.section.beta0)[:, :, _MEMBRANE_KEPT]
    bending = bending_strains(xy)[:, :, _BENDING_KEPT]
    if element.relief is None:
        return membrane, bending
    mean = jnp.mean(membrane, axis=0)
    higher = element.relief.factor * (membrane - mean)
    return jnp.concatenate([mean + higher, higher[:, :, 3:] @ element.relief.drill], axis=2), bending


def constant_strains(
    coordinates: Float[Array, "3"], strain: Float[Array, "3"], curvature: Float[Array, "3"]
) -> Float[Array, "12"]:
    """The deformations e of an element with the strain (εxx, εyy, γxy) and the curvature (κxx, κyy, 2κxy) everywhere.

    The frame follows edge 1-2 and the three nodes: u = εxx x + γ y, v = εyy y, and θ̄z = -γ/2; the deflection
    w = -½ (κxx x² + κyy y² + 2κxy xy) less the plane through the nodes, θ̄x = w,y, θ̄y = -w,x.
    """
    length, bx, by = coordinates
    exx, eyy, shear = strain
    kxx, kyy, twist = curvature
    metric = jnp.stack([exx * length, exx * bx + shear * by, eyy * by])
    drilling = jnp.broadcast_to(-0.5 * shear, (3,))

    def deflection(x, y):
        return -0.5 * (kxx * x * x + kyy * y * y + twist * x * y)

    along = deflection(length, 0.0) / length
    across = (deflection(bx, by) - along * bx) / by
    x, y = corners(coordinates).T
    tilts = jnp.stack([-(kyy * y + 0.5 * twist * x) - across, kxx * x + 0.5 * twist * y + along], axis=1)
    return jnp.concatenate([metric, drilling, tilts.reshape(6)])
