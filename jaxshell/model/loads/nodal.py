"""Forces and moments with a fixed direction on nodes."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Float

from jaxshell.model.history import History
from jaxshell.model.loads.base import DeadLoad, check_vectors, given_history
from jaxshell.model.sets import SetName, nodes_or_name, size_of
from jaxshell.numerics.checks import float_array
from jaxshell.numerics.frozen import Frozen


class NodalForce(DeadLoad):
    """Forces with a fixed direction on nodes or a set of them. `force`: (3,) for each of them, or (k, 3) [force]."""

    kind: ClassVar[str] = "force"
    value: ClassVar[str] = "force"

    sets: ClassVar[dict[str, str]] = {"nodes": "node"}

    nodes: Frozen | SetName = eqx.field(static=True)
    force: Float[jax.Array, "*k 3"]
    history: History

    def __init__(self, nodes, force, history: History | None = None):
        self.nodes = nodes_or_name("force nodes", nodes)
        self.force = float_array(force, "force")
        self.history = given_history(history)

    def __check_init__(self):
        check_vectors("force", self.force, size_of(self.nodes))

    def nodal(self, x0, triangles, mass_per_area) -> Float[jax.Array, "n 6"]:
        """(n, 6) force and moment on each node for factor 1."""
        return jnp.zeros((x0.shape[0], 6)).at[self.nodes.array, :3].add(self.force)


class NodalMoment(DeadLoad):
    """Moments with a fixed direction in space on nodes, or a set. `moment`: (3,) or (k, 3) [force·length]."""

    kind: ClassVar[str] = "moment"
    value: ClassVar[str] = "moment"

    sets: ClassVar[dict[str, str]] = {"nodes": "node"}

    nodes: Frozen | SetName = eqx.field(static=True)
    moment: Float[jax.Array, "*k 3"]
    history: History

    def __init__(self, nodes, moment, history: History | None = None):
        self.nodes = nodes_or_name("moment nodes", nodes)
        self.moment = float_array(moment, "moment")
        self.history = given_history(history)

    def __check_init__(self):
        check_vectors("moment", self.moment, size_of(self.nodes))

    def nodal(self, x0, triangles, mass_per_area) -> Float[jax.Array, "n 6"]:
        """(n, 6) force and moment on each node for factor 1."""
        return jnp.zeros((x0.shape[0], 6)).at[self.nodes.array, 3:].add(self.moment)
