"""`jaxshell check`: what a scene is, and what its run would be, before anything of it is run."""

import argparse
import sys
from pathlib import Path

from jaxshell.command.run_settings import one_thread_for_small_meshes, open_scene
from jaxshell.command.start import prepare_jax


def add(commands) -> None:
    check = commands.add_parser("check", help="look at a scene before it is run: sizes, supports, loads, frequencies")
    check.set_defaults(command=_check)
    check.add_argument("scene", metavar="SCENE", help="a scene's name (see `jaxshell scenes`), a .toml or .h5 file")
    check.add_argument(
        "--divisions", type=int, nargs="+", metavar="N", help="divisions of the mesh (library scenes only)"
    )
    check.add_argument("--frequencies", type=int, default=6, metavar="N", help="how many to look for (default: 6)")
    check.add_argument("--output", type=Path, default=Path("."), metavar="DIR", help="where the picture goes")
    check.add_argument("--no-plots", action="store_true", help="draw no picture")


def _check(options: argparse.Namespace) -> int:
    one_thread_for_small_meshes(options.scene, options.divisions)
    prepare_jax()
    from jaxshell.command.check_run import described_run
    from jaxshell.command.check_scene import described_scene

    if options.frequencies < 0:
        raise ValueError(f"--frequencies must be 0 or more, but it is {options.frequencies}.")
    scene, settings, stem = open_scene(options.scene, options.divisions)
    for line in described_scene(scene):
        print(line)
    lines, wrong = described_run(scene, settings, options.frequencies)
    print("\n".join(lines))
    if not options.no_plots:
        print(_drawn(scene, options.output, f"{stem.removesuffix('_rerun')}_check.png"))
    for line in wrong:
        print(f"jaxshell: {line}", file=sys.stderr)
    return 2 if wrong else 0


def _drawn(scene, folder: Path, name: str) -> Path:
    """The picture of supports and loads."""
    from jaxshell.plotting import scene_figure

    folder.mkdir(parents=True, exist_ok=True)
    scene_figure(scene).savefig(folder / name, dpi=200)
    return folder / name
