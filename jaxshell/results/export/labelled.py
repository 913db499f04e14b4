"""A solution as labelled arrays: an `xarray.Dataset` of histories and frames."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxshell.results.export.fields import Evaluator, check_one_run, choose, thickness
from jaxshell.results.export.histories import histories, times_are, watched
from jaxshell.results.export.units import unit
from jaxshell.results.hdf5 import result_name
from jaxshell.results.solution import Solution

_COORDINATES = ("watched_component", "watched_number", "watched_units", "held_node", "held_dof", "position")
"""Besides those that number or name the entries of a dimension."""
_WATCHED = "node or element, or the name of a connector or an obstacle"
NODAL = ("displacement", "rotation", "velocity")


def to_xarray(solution: Solution, fields: Any = NODAL, *, axes: Any = "global", failure: Mapping | None = None):
    """The solution as an `xarray.Dataset`; see `Solution.to_xarray`."""
    try:
        import xarray
    except ImportError as error:
        raise ImportError("to_xarray needs xarray: pip install xarray") from error
    check_one_run(solution, "to_xarray")
    variables = _mesh(solution) | _histories(solution) | _frames(solution, fields, axes, failure)
    about = {
        "scene": solution.scene.name,
        "analysis": solution.analysis,
        "result": result_name(solution.result),
        "message": solution.message,
        "method": str(solution.stats.get("method", "")),
    }
    labelled = xarray.Dataset(variables, attrs=about)
    return labelled.set_coords([name for name in _COORDINATES if name in variables])


def _item(solution: Solution, dims, values, quantity: str, says: str) -> tuple:
    """What xarray makes a variable of: dimensions, values, attributes."""
    attributes = {"long_name": says}
    if found := unit(solution.scene, quantity):
        attributes["units"] = found
    return dims, np.asarray(values), attributes


def _mesh(solution: Solution) -> dict[str, tuple]:
    mesh = solution.scene.mesh
    found = {
        "node": ("node", np.arange(mesh.n_nodes)),
        "element": ("element", np.arange(mesh.n_elements)),
        "xyz": ("xyz", ["x", "y", "z"]),
        "position": _item(solution, ("node", "xyz"), mesh.nodes, "length", "nodes of the mesh"),
        "triangles": (("element", "corner"), np.asarray(mesh.triangles), {"long_name": "nodes of the elements"}),
    }
    for what, sets, count in (("element", mesh.element_sets, mesh.n_elements), ("node", mesh.node_sets, mesh.n_nodes)):
        for name, numbers in sets.items():
            inside = np.isin(np.arange(count), numbers)
            found[f"{what}_set_{name}"] = (what, inside, {"long_name": f"in the set of {what}s {name!r}"})
    return found


def _histories(solution: Solution) -> dict[str, tuple]:
    scene, times = solution.scene, times_are(solution)
    found = {
        "time": _item(solution, "time", solution.times, times, times),
        "frame_time": _item(solution, "frame_time", solution.frame_times, times, f"{times} of the frames"),
    }
    for name, (values, quantity) in histories(solution).items():
        dims = ("time", "xyz") if np.ndim(values) == 2 else ("time",)
        found[name.replace(" ", "_")] = _item(solution, dims, values, quantity, name)
    found["iterations"] = ("time", np.asarray(solution.iterations), {"long_name": "Newton iterations of the step"})
    if solution.stable is not None:
        found["stable"] = ("time", np.asarray(solution.stable), {"long_name": "the equilibrium is stable"})
    if solution.reaction is not None:
        found |= {
            "held_node": ("held", scene.held_dofs // 6),
            "held_dof": ("held", np.array(["ux", "uy", "uz", "rx", "ry", "rz"])[scene.held_dofs % 6]),
            "reaction": (
                ("time", "held"),
                np.asarray(solution.reaction),
                {"long_name": "force or moment of the support"},
            ),
        }
    if scene.watch:
        labels, numbers, components = zip(*scene.watch, strict=True)
        named = any(isinstance(number, str) for number in numbers)
        units = [unit(scene, history.quantity) for history in watched(solution).values()]
        found |= {
            "watch": ("watch", list(labels)),
            "watched_number": ("watch", [*map(str, numbers)] if named else list(numbers), {"long_name": _WATCHED}),
            "watched_component": ("watch", list(components)),
            "watched": (
                ("watch", "time"),
                np.stack([np.asarray(solution.watched[label]) for label in labels]),
                {"long_name": "what the scene watches"},
            ),
        }
        if any(units):
            found["watched_units"] = ("watch", units)
    return found


def _frames(solution: Solution, fields, axes, failure) -> dict[str, tuple]:
    scene = solution.scene
    chosen = choose(scene, fields, axes, failure)
    evaluate = Evaluator(scene, chosen, solution.analysis == "static")
    count = len(solution.frame_times)
    counts = {"node": scene.mesh.n_nodes, "element": scene.mesh.n_elements}
    values = {name: np.empty((count, counts[chosen.place(name)], *chosen.shape(name))) for name in chosen.changing}
    for start in range(0, count, evaluate.most):
        numbers = np.arange(start, min(start + evaluate.most, count))
        part = evaluate(np.asarray(solution.frame_times)[numbers], solution.frame(numbers.tolist()))
        for name, found in part.items():
            values[name][numbers] = found
    items = {}
    for name, found in values.items():
        components = chosen.components(name)
        dims = ("frame_time", chosen.place(name))
        if components == ("x", "y", "z"):
            dims = (*dims, "xyz")
        elif components:
            dims = (*dims, f"component_{len(components)}")
            items[dims[-1]] = (dims[-1], list(components))
        items[_python_name(name)] = _item(solution, dims, found, chosen.quantity(name), chosen.says(name))
    if "thickness" in chosen.names:
        items["thickness"] = _item(solution, "element", thickness(scene), "length", "thickness")
    return items


def _python_name(name: str) -> str:
    """A field's name without spaces and signs."""
    return name.replace(" ", "_").replace("-", "_")
