"""Result files outlive their writers: cut at every write, killed, disk full, flipped bytes, strangers' files."""

import contextlib
import dataclasses
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import equinox as eqx
import h5py
import jax
import jax.numpy as jnp
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)

from synthetic import synthetic_solution  # noqa: E402

from jaxshell.numerics.compiled import compiled  # noqa: E402
from jaxshell.results import durable  # noqa: E402
from jaxshell.results.hdf5 import ResultWriter  # noqa: E402
from jaxshell.results.solution import RESULTS, Solution  # noqa: E402
from jaxshell.scenes import PAPER  # noqa: E402

PARTS, STEPS = 6, 30


@pytest.fixture(scope="module")
def solution() -> Solution:
    """A run of 30 steps in which everything, the state too, says at which step it is."""
    run = synthetic_solution(PAPER["plate"](), steps=STEPS, save_every=1)
    state = {"time": np.zeros(()), "x": np.zeros((700, 3)), "v": np.zeros((700, 3))}
    return dataclasses.replace(run, state=state)


def part_of(s: Solution, steps: slice) -> Solution:
    """Some steps of the run, with the state of the last."""
    take = lambda tree: jax.tree.map(lambda a: np.asarray(a)[steps], tree)  # noqa: E731
    names = ("times", "watched", "energy", "momentum", "iterations", "frame_times", "frames")
    last = float(s.times[steps][-1])
    state = {"time": np.asarray(last), "x": np.full((700, 3), last), "v": np.full((700, 3), -last)}
    return dataclasses.replace(s, **{name: take(getattr(s, name)) for name in names}, state=state)


def parts_of(s: Solution):
    bounds = np.linspace(0, len(s.times), PARTS + 1).astype(int)
    return [part_of(s, slice(a, b)) for a, b in zip(bounds[:-1], bounds[1:], strict=True)]


def assert_prefix(found: Solution, run: Solution, least: int) -> None:
    """`found` is the first steps of `run`, at least so many, with the state and the frames of its last step."""
    k = len(found.times)
    assert k >= least, (k, least)
    for name in ("times", "energy", "momentum", "watched", "iterations", "frame_times"):
        want = jax.tree.map(lambda a: np.asarray(a)[:k], getattr(run, name))
        assert eqx.tree_equal(jax.tree.map(np.asarray, getattr(found, name)), want), name
    assert np.array_equal(found.displacements, run.displacements[:k])
    time = float(found.times[-1])
    assert float(found.state["time"]) == time
    assert np.all(found.state["x"] == time) and np.all(found.state["v"] == -time)


@pytest.fixture(params=[True, False], ids=["each commit on the disk", "the disk is waited for at the end"])
def recorded(request, solution, tmp_path, monkeypatch):
    """Every change that the writing of a run makes to its file, and the number of steps appended before it."""
    monkeypatch.setattr("jaxshell.results.hdf5._SOON", 0.0 if request.param else 1e9)
    monkeypatch.setattr("jaxshell.results.hdf5._SHARE", 0.0 if request.param else 50)
    changes: list[tuple[str, Any, int, int]] = []
    done, real, cut = [0], os.pwrite, os.ftruncate

    def pwrite(fd, data, at):
        changes.append(("write", bytes(data), at, done[0]))
        return real(fd, data, at)

    def ftruncate(fd, size):
        changes.append(("cut", b"", size, done[0]))
        return cut(fd, size)

    monkeypatch.setattr(durable.os, "pwrite", pwrite)
    monkeypatch.setattr(durable.os, "ftruncate", ftruncate)
    with contextlib.closing(ResultWriter(tmp_path / "a.h5")) as writer:
        writer._pause = 0.0 if request.param else 1e9
        writer.begin(solution.scene, {"method": "EMC", "dt": 0.1})
        for part in parts_of(solution):
            writer.append(part)
            done[0] += len(part.times)
        writer.finish("successful", "", {})
    monkeypatch.undo()
    return changes


def test_every_cut_of_the_writes_can_be_read(recorded, solution, tmp_path):
    """The file is rebuilt after each write, and with half of the next: every moment to die at."""
    content, path, read = bytearray(), tmp_path / "cut.h5", 0
    first = next(k for k, change in enumerate(recorded) if change[3] > 0)
    for k, (kind, data, at, before) in enumerate(recorded):
        if k >= first:  # the file has taken its place
            for torn in {len(data) // 2, 0} if kind == "write" else {0}:
                half = bytearray(content)
                _apply(half, data[:torn], at)
                path.write_bytes(half)
                # All but the part that is being appended.
                assert_prefix(Solution.load(path), solution, before)
                read += 1
        if kind == "cut":
            del content[at:]
        else:
            _apply(content, data, at)
    path.write_bytes(content)
    whole = Solution.load(path)
    assert_prefix(whole, solution, len(solution.times))
    assert bool(whole.result == RESULTS.successful)
    assert read > 30


def _apply(content: bytearray, data: bytes, at: int) -> None:
    content.extend(bytes(max(0, at - len(content))))
    content[at : at + len(data)] = data


def test_a_file_without_a_journal_is_plain_hdf5(solution, tmp_path):
    solution.save(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5") as file:
        times: Any = file["histories/times"]
        assert np.array_equal(times[:], solution.times)


def test_a_reader_holds_no_run_up_and_sees_one_state(solution, tmp_path):
    """While somebody reads, changed pages stay in the journal; who opens the file then sees them."""
    path, parts = tmp_path / "a.h5", parts_of(solution)
    with contextlib.closing(ResultWriter(path)) as writer:
        writer.begin(solution.scene, {})
        writer.append(parts[0])
        early = durable.DurableReader(path)
        with h5py.File(early) as file:
            for part in parts[1:]:
                writer.append(part)
                writer._pause = 0.0
            times: Any = file["histories/times"]
            assert np.array_equal(times[:], parts[0].times)
            assert_prefix(Solution.load(path), solution, len(solution.times))
        early.close()
        writer.finish("successful", "", {})
    with h5py.File(path) as file:
        times = file["histories/times"]
        assert np.array_equal(times[:], solution.times)


def test_what_may_be_replaced(solution, tmp_path):
    path = tmp_path / "a.h5"
    writer = ResultWriter(path)
    writer.begin(solution.scene, {})
    writer.append(part_of(solution, slice(0, 3)))
    with pytest.raises(ValueError, match=r"in use.*--continue.*--overwrite"):
        solution.save(path)
    with pytest.raises(ValueError, match="in use"):
        ResultWriter(path, overwrite=True).begin(solution.scene, {})
    writer.close()
    before = path.read_bytes()
    with pytest.raises(ValueError, match=r"did not end.*--continue.*--overwrite"):
        solution.save(path)
    assert path.read_bytes() == before
    with contextlib.closing(ResultWriter(path, overwrite=True)) as writer:
        writer.begin(solution.scene, {})
        assert path.read_bytes() == before  # until the new run holds something
        writer.append(solution)
        writer.finish("successful", "", {})
    solution.save(path)  # finished: replaced
    path.write_text("my notes\n")
    with pytest.raises(ValueError, match=r"no results of jaxshell.*--overwrite"):
        solution.save(path)
    assert path.read_text() == "my notes\n"
    assert [item.name for item in tmp_path.iterdir()] == ["a.h5"]


def test_frames_of_a_replaced_file_are_not_mixed_up(solution, tmp_path):
    solution.save(tmp_path / "a.h5")
    first = Solution.load(tmp_path / "a.h5")
    assert np.array_equal(first.frame(-1).displacements, solution.displacements[-1])
    assert np.array_equal(first.frame([3, 1, 3]).velocities, np.asarray(solution.velocities)[[3, 1, 3]])
    solution.save(tmp_path / "a.h5")
    with pytest.raises(ValueError, match="another run by now"):
        first.frame(0)


@pytest.mark.parametrize("flips", [60, pytest.param(500, marks=pytest.mark.evidence)])
def test_flipped_bytes_are_seen(flips, solution, tmp_path):
    """No flipped byte changes what is read: it is an error, or a byte that nothing depends on."""
    path, random = tmp_path / "a.h5", np.random.default_rng(0)
    solution.save(path)
    content = path.read_bytes()
    whole, seen = Solution.load(path), 0
    want = jax.tree.map(
        np.asarray, (whole.scene, whole.times, whole.energy, whole.momentum, whole.watched, whole.state)
    )
    frames = whole.frames.at(list(range(len(whole.frame_times))))
    for at in random.integers(0, len(content), flips):
        flipped = bytearray(content)
        flipped[at] ^= 1 << int(random.integers(8))
        path.write_bytes(flipped)
        try:
            found = Solution.load(path)
            got = (found.scene, found.times, found.energy, found.momentum, found.watched, found.state)
            again = found.frames.at(list(range(len(found.frame_times))))
        except ValueError:
            seen += 1
            continue
        assert eqx.tree_equal(jax.tree.map(np.asarray, got), want), at
        assert eqx.tree_equal(again, frames), at
        assert (found.message, found.stats) == (whole.message, whole.stats)
        assert bool(found.result == whole.result)
    assert seen > flips / 2


def _link(file):
    file["scene/x"] = h5py.ExternalLink("other.h5", "/")


def _cycle(file):
    file["scene/mesh/again"] = file["scene"]


def _outside(file):
    del file["scene/mesh/nodes"]
    file.create_dataset("scene/mesh/nodes", (9, 3), "f8", external=[("/etc/passwd", 0, 216)])


def _huge(file):
    del file["histories/times"]
    file.create_dataset("histories/times", (10**12,), "f8", chunks=(256,))


def _result(file):
    del file.attrs["result"]
    file.attrs["result"] = "__class__"


def _settings(file):
    del file["stats"]
    file["stats"] = np.frombuffer(b"[1, 2]", np.uint8)


@pytest.mark.parametrize("spoil", [_link, _cycle, _outside, _huge, _result, _settings])
def test_a_strangers_file_is_refused(spoil, solution, tmp_path):
    solution.save(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        spoil(file)
    with pytest.raises(ValueError, match=r"a\.h5 is damaged") as caught:
        Solution.load(tmp_path / "a.h5")
    assert "\n" not in str(caught.value)


_WRITER = """
import sys
sys.path[:0] = {paths!r}
import jax
jax.config.update("jax_enable_x64", True)
import contextlib
from synthetic import synthetic_solution
from test_durable import PAPER, STEPS, parts_of, ResultWriter
import dataclasses, numpy as np
run = synthetic_solution(PAPER["plate"](), steps=STEPS, save_every=1)
run = dataclasses.replace(run, state={{}})
parts = parts_of(run)
"""


def _child(code: str, **options):
    script = _WRITER.format(paths=[str(Path(__file__).parent)]) + code
    return subprocess.Popen([sys.executable, "-c", script], text=True, stdout=subprocess.PIPE, **options)


_KILLED = """
import os, random, signal, time
def write(trial):
    writer = ResultWriter("{folder}/" + str(trial) + ".h5")
    writer.begin(run.scene, {{}})
    for k, part in enumerate(parts):
        writer._pause = 0.0 if trial % 2 else 1e9
        writer.append(part)
        with open("{folder}/" + str(trial) + ".steps", "a") as told:
            told.write("x" * len(part.times))
for trial in range(-1, {trials}):
    pid = os.fork()
    begun = time.perf_counter()
    if not pid:
        write(trial)
        os._exit(0)
    if trial >= 0:
        time.sleep(whole * random.Random(trial).uniform(0.1, 1.0))
        os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    whole = time.perf_counter() - begun if trial < 0 else whole
"""


def kill(trials: int, folder: Path, solution: Solution) -> int:
    """Kill so many writers; returns how many had a file by then, each of which was read and is whole."""
    process = _child(_KILLED.format(trials=trials, folder=folder))
    assert process.wait(300) == 0
    files = 0
    for path in folder.glob("*.h5"):
        told = path.with_suffix(".steps")
        assert_prefix(Solution.load(path), solution, len(told.read_text()) if told.exists() else 0)
        files += 1
    return files


def test_killed_writers_leave_whole_files(solution, tmp_path):
    assert kill(20, tmp_path, solution) > 5


@pytest.mark.slow
def test_a_hundred_kills(solution, tmp_path):
    assert kill(250, tmp_path, solution) >= 100


_LIMITED = """
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, (120_000, 120_000))
with contextlib.closing(ResultWriter("{path}")) as writer:
    writer.begin(run.scene, {{}})
    try:
        for _ in range(100):
            for part in parts:
                writer.append(part)
    except OSError as error:
        print(error)
"""


def test_a_full_disk_is_an_error_and_the_file_is_whole(solution, tmp_path):
    process = _child(_LIMITED.format(path=tmp_path / "a.h5"))
    said, _ = process.communicate(timeout=120)
    assert process.returncode == 0
    assert "Cannot write on: File too large" in said and "holds the" in said and "--continue" in said
    steps = int(said.split("holds the ")[1].split()[0])
    assert len(Solution.load(tmp_path / "a.h5").times) == steps + 1


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="no such signal here")
def test_a_signal_waits_until_the_file_is_whole():
    from jaxshell.numerics.signals import Stopped, held, raising

    order = []
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # which nohup has ignored
    try:
        with pytest.raises(Stopped) as caught, raising():
            with held():
                signal.raise_signal(signal.SIGHUP)
                order.append("written")
            order.append("not reached")
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_DFL
    finally:
        signal.signal(signal.SIGHUP, before)
    assert order == ["written"] and caught.value.number == signal.SIGHUP


@pytest.mark.skipif(threading.current_thread() is not threading.main_thread(), reason="signals reach main threads")
def test_a_signal_waits_for_the_program_that_runs():
    """XLA's threads are in the native solvers then: a process that ended at once would crash as often as not."""

    @compiled
    def run(turns):  # what calls no library may run in this thread, which no signal interrupts
        once = lambda _, x: jnp.linalg.solve(1.0001 * jnp.eye(40), x)  # noqa: E731
        return jax.lax.fori_loop(0, turns, once, jnp.ones((40, 40)))

    turns, seconds = np.asarray(1000), 0.0
    run(turns)
    while seconds < 0.6:
        turns, begun = 2 * turns, time.perf_counter()
        run(turns).block_until_ready()
        seconds = time.perf_counter() - begun
    threading.Timer(0.1 * seconds, os.kill, (os.getpid(), signal.SIGINT)).start()
    begun = time.perf_counter()
    with pytest.raises(KeyboardInterrupt):
        run(turns).block_until_ready()
    assert time.perf_counter() - begun > 0.5 * seconds
