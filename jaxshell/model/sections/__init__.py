"""Sections, one kind a file: what the reference surface of the shell is made of."""

from jaxshell.model.sections.base import SHAPES, AnySection, Layers, Resultants
from jaxshell.model.sections.direction import Cylindrical
from jaxshell.model.sections.general import GeneralSection
from jaxshell.model.sections.isotropic import Section
from jaxshell.model.sections.laminate import Laminate
from jaxshell.model.sections.ply import Ply
from jaxshell.model.sections.regions import Regions

SECTIONS: tuple[type[AnySection], ...] = (Section, Laminate, GeneralSection, Regions)
"""Every kind that scene files and result files know."""

__all__ = [
    "SECTIONS",
    "SHAPES",
    "AnySection",
    "Cylindrical",
    "GeneralSection",
    "Laminate",
    "Layers",
    "Ply",
    "Regions",
    "Resultants",
    "Section",
]
