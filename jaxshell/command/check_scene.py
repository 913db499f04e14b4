"""A scene in lines of text: mesh, sets, sections, mass, supports, loads, what is watched."""

import dataclasses
from collections.abc import Iterator

import numpy as np

from jaxshell.command.path_report import vector
from jaxshell.model.gauge import gauge_of
from jaxshell.model.history import History
from jaxshell.model.loads import InitialStrains, Load
from jaxshell.model.mechanisms import free_parts
from jaxshell.model.scene import Scene
from jaxshell.model.sections import AnySection, Laminate, Regions, Section
from jaxshell.model.supports import Support
from jaxshell.plotting.scene import held_as
from jaxshell.results.mass_properties import mass_properties
from jaxshell.results.nodal_loads import nodal_loads, resultant

_WIDTH = 15
_MOST = 12
"""Of sets, supports, loads so many are shown one by one."""


def entry(name: str, text: str) -> str:
    """A line of the report, its name in the first column."""
    return f"{name:{_WIDTH}}{text}"


def described_scene(scene: Scene) -> Iterator[str]:
    """All lines but those about the run."""
    held = len(scene.held_dofs)
    total = 6 * scene.mesh.n_nodes
    yield entry("scene", scene.name)
    yield entry(
        "mesh",
        f"{scene.mesh.n_elements} triangles, {scene.mesh.n_nodes} nodes, {total} degrees of freedom, "
        f"{total - held} unknowns",
    )
    yield from _geometry(scene)
    yield from _parts(scene)
    for what in ("node", "element", "side"):
        yield from _sets(what, getattr(scene.mesh, f"{what}_sets", {}))
    yield from _sections(scene)
    found = mass_properties(scene)
    yield entry("mass", f"{float(found.mass):.6g}, centre {vector(found.centre, _small(scene))}")
    yield from _supports(scene)
    yield from _loads(scene)
    yield from _items(scene)
    yield from _initial(scene)
    for label, number, component in scene.watch:
        if isinstance(number, str):
            yield entry("watched", f"{label}: {component} of {number!r}")
            continue
        kind = "node" if gauge_of(component) is None else "element"
        yield entry("watched", f"{label}: {component} of {kind} {number} at {_place(scene, kind, number)}")


def _small(scene: Scene) -> float:
    """A length that is nothing."""
    return 1e-12 * float(np.ptp(np.asarray(scene.mesh.nodes), axis=0).max())


def _geometry(scene: Scene) -> Iterator[str]:
    x = np.asarray(scene.mesh.nodes)
    corners = x[scene.mesh.triangles]
    edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    aspect = edges.max(axis=1) ** 2 / (2 * areas)
    span = (f"{axis} {low:.6g} to {high:.6g}" for axis, low, high in zip("xyz", x.min(0), x.max(0), strict=True))
    yield entry("extent", ", ".join(span) + f"; area {areas.sum():.6g}")
    yield entry("edges", f"{edges.min():.6g} (element {edges.min(axis=1).argmin()}) to {edges.max():.6g} "
                f"(element {edges.max(axis=1).argmax()})")  # fmt: skip
    yield entry("worst shape", f"element {aspect.argmax()}: longest edge {aspect.max():.3g} times its height")


def _parts(scene: Scene) -> Iterator[str]:
    """Loose parts, and the rigid motions that the supports leave to each."""
    parts = free_parts(scene)
    count = len(parts)
    if count > 1:
        yield entry("parts", f"{count}, which no triangle connects")
    for k, (members, motions) in enumerate(parts):
        who = "all of it" if count == 1 else f"part of {len(members)} nodes with node {members[0]}"
        if len(motions) == 6:
            yield entry("free motions", f"{who}: nothing holds it")
        elif motions:
            yield entry("free motions", f"{who}: {'; '.join(motions)}")
        if k == _MOST:
            yield entry("", f"and {count - k - 1} more parts")
            return


def _sets(what: str, sets) -> Iterator[str]:
    """Sets with their sizes, by name."""
    if sets:
        named = [f"{name} ({len(numbers)})" for name, numbers in sets.items()]
        more = f", and {len(named) - _MOST} more" if len(named) > _MOST else ""
        yield entry(f"{what} sets", ", ".join(named[:_MOST]) + more)


def _sections(scene: Scene) -> Iterator[str]:
    section = scene.section
    masses = np.asarray(section.area_masses(scene.mesh))
    if isinstance(section, Regions):
        for name, part, elements in zip(section.names, section.sections, section.elements, strict=True):
            of_part = masses[elements.array]
            yield entry("section", f"{name} ({elements.array.size} elements): {_section(part)}, {_per_area(of_part)}")
    else:
        yield entry("section", f"{_section(section)}, {_per_area(masses)}")


def _section(section: AnySection) -> str:
    if isinstance(section, Section):
        names = {"thickness": "thickness", "young_modulus": "E", "poisson_ratio": "ν", "density": "ρ"}
        return "isotropic, " + ", ".join(f"{text} {_range(getattr(section, name))}" for name, text in names.items())
    if isinstance(section, Laminate):
        copies = 2 if section.symmetric else 1
        total = copies * sum(np.asarray(ply.thickness) for ply in section.plies)
        return f"laminate of {copies * len(section.plies)} plies, thickness {_range(total)}"
    return section.kind


def _per_area(masses) -> str:
    return f"mass per area {_range(masses)}"


def _range(values) -> str:
    values = np.asarray(values)
    low, high = float(values.min()), float(values.max())
    return f"{low:.6g}" if np.isclose(low, high, rtol=1e-12) else f"{low:.6g} to {high:.6g}"


def _supports(scene: Scene) -> Iterator[str]:
    if not scene.supports:
        yield entry("supports", "none")
        return
    for support in scene.supports[:_MOST]:
        text = f"{held_as(support)}{_motion(support)}: {_count(support.nodes.array.size, 'node')}"
        yield entry("support", text + (f"; {history(support.history)}" if support.history is not None else ""))
    if len(scene.supports) > _MOST:
        yield entry("", f"and {len(scene.supports) - _MOST} more")
    nodes = len(np.unique(scene.held_dofs // 6))
    yield entry("held", f"{len(scene.held_dofs)} degrees of freedom of {_count(nodes, 'node')}")


def _motion(support: Support) -> str:
    """How far a support moves, and where."""
    if support.rotation is not None:
        centre = "" if support.about is None else f" through {vector(support.about)}"
        return f" by {float(np.asarray(support.angle)):.6g} rad about {vector(support.rotation)}{centre}"
    size = support.displacement if support.acceleration is None else support.acceleration
    return "" if size is None else f" by {_range(size)}"


def _loads(scene: Scene) -> Iterator[str]:
    if not scene.loads:
        yield entry("loads", "none")
        return
    total, found = np.zeros((scene.mesh.n_nodes, 6)), iter(nodal_loads(scene))
    for position, load in enumerate(scene.loads):
        if isinstance(load, InitialStrains):
            text = f"{load.kind} {_range(getattr(load, load.value))}"
        else:
            _, nodal = next(found)
            total += np.asarray(nodal)
            text = f"{_of(load)}: {_sum(scene, nodal)}"
        if position < _MOST:
            yield entry("load", f"{text}; {history(load.history)}")
    if len(scene.loads) > _MOST:
        yield entry("", f"and {len(scene.loads) - _MOST} more")
    if len(scene.loads) > 1:
        yield entry("all loads", f"{_sum(scene, total)} at factor 1")


def _items(scene: Scene) -> Iterator[str]:
    """Connectors and obstacles, with their numbers."""
    for what, items in (("connector", scene.connectors), ("obstacle", scene.obstacles)):
        for item in items[:_MOST]:
            groups = [part.groups(scene.mesh.triangles).array for part in item.parts()]
            named = "" if item.name is None else f" {item.name!r}"
            place = f": {_count(len(groups[0]), 'pair' if groups[0].shape[1] == 2 else 'node')}" if groups else ""
            values = ((f.name, getattr(item, f.name)) for f in dataclasses.fields(item))
            numbers = (f"{key.replace('_', ' ')} {_value(scene, value)}" for key, value in values if _is_number(value))
            yield entry(what, ", ".join([f"{item.kind}{named}{place}", *numbers]))
        if len(items) > _MOST:
            yield entry("", f"and {len(items) - _MOST} more")


def _is_number(value) -> bool:
    return hasattr(value, "dtype") and np.size(value) > 0


def _value(scene: Scene, value) -> str:
    """One vector, one number, or the range of several."""
    return vector(np.asarray(value), 0.0) if np.shape(value) == (3,) else _range(value)


def _initial(scene: Scene) -> Iterator[str]:
    """What differs from rest in the stress-free shape."""
    names = {"velocities": "velocity", "angular_velocities": "angular velocity", "displacements": "displacement"}
    for name, text in names.items():
        values = None if scene.initial is None else getattr(scene.initial, name)
        sizes = np.zeros(1) if values is None else np.linalg.norm(np.asarray(values), axis=1)
        if sizes.any():
            yield entry(
                "at the start", f"{text} up to {sizes.max():.6g} on {_count(int(np.count_nonzero(sizes)), 'node')}"
            )


def _of(load: Load) -> str:
    edges, nodes = getattr(load, "edges", None), getattr(load, "nodes", None)
    if edges is not None:
        return f"{load.kind} on {_count(len(edges.array), 'edge')}"
    return load.kind if nodes is None else f"{load.kind} on {_count(nodes.array.size, 'node')}"


def _sum(scene: Scene, nodal) -> str:
    """The resultant of nodal forces and moments; what is round-off beside them is zero."""
    force, moment = resultant(scene.mesh.nodes, nodal)
    size = float(np.ptp(np.asarray(scene.mesh.nodes), axis=0).max())
    largest = float(np.abs(np.asarray(nodal)[:, :3]).sum())
    turning = float(np.abs(np.asarray(nodal)[:, 3:]).sum())
    return f"force {vector(force, 1e-9 * largest)}, moment about the origin " + vector(
        moment, 1e-9 * (largest * size + turning)
    )


def history(of: History) -> str:
    """How a load varies in time."""
    times, values = np.asarray(of.times), np.asarray(of.values)
    if len(values) == 1 or np.all(values == values[0]):
        return "constant" if values[0] == 1 else f"constant, factor {values[0]:.6g}"
    if len(values) == 2 and values[0] == 0 and times[0] == 0:
        return f"ramp to factor {values[1]:.6g} at t = {times[1]:.6g}"
    return (
        f"{len(times)} times from {times[0]:.6g} to {times[-1]:.6g}, factors {values.min():.6g} to {values.max():.6g}, "
        f"{values[-1]:.6g} at the end"
    )


def _place(scene: Scene, kind: str, number: int) -> str:
    nodes = np.asarray(scene.mesh.nodes)
    return vector(nodes[number] if kind == "node" else nodes[scene.mesh.triangles[number]].mean(axis=0), _small(scene))


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
