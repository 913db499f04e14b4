"""Write the tables of docs/performance.md from benchmarks/results/*.json, between the page's markers.

A marker is `<!-- NAME -->` ... `<!-- end NAME -->`; whatever stands between is replaced. A result that is not there
leaves its table as it is.
"""

import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

from benchmarks.pages import fill

HERE = Path(__file__).parent
PAGE = HERE.parent / "docs" / "performance.md"


def machine_line(found: dict) -> str:
    m = found["machine"]
    versions = ", ".join(f"{name} {v}" for name, v in m["versions"].items() if name in ("jax", "mkl"))
    load = m["load"][0]
    return f"{m['processor']}, {m['cores']} cores, load {load} at the start; {versions}; {m['commit']}, {m['date']}."


def speed(found: dict) -> str:
    lines = [
        "| scene | cores | program | ms/step | iterations/step | ms/iteration | times EMC's | memory MB |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for key, programs in found["results"].items():
        scene, cores = key.split(", ")
        ours = programs["jaxshell EMC"]["ms_per_step"]
        for name, f in programs.items():
            lines.append(
                f"| {scene} | {cores.split()[0]} | {name} | {f['ms_per_step']:.2f} "
                f"| {f['iterations_per_step']:.2f} | {f['ms_per_iteration']:.2f} "
                f"| {f['ms_per_step'] / ours:.1f} | {f['peak_rss_mb']} |"
            )
    return "\n".join([machine_line(found), "", *lines])


def scaling(found: dict) -> str:
    lines = [
        "| cores | unknowns | ms/step | ms/iteration | µs/element and iteration | first call s | memory MB |",
        "|---|---|---|---|---|---|---|",
    ]
    for e in found["results"]:
        lines.append(
            f"| {e['threads']} | {e['unknowns']} | {e['ms_per_step']:.1f} | {e['ms_per_iteration']:.1f} "
            f"| {e['us_per_element_and_iteration']:.1f} | {e['first_call_seconds']} | {e['peak_rss_mb']} |"
        )
    grows = (f"n^{exponent} with {cores}" for cores, exponent in found["exponents"].items())
    lines += ["", f"Cost grows as {' and '.join(grows)} of the cores."]
    return "\n".join([machine_line(found), "", *lines])


def cold_start(found: dict) -> str:
    return "\n\n".join(
        [
            machine_line(found),
            *(
                f"`{run['command']}`: {run['cold_seconds']} s with an empty compilation cache, {run['warm_seconds']} s "
                "with a full one."
                for run in found["runs"]
            ),
        ]
    )


def kernels(found: dict) -> str:
    lines = [
        "| scene, method | XLA, ms/step | LLVM, ms/step | times quicker | first call, XLA, s | LLVM, s |",
        "|---|---|---|---|---|---|",
    ]
    for name, (xla, llvm) in found["results"].items():
        ratio = xla["ms_per_step"] / llvm["ms_per_step"]
        lines.append(
            f"| {name} | {xla['ms_per_step']:.3f} | {llvm['ms_per_step']:.3f} | {ratio:.2f} "
            f"| {xla['first_call_seconds']:.1f} | {llvm['first_call_seconds']:.1f} |"
        )
    return "\n".join([machine_line(found), "", *lines])


def to_one_percent(results: Path) -> str:
    """The least time to 1 % of each scene's answer, of each method and peer, on the window that all of them cover."""
    lines = [
        "| scene | window, s | program | dt, s | error | seconds | times the best |",
        "|---|---|---|---|---|---|---|",
    ]
    for name in ("cap", "plate", "opened_cap"):
        file = results / f"work_precision_{name}.json"
        found = json.loads(file.read_text()).get("beside") if file.is_file() else None
        if not found:
            continue
        cheapest = {}
        for p in found["points"]:
            reaches = "seconds" in p and p["error"] is not None and p["error"] <= 1e-2
            if reaches and p["seconds"] <= cheapest.get(p["label"], p)["seconds"]:
                cheapest[p["label"]] = p
        best = min(p["seconds"] for p in cheapest.values())
        for label, p in sorted(cheapest.items(), key=lambda item: item[1]["seconds"]):
            lines.append(
                f"| {name} | {found['window']:g} | {label} | {p['dt']:.3g} | {p['error']:.1e} | {p['seconds']:.3g} "
                f"| {p['seconds'] / best:.1f} |"
            )
        missing = sorted({p["label"] for p in found["points"] if "seconds" in p} - set(cheapest))
        lines.extend(f"| {name} | {found['window']:g} | {label} | | not reached | | |" for label in missing)
    return "\n".join(lines)


def references(found: dict) -> str:
    lines = ["| scene | window s | finest dt s | known to | first halving changes |", "|---|---|---|---|---|"]
    for name, entry in found.items():
        last = entry["halvings"][-1]
        lines.append(
            f"| {name} | {last.get('known_until', 0):.4g} of {entry['window']:.4g} | {last['dt']:.3g} "
            f"| {last.get('uncertainty', float('nan')):.1e} | {entry['halvings'][1]['halving_changes']:.1e} |"
        )
    return "\n".join(lines)


def main() -> int:
    results = HERE / "results"
    tables = {}
    for name, make in (
        ("speed", speed), ("scaling", scaling), ("scaling_llvm", scaling), ("cold_start", cold_start),
        ("references", references), ("kernels", kernels),
    ):  # fmt: skip
        file = results / f"{name}.json"
        if file.is_file():
            tables[name] = make(json.loads(file.read_text()))
    if any(results.glob("work_precision_*.json")):
        tables["to_one_percent"] = to_one_percent(results)
    fill(PAGE, tables)
    print(f"{PAGE.name}: {', '.join(tables)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
