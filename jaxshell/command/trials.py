"""What `jaxshell chart` and `jaxshell advise`, which make trial runs, are asked."""

import argparse


def add_options(command: argparse.ArgumentParser) -> None:
    """The scene, and what trials of it start from."""
    command.add_argument("scene", metavar="SCENE", help="a scene's name, a .toml or .h5 file")
    command.add_argument("--dt", type=float, help="step to start from (default: the scene's)")
    command.add_argument("--t-end", type=float, help="time that trials cover (default: the reference's, or 100 steps)")
    command.add_argument("--quiet", action="store_true", help="print the outcome only")
