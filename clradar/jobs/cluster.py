"""Dask clusters: worker processes of this machine, or a scheduler that runs already.

Importing this needs Dask.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import dask
from distributed import Client, Nanny, Scheduler, SpecCluster
from distributed.diagnostics.plugin import WorkerPlugin

from clradar.errors import ClusterError
from clradar.files.failures import clean
from clradar.files.interrupts import interrupts_blocked
from clradar.jobs.lock import scratch_folder
from clradar.jobs.resources import WorkerResources

DEVICE = "DEVICE"
"""The Dask resource of workers: one for each sample that a worker makes at a time."""

CONNECT_S = 10.0

BLAS_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")

HERE = "127.0.0.1"


def _silence() -> None:
    """Silence Dask's own messages: the fate of samples and workers is reported here."""
    # Dask gives some of its loggers levels of their own, so that the parent's does not count.
    known = list(logging.root.manager.loggerDict)
    for name in {"distributed", "tornado.application", "asyncio", *known}:
        if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL)


STARTS = 2
"""How often the workers are started: one that is killed meanwhile is no reason to end."""


@contextmanager
def local_cluster(
    resources: Sequence[WorkerResources],
) -> Iterator[tuple[Client, Callable[[], Any]]]:
    """Start one worker process for each of `resources` on this machine."""
    _silence()
    threads = str(min(one.threads for one in resources))
    settings = {
        # numpy reads them when it is loaded, so they are set before a process starts. They replace
        # Dask's MALLOC_TRIM_THRESHOLD_, which makes every large array fault its pages in again and
        # a sample a third slower.
        "distributed.nanny.pre-spawn-environ": dict.fromkeys(BLAS_VARIABLES, threads),
        "distributed.worker.multiprocessing-method": "spawn",
        # Dask gives up a worker that is not back after 15 s, as on a busy machine, or that has died
        # again by then; its nanny starts it as often as it dies.
        "distributed.deploy.lost-worker-timeout": "1000 days",
        # What kills two workers is not given to a third.
        "distributed.scheduler.allowed-failures": 1,
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
                # Results are small; a worker is not killed for a sample that needs much memory.
                "memory_limit": None,
                "silence_logs": logging.CRITICAL,
            },
        }
        for i, one in enumerate(resources)
    }
    # Dask leaves its folder of scratch behind.
    with (
        scratch_folder() as scratch,
        dask.config.set({**settings, "temporary-directory": str(scratch)}),
    ):
        for left in reversed(range(STARTS)):
            try:
                with interrupts_blocked():
                    cluster = SpecCluster(
                        workers=workers, scheduler=scheduler, silence_logs=logging.CRITICAL
                    )
                break
            except Exception as error:
                if not left:
                    raise ClusterError(f"the workers did not start: {clean(error)}") from error

        def end() -> None:
            # Ctrl-C would cancel the closing, and closing again would wait for that forever.
            with interrupts_blocked():
                cluster.close()

        try:
            with Client(cluster, set_as_default=False) as client:
                yield client, end
        finally:
            end()


@contextmanager
def running_cluster(address: str) -> Iterator[Client]:
    """Connect to a Dask scheduler; yields the client."""
    _silence()
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
    """Plugin of a worker that sets the affinity of its process before it starts other threads."""

    def __init__(self, cores: Sequence[int]) -> None:
        self.cores = tuple(cores)

    def setup(self, worker: Any) -> None:
        if hasattr(os, "sched_setaffinity"):  # elsewhere the number of threads has to do
            os.sched_setaffinity(0, self.cores)
