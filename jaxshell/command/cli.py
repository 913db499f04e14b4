"""The command `jaxshell`; each of its commands is a file of this room.

Exit status: 0, or 1 when a run failed (what it finished is kept and drawn), 2 for bad input, 128 and the signal's
number when stopped by one: 130 by the keyboard, 143 by SIGTERM, 129 by SIGHUP. JAX and matplotlib are imported when a
command needs them, and float64 is switched on then.
"""

import argparse
import os
import sys
from collections.abc import Sequence

from jaxshell.command import (
    advise,
    animate,
    chart,
    check,
    completion,
    export,
    import_model,
    init,
    plot,
    run,
    scenes,
    schema,
    sweep,
    view,
)
from jaxshell.numerics.signals import LostOutput, exit_status, raising

COMMANDS = (
    init,
    import_model,
    check,
    run,
    sweep,
    plot,
    animate,
    view,
    export,
    chart,
    advise,
    scenes,
    schema,
    completion,
)
"""In the order of `jaxshell --help`. Each has `add(commands)`, which adds its parser and names its function."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status. Errors in the arguments leave through SystemExit(2)."""
    parser = _parser()
    completion.complete(parser)
    options = parser.parse_args(arguments)
    if hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(line_buffering=True)  # pyright: ignore[reportAttributeAccessIssue]
    try:
        with raising():
            return options.command(options)
    except KeyboardInterrupt as stopped:
        print("jaxshell: stopped.", file=sys.stderr)
        return exit_status(stopped)
    except BrokenPipeError:  # who read the output has gone
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115 - until the process ends
        return 141
    except (ValueError, OSError, ImportError) as error:
        print(f"jaxshell: {getattr(error, 'strerror', None) or error}", file=sys.stderr)
        return 1 if isinstance(error, LostOutput) else 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="jaxshell", description="Nonlinear dynamics of thin shells with finite rotations."
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version and leave")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for command in COMMANDS:
        command.add(commands)
    return parser


class _Version(argparse.Action):
    def __call__(self, parser, *_):
        from jaxshell.version import version

        print(f"jaxshell {version()}")
        parser.exit()
