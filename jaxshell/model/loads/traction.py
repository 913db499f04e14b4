"""Forces per area of the stress-free shape that keep their direction: tractions, and a pressure that does not turn."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Float

from jaxshell.model.history import History
from jaxshell.model.loads.base import (
    DeadLoad,
    OnElements,
    check_vectors,
    chosen,
    given_history,
    number_of_elements,
    on_corners,
)
from jaxshell.model.mesh import Mesh
from jaxshell.model.normals import area_vectors
from jaxshell.model.sets import SetName, elements_or_name
from jaxshell.numerics.checks import float_array
from jaxshell.numerics.frozen import Frozen


class Traction(DeadLoad):
    """A force with a fixed direction per area of the stress-free shape, as snow's or a cladding's weight.

    Arguments:
        traction: (3,), or (m, 3) one for each of the elements [force/length²]. Differentiable.
        history: how it varies in time; None is constant.
        elements: numbers of the elements that it acts on, or the name of a set; None is all.

    A third of an element's resultant goes to each of its nodes. Its potential is not recorded: its work counts as
    external work. Raises ValueError for NaN and for another number of values than elements.
    """

    kind: ClassVar[str] = "traction"
    value: ClassVar[str] = "traction"
    acts_on: ClassVar[str] = "shell"
    sets: ClassVar[dict[str, str]] = {"elements": "element"}

    traction: Float[jax.Array, "*m 3"]
    history: History
    elements: Frozen | SetName | None = eqx.field(static=True)

    def __init__(self, traction, history: History | None = None, elements=None):
        self.traction = float_array(traction, "traction")
        self.history = given_history(history)
        self.elements = elements_or_name(elements)

    def __check_init__(self):
        check_vectors("traction", self.traction, None)

    def check(self, mesh: Mesh) -> None:
        check_vectors("traction", self.traction, number_of_elements(self.elements, mesh))

    def nodal(self, x0, triangles, mass_per_area) -> Float[jax.Array, "n 6"]:
        """(n, 6) force and moment on each node for factor 1."""
        triangles = chosen(self.elements, triangles)
        area = jnp.linalg.norm(area_vectors(x0, triangles), axis=1, keepdims=True)
        return on_corners(area / 3 * self.traction, triangles, x0.shape[0])


class DeadPressure(OnElements, DeadLoad):
    """A pressure on the area of the stress-free shape along its normals, where it stays: it does not turn as
    `Pressure` does, nor grow with the surface.

    Arguments:
        pressure: scalar, or (m,) one for each of the elements [force/length²], positive along the elements' normals.
            Differentiable.
        history: how it varies in time; None is constant.
        elements: numbers of the elements that it acts on, or the name of a set; None is all.

    Its potential is not recorded: its work counts as external work. Raises ValueError for anything but finite numbers.
    """

    kind: ClassVar[str] = "dead pressure"

    def nodal(self, x0, triangles, mass_per_area) -> Float[jax.Array, "n 6"]:
        """(n, 6) force and moment on each node for factor 1."""
        triangles = chosen(self.elements, triangles)
        each = jnp.broadcast_to(self.pressure, (len(triangles),))[:, None]
        return on_corners(each / 3 * area_vectors(x0, triangles), triangles, x0.shape[0])
