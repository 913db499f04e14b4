"""Strains and curvatures of one deformed element, from which its section forces and stresses follow."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.elements import corotational
from jaxshell.elements.element import Element, strain_matrices

CORNERS_OF_MIDPOINTS = ((1.0, -1.0, 1.0), (1.0, 1.0, -1.0), (-1.0, 1.0, 1.0))
"""Rows: a linear field at the corners 1, 2, 3 from its values at the mid-edges 12, 23, 31."""


def section_strains(
    x0: Float[Array, "3 3"], d: Float[Array, "3 3"], R: Float[Array, "3 3 3"], element: Element
) -> Float[Array, "3 6"]:
    """(εxx, εyy, γxy, κxx, κyy, 2κxy) at the mid-edges 12, 23, 31, in the element's axes, from the shape x0.

    Corners are seen from node 1, as edges and differences of the displacements d: positions x0 + d would round d off
    (`jaxshell.methods.static`). With the strains of initial strains, or without where `element.rest` states them.
    """
    x = (x0 - x0[:1]) + (d - d[:1])
    e = corotational.kinematics(x, R, element).deformations
    membrane, bending = strain_matrices(element)
    strains = membrane @ e[: membrane.shape[2]]
    if element.shape is not None:
        strains = strains + e[12:]
    return jnp.concatenate([strains, bending @ e[6:12]], axis=1)
