"""Failure criteria of plies and sheets, and a smooth maximum of them.

An index of 1 is failure, by the stresses in the axes of the ply's material at its top and bottom. Source: R. M. Jones,
Mechanics of Composite Materials (1999), section 2.9.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxshell.model.gauge import check_at
from jaxshell.model.materials.base import strain_rotation, stress_rotation
from jaxshell.model.scene import Scene
from jaxshell.numerics.checks import check_choice, check_kind, check_positive, check_shape, float_array, shown
from jaxshell.numerics.compiled import compiled_for_frames
from jaxshell.numerics.plane_stress import von_mises
from jaxshell.results.section_forces import Shape, elements_of, given_shape, over_frames, shape_of, strains_at_points
from jaxshell.results.solution import Solution

NEEDS = {
    "tsai-wu": ("X_t", "X_c", "Y_t", "Y_c", "S"),
    "tsai-hill": ("X_t", "X_c", "Y_t", "Y_c", "S"),
    "max-stress": ("X_t", "X_c", "Y_t", "Y_c", "S"),
    "max-strain": ("X_t", "X_c", "Y_t", "Y_c", "S"),
    "von-mises": ("yield_stress",),
}
"""The criteria, with the strengths that each needs."""
_ALIASES = {"yield": "yield_stress"}


class Strengths(eqx.Module):
    """What a ply bears, all positive and differentiable; a criterion needs some of them.

    Arguments:
        X_t, X_c: along the fibres, in tension and in compression [force/length²]; for "max-strain" strains.
        Y_t, Y_c: across them, likewise.
        S: in shear, likewise (for "max-strain" γ12).
        f12: Tsai-Wu's coefficient of σ1 σ2 over √(F11 F22), in (-1, 1); -0.5 makes an isotropic material's criterion
            von Mises'.
        yield_stress: for "von-mises" [force/length²].

    Raises ValueError naming the value that is out of range.
    """

    X_t: Any
    X_c: Any
    Y_t: Any
    Y_c: Any
    S: Any
    f12: Float[Array, ""]
    yield_stress: Any

    def __init__(self, X_t=None, X_c=None, Y_t=None, Y_c=None, S=None, f12=-0.5, yield_stress=None):
        given = {"X_t": X_t, "X_c": X_c, "Y_t": Y_t, "Y_c": Y_c, "S": S, "f12": f12, "yield_stress": yield_stress}
        for name, value in given.items():
            setattr(self, name, None if value is None else float_array(value, name))

    def __check_init__(self):
        for name in ("X_t", "X_c", "Y_t", "Y_c", "S", "yield_stress"):
            value = getattr(self, name)
            if value is not None:
                check_shape(name, value, ())
                check_positive(name, value)
        check_shape("f12", self.f12, ())
        check_positive("1 - f12²", 1.0 - self.f12**2)


def failure_index(
    solution: Solution, criterion: str = "tsai-wu", strengths=None, frame=-1, *, reduce: str = "max"
) -> Float[Array, "*m"]:
    """How near the plies are to failure, by a criterion; 1 is failure.

    Arguments:
        criterion: "tsai-wu": F1 σ1 + F2 σ2 + F11 σ1² + F22 σ2² + F66 τ² + 2 F12 σ1 σ2, F1 = 1/X_t - 1/X_c, F11 =
            1/(X_t X_c), F66 = 1/S². "tsai-hill": (σ1² - σ1 σ2)/X² + σ2²/Y² + τ²/S² with the strengths of the stresses'
            signs. "max-stress", "max-strain": the largest of the ratios. "von-mises": von Mises' stress over the yield
            stress. All but the last two kinds are quadratic: at half the load they are less than half.
        strengths: a `Strengths` or a dict of its arguments for all plies, or a list of them, from the bottom ply up.
        frame: the frame's number, or a list of them, which gives a leading axis.
        reduce: "max", (m,) of each element the largest; or "all", (m, p, 2, 3): every ply's bottom and top at the
            mid-edges 12, 23, 31. Elements with fewer plies repeat their last one.

    Differentiable, in the strengths too; `failure_index_of` computes it from arrays, and `jaxshell.ks` makes one smooth
    number of it. Raises ValueError for a section without layers, and naming the strength that is missing.
    """
    shape = shape_of(solution, frame)
    return _index(solution.scene, shape, criterion, strengths, reduce)


def failure_index_of(
    scene: Scene,
    displacements,
    rotations,
    time=0.0,
    criterion: str = "tsai-wu",
    strengths=None,
    *,
    static: bool = False,
    reduce: str = "max",
) -> Float[Array, "*m"]:
    """`failure_index` of displacements (n, 3) and rotations (n, 3, 3) of all nodes at a time, with `static` the load
    factor. A pure function, for jax.grad, jax.vmap and jax.jit."""
    return _index(scene, given_shape(scene, displacements, rotations, time, static), criterion, strengths, reduce)


def ks(values, sharpness=50.0, axis=None) -> Float[Array, "*b"]:
    """Kreisselmeier and Steinhauser's smooth maximum, max + ln Σ exp(ρ (v - max))/ρ, with ρ the `sharpness`.

    Above the maximum of the n values, by at most ln(n)/ρ. Over all values, or over one axis. It does not overflow, and
    is differentiable where the maximum is not. Source: G. Kreisselmeier & R. Steinhauser, "Systematic control design by
    optimizing a vector performance index", IFAC Proc. 12 (1979) 113-117. Raises ValueError for a sharpness that is not
    positive, and for no values.
    """
    values = float_array(values, "values")
    check_shape("sharpness", sharpness, ())
    check_positive("sharpness", sharpness)
    if values.size == 0:
        raise ValueError("ks needs values, at least one.")
    return jax.scipy.special.logsumexp(sharpness * values, axis=axis) / sharpness


def _index(scene: Scene, shape: Shape, criterion: str, strengths, reduce: str):
    check_choice("reduce", reduce, ("max", "all"))
    each = strengths_of_plies(scene, criterion, strengths)
    return over_frames(index_in_shape, scene, shape, each, criterion, reduce == "max")


def index_in_shape(scene: Scene, shape: Shape, strengths: tuple[Strengths, ...], criterion: str, largest: bool):
    """The index of one shape: (m,) the largest of each element, or (m, p, 2, 3)."""
    stress, strain = _in_plies(scene, shape)
    return _judged(strain if criterion == "max-strain" else stress, strengths, criterion, largest)


def strengths_of_plies(scene: Scene, criterion: str, strengths) -> tuple[Strengths, ...]:
    """One for each ply. Raises ValueError for a criterion that is none, and as `failure_index`."""
    check_choice("criterion", criterion, tuple(NEEDS))
    check_at("failure_index", "top", scene.section, scene.mesh)
    plies = eqx.filter_eval_shape(scene.section.layers, scene.mesh).angle.shape[1]
    return tuple(_given_strengths(criterion, strengths, plies))


def _given_strengths(criterion: str, strengths, plies: int) -> list[Strengths]:
    """One for each ply. Raises ValueError for another number of them, and naming what one lacks."""
    if strengths is None:
        raise ValueError(f"failure_index by {criterion} needs strengths with {', '.join(NEEDS[criterion])}.")
    listed = isinstance(strengths, Sequence) and not isinstance(strengths, str)
    given: Sequence[Any] = strengths if listed else [strengths] * plies  # pyright: ignore[reportAssignmentType]
    if len(given) != plies:
        raise ValueError(f"strengths must be one for all plies or {plies}, one for each, but they are {len(given)}.")
    found = []
    for position, item in enumerate(given):
        name = f"strengths[{position}]" if listed else "strengths"
        if isinstance(item, Mapping):
            named: dict[str, Any] = {_ALIASES.get(str(key), str(key)): value for key, value in item.items()}
            for key in named:
                if key not in Strengths.__dataclass_fields__:
                    known = ", ".join(Strengths.__dataclass_fields__)
                    raise ValueError(f"{name} has the unknown name {shown(key)}. Known names: {known}.")
            item = Strengths(**named)
        check_kind(name, item, Strengths, "a jaxshell.Strengths or a dict of its arguments")
        for needed in NEEDS[criterion]:
            if getattr(item, needed) is None:
                raise ValueError(f"{name} lacks {needed}, which the criterion {criterion} needs.")
        found.append(item)
    return found


@compiled_for_frames
def _judged(values: Float[Array, "*f m p 2 3 3"], strengths: tuple, criterion: str, largest: bool):
    given = jax.tree.map(lambda *each: jnp.stack(each)[:, None, None], *strengths)
    found = _CRITERIA[criterion](values, given)
    return jnp.max(found, axis=(-3, -2, -1)) if largest else found


@compiled_for_frames
def _in_plies(scene: Scene, shape: Shape) -> tuple[Float[Array, "m p 2 3 3"], Float[Array, "m p 2 3 3"]]:
    """Stresses and the strains that make them in the plies' axes: element, ply, bottom and top, point, component."""
    layers = scene.section.layers(scene.mesh)
    assert layers is not None  # checked before
    strains = strains_at_points(scene, elements_of(scene), shape)[:, None, None]
    e = strains[..., :3] + layers.z[..., None, None] * strains[..., 3:]
    for factor, load in zip(shape.factors, scene.initial_strains, strict=True):
        free = (load.in_layers(scene.mesh, layers, layers.z[:, :, face]) for face in (0, 1))
        e = e - factor * jnp.stack(tuple(free), axis=2)[:, :, :, None]
    turns = jax.vmap(jax.vmap(lambda angle, C: (strain_rotation(angle), stress_rotation(angle) @ C)))
    to_strain, to_stress = turns(layers.angle, layers.C)
    return tuple(jnp.einsum("mkij,mk...j->mk...i", turn, e) for turn in (to_stress, to_strain))  # pyright: ignore[reportReturnType]


# --- criteria: of components (..., 3) in the ply's axes ------------------------------------------------------


def _signed(value, in_tension, in_compression):
    """The strength that goes with the sign of a stress."""
    return jnp.where(value >= 0, in_tension, in_compression)


def _tsai_wu(stress, s: Strengths):
    s1, s2, t = stress[..., 0], stress[..., 1], stress[..., 2]
    F11, F22 = 1.0 / (s.X_t * s.X_c), 1.0 / (s.Y_t * s.Y_c)
    linear = (1.0 / s.X_t - 1.0 / s.X_c) * s1 + (1.0 / s.Y_t - 1.0 / s.Y_c) * s2
    return linear + F11 * s1**2 + F22 * s2**2 + (t / s.S) ** 2 + 2.0 * s.f12 * jnp.sqrt(F11 * F22) * s1 * s2


def _tsai_hill(stress, s: Strengths):
    s1, s2, t = stress[..., 0], stress[..., 1], stress[..., 2]
    X, Y = _signed(s1, s.X_t, s.X_c), _signed(s2, s.Y_t, s.Y_c)
    return (s1**2 - s1 * s2) / X**2 + (s2 / Y) ** 2 + (t / s.S) ** 2


def _largest_ratio(value, s: Strengths):
    v1, v2, t = value[..., 0], value[..., 1], value[..., 2]
    ratios = [jnp.abs(v1) / _signed(v1, s.X_t, s.X_c), jnp.abs(v2) / _signed(v2, s.Y_t, s.Y_c), jnp.abs(t) / s.S]
    return jnp.max(jnp.stack(ratios), axis=0)


def _yielding(stress, s: Strengths):
    return von_mises(stress) / s.yield_stress


_CRITERIA = {
    "tsai-wu": _tsai_wu,
    "tsai-hill": _tsai_hill,
    "max-stress": _largest_ratio,
    "max-strain": _largest_ratio,
    "von-mises": _yielding,
}
