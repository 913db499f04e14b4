"""The installed version."""

import importlib.metadata


def version() -> str:
    """As the installed package has it."""
    try:
        return importlib.metadata.version("jaxshell")
    except importlib.metadata.PackageNotFoundError:
        return "not installed"
