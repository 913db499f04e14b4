"""Mass, centre of mass and inertia tensor of a scene's shell in its stress-free shape."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.elements.inertia import LINEAR_MASS
from jaxshell.model.scene import Scene
from jaxshell.numerics.checks import check_kind
from jaxshell.numerics.compiled import compiled_once
from jaxshell.numerics.triangles import local_frame


class MassProperties(eqx.Module):
    """What a shell weighs, and how it resists being spun."""

    mass: Float[Array, ""]
    centre: Float[Array, "3"]
    """[length], in the axes of the mesh."""
    inertia: Float[Array, "3 3"]
    """About the centre [mass·length²]: ½ ωᵀ J ω is the kinetic energy of a rigid spin ω about it."""


def mass_properties(scene: Scene) -> MassProperties:
    """Mass, centre and inertia tensor of the shell with its point masses and rigid bodies.

    Of the kinetic energy ½ ∫ m₀|v|² + 2 m₁ v·ṫ + m₂|ṫ|² dA of a surface with directors t, m_k = ∫ρ zᵏ dz: a rigid spin
    ω about a point has v = ω × r and ṫ = ω × t. Exact for flat triangles. Differentiable.
    """
    check_kind("scene", scene, Scene, "a jaxshell.Scene")
    return _mass_properties(scene)


@compiled_once
def _mass_properties(scene: Scene) -> MassProperties:
    x = scene.mesh.nodes[scene.mesh.triangles]
    frames, coordinates = jax.vmap(local_frame)(x)
    area, t = 0.5 * coordinates[:, 0] * coordinates[:, 2], frames[:, 2]
    section = scene.section.resultants(scene.mesh)
    zeroth, second = area * section.mass_per_area, area * section.rotary_inertia
    first = jnp.zeros_like(area) if section.first_moment is None else area * section.first_moment
    points, lumped, tensors = _points(scene)
    mass = jnp.sum(zeroth) + jnp.sum(lumped)
    centre = (zeroth @ jnp.mean(x, axis=1) + first @ t + lumped @ points) / mass
    r = x - centre
    middle = jnp.mean(r, axis=1)
    # ∫ (density) p pᵀ over the body, of places p = r + z t.
    moments = jnp.einsum("m,mai,ab,mbj->ij", zeroth, r, jnp.asarray(LINEAR_MASS), r)
    crossed = jnp.einsum("m,mi,mj->ij", first, middle, t)
    moments = moments + crossed + crossed.T + jnp.einsum("m,mi,mj->ij", second, t, t)
    moments = moments + jnp.einsum("k,ki,kj->ij", lumped, points - centre, points - centre)
    return MassProperties(mass, centre, jnp.trace(moments) * jnp.eye(3) - moments + tensors)


def _points(scene: Scene):
    """Places (k, 3) and masses (k,) of the point masses, and the sum of their inertia tensors (3, 3)."""
    masses = scene.point_masses
    if masses is None:
        return jnp.zeros((0, 3)), jnp.zeros(0), jnp.zeros((3, 3))
    return scene.mesh.nodes[masses.nodes.array], masses.mass, jnp.sum(masses.inertia, axis=0)
