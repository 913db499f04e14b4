"""`jaxshell scenes`: the scenes that `run` knows by name."""

import argparse


def add(commands) -> None:
    scenes = commands.add_parser("scenes", help="list the scenes that `run` knows by name")
    scenes.set_defaults(command=_scenes)


def _scenes(options: argparse.Namespace) -> int:
    from jaxshell.scenes import BY_NAME

    width = max(len(name) for name in BY_NAME)
    for name, make in BY_NAME.items():
        print(f"{name:{width}}  {(make.__doc__ or '').splitlines()[0]}")
    return 0
