"""The protocol between the harness and a program it times: one JSON line in, one JSON line out.

A worker lives as long as the harness, so that start-up and compilation are paid once, and every line asks for one
timed run. In: {"case": npz of the scene, "dt", "steps", "tolerance", "history": npz to write or null, ...}. Out:
{"seconds" of the time loop alone, "setup" before it, "iterations", "steps", "peak_rss" [MB], ...}, or {"error"}.
Whatever else a program prints goes to stderr.
"""

import json
import os
import resource
import sys
import traceback


def serve(run) -> None:
    """Answer requests with `run(request) -> dict` until the input ends."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    for line in sys.stdin:
        try:
            answer = run(json.loads(line))
            answer["peak_rss"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        except Exception:
            answer = {"error": traceback.format_exc()}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()
