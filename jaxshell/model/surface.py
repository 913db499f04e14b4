"""The true surfaces of generated meshes: where new nodes go, and what the normals at nodes are.

A mesh of flat triangles only approximates the shell that is meant. One that was made from a formula remembers it, as
`mesh.surface`:

    surface.project(points)         (n, 3) the points of the surface at these
    surface.normals(points)         (n, 3) unit normals there
    surface.middles(first, second)  (n, 3) the nodes halfway between two, where the generator puts them

All are differentiable, in points and in the floats of the surface, and take points that are not on the surface. The
normals point outwards or upwards; a mesh's elements may be turned the other way (`jaxshell.model.corner_normals` goes
by them). `mesh.with_imperfection` forgets the surface; whoever moves nodes otherwise (`equinox.tree_at`) says so with
`mesh.on_surface(None)`.
"""

import abc
import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.numerics.checks import (
    check_choice,
    check_finite,
    check_number,
    check_positive_number,
    check_shape,
    floats,
)
from jaxshell.numerics.directions import across, unit_vector

_AT_POLE = 1e-3
"""A node nearer to a pole than this part of an edge's length is at it, and has no azimuth."""
_PROBE = 1e-2
"""How far along an edge one looks which quarter of a square grid it is in."""


class TrueSurface(eqx.Module):
    """What every surface offers."""

    @abc.abstractmethod
    def project(self, points: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """The points of the surface at these."""

    @abc.abstractmethod
    def normals(self, points: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """Unit normals of the surface at these points."""

    def middles(self, first: Float[Array, "k 3"], second: Float[Array, "k 3"]) -> Float[Array, "k 3"]:
        """Halfway between points, as the generator divides: on the surface, and as far from it as they are in the mean.

        So nodes that were moved off the surface, as by a shape derivative, take the new ones along.
        """
        a, b = self.project(first), self.project(second)
        return self._between(a, b) + 0.5 * ((first - a) + (second - b))

    @abc.abstractmethod
    def _between(self, a: Float[Array, "k 3"], b: Float[Array, "k 3"]) -> Float[Array, "k 3"]:
        """Halfway between points of the surface."""


class FlatSurface(TrueSurface):
    """A plane through `point` (3,) with the normal `normal` (3,), of any length.

    `chart` says what is halfway: "straight", or "polar" about the point, as for rings. Raises ValueError for a normal
    of no length.
    """

    point: Float[jax.Array, "3"] = eqx.field(converter=floats("point"), default=(0.0, 0.0, 0.0))
    normal: Float[jax.Array, "3"] = eqx.field(
        converter=lambda value: unit_vector(value, "A surface's normal"), default=(0.0, 0.0, 1.0)
    )
    chart: str = eqx.field(static=True, default="straight")

    def __check_init__(self):
        _check_vectors(point=self.point)
        check_choice("chart", self.chart, ("straight", "polar"))

    def project(self, points):
        normal = self.normal / jnp.linalg.norm(self.normal)
        return points - ((points - self.point) @ normal)[:, None] * normal

    def normals(self, points):
        return jnp.broadcast_to(self.normal / jnp.linalg.norm(self.normal), points.shape)

    def _between(self, a, b):
        if self.chart == "straight":
            return 0.5 * (a + b)
        frame = across(self.normal)
        (height, radius, angle), other = (_around(p - self.point, frame) for p in (a, b))
        radius, angle = 0.5 * (radius + other[1]), _mean_angle(angle, other[2])
        return self.point + _placed(height, radius, angle, frame)


class CylindricalSurface(TrueSurface):
    """A circular cylinder about the line through `point` (3,) along `axis` (3,); normals point outwards.

    Raises ValueError for a radius that is not positive and an axis of no length.
    """

    radius: Float[jax.Array, ""] = eqx.field(converter=floats("radius"))
    axis: Float[jax.Array, "3"] = eqx.field(
        converter=lambda value: unit_vector(value, "A cylinder's axis"), default=(1.0, 0.0, 0.0)
    )
    point: Float[jax.Array, "3"] = eqx.field(converter=floats("point"), default=(0.0, 0.0, 0.0))

    def __check_init__(self):
        check_positive_number("radius", self.radius)
        _check_vectors(point=self.point)

    def project(self, points):
        frame = across(self.axis)
        along, _, angle = _around(points - self.point, frame)
        return self.point + _placed(along, self.radius, angle, frame)

    def normals(self, points):
        frame = across(self.axis)
        along, _, angle = _around(points - self.point, frame)
        return _placed(jnp.zeros_like(along), jnp.ones(()), angle, frame)

    def _between(self, a, b):
        frame = across(self.axis)
        (along, _, angle), other = (_around(p - self.point, frame) for p in (a, b))
        along, angle = 0.5 * (along + other[0]), _mean_angle(angle, other[2])
        return self.point + _placed(along, self.radius, angle, frame)


class SphericalSurface(TrueSurface):
    """A sphere about `centre` (3,); normals point outwards.

    `chart` says what is halfway between two points: "arcs" the middle of their great circle; "polar" the means of their
    polar angles, from the z axis, and azimuths, as for rings about z; "square" that of the square grid that
    `spherical_cap` draws onto the sphere about +z. Raises ValueError for a radius that is not positive.
    """

    radius: Float[jax.Array, ""] = eqx.field(converter=floats("radius"))
    centre: Float[jax.Array, "3"] = eqx.field(converter=floats("centre"), default=(0.0, 0.0, 0.0))
    chart: str = eqx.field(static=True, default="arcs")

    def __check_init__(self):
        check_positive_number("radius", self.radius)
        _check_vectors(centre=self.centre)
        check_choice("chart", self.chart, ("arcs", "polar", "square"))

    def project(self, points):
        return self.centre + self.radius * self.normals(points)

    def normals(self, points):
        return _unit(points - self.centre)

    def _between(self, a, b):
        a, b = a - self.centre, b - self.centre
        if self.chart == "arcs":
            return self.centre + self.radius * _unit(a + b)
        # A node at a pole has no azimuth: that of the other is taken, and where it moves from there moves the middle.
        (a, shift_a), (b, shift_b) = _off_pole(a, b), _off_pole(b, a)
        middle = _polar_mean(a, b) if self.chart == "polar" else _square_mean(a, b)
        return self.centre + self.radius * middle + 0.5 * (shift_a + shift_b)


class TwistedSurface(TrueSurface):
    """A strip twisted about the x axis by `rate` [rad/length]: (x, s cos θ, s sin θ) with θ = rate·x.

    Points are projected in their cross-section x, not to the nearest. The normal at θ = 0 on the axis is +z.
    """

    rate: Float[jax.Array, ""] = eqx.field(converter=floats("rate"))

    def __check_init__(self):
        check_number("rate", self.rate)

    def project(self, points):
        return self._at(*self._chart(points))

    def normals(self, points):
        x, s = self._chart(points)
        turn = self.rate * x
        return _unit(jnp.stack([-self.rate * s, -jnp.sin(turn), jnp.cos(turn)], axis=1))

    def _between(self, a, b):
        first, second = self._chart(a), self._chart(b)
        return self._at(0.5 * (first[0] + second[0]), 0.5 * (first[1] + second[1]))

    def _chart(self, points):
        turn = self.rate * points[:, 0]
        return points[:, 0], points[:, 1] * jnp.cos(turn) + points[:, 2] * jnp.sin(turn)

    def _at(self, x, s):
        turn = self.rate * x
        return jnp.stack([x, s * jnp.cos(turn), s * jnp.sin(turn)], axis=1)


SURFACES: tuple[type[TrueSurface], ...] = (FlatSurface, CylindricalSurface, SphericalSurface, TwistedSurface)
"""Every kind that result files know."""


def _check_vectors(**values) -> None:
    for name, value in values.items():
        check_shape(f"A surface's {name}", value, (3,))
        check_finite(f"A surface's {name}", value)


def _unit(vectors: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
    """Unit vectors along these; +z for one of no length."""
    square = jnp.sum(vectors * vectors, axis=1, keepdims=True)
    good = square > 0
    return jnp.where(good, vectors / jnp.sqrt(jnp.where(good, square, 1.0)), jnp.array([0.0, 0.0, 1.0]))


def _around(arms: Float[Array, "n 3"], frame: Float[Array, "3 3"]):
    """Place along the first of three axes (rows), distance from it, and angle about it [rad]; 0 for one on it."""
    along, y, z = (arms @ frame.T).T
    square = y * y + z * z
    good = square > 0
    radius = jnp.where(good, jnp.sqrt(jnp.where(good, square, 1.0)), 0.0)
    return along, radius, jnp.where(good, jnp.arctan2(jnp.where(good, z, 0.0), jnp.where(good, y, 1.0)), 0.0)


def _placed(along, radius, angle, frame: Float[Array, "3 3"]) -> Float[Array, "n 3"]:
    """The inverse of `_around`."""
    radius = jnp.broadcast_to(radius, angle.shape)
    return jnp.stack([along, radius * jnp.cos(angle), radius * jnp.sin(angle)], axis=1) @ frame


def _wrapped(angle):
    """Within half a turn."""
    turns = jnp.round(jax.lax.stop_gradient(angle) / (2.0 * math.pi))
    return angle - 2.0 * math.pi * turns


def _mean_angle(first, second):
    return first + 0.5 * _wrapped(second - first)


# --- spheres about the origin ----------------------------------------------------------------------------------------

_POLE = ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
"""Axes from which `_around` gives the azimuth about z."""


def _off_pole(p: Float[Array, "k 3"], other: Float[Array, "k 3"]):
    """The points, those that are at a pole exactly there; and how far they are from it, else zero."""
    still, far = jax.lax.stop_gradient(p), jax.lax.stop_gradient(other)
    at_pole = jnp.hypot(still[:, 0], still[:, 1]) < _AT_POLE * jnp.linalg.norm(far - still, axis=1)
    height = jnp.sign(still[:, 2]) * jnp.linalg.norm(still, axis=1)
    pole = jnp.stack([0.0 * height, 0.0 * height, height], axis=1)
    there = at_pole[:, None]
    return jnp.where(there, pole, p), jnp.where(there, p - pole, 0.0)


def _polar(p: Float[Array, "k 3"]):
    """Polar angle and azimuth; 0 at the poles."""
    height, radius, azimuth = _around(p, jnp.array(_POLE))
    safe = jnp.where(radius > 0, radius, 1.0)
    polar = jnp.arctan2(safe, height)
    return jnp.where(radius > 0, polar, jnp.where(height > 0, 0.0, math.pi)), azimuth, radius > 0


def _direction(polar, azimuth) -> Float[Array, "k 3"]:
    across_axis = jnp.sin(polar)
    return jnp.stack([across_axis * jnp.cos(azimuth), across_axis * jnp.sin(azimuth), jnp.cos(polar)], axis=1)


def _polar_mean(a, b) -> Float[Array, "k 3"]:
    (polar, azimuth, off), (other_polar, other, other_off) = _polar(a), _polar(b)
    azimuth, other = jnp.where(off, azimuth, other), jnp.where(other_off, other, azimuth)
    return _direction(0.5 * (polar + other_polar), _mean_angle(azimuth, other))


def _square_mean(a, b) -> Float[Array, "k 3"]:
    """By the coordinates of a grid whose squares |s|, |t| = const are circles of polar angle max(|s|, |t|).

    They have kinks where quarters of the square meet. Each end is taken in that which the edge goes to, and the middle
    as the mean of what it is in both: on the line between them, where the generator has it, and smooth in the ends.
    """
    quarters = [_quarter(a, b), _quarter(b, a)]
    ends = [_on_square(point, quarter) for point, quarter in zip((a, b), quarters, strict=True)]
    s, t = (0.5 * (first + second) for first, second in zip(*ends, strict=True))
    (polar, azimuth), other = (_off_square(s, t, quarter) for quarter in quarters)
    return _direction(0.5 * (polar + other[0]), _mean_angle(azimuth, other[1]))


def _on_square(p: Float[Array, "k 3"], quarter):
    """Coordinates (s, t) of points in a quarter of the square, and beyond it."""
    polar, azimuth, _ = _polar(p)
    t = polar * _wrapped(azimuth - 0.5 * math.pi * quarter) * (4.0 / math.pi)
    return _turned(polar, jnp.where(polar > 0, t, 0.0), quarter)


def _off_square(s, t, quarter):
    """Polar angle and azimuth, the inverse of `_on_square`."""
    s, t = _turned(s, t, -quarter)
    good = s > 0
    azimuth = jnp.where(good, 0.25 * math.pi * t / jnp.where(good, s, 1.0), 0.0)
    return s, azimuth + 0.5 * math.pi * quarter


def _quarter(p: Float[Array, "k 3"], other: Float[Array, "k 3"]):
    """That of the square into which edges lead from p: 0 about +s, 1 about +t, 2 about -s, 3 about -t."""
    s, t, _ = jax.lax.stop_gradient(p + _PROBE * (other - p)).T
    return jnp.mod(jnp.round(jnp.arctan2(t, s) / (0.5 * math.pi)), 4.0)


def _turned(s, t, quarter):
    """(s, t) turned by quarters, without round-off."""
    quarter = jnp.mod(quarter, 4.0)
    choices = [(s, t), (-t, s), (-s, -t), (t, -s)]
    return tuple(jnp.select([quarter == k for k in range(4)], [choice[axis] for choice in choices]) for axis in (0, 1))
