"""`jaxshell import`: write the scene file of a model of another program, and list what is not in it."""

import argparse
from pathlib import Path

from jaxshell.command.start import prepare_jax


def add(commands) -> None:
    command = commands.add_parser("import", help="write the scene file of an Abaqus, CalculiX or Nastran model")
    command.set_defaults(command=_import)
    command.add_argument("model", type=Path, metavar="MODEL", help="an .inp, .bdf, .dat or .nas file")
    command.add_argument("scene", type=Path, metavar="SCENE.toml", help="the scene file to write")
    command.add_argument(
        "--partial", action="store_true", help="leave out also what the answer depends on, such as beams or masses"
    )
    command.add_argument(
        "--second-order",
        choices=("error", "split"),
        default="error",
        help="elements with nodes on their sides: refuse them, or cut them in triangles (default: error)",
    )
    command.add_argument("--overwrite", action="store_true", help="replace files that exist")


def _import(options: argparse.Namespace) -> int:
    prepare_jax()
    from jaxshell.files.models import draft_of, write_scene_file

    draft = draft_of(options.model, partial=options.partial, second_order=options.second_order)
    written = write_scene_file(draft, options.scene, overwrite=options.overwrite)
    print(f"{options.model}: {draft.mesh.n_elements} triangles, {draft.mesh.n_nodes} nodes")
    for what, number in draft.notes.carried.items():
        print(f"  {what}: {number}")
    for line in draft.notes.lines():
        print(f"  {line}")
    for path in written:
        print(f"  written: {path}")
    return 0
