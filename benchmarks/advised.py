"""Whether what `jaxshell advise` advises holds: `python benchmarks/advised.py [cap plate ...]`.

Every scene whose continuous answer is known (`continuous.py`) is advised on at several tolerances, by trials of its own
that know nothing of that answer; then what was advised is run as it is, and set against the answer. Writes
results/advised.json and the table of docs/choosing.md. Times are those of this machine, compilation apart in the runs
and with it in the advice.
"""

import argparse
import json
import os
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))
os.environ.setdefault("MKL_NUM_THREADS", "1")

import jax  # noqa: E402
import numpy as np  # noqa: E402

jax.config.update("jax_enable_x64", True)

from benchmarks.pages import fill, table  # noqa: E402
from jaxshell import scenes  # noqa: E402
from jaxshell.advice.advise import advise  # noqa: E402
from jaxshell.advice.chart import measure  # noqa: E402
from jaxshell.advice.limits import limit_reference  # noqa: E402
from jaxshell.advice.text import command_line  # noqa: E402

PAGE = ROOT / "docs" / "choosing.md"
RESULTS = Path(__file__).parent / "results" / "advised.json"
TOLERANCES = (5e-2, 2e-2, 1e-2)
NAMES = ("cap", "suddenly_loaded_cap", "opened_cap", "plate", "snapping_panel", "flying_cylinder")


def check(name: str, tolerance: float, say) -> dict:
    """What is advised, and how far its answer is from the continuous one."""
    make = scenes.BY_NAME[name]
    scene = make()
    limit = limit_reference(scene)
    assert limit is not None, f"continuous.py makes the answer of {name}"
    begun = time.perf_counter()
    advice = advise(scene, tolerance, t_end=float(limit.times[-1]), say=say, make=make)
    spent = time.perf_counter() - begun
    point = measure(advice.member.scene, advice.best, limit)
    return {
        "scene": name,
        "tolerance": tolerance,
        "promised": advice.met,
        "command": command_line(name, advice),
        "expected": float(advice.point.error),
        "error": float(point.error) if np.isfinite(point.error) else None,
        "known": limit.uncertainty,
        "seconds": point.seconds,
        "advice_seconds": spent,
    }


def report(found: list[dict]) -> str:
    """The table of docs/choosing.md."""
    rows = []
    for entry in found:
        error = "fails" if entry["error"] is None else f"{100 * entry['error']:.2f} %"
        rows.append(
            [
                f"`{entry['scene']}`",
                f"{100 * entry['tolerance']:g} %",
                "yes" if entry["promised"] else "no",
                f"`{entry['command'].removeprefix('jaxshell run ')}`",
                f"{100 * entry['expected']:.2f} %",
                f"{error} (± {100 * entry['known']:.2f})",
                f"{entry['seconds']:.3g}",
                f"{entry['advice_seconds']:.0f}",
            ]
        )
    return table(["scene", "within", "promised", "run", "expected", "true", "seconds", "advice took"], rows)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", choices=[[], *NAMES], help="default: all")
    parser.add_argument("--tolerances", type=float, nargs="+", default=TOLERANCES)
    parser.add_argument("--quiet", action="store_true", help="print the outcome only")
    options = parser.parse_args()
    say = (lambda *_: None) if options.quiet else lambda text: print(text, flush=True)
    kept = json.loads(RESULTS.read_text()) if RESULTS.is_file() else []
    for name in options.scenes or NAMES:
        for tolerance in options.tolerances:
            entry = check(name, tolerance, say)
            print(json.dumps(entry), flush=True)
            kept = [e for e in kept if (e["scene"], e["tolerance"]) != (name, tolerance)] + [entry]
            kept.sort(key=lambda e: (NAMES.index(e["scene"]), -e["tolerance"]))
            RESULTS.write_text(json.dumps(kept, indent=1) + "\n")
            fill(PAGE, {"advised": report(kept)})
    return 0


if __name__ == "__main__":
    sys.exit(main())
