"""What every result file begins with: whose it is, what it holds, how it was asked for, and the scene."""

import json

from jaxshell.model.scene import Scene
from jaxshell.results.checked import read_text, write_attribute, write_text
from jaxshell.results.tree import to_json, write_scene
from jaxshell.version import version

FORMAT, SCHEMA = "jaxshell", 2
SWEEP = "jaxshell sweep"
"""The format of a sweep's file (`jaxshell.results.sweep_file`)."""
_READ = (1, 2)
RUN, MODES, BUCKLING = "run", "modes", "buckling"
"""What a file may hold; the first where it does not say."""
_READERS = {RUN: "jaxshell.Solution.load", MODES: "jaxshell.Modes.load", BUCKLING: "jaxshell.BucklingModes.load"}
_WORDS = {RUN: "a run", MODES: "natural frequencies", BUCKLING: "buckling factors"}


def write_head(file, run: str, scene: Scene, settings: dict, holds: str = RUN) -> None:
    """Attributes, settings and scene of an empty file; `run` is a name that no other has."""
    for name, text in {"format": FORMAT, "jaxshell": version(), "run": run}.items():
        write_attribute(file, name, text)
    if holds != RUN:
        write_attribute(file, "holds", holds)
    file.attrs["schema"] = SCHEMA
    write_text(file, "settings", to_json(settings))
    write_scene(file.create_group("scene"), scene)


def check_schema(file, path, holds: str | None = None) -> None:
    """Raise ValueError for a file that is not ours, of another schema, or that holds something else than `holds`."""
    kind = read_text(file, "format") if "format" in file.attrs else None
    schema = file.attrs.get("schema")
    if kind == SWEEP:
        raise ValueError(
            f"{path} holds a sweep, not one run: jaxshell.Sweep.load reads it, and `jaxshell sweep` with the same "
            "arguments draws it."
        )
    if kind != FORMAT:
        raise ValueError(f"{path} is an HDF5 file, but not one that jaxshell wrote.")
    if schema not in _READ:
        raise ValueError(
            f"{path} has schema {schema}, and this version of jaxshell reads schemas {_READ[0]} to {_READ[-1]}. "
            "Use the version that wrote it, or run the scene again."
        )
    found = what_it_holds(file)
    if holds is not None and found != holds:
        if found not in _WORDS:
            raise ValueError(f"{path} holds {found!r}, which this version of jaxshell does not know.")
        raise ValueError(f"{path} holds {_WORDS[found]}, not {_WORDS[holds]}: {_READERS[found]} reads it.")


def what_it_holds(file) -> str:
    """One of the kinds above, or what the file says."""
    return read_text(file, "holds") if "holds" in file.attrs else RUN


def read_settings_of(file) -> dict:
    """How the run was asked for."""
    return json_table(read_text(file, "settings"))


def json_table(text: str) -> dict:
    """A JSON object. Raises RuntimeError for other JSON."""
    table = json.loads(text)
    if not isinstance(table, dict):
        raise RuntimeError(f"its settings are {text[:40]!r}")
    return table
