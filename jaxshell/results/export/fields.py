"""The fields of an export: what they are called, which of them a scene has, and their values in several frames.

Of nodes: displacement, rotation (a rotation vector), velocity. Of elements, at their middles: section forces, stresses,
strains, the normal, energies, the error of the mesh, failure indices, and whatever a gauge's text names
(`jaxshell.model.gauge`). All of them are computed in one program, frame after frame, so that a frame costs its own
memory only.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxshell.assembly.gauges import force_probe, picked, probe_of, stress_probe
from jaxshell.model.gauge import gauge_of, ply_counts
from jaxshell.model.scene import Scene
from jaxshell.numerics import rotations
from jaxshell.numerics.checks import check_kind, shown
from jaxshell.numerics.compiled import compiled_for_frames
from jaxshell.numerics.frozen import Frozen
from jaxshell.results.failure import index_in_shape, strengths_of_plies
from jaxshell.results.frames import Frames
from jaxshell.results.mesh_errors import check_has_error, local_in_shape
from jaxshell.results.section_forces import (
    Shape,
    deformed_frames,
    elements_of,
    energies_of_elements,
    in_space,
    strain_factors,
    strains_at_points,
    strains_in_axes,
    turning,
)
from jaxshell.results.smoothing import smooth_patches
from jaxshell.results.stresses import checked_gauge

_BYTES, _MOST = 2**22, 64
"""What is computed at a time: so many bytes, or so many frames."""


class Field(NamedTuple):
    """A field: of what, which kind of quantity (`jaxshell.results.export.units`), what it is, whether it is asked for
    unasked, and whether only sections of layers have it."""

    place: str
    """"node" or "element"."""
    quantity: str
    says: str
    usual: bool = True
    layered: bool = False


FIELDS = {
    "displacement": Field("node", "length", "displacement from the mesh"),
    "rotation": Field("node", "angle", "rotation vector from the mesh, of up to pi"),
    "velocity": Field("node", "velocity", "velocity"),
    "N": Field("element", "N", "membrane forces"),
    "M": Field("element", "M", "moments; M > 0 stretches the side that the normal points to"),
    "stress top": Field("element", "stress", "stress at the side that the normal points to", layered=True),
    "stress bottom": Field("element", "stress", "stress at the other side", layered=True),
    "von mises top": Field("element", "stress", "von Mises' stress at the top", layered=True),
    "von mises bottom": Field("element", "stress", "von Mises' stress at the bottom", layered=True),
    "thickness": Field("element", "length", "thickness; does not change", layered=True),
    "strain": Field("element", "strain", "strain of the surface of the nodes", usual=False),
    "curvature": Field("element", "curvature", "change of curvature", usual=False),
    "normal": Field("element", "none", "normal, which points to the top", usual=False),
    "element strain energy": Field("element", "energy", "strain energy of the element", usual=False),
    "mesh error": Field("element", "index", "error of the mesh in the norm of energy, by recovery", usual=False),
}
TENSORS = ("N", "M", "stress top", "stress bottom", "strain", "curvature")
"""Fields whose components depend on axes: 6 in space, xx, yy, zz, xy, yz, xz, or 3 in a plane, xx, yy, xy."""
FAILURE = "failure index "
"""Before a criterion, the name of its field."""
_SPACE = (0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)


class Chosen(NamedTuple):
    """The fields that are asked for; what is no array in it is static."""

    names: tuple[str, ...]
    """In the order in which they were asked for, each once."""
    axes: str
    """"global", or "plane" where `angle` says from where it is counted."""
    angle: Any
    """(m,) from every element's e1 to the axis x [rad], or None."""
    strengths: dict[str, tuple]
    """Of the plies, for each criterion."""
    patches: Frozen | None
    """Labels of `jaxshell.smooth_patches`, for the mesh's error."""

    @property
    def changing(self) -> tuple[str, ...]:
        """Those that differ from frame to frame."""
        return tuple(name for name in self.names if name != "thickness")

    def place(self, name: str) -> str:
        """ "node" or "element"."""
        return FIELDS[name].place if name in FIELDS else "element"

    def shape(self, name: str) -> tuple[int, ...]:
        """Of a value at one node or element."""
        if name in TENSORS:
            return (6,) if self.axes == "global" else (3,)
        return (3,) if self.place(name) == "node" or name == "normal" else ()

    def quantity(self, name: str) -> str:
        """The kind of quantity of a field."""
        if name in FIELDS:
            return FIELDS[name].quantity
        gauge = gauge_of(name)
        return "index" if gauge is None else gauge.quantity

    def says(self, name: str) -> str:
        """What a field is, in words."""
        said = FIELDS[name].says if name in FIELDS else name
        if name not in TENSORS:
            return said
        return f"{said}; {'xx yy zz xy yz xz in space' if self.axes == 'global' else 'xx yy xy in the element'}"

    def components(self, name: str) -> tuple[str, ...]:
        """Names of a field's components; none of a scalar."""
        if name in TENSORS:
            return ("xx", "yy", "zz", "xy", "yz", "xz") if self.axes == "global" else ("xx", "yy", "xy")
        return ("x", "y", "z") if self.shape(name) else ()

    def at_once(self, scene: Scene) -> int:
        """So many frames are computed together: their memory is bounded, whatever the mesh."""
        counts = {"node": scene.mesh.n_nodes, "element": scene.mesh.n_elements}
        values = sum(counts[self.place(name)] * int(np.prod(self.shape(name))) for name in self.changing)
        return max(1, min(_MOST, _BYTES // (8 * (values + 15 * scene.mesh.n_nodes))))


def choose(scene: Scene, fields: Any = "default", axes: Any = "global", failure: Mapping | None = None) -> Chosen:
    """The fields of an export, checked.

    Arguments:
        fields: "default", "all" (what the scene's section has), a name of FIELDS, a gauge's text such as "Mxx" or "s11
            ply 0 top", or a list of them.
        axes: of the tensors: "global", 6 components in space; "element", "material" or a vector, 3 components in the
            elements' planes, as of `jaxshell.section_forces`.
        failure: {criterion: strengths}, as of `jaxshell.failure_index`: a field "failure index CRITERION" for each.

    Raises ValueError for a name that is none, and for what the section does not have.
    """
    layered = ply_counts(scene.section, scene.mesh) is not None
    names: list[str] = []
    for name in [fields] if isinstance(fields, str) else list(fields):
        if isinstance(name, str) and name in ("default", "all"):
            own = [key for key, field in FIELDS.items() if (layered or not field.layered)]
            own = [key for key in own if key != "mesh error" or scene.mesh.n_elements]
            names += [key for key in own if name == "all" or FIELDS[key].usual]
        else:
            names.append(_checked(scene, name, layered))
    check_kind("failure", failure, Mapping | None, "{criterion: strengths}")
    strengths = {what: strengths_of_plies(scene, what, given) for what, given in (failure or {}).items()}
    names += [f"{FAILURE}{criterion}" for criterion in strengths]
    whole = isinstance(axes, str) and axes == "global"
    angle = turning(scene, axes)
    patches = smooth_patches(scene).labels if "mesh error" in names else None
    return Chosen(tuple(dict.fromkeys(names)), "global" if whole else "plane", angle, strengths, patches)


def _checked(scene: Scene, name, layered: bool) -> str:
    if isinstance(name, str) and name in FIELDS:
        if FIELDS[name].layered and not layered:
            raise ValueError(f"The field {name!r} needs a section of layers; this scene's has section forces only.")
        if name == "mesh error":
            check_has_error(scene)
        return name
    if isinstance(name, str) and name.startswith(FAILURE):
        raise ValueError(f"The field {name!r} is asked for by failure={{{name.removeprefix(FAILURE)!r}: strengths}}.")
    if gauge_of(name) is None:
        raise ValueError(
            f"There is no field {shown(name)}. Choose out of default, all, {', '.join(FIELDS)}, or name a gauge, "
            'as "Mxx", "s11 ply 0 top", "smax bottom".'
        )
    checked_gauge(scene, name)
    return name


def thickness(scene: Scene) -> Float[Array, " m"]:
    """Of every element, from the bottom of the lowest layer to the top of the uppermost."""
    layers = scene.section.layers(scene.mesh)
    assert layers is not None  # checked when it was chosen
    return layers.z[:, -1, 1] - layers.z[:, 0, 0]


class Evaluator:
    """Values of the chosen fields of a scene's frames, at most `most` at a time, by one program for any number."""

    def __init__(self, scene: Scene, chosen: Chosen, static: bool):
        self.scene, self.chosen, self.static = scene, chosen, static
        self.most = chosen.at_once(scene)

    def __call__(self, times, frames: Frames) -> dict[str, np.ndarray]:
        """{name: (f, n or m, *shape)} of f ≤ `most` frames."""
        times = np.asarray(times, float)
        count = len(times)
        known = {"displacement": frames.displacements, "velocity": frames.velocities}
        found = {name: np.asarray(known[name]) for name in self.chosen.changing if name in known}
        computed = tuple(name for name in self.chosen.changing if name not in known)
        if computed:
            given = [self._filled(each) for each in (times, frames.displacements, frames.rotations)]
            values = _values(self.scene, self.chosen, computed, self.static, given, np.asarray(count))
            found |= {name: np.asarray(value)[:count] for name, value in values.items()}
        return {name: found[name] for name in self.chosen.changing}

    def _filled(self, values) -> Any:
        """`most` rows, the last of them repeated."""
        values = np.asarray(values)
        return np.concatenate([values, np.repeat(values[-1:], self.most - len(values), axis=0)])


@compiled_for_frames
def _values(scene: Scene, chosen: Chosen, names: tuple[str, ...], static: bool, given, count) -> dict[str, Array]:
    """The fields of the first `count` frames, given as times, displacements, rotations; of the others zeros."""
    of_shape = _of_one(scene, chosen, names)

    def one(k):
        time, displacements, rotations = (jnp.asarray(each)[k] for each in given)
        return of_shape(Shape(displacements, rotations, strain_factors(scene, time, static)))

    rows = len(given[0])
    found = jax.tree.map(lambda a: jnp.zeros((rows, *a.shape), a.dtype), jax.eval_shape(one, 0))

    def add(k, found):
        return jax.tree.map(lambda rows, value: rows.at[k].set(value), found, one(k))

    return jax.lax.fori_loop(0, count, add, found)


def _of_one(scene: Scene, chosen: Chosen, names: tuple[str, ...]):
    """The function of one shape that gives its fields; what does not change is computed before."""
    elements = elements_of(scene)
    probes: dict[str, Any] = {}
    if {"N", "M"} & set(names):
        probes["forces"] = _turned(force_probe(scene, elements.section.matrix), chosen)
    for face in ("top", "bottom"):
        if f"stress {face}" in names:
            probes[f"stress {face}"] = _turned(stress_probe(scene, face), chosen)
    gauges = {name: gauge for name in names if (gauge := gauge_of(name)) is not None}
    probes |= {name: probe_of(scene, elements, gauge) for name, gauge in gauges.items()}

    def one(shape: Shape) -> dict[str, Array]:
        strains = jnp.mean(strains_at_points(scene, elements, shape), axis=1, keepdims=True)
        read = {name: probe(strains, shape.factors)[:, 0] for name, probe in probes.items()}
        found = {name: value for name, value in read.items() if name not in gauges and name != "forces"}
        found |= {name: picked(read[name], gauge) for name, gauge in gauges.items()}
        if "forces" in read:
            found |= {"N": read["forces"][:, :3], "M": read["forces"][:, 3:]}
        if chosen.axes == "global":
            found |= {name: _in_space(scene, shape, found[name]) for name in TENSORS if name in found}
        found |= _strains(scene, chosen, names, shape)
        if "rotation" in names:
            found["rotation"] = jax.vmap(rotations.log)(shape.rotations)
        if "normal" in names:
            found["normal"] = deformed_frames(scene, shape)[:, 2]
        if "element strain energy" in names:
            found["element strain energy"] = energies_of_elements(scene, shape)
        if "mesh error" in names:
            assert chosen.patches is not None  # found when it was chosen
            found["mesh error"] = local_in_shape(scene, shape, chosen.patches)
        for criterion, strengths in chosen.strengths.items():
            found[f"{FAILURE}{criterion}"] = index_in_shape(scene, shape, strengths, criterion, True)
        return {name: found[name] for name in names}

    return one


def _turned(probe, chosen: Chosen):
    return probe if chosen.angle is None else probe.turned(chosen.angle)


def _strains(scene: Scene, chosen: Chosen, names: tuple[str, ...], shape: Shape) -> dict[str, Array]:
    if not {"strain", "curvature"} & set(names):
        return {}
    both = strains_in_axes(scene, shape, chosen.angle, chosen.axes == "global", False)
    found = {"strain": jnp.mean(both.strain, axis=1), "curvature": jnp.mean(both.curvature, axis=1)}
    return {name: _six(value) if chosen.axes == "global" else value for name, value in found.items()}


def _in_space(scene: Scene, shape: Shape, plane: Float[Array, "m 3"]) -> Float[Array, "m 6"]:
    return _six(in_space(scene, shape, plane))


def _six(tensors: Float[Array, "m 3 3"]) -> Float[Array, "m 6"]:
    """The components of symmetric tensors in VTK's order."""
    return jnp.stack([tensors[:, i, j] for i, j in _SPACE], axis=1)


def check_one_run(solution, what: str) -> None:
    """Raise ValueError for a batch of solutions, made under `jax.vmap`."""
    if np.ndim(solution.times) != 1:
        raise ValueError(
            f"{what} takes the solution of one run, but its times have shape {np.shape(solution.times)}. "
            "Index the batch first."
        )
