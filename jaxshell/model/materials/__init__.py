"""Elastic materials, one kind a file: what the plies of a laminate are made of."""

from jaxshell.model.materials.base import Material
from jaxshell.model.materials.isotropic import Isotropic
from jaxshell.model.materials.orthotropic import Orthotropic

MATERIALS: tuple[type[Material], ...] = (Isotropic, Orthotropic)
"""Every kind that scene files and result files know."""

__all__ = ["MATERIALS", "Isotropic", "Material", "Orthotropic"]
