"""Where batches run: in this process, or in the workers of a Dask cluster.

Both take batches as they come and give (batch, rows or error) as they end. A worker that dies has its batches done
again by others; a batch that several workers died of is given up as `Lost`.
"""

import contextlib
import importlib
import logging
import os
from collections.abc import Iterator
from typing import Any, NamedTuple

from jaxshell.analyses.sweep.batch import Batch, Kept, Quantities, run_batch

_AHEAD = 2
"""Batches in the cluster for each of its workers, so that none waits for the next."""
_PATIENCE = 60
"""Seconds that a cluster has to answer, and to have a worker."""
_given: dict[str, tuple[Quantities, Kept]] = {}
"""In a worker: what all batches of a sweep have in common, by the sweep's name. Kept, so that the functions stay the
same objects and their programs need no compiling again."""


class Lost(RuntimeError):
    """A batch that several workers died of."""


class Task(NamedTuple):
    """What all batches of a sweep have in common."""

    name: str
    quantities: Quantities
    kept: Kept


def here(batches: Iterator[Batch], task: Task) -> Iterator[tuple[Batch, Any]]:
    """Run batches in this process, one after the other."""
    for batch in batches:
        try:
            yield batch, run_batch(batch, task.quantities, task.kept)
        except ValueError as error:
            yield batch, error


@contextlib.contextmanager
def cluster(workers: int, scheduler: str | None):
    """A client of the cluster at `scheduler`, or of a new one of so many processes on this machine.

    Raises ImportError without `distributed`, OSError where no cluster answers.
    """
    distributed = imported()
    with contextlib.ExitStack() as stack:
        if scheduler is None:
            share = max(1, (os.cpu_count() or 1) // workers)
            local = distributed.LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                dashboard_address=None,
                silence_logs=logging.ERROR,  # that a worker died and was replaced is no news to the user
                env={"NPROC": os.environ.get("NPROC", str(share))},
            )
            address = stack.enter_context(local)
        else:
            address = scheduler
        try:
            client = stack.enter_context(distributed.Client(address, timeout=_PATIENCE))
            client.wait_for_workers(1, timeout=_PATIENCE)
        except (OSError, ValueError) as error:  # TimeoutError is an OSError
            raise OSError(f"No cluster with a worker answers at {scheduler or 'this machine'}: {error}.") from error
        yield client


def imported():
    """The package `distributed`. Raises ImportError, with the command to install it."""
    try:
        return importlib.import_module("distributed")
    except ImportError as error:
        raise ImportError(
            "Several processes need Dask, which is not installed: pip install distributed. One process works without "
            "it: leave --workers and --scheduler (workers=, scheduler=) out."
        ) from error


def there(client, batches: Iterator[Batch], task: Task) -> Iterator[tuple[Batch, Any]]:
    """Run batches in the workers of a cluster."""
    import cloudpickle  # which distributed needs itself

    distributed = imported()
    common = cloudpickle.dumps((dict(task.quantities), task.kept))
    sent: dict[Any, Batch] = {}
    ended = distributed.as_completed()

    def send() -> None:
        for batch in batches:
            future = client.submit(_work, task.name, common, settings(), batch, pure=False)
            sent[future] = batch
            ended.add(future)
            if len(sent) >= _AHEAD * max(1, len(client.nthreads())):
                return

    send()
    while sent:
        future = next(ended)
        batch = sent.pop(future)
        try:
            yield batch, future.result()
        except ValueError as error:
            yield batch, error
        except distributed.KilledWorker as error:
            yield batch, Lost(str(error))
        future.release()
        send()


def settings() -> dict[str, Any]:
    """JAX's, which workers are to have too."""
    import jax

    names = ("jax_enable_x64", "jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    return {name: jax.config.values[name] for name in names}


def _work(name: str, common: bytes, config: dict[str, Any], batch: Batch) -> dict:
    """In a worker."""
    import cloudpickle
    import jax

    for key, value in config.items():
        if jax.config.values[key] != value:
            jax.config.update(key, value)
    if name not in _given:
        _given[name] = cloudpickle.loads(common)
    return run_batch(batch, *_given[name])
