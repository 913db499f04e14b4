"""*ORIENTATION: local systems, and the direction on the shell from which they count angles.

A shell's direction 1 is the projection of the axis that follows the one near its normal: with 3 the first axis, with 1
the second, with 2 the third; an additional angle turns it about the axis near the normal. Abaqus demands the line that
says both for shells; where a file has none, as CalculiX's have, direction 1 is the projection of the first axis.
"""

from typing import Any

import numpy as np

from jaxshell.files.abaqus.geometry import Scope, rotation
from jaxshell.model.mesh_files.cards import Card

_NORMAL = np.cos(np.deg2rad(0.1))
"""Abaqus's default direction is the projection of the axis x, or of z where x is within 0.1 degrees of the normal."""


class Orientation:
    """A local system. Raises ValueError for kinds that are not read."""

    def __init__(self, card: Card, scope: Scope):
        self.name, self.where = card.option("NAME"), card.where
        self._system = card.choice("SYSTEM", "RECTANGULAR")
        if self._system not in ("RECTANGULAR", "CYLINDRICAL") or card.choice("DEFINITION", "COORDINATES") != (
            "COORDINATES"
        ):
            raise ValueError(
                f"{card.where}: *ORIENTATION is read with SYSTEM=RECTANGULAR or CYLINDRICAL and "
                "DEFINITION=COORDINATES only."
            )
        line = card.line(0)
        a, b, origin = (np.array([line.number(3 * k + i, 0.0) for i in range(3)]) for k in range(3))
        self._near, self._angle = 3, 0.0
        if len(card.lines) > 1:
            self._near, self._angle = card.lines[1].whole(0, 1), card.lines[1].number(1, 0.0)
        if self._near not in (1, 2, 3):
            raise ValueError(f"{card.lines[1].where}: the local direction is 1, 2 or 3, but it is {self._near}.")
        if self._system == "RECTANGULAR":
            first, third = a - origin, np.cross(a - origin, b - origin)
            axes = np.stack([first, np.cross(third, first), third])
        else:
            axes = np.stack([b - a] * 3)
        length = np.linalg.norm(axes, axis=1, keepdims=True)
        if not (length > 0).all():
            raise ValueError(f"{line.where}: the points of *ORIENTATION {self.name} span no system.")
        self._axes = axes / length @ scope.turn.T
        self._origin = scope.moved(a if self._system == "CYLINDRICAL" else origin)

    def direction(self) -> Any:
        """As a section's table has it: a vector, or the table of a cylinder; None where it differs by element."""
        if self._system == "RECTANGULAR":
            return self.vectors(np.zeros((1, 3)))[0].tolist()
        if self._angle or self._near == 3:
            return None
        along = {1: "circumference", 2: "axis"}[self._near]
        return {"axis": self._axes[0].tolist(), "origin": self._origin.tolist(), "along": along}

    def vectors(self, centres: np.ndarray) -> np.ndarray:
        """(m, 3) the direction at each of the points."""
        axes = np.broadcast_to(self._axes, (len(centres), 3, 3))
        if self._system == "CYLINDRICAL":
            axial = self._axes[0]
            radial = centres - self._origin
            radial = radial - (radial @ axial)[:, None] * axial
            size = np.linalg.norm(radial, axis=1, keepdims=True)
            if not (size > 0).all():
                raise ValueError(f"{self.where}: an element lies on the axis of *ORIENTATION {self.name}.")
            radial = radial / size
            axes = np.stack([radial, np.cross(axial, radial), np.broadcast_to(axial, radial.shape)], axis=1)
        near, after = axes[:, self._near - 1], axes[:, self._near % 3]
        if not self._angle:
            return after
        angle = np.deg2rad(self._angle)
        return np.stack([rotation(about, angle) @ vector for about, vector in zip(near, after, strict=True)])


def default_direction(x: np.ndarray) -> Any:
    """The direction of triangles x (m, 3, 3) that have no orientation: a vector, or one for each."""
    normals = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    along = np.abs(normals[:, 0]) > _NORMAL
    if not along.any():
        return [1.0, 0.0, 0.0]
    if along.all():
        return [0.0, 0.0, 1.0]
    return np.where(along[:, None], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]).tolist()


def angle_between(x: np.ndarray, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(m,) degrees from one direction to another (m, 3), both projected onto triangles x (m, 3, 3), about their
    normals."""
    normals = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    one, other = (v - np.sum(v * normals, axis=1, keepdims=True) * normals for v in (one, other))
    return np.rad2deg(np.arctan2(np.sum(np.cross(one, other) * normals, axis=1), np.sum(one * other, axis=1)))
