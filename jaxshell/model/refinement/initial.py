"""The state at the start at new nodes: as the nodes at the ends of their edges say by places and rotations.

Between nodes a and b lies x_m = ½ (x_a + x_b) + ½ (R_a + R_b) r + ⅛ (R_a - R_b) d, with the edge d before it moves and
the new node's place r against its middle: the cubic that rotations say, exact for every rigid motion. Velocities are
its derivative.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.model.initial import Initial
from jaxshell.model.refinement.split import Split
from jaxshell.numerics.rotations import exp, log


def carried_initial(initial: Initial | None, split: Split, x0: Float[Array, "n 3"], new: Float[Array, "k 3"]):
    """With rows for new nodes at `new`; `x0` are the places before."""
    if initial is None:
        return None
    n, (first, second) = split.n_shell, split.edges.ends[split.cut].T
    eyes = jnp.broadcast_to(jnp.eye(3), (len(x0), 3, 3))
    R = eyes if initial.rotations is None else initial.rotations
    r, d = new - 0.5 * (x0[first] + x0[second]), x0[second] - x0[first]
    arms = [jnp.einsum("kij,kj->ki", R[end], v) for end, v in ((first, r), (second, r), (first, d), (second, d))]
    middle = {}
    if initial.displacements is not None or initial.rotations is not None:
        u = jnp.zeros_like(x0) if initial.displacements is None else initial.displacements
        places = 0.5 * ((x0 + u)[first] + (x0 + u)[second])
        middle["displacements"] = places + 0.5 * (arms[0] + arms[1]) + 0.125 * (arms[2] - arms[3]) - new
        if initial.rotations is not None:
            middle["rotations"] = halfway(R[first], R[second])
    if initial.velocities is not None or initial.angular_velocities is not None:
        zero = jnp.zeros_like(x0)
        v = zero if initial.velocities is None else initial.velocities
        spins = zero if initial.angular_velocities is None else initial.angular_velocities
        a, b = spins[first], spins[second]
        turned = 0.5 * (jnp.cross(a, arms[0]) + jnp.cross(b, arms[1]))
        turned += 0.125 * (jnp.cross(a, arms[2]) - jnp.cross(b, arms[3]))
        middle["velocities"] = 0.5 * (v[first] + v[second]) + turned
        if initial.angular_velocities is not None:
            middle["angular_velocities"] = 0.5 * (a + b)
    found = {}
    for name, rows in middle.items():
        old = getattr(initial, name)
        old = jnp.zeros_like(x0) if old is None else old
        found[name] = jnp.concatenate([old[:n], rows, old[n:]])
    return Initial(**found)


def halfway(first: Float[Array, "k 3 3"], second: Float[Array, "k 3 3"]) -> Float[Array, "k 3 3"]:
    """The rotations in the middle of the shortest way from the first to the second."""
    turns = jax.vmap(log)(jnp.swapaxes(first, 1, 2) @ second)
    return first @ jax.vmap(exp)(0.5 * turns)
