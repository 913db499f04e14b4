"""Contact of nodes with a rigid obstacle: a normal force with a potential, and friction.

**Normal force.** The potential of a node is V = ½ κ p², with the penetration p = max(-g, 0) and g the gap between the
obstacle and the shell's skin, in a fixed distance from the node. Over a step the force is F = -(ΔV/Δg) D with the gap's
discrete gradient D, D·Δx = Δg. It does exactly the work -ΔV, pushes and never pulls, and vanishes before touching.
    -ΔV/Δg = ½ κ (p₀ + p₁) |Δp|/|Δg|
has no cancellation: where one end touches and the other does not, |Δg| is at least the penetration.

**Stiffness.** κ is a third of the stiffness k A of each element around the node. Where k is not given, k A is the mean
of the two diagonal entries of the membrane stiffness: κ is about 2 E h of an inner node, whatever the mesh. So a node
on its own swings against the obstacle as fast as its elements stretch, √(κ/m) ≈ c/ℓ with the wave speed c and the
element's size ℓ: no smaller step than theirs is asked for, and an impact at the speed v penetrates by about v ℓ/c.
Of a point, which belongs to no element, κ is k A with the area A that it is given.

**Friction.** F = -μ N v/√(v² + v₀²), v the tangential velocity against the obstacle and N the normal force above: it
always takes energy. Below the slip velocity v₀ it is viscous: what should stick creeps. Where v₀ is not given it is a
millionth of the wave speed √(A/ρh). Forces act on the nodes: friction on the skin has no moment about them.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.model.contribution import Elastic, Place, Resisting, Surface
from jaxshell.numerics.frozen import Frozen

FORCES = ("fx", "fy", "fz")
"""What can be watched of both: the force on the shell, in global axes."""
SLIP = 1e-6
"""The slip velocity, as a part of the membrane's wave speed."""
_SETTLED = 0.25
"""A velocity has settled in the iteration where its last change is below this part of its smoothed size."""


class Touch(NamedTuple):
    """What a node needs for contact."""

    stiffness: Float[Array, "*k"]
    """κ [force/length]."""
    offset: Float[Array, "*k"]
    """Distance of the skin from the node [length]."""
    slip: Any = None
    """v₀ [length/time]; None without friction."""


class OnObstacle:
    """What both contributions share; `obstacle` is the `Obstacle` that is touched."""

    obstacle: Any

    @property
    def driven(self) -> bool:
        return self.obstacle.is_moving

    def groups(self, triangles: np.ndarray) -> Frozen:
        return Frozen(self.obstacle.touching(triangles)[:, None])

    def quantities(self) -> tuple[str, ...]:
        return FORCES

    def read(self, data: Touch, start: Place, end: Place, force, component: str) -> Float[Array, ""]:
        return force[0, FORCES.index(component)]

    def data(self, surface: Surface) -> Touch:
        return touch_of(self.obstacle, surface)


class NormalContact(OnObstacle, Elastic):
    """The normal force: energy as above, along the gap's gradient. The obstacle bears the momenta that it gives."""

    obstacle: Any

    def energy(self, data: Touch, place: Place) -> Float[Array, ""]:
        return 0.5 * data.stiffness * jnp.maximum(-self._gap(data, place), 0.0) ** 2

    def force(self, data: Touch, place: Place) -> Float[Array, "1 6"]:
        return self.mean_force(data, place, place)

    def stiffness(self, data: Touch, place: Place) -> Float[Array, "6 6"]:
        return _by_position(lambda place: self.force(data, place), place)

    def mean_force(self, data: Touch, start: Place, end: Place) -> Float[Array, "1 6"]:
        normal, direction = pressed(self.obstacle, data, start, end)
        return on_node(normal * direction)

    def mean_stiffness(self, data: Touch, start: Place, end: Place) -> Float[Array, "6 6"]:
        return _by_position(lambda end: self.mean_force(data, start, end), end)

    def stiffest(self, data: Touch, place: Place) -> Float[Array, "6 6"]:
        """As in contact, in any direction: at the start nothing touches."""
        return jnp.zeros((6, 6)).at[:3, :3].set(data.stiffness * jnp.eye(3))

    def quantities(self) -> tuple[str, ...]:
        return (*FORCES, "penetration", "energy")

    def read(self, data: Touch, start: Place, end: Place, force, component: str) -> Float[Array, ""]:
        if component == "penetration":
            return jnp.maximum(-self._gap(data, end), 0.0)
        return self.energy(data, end) if component == "energy" else super().read(data, start, end, force, component)

    def _gap(self, data: Touch, place: Place) -> Float[Array, ""]:
        return self.obstacle.gap(seen(self.obstacle, place)) - data.offset


class Friction(OnObstacle, Resisting):
    """Regularised Coulomb friction: dissipates F·v against the obstacle; one that moves works through it."""

    obstacle: Any

    def resistance(self, data: Touch, start: Place, end: Place, middle: Place, rates) -> Float[Array, "1 6"]:
        normal, sliding = self._sliding(data, start, end, middle, rates)
        return on_node(-self.obstacle.friction * normal * sliding / _smoothed(sliding, data))

    def iterated(self, data: Touch, start: Place, end: Place, middle: Place, rates, last) -> Float[Array, "1 6"]:
        """With the size of the velocity held fast, unless it has all but settled.

        The force is flat where a node slides and steep where it sticks: Newton's tangents would throw it from one
        direction to the other and back. Of a force -μ N v/s with s held fast the iteration goes to rest steadily.
        """
        normal, sliding = self._sliding(data, start, end, middle, rates)
        _, before = self._sliding(data, start, end, middle, last)
        s, moved = _smoothed(sliding, data), sliding - before
        s = jnp.where(moved @ moved < (_SETTLED * s) ** 2, s, jax.lax.stop_gradient(s))
        return on_node(-self.obstacle.friction * normal * sliding / s)

    def _sliding(self, data: Touch, start: Place, end: Place, middle: Place, rates):
        """The normal force, and the tangential velocity (3,) against the obstacle."""
        normal, direction = pressed(self.obstacle, data, start, end)
        normal = _at_middle(normal, pressed(self.obstacle, data, end, end)[0], start, end, middle)
        along = direction / jnp.maximum(jnp.linalg.norm(direction), jnp.finfo(float).tiny)
        against = rates[0, :3] - self._velocity(start, end)
        return normal, against - along * (along @ against)

    def carried(self, data: Touch, start: Place, end: Place) -> Float[Array, "1 6"]:
        return on_node(self.obstacle.moved(end.time) - self.obstacle.moved(start.time))

    def _velocity(self, start: Place, end: Place) -> Any:
        """Mean velocity (3,) of the obstacle in the step; at one time its velocity then."""
        if not self.driven:
            return 0.0
        moved, span = self.obstacle.moved, end.time - start.time
        _, now = jax.jvp(moved, (end.time,), (jnp.ones(()),))
        mean = (moved(end.time) - moved(start.time)) / jnp.where(span == 0.0, 1.0, span)
        return jnp.where(span == 0.0, now, mean)


def _smoothed(sliding: Float[Array, "3"], data: Touch) -> Float[Array, ""]:
    """√(v² + v₀²)."""
    return jnp.sqrt(sliding @ sliding + data.slip**2)


def seen(obstacle: Any, place: Place) -> Float[Array, "3"]:
    """The node's position where the obstacle stands still."""
    return place.x[0] - obstacle.moved(place.time)


def pressed(obstacle: Any, data: Touch, start: Place, end: Place) -> tuple[Float[Array, ""], Float[Array, "3"]]:
    """The normal force -ΔV/Δg of a step, never negative, and the gap's discrete gradient."""
    ends = seen(obstacle, start), seen(obstacle, end)
    before, after = (obstacle.gap(x) - data.offset for x in ends)
    p = jnp.maximum(-before, 0.0), jnp.maximum(-after, 0.0)
    is_partly = (p[0] > 0.0) != (p[1] > 0.0)
    share = jnp.abs(p[1] - p[0]) / jnp.where(is_partly, jnp.abs(after - before), 1.0)
    normal = 0.5 * data.stiffness * (p[0] + p[1]) * jnp.where(is_partly, share, 1.0)
    return normal, obstacle.gap_between(*ends)


def _at_middle(mean, last, start: Place, end: Place, middle: Place):
    """The normal force where the balance stands, from the middle of the step to its end."""
    span = end.time - start.time
    weight = jnp.where(span == 0.0, 1.0, (middle.time - start.time) / jnp.where(span == 0.0, 1.0, span))
    return 2.0 * (1.0 - weight) * mean + (2.0 * weight - 1.0) * last


def on_node(force: Any) -> Float[Array, "1 6"]:
    """A force without moment, on the one node of a group."""
    return jnp.concatenate([jnp.broadcast_to(force, (3,)), jnp.zeros(3)])[None]


def _by_position(force, place: Place) -> Float[Array, "6 6"]:
    """Derivative of a force by the displacement of its node; rotations do not enter."""
    block = jax.jacfwd(lambda x: force(place._replace(x=x))[0, :3])(place.x)[:, 0]
    return jnp.zeros((6, 6)).at[:3, :3].set(block)


# --- the shell --------------------------------------------------------------------------------------------


def touch_of(obstacle: Any, surface: Surface) -> Touch:
    """What the nodes need, each field (k,)."""
    nodes, n = obstacle.touching(surface.connectivity), surface.x0.shape[0]
    diagonal = 0.5 * (surface.membrane_stiffness[:, 0, 0] + surface.membrane_stiffness[:, 1, 1])
    each = diagonal if obstacle.stiffness is None else obstacle.stiffness * surface.area
    kappa = _sum_at_nodes(each / 3.0, surface.triangles, n)[nodes]
    if obstacle.area is not None:
        is_point = ~np.isin(nodes, surface.connectivity)
        kappa = jnp.where(is_point, obstacle.stiffness * obstacle.area, kappa)
    if obstacle.offset is None:
        offset = half_thickness(surface.layers().z, surface.area, surface.triangles, n)[nodes]
    else:
        offset = jnp.broadcast_to(obstacle.offset, kappa.shape)
    if not obstacle.has_friction:
        return Touch(kappa, offset)
    slip = SLIP * jnp.sqrt(jnp.mean(diagonal / surface.mass_per_area)) if obstacle.slip is None else obstacle.slip
    return Touch(kappa, offset, jnp.broadcast_to(slip, kappa.shape))


def half_thickness(z: Float[Array, "m p 2"], area: Float[Array, " m"], triangles, n_nodes: int) -> Float[Array, " n"]:
    """Half the thickness at the nodes, the mean of their elements' by area; of layers between the heights z."""
    half = 0.5 * (z[:, -1, 1] - z[:, 0, 0])
    total = _sum_at_nodes(area, triangles, n_nodes)
    return _sum_at_nodes(area * half, triangles, n_nodes) / jnp.where(total > 0.0, total, 1.0)


def _sum_at_nodes(values: Float[Array, " m"], triangles, n_nodes: int) -> Float[Array, " n"]:
    return jnp.zeros(n_nodes).at[triangles].add(values[:, None])
