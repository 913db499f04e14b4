"""What the property tests share: the hypothesis profile, and random elements, motions and states of one element."""

from typing import NamedTuple

import isotropic
import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from jaxshell.elements.element import Element

# Compiling makes the first example slow; the same examples in every run keep failures reproducible.
PROFILE = settings(deadline=None, derandomize=True, max_examples=40, database=None)
EPS = np.finfo(float).eps

build = jax.jit(isotropic.element)


def numbers(low, high):
    return st.floats(low, high, allow_subnormal=False)


def vectors(count, size=1.0):
    """(count, 3) with entries in [-size, size]; one vector (3,) for count None."""
    flat = st.lists(numbers(-size, size), min_size=3 * (count or 1), max_size=3 * (count or 1))
    shape = (3,) if count is None else (count, 3)
    return flat.map(lambda values: np.array(values).reshape(shape))


def powers(low, high):
    """10^p with p in [low, high]."""
    return numbers(low, high).map(lambda p: 10.0**p)


class Rigid(NamedTuple):
    """x → Q x + c."""

    Q: np.ndarray
    c: np.ndarray

    def points(self, x):
        return jnp.asarray(np.asarray(x) @ self.Q.T + self.c)

    def turn(self, v):
        return jnp.asarray(np.asarray(v) @ self.Q.T)

    def matrices(self, R):
        return jnp.asarray(self.Q @ np.asarray(R))


def rigid_motions(size=1.0):
    """Rotations by up to 2π about any axis and translations of up to some ten sizes."""

    def motion(axis, angle, shift):
        norm = np.linalg.norm(axis)
        axis = axis / norm if norm > 1e-6 else np.array([0.0, 0.0, 1.0])
        return Rigid(Rotation.from_rotvec(angle * axis).as_matrix(), 10.0 * size * shift)

    return st.builds(motion, vectors(None), numbers(0.0, 2.0 * np.pi), vectors(None))


class Case(NamedTuple):
    """One element and a deformed, turned state of it."""

    element: Element
    x: jax.Array
    R: jax.Array
    altitude: float
    """The smallest of the deformed triangle."""
    condition: float
    """Largest coordinate over the altitude: what a rounding error of a coordinate does to the local frame."""


@st.composite
def triangles(draw):
    """(3, 3) corners: sides of about 1 times 10^±2, aspect ratios up to some fifteen, any edge first, anywhere."""
    plane = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [draw(numbers(-0.5, 1.5)), draw(powers(-1.0, 0.0)), 0.0]])
    corners = np.roll(plane, draw(st.integers(0, 2)), axis=0) * draw(powers(-2.0, 2.0))
    return np.asarray(draw(rigid_motions()).points(corners))


def altitude_of(x) -> float:
    a, b = x[1] - x[0], x[2] - x[0]
    longest = max(np.linalg.norm(v) for v in (a, b, b - a))
    return float(np.linalg.norm(np.cross(a, b)) / longest)


@st.composite
def cases(draw):
    """Random section, and a state strained by up to 0.2 with nodes that turn by up to 1 rad against the triangle."""
    x0 = draw(triangles())
    altitude, longest = altitude_of(x0), np.ptp(x0, axis=0).max()
    thickness = longest * draw(powers(-2.0, -0.5))
    values = thickness, draw(powers(-1.0, 6.0)), draw(numbers(-0.5, 0.5)), draw(powers(-1.0, 4.0))
    element = build(jnp.asarray(x0), *(jnp.asarray(v) for v in values))
    strained = x0 - x0[0] + 0.2 * altitude * draw(vectors(3))
    motion = draw(rigid_motions(longest))
    R = motion.Q @ Rotation.from_rotvec(draw(vectors(3, 0.6))).as_matrix()
    x = np.asarray(motion.points(strained))
    altitude = altitude_of(x)
    return Case(element, jnp.asarray(x), jnp.asarray(R), altitude, float(np.abs(x).max() / altitude + 1.0))
