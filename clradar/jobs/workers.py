"""The workers of one Dask client: processes of this machine, or those of a scheduler.

Dask schedules items, retries failed ones and restarts dead workers. This module limits the number
of submitted items, checks that workers are alike, and interprets outcomes. Importing it needs Dask.
"""

from __future__ import annotations

import json
import logging
import os
import secrets
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from socket import gethostname
from time import monotonic, sleep
from typing import Any

import dask
import distributed
from distributed.comm import CommClosedError
from distributed.diagnostics.plugin import WorkerPlugin

from clradar.errors import ClradarError, ClusterError, DeviceError, ModelError, OutputError
from clradar.files.atomic import write_file
from clradar.files.failures import clean, shown
from clradar.files.interrupts import interrupts_blocked
from clradar.files.json_file import differences
from clradar.jobs.lock import scratch_folder
from clradar.jobs.outcome import ATTEMPTS, Outcome, Work, made_with, outcome_of, reason_of, silent
from clradar.opencl import Device, DeviceInfo, open_device
from clradar.opencl.program import self_test
from clradar.versions import own_version

DEVICE = "DEVICE"  # the Dask resource of workers: one for each item that a worker makes at a time
AHEAD = 4
"""Submitted items per worker where results keep their order, so that others are made while one is
waited for; else one, so that no other is blamed where a worker dies."""

CONNECT_S = 10.0

FIRST_S, RETURN_S, POLL_S = 10.0, 600.0, 0.05
"""Longest wait for a first worker, and for one that died, which its nanny starts again however busy
the machine is; and the interval of polling."""

BLAS_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")

HERE = "127.0.0.1"


@dataclass(frozen=True, slots=True)
class Share:
    """The device and the cores of one worker process."""

    device: str
    cores: tuple[int, ...]
    threads: int

    def environment(self) -> dict[str, str]:
        """The environment variables that limit OpenCL; set before the process starts.

        PoCL reads POCL_CPU_MAX_CU_COUNT from version 4 on and POCL_MAX_PTHREAD_COUNT before; with
        either it reports so many compute units. Other runtimes use the cores that the process has.
        """
        threads = str(self.threads)
        return {
            "CLRADAR_DEVICE": self.device,
            "POCL_MAX_PTHREAD_COUNT": threads, "POCL_CPU_MAX_CU_COUNT": threads,
        }  # fmt: skip


def own_cores() -> list[int]:
    """The processors that this process may use; all where the system does not tell."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def partition(workers: int, devices: Sequence[DeviceInfo], cores: Sequence[int]) -> list[Share]:
    """Assign devices in turn, and cores of CPU devices in equal shares, to so many processes."""
    is_gpu, n_cores = devices[0].kind == "gpu", len(cores)
    if not is_gpu and workers > n_cores:
        raise ModelError(
            f"workers: expected at most {n_cores}, one per core of the CPU device, got {workers}"
        )
    shares, first = [], 0
    for i in range(workers):
        n = max(1, n_cores // workers) if is_gpu else n_cores // workers + (i < n_cores % workers)
        own = tuple(cores if is_gpu else cores[first : first + n])
        shares.append(Share(devices[i % len(devices)].selector, own, n))
        first += n
    return shares


class KeepToCores(WorkerPlugin):
    """Plugin of a worker that sets the affinity of its process before it starts other threads."""

    def __init__(self, cores: Sequence[int]) -> None:
        self.cores = tuple(cores)

    def setup(self, worker: Any) -> None:
        if hasattr(os, "sched_setaffinity"):  # elsewhere the number of threads has to do
            os.sched_setaffinity(0, self.cores)


@contextmanager
def local_client(shares: Sequence[Share]) -> Iterator[distributed.Client]:
    """Start one worker process for each share of this machine; yields the client."""
    _silence()
    threads = str(min(share.threads for share in shares))
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
        "cls": distributed.Scheduler,
        "options": {"host": HERE, "port": 0, "dashboard": True, "dashboard_address": f"{HERE}:0"},
    }
    common = {
        "host": HERE, "nthreads": 1, "resources": {DEVICE: 1}, "silence_logs": logging.CRITICAL,
        # Results are small; a worker is not killed for an item that needs much memory.
        "memory_limit": None,
    }  # fmt: skip
    workers = {}
    for i, share in enumerate(shares):
        own = {"env": share.environment(), "plugins": (KeepToCores(share.cores),)}
        workers[i] = {"cls": distributed.Nanny, "options": common | own}
    # Dask leaves its folder of scratch behind.
    with (
        scratch_folder() as scratch,
        dask.config.set({**settings, "temporary-directory": str(scratch)}),
    ):
        try:
            with interrupts_blocked():
                cluster = distributed.SpecCluster(
                    workers=workers, scheduler=scheduler, silence_logs=logging.CRITICAL
                )
        except Exception as error:
            raise ClusterError(f"the workers did not start: {clean(error)}") from error
        try:
            with distributed.Client(cluster, set_as_default=False) as client:
                yield client
        finally:
            # Ctrl-C would cancel the closing, and closing again would wait for that forever.
            with interrupts_blocked():
                cluster.close()


def _silence() -> None:
    """Silence Dask's own messages: the fate of items and workers is reported here."""
    # Of what goes to a worker with an item, such as a mesh.
    dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 TB"})
    # Dask gives some of its loggers levels of their own, so that the parent's does not count.
    known = list(logging.root.manager.loggerDict)
    for name in {"distributed", "tornado.application", "asyncio", *known}:
        if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL)


def worker_facts(device: str | None) -> dict[str, Any]:
    return made_with(open_device(device))


@dataclass(frozen=True, slots=True)
class Terms:
    """Conditions on a scheduler's worker, which each process verifies before its first item."""

    made_with: str
    device: str | None
    files: tuple[str, ...]
    here: str  # the client's folder: names of files may be relative to it


@lru_cache(maxsize=4)
def breach(terms: Terms) -> str | None:
    different = differences(json.loads(terms.made_with), worker_facts(terms.device))
    if different:
        return f"expected versions and device of the other workers: {'; '.join(different)}"
    unseen = [file for file in terms.files if not os.path.exists(file)]
    return f"cannot see {shown(unseen[0])}; share it under this name" if unseen else None


def run_item(work: Work[Any], item: Any, terms: Terms | None) -> Outcome:
    """Work on an item: the task that Dask runs."""
    if terms is None:  # a process of this machine, whose device is in CLRADAR_DEVICE
        device = _tested_device()
        result, warned = outcome_of(work, item, device, silent)
        if type(result) is DeviceError:  # with its selector: names may be the same
            text = str(result).removeprefix(f"device {device.info.label}: ")
            result = DeviceError(f"device {device.info.selector} {device.info.label}: {text}")
        return result, warned
    if (violated := breach(terms)) is not None:
        return OutputError(f"worker on {gethostname()}: {violated}"), []
    before = os.getcwd()
    try:
        with suppress(OSError):  # it is not on this machine
            os.chdir(terms.here)
        return outcome_of(work, item, open_device(terms.device), silent)
    finally:
        os.chdir(before)


@lru_cache(maxsize=1)
def _tested_device() -> Device:
    device = open_device()
    self_test(device)
    return device


class Workers:
    """The workers of a client: of this machine, with the names of their devices, or on terms."""

    def __init__(
        self, client: distributed.Client, terms: Terms | None = None, names: Sequence[str] = ()
    ) -> None:
        self.client, self.terms, self.names = client, terms, names

    @classmethod
    @contextmanager
    def of_scheduler(
        cls, address: str, folder: Path, files: Sequence[str], device: str | None
    ) -> Iterator[Workers]:
        """Those that a scheduler has; whether they see the folder is known by a file in it."""
        _silence()
        try:
            client = distributed.Client(address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise ClusterError(
                f"{clean(address)}: expected the address of a Dask scheduler, such as "
                f"tcp://HOST:8786; {clean(error)}"
            ) from error
        # A later run removes it as a temporary file, if this one is killed.
        visible = folder.absolute() / f".visible.{secrets.token_hex(16)}.tmp"
        with client:
            write_file(visible, b"")
            try:
                facts = json.dumps(cls(client)._facts(device))
                yield cls(client, Terms(facts, device, (str(visible), *files), os.getcwd()))
            finally:
                visible.unlink(missing_ok=True)

    def _facts(self, device: str | None) -> dict[str, Any]:
        """Versions and device of one worker, which has to be of this version."""
        self._await_workers(FIRST_S)
        expected = f"expected workers with clradar {own_version()}, as on the client"
        try:
            asked = self.client.submit(worker_facts, device, pure=False, resources={DEVICE: 1})
            facts: dict[str, Any] = asked.result()
            got = None if facts["clradar"] == own_version() else facts["clradar"]
        except Exception as error:
            got = reason_of(error)
        if got is not None:
            address = self.client.scheduler_info(n_workers=0)["address"]
            raise ClusterError(f"{address}: {expected}, got {got}")
        return facts

    def in_order(self, work: Work[Any], items: Sequence[Any]) -> Iterator[Outcome]:
        """Yield the outcomes of all items in their order; the first error ends all."""
        for i, future in self._finished(work, items, AHEAD, ordered=True):
            try:
                result, warned = future.result()
            except distributed.KilledWorker as error:
                name = self.names[int(str(error.last_worker.name))]
                raise DeviceError(
                    f"device {name}: its process died at item {i}; choose other devices, see "
                    "`clradar devices`"
                ) from error
            if isinstance(result, BaseException):
                raise result
            yield result, warned

    def outcomes(self, work: Work[Any], items: Sequence[Any]) -> Iterator[tuple[int, Outcome]]:
        """Yield the number of each item with its outcome, as soon as it is known."""
        for number, future in self._finished(work, items, 1):
            try:
                yield number, future.result()
            except distributed.KilledWorker:
                self._await_workers(RETURN_S)  # the next client may wait less
                yield number, (ClradarError("its worker process died each time"), [])
            except (distributed.CancelledError, CommClosedError) as error:
                raise ClusterError(
                    "the scheduler is gone, or cancelled the samples; the same command resumes"
                ) from error
            except Exception as error:
                yield number, (ClradarError(reason_of(error)), [])

    def _finished(
        self, work: Work[Any], items: Sequence[Any], ahead: int, *, ordered: bool = False
    ) -> Iterator[tuple[int, distributed.Future]]:
        """Yield numbers of items with futures that are done; `ahead` for each worker are begun."""
        run, finished = secrets.token_hex(4), distributed.as_completed([], loop=self.client.loop)
        pending: dict[distributed.Future, int] = {}
        ready: dict[int, distributed.Future] = {}
        submitted, dead = 0, -1
        try:
            for turn in range(len(items)):
                until = min(len(items), turn + max(1, ahead * len(self._known())))
                for number in range(submitted, until):
                    future = self.client.submit(
                        run_item, work, items[number], self.terms, key=("item", run, number),
                        resources={DEVICE: 1}, retries=0 if ordered else ATTEMPTS - 1,
                    )  # fmt: skip
                    pending[future] = number
                    finished.add(future)
                submitted = max(submitted, until)
                while not (due := [n for n in ready if not ordered or n in (turn, dead)]):
                    future = next(finished)
                    ready[number := pending.pop(future)] = future
                    # Where a process died the others are not waited for.
                    dead = number if future.status == "error" else dead
                yield due[0], ready.pop(due[0])
        finally:
            # Workers of a scheduler finish the items that they have begun, and leave what they made
            # to the next run.
            with suppress(Exception):
                self.client.cancel(list(pending))

    def _known(self) -> dict[str, Any]:
        """The workers with a device by their addresses."""
        known = self.client.scheduler_info(n_workers=-1)["workers"]
        return {at: worker for at, worker in known.items() if worker["resources"].get(DEVICE)}

    def _await_workers(self, limit_s: float) -> None:
        until_s = monotonic() + limit_s
        while not self._known():
            if monotonic() > until_s:
                address = self.client.scheduler_info(n_workers=0)["address"]
                raise ClusterError(
                    f"{address}: expected workers with a device, got none; start some by: "
                    f'dask worker {address} --nthreads 1 --memory-limit 0 --resources "{DEVICE}=1"'
                )
            sleep(POLL_S)
