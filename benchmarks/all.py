"""Every figure of docs/performance.md in one go: `python benchmarks/all.py --peers PYTHON_OF_PEERS`.

About three hours on two quiet cores, half of it the peers' refined meshes. The last script, tables.py,
writes the tables into docs/performance.md.
"""

import argparse
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peers", help="Python of the environment that has the peers; left out: jaxshell only")
    options = parser.parse_args()
    peers = ["--peers", options.peers] if options.peers else []
    failed = []
    for script, arguments in (
        ("harness.py", peers),
        ("cold_start.py", []),
        ("kernels.py", []),
        ("scaling.py", []),
        ("scaling.py", ["--kernels", "llvm"]),
        ("limits.py", []),
        ("way_back.py", []),
        ("joints.py", []),
        ("work_precision.py", peers),
        ("total_error.py", peers),
        *([("flex.py", peers)] if peers else []),
        ("tables.py", []),
    ):
        print(f"== {script}", flush=True)
        if subprocess.run([sys.executable, str(HERE / script), *arguments], check=False).returncode:
            failed.append(script)
    if failed:
        print(f"Failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
