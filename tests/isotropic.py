"""Elements and their two plane parts for an isotropic section, from thickness, modulus, Poisson's ratio and density."""

from jaxshell.elements import bending, membrane
from jaxshell.elements.element import Element
from jaxshell.model.materials.isotropic import plane_stress_matrix
from jaxshell.model.sections.isotropic import isotropic

__all__ = ["bending_stiffness", "element", "membrane_stiffness", "plane_stress_matrix"]


def element(x0, thickness, young_modulus, poisson_ratio, density) -> Element:
    return Element.build(x0, isotropic(thickness, young_modulus, poisson_ratio, density))


def membrane_stiffness(xy, thickness, young_modulus, poisson_ratio, beta0=None):
    section = isotropic(thickness, young_modulus, poisson_ratio, 0.0)
    return membrane.membrane_stiffness(xy, section.A, section.beta0 if beta0 is None else beta0)


def bending_stiffness(xy, thickness, young_modulus, poisson_ratio):
    return bending.bending_stiffness(xy, isotropic(thickness, young_modulus, poisson_ratio, 0.0).D)
