"""Malformed scene files, mesh files and calls, each made by a random generator and tried: what tests/fuzz.py tries."""

import contextlib
import io
import math
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import jax
import numpy as np
from mesh_texts import BDF, GMSH22, INP, OBJ, PARTS, POLYDATA

jax.config.update("jax_enable_x64", True)

import jaxshell as js  # noqa: E402
from jaxshell import scenes  # noqa: E402
from jaxshell.command.analyses import path_analysis  # noqa: E402
from jaxshell.command.run_settings import arguments_of_simulate, chosen_methods  # noqa: E402
from jaxshell.files.run_keys import RunSettings  # noqa: E402
from jaxshell.files.scene_file import read_scene_file  # noqa: E402
from jaxshell.model import generators  # noqa: E402


class Reached(Exception):
    """A run got past its checks."""


class NotFinite(Exception):
    """Something was accepted that holds NaN or infinity."""


def check_finite(made: Any) -> None:
    for leaf in jax.tree.leaves(made):
        if isinstance(leaf, float | np.ndarray | jax.Array) and not np.all(
            np.isfinite(leaf) | (np.asarray(leaf) == np.inf)
        ):
            raise NotFinite(f"a {type(made).__name__} that holds NaN was accepted")
        if not isinstance(made, js.StepControl) and not np.all(np.isfinite(leaf)):
            raise NotFinite(f"a {type(made).__name__} that is not finite was accepted")


# --- wrong values ----------------------------------------------------------------------------------------


def wrong_number(random: Random) -> Any:
    return random.choice(
        [math.nan, math.inf, -math.inf, 0, -1, -2.5, 1e308, -1e308, 5e-324, 1e-200, 1e200, 10**30, 10**400]
    )


def wrong_plain(random: Random) -> Any:
    """A value that a TOML file can hold."""
    deep: Any = 1.0
    for _ in range(random.choice([3, 30, 200])):
        deep = [deep]
    return random.choice(
        [
            wrong_number(random), wrong_number(random), True, False, "", "a", "0.1", "nan", "../../x", "\0", "é" * 300, "$x_",
            [], [[]], [True], ["a"], [math.nan], [[math.nan]], [1, 2], [0.1, 0.2, 0.3], [[1, 2], [3]], [1, [2]],
            [[0, 0, 0], [1, 1, 1]], [30000, 30000], [10**12, 10**12], {}, {"a": 1}, {"x": math.nan}, [{}], deep, 3, 1e-12,
            [0, 0, "z"], [math.inf, 0, 0], [-1], [10**30], 0.5,
        ]
    )  # fmt: skip


def wrong_value(random: Random) -> Any:
    """Any Python value."""
    if random.random() < 0.6:
        return wrong_plain(random)
    return random.choice(
        [
            None, object(), 1j, b"x", len, {1}, np.zeros(0), np.zeros((2, 0)), np.array(["a"]), np.array([True]),
            np.array([1j]), np.array(math.nan), np.full((3, 3), math.nan), np.array([None]), np.zeros((2, 2, 2)),
            js.History.ramp(1.0), MESH, np.float32(math.inf), np.datetime64("2020"), np.ones(3), np.ones((4, 3)), range(3),
            [None], [object()], [np.zeros(2), np.zeros(3)], jax.numpy.array([math.nan]), jax.numpy.array(True), Ellipsis,
        ]
    )  # fmt: skip


def changed(random: Random, value: Any, wrong: Callable[[Random], Any]) -> Any:
    """`value` with a part of it, or all of it, replaced, dropped or said twice."""
    if isinstance(value, list) and value and random.random() < 0.6:
        value, at = list(value), random.randrange(len(value))
        how = random.random()
        if how < 0.15:
            del value[at]
        elif how < 0.25:
            value.insert(at, value[at])
        else:
            value[at] = changed(random, value[at], wrong)
        return value
    return wrong(random)


# --- scene files -----------------------------------------------------------------------------------------

SECTION = {"thickness": 0.1, "young_modulus": 1e6, "poisson_ratio": 0.3, "density": 1.0}
FILES: list[dict] = [
    {
        "name": "one",
        "units": "SI",
        "mesh": {"generator": "rectangle", "length": 4.0, "width": 2.0, "divisions": [4, 2]},
        "section": SECTION,
        "supports": [
            {"plane": {"x": 0.0}, "hold": "clamped"},
            {"nodes": [14], "hold": ["uz"], "displacement": 0.5, "history": {"times": [0.0, 1.0], "values": [0.0, 1.0]}},
        ],
        "loads": [
            {"kind": "force", "nearest": [4.0, 1.0, 0.0], "force": [0.0, 0.0, 1.0], "history": {"ramp": 1.0}},
            {"kind": "edge force", "plane": {"x": 4.0}, "force": [0.0, 2.0, 0.0]},
            {"kind": "pressure", "pressure": 3.0},
        ],
        "watch": {"tip": {"nearest": [4.0, 1.0, 0.0], "component": "uz"}, "foot": {"node": 3, "component": "vx"}},
        "initial": {"velocity": [1.0, 0.0, 0.0], "angular_velocity": [0.0, 0.0, 1.0], "about": [0.0, 0.0, 0.0]},
        "run": {"method": "EMC", "dt": 0.01, "t_end": 1.0, "save_every": 2, "newton_tolerance": 1e-8, "newton_reuse": False,
                "picture_times": [0.0, 0.5], "dissipation": 0.1, "reactions": True},
    },
    {
        "mesh": {"generator": "cylinder", "radius": 1.0, "length": 2.0, "divisions": [2, 6], "angle": 360.0},
        "section": {"kind": "isotropic", **SECTION},
        "supports": [{"boundary": True, "box": [[0.0, -9.0, -9.0], [0.0, 9.0, 9.0]], "hold": "pinned"}],
        "loads": [{"kind": "gravity", "acceleration": [0.0, 0.0, -9.81]}, {"kind": "normal force", "nodes": [1], "magnitude": 1.0},
                  {"kind": "moment", "nodes": [2, 3], "moment": [0.0, 0.0, 1.0]}],
        "run": {"method": ["Newmark"], "beta": 0.3, "gamma": 0.55, "dt": 0.01, "t_end": 1.0, "step_tolerance": 1e-3,
                "step_smallest": 1e-4, "step_largest": 0.1, "step_output_interval": 0.1, "step_horizon": 1.0},
    },
    {"mesh": {"generator": "spherical_cap", "radius": 1.0, "half_angle": 30.0, "divisions": 2}, "section": SECTION,
     "run": {"method": ["exact"], "dt": 0.1, "t_end": 1.0, "linear_solver": "dense", "tangent": "autodiff"}},
    {"mesh": {"generator": "spherical_zone", "radius": 1.0, "top": 20.0, "bottom": 60.0, "divisions": [6, 2]}, "section": SECTION},
    {
        "mesh": {"generator": "rectangle", "length": 4.0, "width": 2.0, "divisions": [2, 1],
                 "element_sets": {"skin": [0, 1], "rib": {"box": [[2.0, 0.0, 0.0], [4.0, 2.0, 0.0]]}}},
        "materials": {
            "carbon": {"young_modulus_1": 1e6, "young_modulus_2": 1e5, "poisson_ratio_12": 0.3, "shear_modulus_12": 5e4,
                       "density": 1.0, "expansion_2": 1e-5},
            "steel": {"kind": "isotropic", "young_modulus": 2e6, "poisson_ratio": 0.3, "density": 7.0}},
        "section": [
            {"elements": "skin", "kind": "laminate", "layup": "[45/-45/0_2/90]2s", "material": "carbon", "ply_thickness": 0.01,
             "direction": [1.0, 0.0, 0.0], "offset": 0.01},
            {"elements": {"box": [[2.0, 0.0, 0.0], [4.0, 2.0, 0.0]]}, "kind": "laminate", "symmetric": True,
             "direction": {"axis": [0.0, 1.0, 0.0], "origin": [0.0, 0.0, 5.0], "along": "circumference"},
             "plies": [{"material": "steel", "thickness": 0.1, "angle": 30.0}, {"material": "carbon", "thickness": 0.1}]}],
        "thermal": [{"temperature": 10.0, "gradient": 1.0, "history": {"ramp": 1.0}}],
        "initial_strain": [{"strain": [1e-3, 0.0, 0.0], "curvature": [0.0, 0.1, 0.0], "direction": [0.0, 1.0, 0.0]}],
        "run": {"method": "exact", "dt": 0.01, "t_end": 1.0},
    },
    {
        "mesh": {"generator": "rectangle", "length": 4.0, "width": 2.0, "divisions": [2, 1]},
        "section": {"kind": "general", "A": [[2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.0]],
                    "B": [[0.1, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]], "mass_per_area": 1.0,
                    "D": [[2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.0]], "rotary_inertia": 0.1, "first_moment": 0.01},
    },
    {
        "mesh": {"generator": "rectangle", "length": 4.0, "width": 2.0, "divisions": [4, 2],
                 "node_sets": {"root": {"plane": {"x": 0.0}}, "tip": [12, 13, 14]}, "element_sets": {"skin": [0, 1, 2]},
                 "side_sets": {"rib": {"plane": {"x": 2.0}, "inner": True}, "end": [[12, 13], [13, 14]]}},
        "section": SECTION,
        "supports": [{"nodes": "root", "hold": "clamped"}],
        "loads": [{"kind": "edge force", "edges": "rib", "force": [0.0, 0.0, 1.0]},
                  {"kind": "edge force", "plane": {"x": 1.0}, "inner": True, "force": [0.0, 0.0, 1.0]},
                  {"kind": "pressure", "elements": "skin", "pressure": 1.0}],
        "initial": [{"nodes": "tip", "velocity": [0.0, 0.0, 1.0]}, {"nodes": [0], "angular_velocity": [0.0, 1.0, 0.0]}],
        "run": {"analysis": "static", "load_factors": [0.5, 1.0], "branch": "follow", "newton_tolerance": 1e-10},
    },
    {"mesh": {"generator": "rectangle", "length": 4.0, "width": 2.0, "divisions": [2, 1]}, "section": SECTION,
     "supports": [{"plane": {"x": 0.0}, "hold": "clamped"}], "loads": [{"kind": "gravity", "acceleration": [0.0, 0.0, 1.0]}],
     "run": {"analysis": "arc-length", "arc_length": 0.1, "max_steps": 3, "max_load_factor": 2.0, "tangent": "autodiff"}},
    {"mesh": {"generator": "rectangle", "length": 4.0, "width": 2.0, "divisions": [2, 1]}, "section": SECTION,
     "run": {"analysis": "modes", "count": 3, "rigid_modes": False, "preload": 0.5}},
    {"mesh": {"file": "sheet.vtk", "quads": "split", "second_order": "split", "merge": 1e-6, "orient": True, "coincident": "error"}, "section": SECTION},
]  # fmt: skip


def toml(value: Any) -> str:
    """A value as TOML writes it, tables inline."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return '"' + "".join(c if c.isprintable() and c not in '"\\' else f"\\u{ord(c):04x}" for c in value) + '"'
    if isinstance(value, dict):
        return "{" + ", ".join(f"{toml(key)} = {toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return repr(value)


def mutated(random: Random, content: dict) -> tuple[dict, list[str]]:
    """A file's content with a value changed, left out or added, and the keys that lead there."""
    content, keys, at = dict(content), [], None
    at = content
    while True:
        key = random.choice(list(at)) if isinstance(at, dict) else random.randrange(len(at))
        keys.append(key)
        inner = at[key]
        if isinstance(inner, dict | list) and inner and random.random() < 0.85 and not _numeric(inner):
            at[key] = at = dict(inner) if isinstance(inner, dict) else list(inner)
            continue
        how = random.random()
        if how < 0.08:
            del at[key]
        elif how < 0.16 and isinstance(at, dict):
            keys.append("colour")
            at["colour"] = wrong_plain(random)
        else:
            at[key] = changed(random, inner, wrong_plain)
        return content, [key for key in keys if isinstance(key, str)]


def _numeric(value) -> bool:
    return isinstance(value, list) and all(isinstance(item, int | float | str | list) for item in value)


def damaged(random: Random, text: str) -> bytes:
    """A file's text cut short, with bytes of its own, lines twice, or nested beyond reason."""
    how = random.randrange(5)
    data = text.encode()
    at = random.randrange(len(data) + 1)
    if how == 0:
        return data[:at]
    if how == 1:
        return data[:at] + random.randbytes(random.randrange(1, 9)) + data[at:]
    if how == 2:
        lines = text.splitlines()
        line = random.randrange(len(lines))
        return "\n".join(lines[:line] + [lines[line]] * 2 + lines[line:]).encode()
    if how == 3:
        return data + b"\nx = " + random.choice([b"[", b"{a = "]) * random.choice([10, 1000, 20000])
    flipped = bytearray(data)
    for _ in range(random.randrange(1, 6)):
        flipped[random.randrange(len(flipped))] = random.randrange(32, 127)
    return bytes(flipped)


def try_scene_file(random: Random, folder: Path) -> tuple[str, list[str]]:
    """Read one malformed scene file, and settle how it would be run."""
    file = folder / "scene.toml"
    content, keys = dict(random.choice(FILES)), []
    for _ in range(random.choice([1, 1, 2])):
        content, more = mutated(random, content)
        keys += more
        if not content:
            break
    text = "\n".join(f"{toml(key)} = {toml(value)}" for key, value in content.items())
    if random.random() < 0.2:
        file.write_bytes(damaged(random, text))
        keys = ["scene.toml"]
    else:
        file.write_text(text, encoding="utf-8")
    words = [*keys, "scene.toml"]
    scene, settings = read_scene_file(file)
    check_finite(scene)
    if settings.analysis in ("static", "arc-length") and scene.mesh.n_elements < 200:
        solve, asked = path_analysis(RunSettings(save_every=1) | settings)
        _reach(solve, scene, **asked)
        return text, words
    methods = chosen_methods(settings, scene)
    if settings.dt is not None and settings.t_end is not None and scene.mesh.n_elements < 200:
        arguments = arguments_of_simulate(RunSettings(save_every=1) | settings)
        for method in methods.values():
            _reach(js.simulate, scene, method, t_end=settings.t_end, **arguments)
    return text, words


# --- mesh files ------------------------------------------------------------------------------------------


def try_mesh_file(random: Random, folder: Path) -> tuple[str, list[str]]:
    """Read a mesh file that is damaged, empty, of another kind, or of cells that are no shell."""
    options = {"merge": random.choice([None, 1e-9, math.nan, "a"]), "orient": random.choice([True, False])}
    if random.random() < 0.5:
        suffix, text = random.choice(list(MESHES.items()))
        file = folder / f"broken{suffix}"
        file.write_bytes(damaged(random, text))
        check_finite(js.Mesh.read(file, second_order="split", **options))
        return f"{file.name}: {file.read_bytes()!r}", [file.name, "merge", "tolerance"]
    return _try_written_mesh_file(random, folder, options)


MESHES = {".msh": GMSH22, ".inp": INP + PARTS, ".bdf": BDF, ".vtk": POLYDATA, ".obj": OBJ}


def _try_written_mesh_file(random: Random, folder: Path, options: dict) -> tuple[str, list[str]]:
    import meshlane

    suffix = random.choice(
        [".vtk", ".msh", ".stl", ".inp", ".obj", ".off", ".ply", ".vtu", ".xyz", ".med", ".bdf", ".h5", ""]
    )
    file = folder / f"broken{suffix}"
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0]])
    cells = random.choice(
        [
            {"triangle": [[0, 1, 2], [0, 2, 3]], "quad": [[1, 4, 5, 2]]}, {"quad": [[0, 1, 2, 3]]}, {"line": [[0, 1]]},
            {"tetra": [[0, 1, 2, 3]]}, {"triangle6": [[0, 1, 2, 3, 4, 5]]}, {"triangle": [[0, 1, 2], [0, 2, 9]]},
            {"triangle": [[0, 1, 1]]}, {"triangle": [[0, 1, 2], [0, 3, 2]]}, {"vertex": [[0]], "triangle": [[0, 1, 2]]},
        ]
    )  # fmt: skip
    good = folder / f"good{suffix}"
    data = b""
    silence = contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO())
    try:
        with silence[0], silence[1]:
            meshlane.write(good, meshlane.Mesh(points, {kind: np.array(cell) for kind, cell in cells.items()}))
        data = good.read_bytes()
    except (Exception, SystemExit):  # meshlane does not write all of it in all formats
        data = b"solid x\n" if random.random() < 0.5 else b""
    if random.random() < 0.7:
        data = damaged(random, data.decode("latin-1") or "x").decode("utf-8", "ignore").encode("latin-1", "ignore")
    file.write_bytes(data)
    mesh = js.Mesh.read(file, **options)
    check_finite(mesh)
    return f"{file.name}: {data[:300]!r}", [file.name, "merge", "tolerance"]


# --- calls -----------------------------------------------------------------------------------------------

NODES = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]
TRIANGLES = [[0, 1, 2], [0, 2, 3]]
MESH = js.Mesh(NODES, TRIANGLES)
RAMP = js.History.ramp(1.0)
PLAIN = js.Section(**SECTION)
ORTHOTROPIC = dict(zip(("young_modulus_1", "young_modulus_2", "poisson_ratio_12", "shear_modulus_12", "density"),
                       (1e6, 1e5, 0.3, 5e4, 1.0), strict=True))  # fmt: skip
PLY = js.Ply(js.Orthotropic(**ORTHOTROPIC), 0.1)
EYE = np.eye(3).tolist()
SUPPORTED = js.Scene(MESH, PLAIN, [js.clamped([0, 3])], [js.NodalForce([1], [0.0, 0.0, 1.0])])
UP = [0.0, 0.0, 1.0]


def _reach(run: Callable, *arguments: Any, **named: Any) -> None:
    with contextlib.suppress(Reached):
        run(*arguments, **named)


def _simulate(**named: Any) -> None:
    _reach(js.simulate, **named)


CALLS: dict[str, tuple[Callable, dict[str, Any]]] = {
    "Mesh": (js.Mesh, {"nodes": NODES, "triangles": TRIANGLES, "coincident": "error"}),
    "Mesh.merged": (js.Mesh.merged, {"nodes": NODES, "triangles": TRIANGLES, "tolerance": 1e-3, "orient": True}),
    "Mesh.oriented": (js.Mesh.oriented, {"nodes": NODES, "triangles": TRIANGLES, "coincident": "error"}),
    "Mesh.read": (js.Mesh.read, {"path": "none.vtk", "quads": "split", "second_order": "error", "merge": 1e-3, "orient": True}),
    "nearest_node": (MESH.nearest_node, {"point": UP}),
    "nodes_where": (MESH.nodes_where, {"condition": lambda x: x[0] == 0}),
    "Section": (js.Section, SECTION),
    "Orthotropic": (js.Orthotropic, ORTHOTROPIC),
    "Isotropic": (js.Isotropic, {"young_modulus": 1e6, "poisson_ratio": 0.3, "density": 1.0, "expansion": 1e-5}),
    "Ply": (js.Ply, {"material": js.Orthotropic(**ORTHOTROPIC), "thickness": 0.1, "angle": 30.0}),
    "Laminate": (js.Laminate, {"plies": [PLY], "direction": UP, "offset": 0.1, "symmetric": True}),
    "Laminate.from_layup": (js.Laminate.from_layup, {"layup": "[0/90_2/±45]2s", "material": PLY.material, "ply_thickness": 0.1,
                                                     "direction": js.Cylindrical(UP), "offset": 0.1}),
    "Cylindrical": (js.Cylindrical, {"axis": UP, "origin": UP, "along": "axis"}),
    "GeneralSection": (js.GeneralSection, {"A": EYE, "B": (0.1 * np.eye(3)).tolist(), "D": EYE, "mass_per_area": 1.0,
                                           "rotary_inertia": 0.1, "first_moment": 0.1, "thermal": EYE, "direction": UP}),
    "Thermal": (js.Thermal, {"temperature": 1.0, "gradient": 0.1, "history": RAMP}),
    "InitialStrain": (js.InitialStrain, {"strain": UP, "curvature": UP, "history": RAMP, "direction": UP}),
    "History": (js.History, {"times": [0.0, 1.0], "values": [0.0, 1.0]}),
    "History.ramp": (js.History.ramp, {"end": 1.0}),
    "NodalForce": (js.NodalForce, {"nodes": [1, 2], "force": UP, "history": RAMP}),
    "NodalMoment": (js.NodalMoment, {"nodes": [1], "moment": [UP], "history": RAMP}),
    "EdgeForce": (js.EdgeForce, {"edges": [[1, 2]], "force": UP, "history": RAMP}),
    "Gravity": (js.Gravity, {"acceleration": UP, "history": RAMP}),
    "Pressure": (js.Pressure, {"pressure": 1.0, "history": RAMP}),
    "NormalForce": (js.NormalForce, {"nodes": [1], "magnitude": 1.0, "history": RAMP}),
    "Support": (js.Support, {"nodes": [0], "dofs": ["ux", "uz"], "displacement": [0.1, 0.2], "history": RAMP}),
    "clamped": (js.clamped, {"nodes": [0, 3]}),
    "symmetry": (js.symmetry, {"nodes": [0], "normal": "x"}),
    "Initial": (js.Initial, {"velocities": NODES, "angular_velocities": NODES, "displacements": NODES,
                             "rotations": np.tile(np.eye(3), (4, 1, 1)).tolist()}),
    "Initial.rigid": (js.Initial.rigid, {"mesh": MESH, "velocity": UP, "angular_velocity": UP, "about": UP}),
    "Scene": (js.Scene, {"mesh": MESH, "section": PLAIN, "supports": [js.clamped([0])], "loads": [js.Gravity(UP)],
                         "initial": js.Initial(NODES), "name": "s", "watch": {"tip": (1, "uz")}}),
    "rectangle": (generators.rectangle, {"length": 2.0, "width": 1.0, "divisions": [2, 1]}),
    "cylinder": (generators.cylinder, {"radius": 2.0, "length": 1.0, "divisions": [1, 3], "angle": 360.0}),
    "spherical_cap": (generators.spherical_cap, {"radius": 2.0, "half_angle": 30.0, "divisions": 2}),
    "spherical_zone": (generators.spherical_zone, {"radius": 2.0, "top": 10.0, "bottom": 30.0, "divisions": [3, 1]}),
    "scenes.spherical_cap": (scenes.spherical_cap, {"divisions": 2, "force": 1.0, "thickness": 0.001}),
    "scenes.opened_cap": (scenes.opened_cap, {"divisions": [3, 1], "force": 1.0}),
    "scenes.hemisphere": (scenes.hemisphere, {"divisions": [2, 2], "force": 1.0}),
    "Newton": (js.Newton, {"tolerance": 1e-8, "max_iterations": 9, "max_rotation": 0.3, "reuse": True, "criterion": "norm"}),
    "StepControl": (js.StepControl, {"tolerance": 1e-3, "initial": 0.1, "smallest": 0.01, "largest": 1.0,
                                     "output_interval": 0.5, "horizon": 1.0}),
    "GeneralizedEnergyMomentum": (js.GeneralizedEnergyMomentum, {"spectral_radius": 0.9, "dissipation": 0.1,
                                  "initial_acceleration": "zero", "inertia": "none"}),
    "EnergyMomentum": (js.EnergyMomentum, {"dissipation": 0.1}),
    "Newmark": (js.Newmark, {"beta": 0.25, "gamma": 0.5}),
    "HHT": (js.HHT, {"alpha": -0.1}),
    "GeneralizedAlpha": (js.GeneralizedAlpha, {"spectral_radius": 0.8}),
    "CentralDifference": (js.CentralDifference, {"safety": 0.9, "rotary": "scaled"}),
    "simulate": (_simulate, {"scene": SUPPORTED, "method": js.Newmark(), "dt": 0.1, "t_end": 1.0, "newton": js.Newton()}),
    "simulate, controlled": (_simulate, {"scene": SUPPORTED, "method": js.Newmark(), "dt": js.StepControl(1e-3, 0.1), "t_end": 1.0}),
    "simulate, steps": (_simulate, {"scene": SUPPORTED, "method": js.Newmark(), "dt": [0.1, 0.2]}),
}  # fmt: skip
GENERATORS = ("rectangle", "cylinder", "spherical_cap", "spherical_zone")
ALIASES = {
    "triangles": ("triangle",), "nodes": ("node", "triangle", "sliver", "force", "moment", "magnitude"), "thickness": ("thickness",), "edges": ("edge",),
    "condition": ("nodes_where",), "end": ("ramp", "history"), "dofs": ("support holds", "degree of freedom", "support must hold", "displacement"), "times": ("history",),
    "values": ("history",), "magnitude": ("normal force",), "supports": ("support",), "loads": ("load",), "normal": ("normal",),
    "top": ("angles",), "bottom": ("angles",), "initial": ("initial",), "smallest": ("initial",), "largest": ("initial",),
    "path": ("mesh file", "file", "is no"), "beta": ("beta",), "gamma": ("beta",), "velocities": ("initial",), "merge": ("tolerance",),
    "tolerance": ("merging",), "dt": ("stepcontrol", "step", "t_end"),
}  # fmt: skip


def try_call(random: Random, _: Path) -> tuple[str, list[str]]:
    """Make one object, or begin one run, with one or two arguments that are wrong."""
    name = random.choice(list(CALLS))
    make, good = CALLS[name]
    named, words = dict(good), []
    for _ in range(random.choice([1, 1, 1, 2])):
        key = random.choice(list(good))
        named[key] = changed(random, named[key], wrong_value)
        words += [key, *ALIASES.get(key, ())]
    if name == "Mesh.read" or name in GENERATORS:  # whose file there is not, whose triangles vanish
        words += ["none.vtk", "Triangle"]
    latest[:] = [f"{name}({', '.join(f'{key}={_text(named[key])}' for key in words if key in named)})"]
    latest.append(words)
    check_finite(make(**named))
    return latest[0], words


latest: list = []
"""The call that is being tried, for the report of its failure."""


def _text(value: Any) -> str:
    try:
        return repr(value)[:120]
    except Exception:
        return f"a {type(value).__name__}"
