"""`jaxshell animate`: a film of result files, several of them side by side."""

import argparse
from pathlib import Path

from jaxshell.command.result_files import add_field, add_files, add_renderer, read_runs
from jaxshell.command.start import prepare_jax


def add(commands) -> None:
    animate = commands.add_parser("animate", help="make a film of result files, several of them side by side")
    animate.set_defaults(command=_animate)
    add_files(animate, "result files, side by side; a run and its continuation are one")
    animate.add_argument("film", type=Path, metavar="FILM", help="what to write: a .gif or .mp4 file")
    add_field(animate)
    animate.add_argument("--fps", type=float, help="pictures to a second (default: 25, or less where frames are few)")
    animate.add_argument("--duration", type=float, metavar="SECONDS", help="of the film (default: 8 s at most)")
    animate.add_argument("--size", type=_size, metavar="WIDTHxHEIGHT", help="in pixels (default: 1280 across)")
    add_renderer(animate)


def _animate(options: argparse.Namespace) -> int:
    prepare_jax()
    from jaxshell.plotting import animate

    print(
        animate(
            read_runs(options.files),
            options.film,
            options.field,
            fps=options.fps,
            duration=options.duration,
            size=options.size,
            renderer=options.renderer,
        )
    )
    return 0


def _size(text: str) -> tuple[int, int]:
    width, by, height = text.lower().partition("x")
    if not by or not (width.isdigit() and height.isdigit()):
        raise argparse.ArgumentTypeError(f"must be WIDTHxHEIGHT in pixels, such as 1280x720, but is {text!r}")
    return int(width), int(height)
