"""Refinement: scenes and meshes with every triangle cut in four, and the way back."""

from jaxshell.model.refinement.coarsened import coarsen
from jaxshell.model.refinement.refined import refine

__all__ = ["coarsen", "refine"]
