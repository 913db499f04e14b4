"""`jaxshell completion`: what makes a shell complete commands, options, scenes and files, by argcomplete."""

import argparse
import os
from collections.abc import Sequence
from typing import Any

SHELLS = ("bash", "zsh", "fish")
SCENES = (
    "cap",
    "plate",
    "opened_cap",
    "flying_cylinder",
    "l_shaped_plate",
    "snapping_panel",
    "spinning_plate",
    "suddenly_loaded_cap",
    "dropped_tray",
    "tape_spring",
    "shaken_plate",
    "spun_blade",
    "unfolding_panel",
)
"""The library's names, which a press of the tab key has no time to import."""
_HOW = {
    "bash": 'eval "$(jaxshell completion bash)" in ~/.bashrc',
    "zsh": 'eval "$(jaxshell completion zsh)" in ~/.zshrc, after compinit',
    "fish": "jaxshell completion fish | source in ~/.config/fish/config.fish",
}


def add(commands) -> None:
    text = "; ".join(f"{shell}: {how}" for shell, how in _HOW.items())
    completion = commands.add_parser(
        "completion", help="print what makes a shell complete jaxshell's commands and options", epilog=text
    )
    completion.set_defaults(command=_completion)
    completion.add_argument("shell", choices=SHELLS)


def complete(parser: argparse.ArgumentParser) -> None:
    """Answer the shell where it asks what may stand here, and leave; else nothing."""
    if "_ARGCOMPLETE" not in os.environ:
        return
    import argcomplete

    for command in _commands(parser):
        for action in command._actions:
            if action.dest in _ENDINGS:
                action.completer = _completer(_ENDINGS[action.dest])  # pyright: ignore[reportAttributeAccessIssue]
    argcomplete.autocomplete(parser)


_ENDINGS: dict[str, Sequence[str]] = {"scene": (".toml", ".h5"), "files": (".h5",), "file": (".toml",)}
"""Of the files that an argument of this name takes."""


def _commands(parser: argparse.ArgumentParser) -> list[argparse.ArgumentParser]:
    found = []
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            found += action.choices.values()
    return found


def _completer(endings: Sequence[str]) -> Any:
    from argcomplete.completers import FilesCompleter

    files = FilesCompleter([ending.lstrip(".") for ending in endings])

    def found(prefix: str, **named) -> list[str]:
        names = SCENES if ".toml" in endings and ".h5" in endings else ()
        return [name for name in names if name.startswith(prefix)] + list(files(prefix, **named))

    return found


def _completion(options: argparse.Namespace) -> int:
    import argcomplete.shell_integration

    print(argcomplete.shell_integration.shellcode(["jaxshell"], shell=options.shell))
    return 0
