"""`jaxshell init`: a scene file to start from, and the schema that editors check it by."""

import argparse
import json
import os
from importlib.resources import files
from pathlib import Path
from typing import Any

from jaxshell.command.start import prepare_jax

_SCHEMA = "scene.schema.json"
_LINE = f"#:schema ./{_SCHEMA}\n"
"""What Even Better TOML and taplo look for."""
_MOST = 8
"""Sets of one kind that stand in a comment one by one."""


def add(commands) -> None:
    init = commands.add_parser("init", help="write a scene file to start from, for a mesh file or as a template")
    init.set_defaults(command=_init)
    init.add_argument("file", nargs="?", type=Path, default=Path("scene.toml"), help="default: scene.toml")
    init.add_argument("--mesh", type=Path, metavar="FILE", help="of the shell in this mesh file, with its sets")
    init.add_argument("--no-schema", action="store_true", help=f"write no {_SCHEMA} beside it, which editors use")
    init.add_argument("--overwrite", action="store_true", help="replace files that are there")


def _init(options: argparse.Namespace) -> int:
    if options.file.suffix != ".toml":
        raise ValueError(f"A scene file's name ends with .toml, but it is {str(options.file)!r}.")
    _check_free(options.file, options.overwrite)
    if options.mesh is None:
        text = files("jaxshell.data").joinpath("scene.toml").read_text(encoding="utf-8")
    else:
        prepare_jax()
        text = _of_mesh(options.mesh, options.file.parent)
    options.file.parent.mkdir(parents=True, exist_ok=True)
    if not options.no_schema:
        from jaxshell.files.schema import schema_text

        schema, content = options.file.parent / _SCHEMA, schema_text()
        if not schema.exists() or schema.read_text(encoding="utf-8") != content:
            _check_free(schema, options.overwrite)
            schema.write_text(content, encoding="utf-8")
        text = _LINE + text
    options.file.write_text(text, encoding="utf-8")
    print(f"{options.file}: look at it with `jaxshell check {options.file}`, run it with `jaxshell run {options.file}`")
    return 0


def _check_free(path: Path, overwrite: bool) -> None:
    if os.path.lexists(path) and not overwrite:
        raise ValueError(f"{path} exists: choose another name, or replace it with --overwrite.")


def _of_mesh(path: Path, folder: Path) -> str:
    """A scene of a mesh file, whose sets are listed and used; its run finds frequencies, which every shell has."""
    import numpy as np

    mesh, reading = _read(path)
    x = np.asarray(mesh.nodes)
    low, high = x.min(axis=0), x.max(axis=0)
    axis = int(np.argmax(high - low))
    span = ", ".join(f"{name} {a:.6g} to {b:.6g}" for name, a, b in zip("xyz", low, high, strict=True))
    lines = [
        f"# The shell in {path.name}. Look at it with `jaxshell check`, run it with `jaxshell run`.",
        "# docs/scene_files.md has every table and key. Units are yours, any consistent set.",
        "",
        f"name = {_text(path.stem)}",
        '# units = "SI"              # puts s, m, J, ... on the pictures\' axes',
        "",
        "[mesh]",
        f"file = {_text(Path(os.path.relpath(path, folder)).as_posix())}",
        *reading,
        f"# {mesh.n_elements} triangles, {mesh.n_nodes} nodes; {span}",
        *(_listed(kind, getattr(mesh, f"{kind}_sets")) for kind in ("node", "element", "side")),
        "",
        "[section]                   # to be changed: these are of steel in SI units, 1 % of the shell's size thick",
        f"thickness = {float(np.linalg.norm(high - low)) / 100:.3g}",
        "young_modulus = 210e9",
        "poisson_ratio = 0.3",
        "density = 7800.0",
        "",
        "[[supports]]",
        *_support(mesh, "xyz"[axis], float(low[axis])),
        'hold = "clamped"            # or "pinned", "symmetry x", or a list such as ["ux", "uy", "rz"]',
        "",
        *_load(mesh),
        "",
        "[run]",
        'analysis = "modes"          # also "static", "arc-length", "buckling"; or in time, by method, dt and t_end',
        "",
    ]
    return "\n".join(line for line in lines if line is not None)


def _read(path: Path):
    """(the mesh, lines that say how it was read): as it is, or mended where only that makes a shell of it."""
    from jaxshell.model.mesh import Mesh

    first = None
    attempts: tuple[dict[str, Any], ...] = ({}, {"orient": True}, {"merge": 1e-6}, {"orient": True, "merge": 1e-6})
    for named in attempts:
        try:
            mesh = Mesh.read(path, **named)
        except ValueError as error:
            first = first or error
        else:
            return mesh, [f"{key} = {json.dumps(value)}" for key, value in named.items()]
    raise first or ValueError(f"{path} cannot be read.")


def _listed(kind: str, sets) -> str:
    if not sets:
        return f"# {kind} sets: none"
    named = [f"{_text(name)} ({len(numbers)})" for name, numbers in sets.items()]
    more = f", and {len(named) - _MOST} more" if len(named) > _MOST else ""
    return f"# {kind} sets: {', '.join(named[:_MOST])}{more}"


def _holds(name: str) -> bool:
    """Whether a set's name says that it is of supports."""
    return any(word in name.lower() for word in ("clamp", "fix", "support", "root", "hold"))


def _support(mesh, axis: str, least: float) -> list[str]:
    """The set of nodes whose name says so, else the first, or the nodes at the shell's end."""
    if mesh.node_sets:
        return [f"nodes = {_text(next(filter(_holds, mesh.node_sets), next(iter(mesh.node_sets))))}"]
    return [f"plane = {{ {axis} = {least!r} }}       # or nodes, nearest, box, boundary = true"]


def _load(mesh) -> list[str]:
    """A pressure on the first set of elements, a force on the first set of sides that is of no support."""
    lines = ["[[loads]]", 'kind = "pressure"           # also: force, moment, normal force, edge force, gravity']
    if mesh.element_sets:
        lines.append(f"elements = {_text(next(iter(mesh.element_sets)))}")
    lines.append("pressure = 1.0")
    free = [name for name in mesh.side_sets if not _holds(name)]
    if free:
        lines += ["", "[[loads]]", 'kind = "edge force"', f"edges = {_text(free[0])}"]
        lines.append("force = [0.0, 0.0, 1.0]     # per length")
    return lines


def _text(value: str) -> str:
    """A text as TOML writes it."""
    return json.dumps(value, ensure_ascii=False)
