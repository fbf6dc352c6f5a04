"""Where processes that make samples come from: this machine, or a cluster that runs already.

Importing this needs Dask.
"""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from multiprocessing import resource_tracker
from typing import Any

import dask
from distributed import Client, Nanny, Scheduler, SpecCluster
from distributed.diagnostics.plugin import WorkerPlugin

from clradar.dataset.engine.worker_resources import WorkerResources
from clradar.errors import ClusterError
from clradar.files.failures import clean

DEVICE = "DEVICE"
"""The Dask resource of which each worker has as many as it makes samples at a time."""

CONNECT_S = 10.0

BLAS_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")

HERE = "127.0.0.1"


@contextmanager
def local_cluster(
    resources: Sequence[WorkerResources],
) -> Iterator[tuple[Client, Callable[[], Any]]]:
    """Start one worker process for each of `resources` on this machine.

    Yields
    ------
    client : distributed.Client
    end : callable
        Ends the workers, and returns when they are gone.

    Raises
    ------
    ClusterError
        The workers do not start.
    """
    threads = str(min(one.threads for one in resources))
    settings = {
        # Read by numpy when it is loaded, so set before a process starts. They take the place of
        # Dask's MALLOC_TRIM_THRESHOLD_, by which every large array costs page faults anew and a
        # sample a third more.
        "distributed.nanny.pre-spawn-environ": dict.fromkeys(BLAS_VARIABLES, threads),
        "distributed.worker.multiprocessing-method": "spawn",
    }
    scheduler = {
        "cls": Scheduler,
        "options": {"host": HERE, "port": 0, "dashboard": True, "dashboard_address": f"{HERE}:0"},
    }
    workers = {
        i: {
            "cls": Nanny,
            "options": {
                "host": HERE,
                "nthreads": 1,
                "resources": {DEVICE: 1},
                "env": one.environment(),
                "plugins": (KeepToCores(one.cores),),
                # Results are numbers; a sample that needs much memory is no reason to kill it.
                "memory_limit": None,
                "silence_logs": logging.CRITICAL,
            },
        }
        for i, one in enumerate(resources)
    }
    with dask.config.set(settings):
        try:
            with _interrupts_kept_back():
                cluster = SpecCluster(
                    workers=workers, scheduler=scheduler, silence_logs=logging.CRITICAL
                )
        except Exception as error:
            raise ClusterError(f"the workers did not start: {clean(error)}") from error

        def end() -> None:
            # Ctrl-C would cancel the closing, and closing again would wait for it for ever.
            with _interrupts_kept_back():
                cluster.close()

        try:
            with Client(cluster, set_as_default=False) as client:
                yield client, end
        finally:
            end()


def dashboard_text(client: Client) -> str:
    """Return where the dashboard is, and what it takes to see that of a cluster of our own."""
    own = client.cluster is not None
    hint = " (needs: pip install bokeh)" if own and find_spec("bokeh") is None else ""
    return f"dashboard: {client.dashboard_link}{hint}"


@contextmanager
def running_cluster(address: str) -> Iterator[Client]:
    """Connect to a Dask scheduler; yields the client.

    Raises
    ------
    ClusterError
        No scheduler answers at the address.
    """
    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise ClusterError(
            f"{clean(address)}: expected the address of a Dask scheduler, such as "
            f"tcp://HOST:8786; {clean(error)}"
        ) from error
    with client:
        yield client


class KeepToCores(WorkerPlugin):
    """Plugin of a worker that confines its process to cores, before it has any other thread."""

    def __init__(self, cores: Sequence[int]) -> None:
        self.cores = tuple(cores)

    def setup(self, worker: Any) -> None:
        os.sched_setaffinity(0, self.cores)


@contextmanager
def _interrupts_kept_back() -> Iterator[None]:
    """Hold Ctrl-C back while the block runs, and for good from the threads that it starts.

    A terminal sends the signal to all processes. Workers inherit the mask of the thread that starts
    them, so only this process hears it, and ends them in order.
    """
    # A thread that finds no resource tracker starts one, and unmasks the signal.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
