"""Sections, one kind a file: what the reference surface of the shell is made of."""

from jaxshell.model.sections.base import AnySection, Resultants
from jaxshell.model.sections.isotropic import Section

SECTIONS: tuple[type[AnySection], ...] = (Section,)
"""Every kind that scene files and result files know."""

__all__ = ["SECTIONS", "AnySection", "Resultants", "Section"]
