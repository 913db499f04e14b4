"""A scene with another shape of its elements: flat, curved or relaxed."""

import dataclasses

from jaxshell.model.scene import Scene
from jaxshell.model.sections import AnySection
from jaxshell.model.sections.base import given_shape
from jaxshell.model.sections.regions import Regions
from jaxshell.numerics.checks import check_kind


def with_shape(scene: Scene, shape: str) -> Scene:
    """The scene with elements of the `shape` "flat", "curved" or "relaxed", in all regions (docs/accuracy.md).

    Differentiable in all of the scene's floats. Raises ValueError for another shape, and for a scene without a section.
    """
    check_kind("with_shape's first argument", scene, Scene, "a jaxshell.Scene")
    given_shape(shape)
    if scene.section is None:
        raise ValueError("The scene has no section, and no elements that could have a shape.")
    return dataclasses.replace(scene, section=_shaped(scene.section, shape))


def _shaped(section: AnySection, shape: str) -> AnySection:
    if isinstance(section, Regions):
        return dataclasses.replace(section, sections=tuple(_shaped(part, shape) for part in section.sections))
    return dataclasses.replace(section, shape=shape)  # pyright: ignore[reportCallIssue]
