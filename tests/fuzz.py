"""Malformed scene files, mesh files and calls, by a seed: each must be a working set-up or an error that names the thing.

    python tests/fuzz.py --seed 0 --count 10000

prints how many inputs were refused, accepted and failed, and the failures by kind. A failure is any other exception than
ValueError, TypeError and FileNotFoundError, a message that does not name what is wrong or that is a library's, more than
ten seconds, or a set-up that holds NaN. Nothing is run: `simulate` is stopped where it would compile.
"""

import argparse
import collections
import signal
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path
from random import Random
from typing import NamedTuple

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

from malformed import NODES, TRIANGLES, NotFinite, Reached, latest, try_call, try_mesh_file, try_scene_file  # noqa: E402

from jaxshell.analyses import program  # noqa: E402

LIMIT = 10
"""Seconds for one input."""
LIBRARY = (
    "has no attribute", "object is not", "unhashable", "could not convert", "inhomogeneous", "not supported between",
    "setting an array", "ambiguous", "not iterable", "not subscriptable", "bad operand", "must be real number", "__",
    "Traceback", "out of bounds", "cannot reshape", "object of type", "not a valid JAX", "dtype('", "embedded null",
    "Exceeds the limit", "too many values", "not enough values", "broadcast", "unexpected keyword", "required positional",
)  # fmt: skip
"""Words of Python's, NumPy's and JAX's own messages."""


class Overdue(BaseException):
    """An input took longer than `LIMIT`."""


class Failure(NamedTuple):
    """What went wrong, in words that are the same for failures of one kind; and the input."""

    kind: str
    what: str


# --- the verdict -----------------------------------------------------------------------------------------


KINDS = {"scene file": try_scene_file, "mesh file": try_mesh_file, "call": try_call}
SHARES = [0.5, 0.1, 0.4]


def attempt(seed: int, folder: Path) -> tuple[str, Failure | None]:
    """One input, as the seed has it: ("accepted" or "refused", the failure if it is one)."""
    random = Random(seed)
    (name,) = random.choices(list(KINDS), SHARES)
    latest[:] = []
    begun, words, outcome, failure = time.perf_counter(), [], "accepted", None
    try:
        KINDS[name](random, folder)
    except (ValueError, TypeError, FileNotFoundError) as error:
        outcome, words = (
            "refused",
            latest[1]
            if name == "call"
            else {"scene file": ["scene.toml"], "mesh file": ["broken", "merge", "tolerance", "orient"]}[name],
        )
        if name == "scene file" and not _in_reading(error):
            words = ["dt", "t_end", "step", "method", "newton", "dissipation", "spectral", "beta", "gamma", "alpha"]
            words += ["load_factors", "arc_length", "max_load_factor", "supports leave", "nothing loads"]
        failure = _of_message(name, error, words)
    except Overdue:
        failure = Failure(f"{name}: more than {LIMIT} s", "")
    except NotFinite as error:
        failure = Failure(f"{name}: {error}", "")
    except BaseException as error:  # SystemExit too
        if isinstance(error, KeyboardInterrupt):
            raise
        where = traceback.extract_tb(error.__traceback__)[-1]
        failure = Failure(f"{name}: {type(error).__name__} in {Path(where.filename).name}", str(error)[:150])
    if failure is None and time.perf_counter() - begun > LIMIT:
        failure = Failure(f"{name}: more than {LIMIT} s", "")
    if failure is not None:
        failure = failure._replace(what=f"seed {seed}: {failure.what} {latest[0] if latest else ''}")
    return outcome, failure


def _in_reading(error: BaseException) -> bool:
    return any(frame.name == "read_scene_file" for frame in traceback.extract_tb(error.__traceback__))


def _of_message(name: str, error: Exception, words: list[str]) -> Failure | None:
    text = str(error)
    said = next((word for word in LIBRARY if word in text), None)
    if said:
        return Failure(f"{name}: {type(error).__name__} with a library's text ({said})", text[:200])
    if len(text) < 12 or not any(word.lower() in text.lower() for word in words):
        return Failure(
            f"{name}: {type(error).__name__} that does not name {'the file' if name != 'call' else words}", text[:200]
        )
    return None


def fuzz(seeds: range, watch_time: bool = False) -> tuple[collections.Counter, list[Failure]]:
    """How many inputs were accepted and refused, and the failures."""

    def stopped(*_):
        raise Reached

    def overdue(*_):
        raise Overdue

    count, failures, before = collections.Counter(), [], program.prepare
    program.prepare = stopped
    if watch_time:
        signal.signal(signal.SIGALRM, overdue)
    try:
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            _write_sheet(Path(folder))
            for seed in seeds:
                if watch_time:
                    signal.alarm(LIMIT)
                outcome, failure = attempt(seed, Path(folder))
                count["failed" if failure else outcome] += 1
                failures += [failure] if failure else []
    finally:
        program.prepare = before
        if watch_time:
            signal.alarm(0)
    return count, failures


def _write_sheet(folder: Path) -> None:
    import meshlane

    meshlane.write(folder / "sheet.vtk", meshlane.Mesh(np.array(NODES), {"triangle": np.array(TRIANGLES)}))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=10_000)
    options = parser.parse_args()
    first = 1_000_000 * options.seed
    count, failures = fuzz(range(first, first + options.count), watch_time=True)
    print(", ".join(f"{number} {name}" for name, number in count.most_common()))
    kinds: dict[str, list[str]] = {}
    for failure in failures:
        kinds.setdefault(failure.kind, []).append(failure.what)
    for kind, found in sorted(kinds.items(), key=lambda item: -len(item[1])):
        print(f"{len(found):5d}  {kind}\n         {found[0]}")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
