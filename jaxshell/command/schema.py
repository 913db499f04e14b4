"""`jaxshell schema`: the JSON schema of scene files, for editors."""

import argparse

from jaxshell.command.start import prepare_jax


def add(commands) -> None:
    schema = commands.add_parser("schema", help="print the JSON schema of scene files, which editors use")
    schema.set_defaults(command=_schema)


def _schema(options: argparse.Namespace) -> int:
    prepare_jax()
    from jaxshell.files.schema import schema_text

    print(schema_text(), end="")
    return 0
