"""Files to read: whether there are any, and their text."""

from pathlib import Path


def is_file(path) -> bool:
    """Whether `path` is a file; False for what cannot be a path at all."""
    try:
        return Path(path).is_file()
    except (OSError, ValueError):
        return False


def text_of(path: Path) -> str:
    """A text file's content. Raises FileNotFoundError, and ValueError for what is no text."""
    if not is_file(path):
        raise FileNotFoundError(f"There is no file {path}.")
    content = path.read_bytes()
    if b"\0" in content:
        raise ValueError(f"{path} is no text file.")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError:
        return content.decode("cp1252", "replace")
