"""Where items are worked on: here, or by Dask on processes of this machine or of others.

Processes and not threads: the host's part of a simulation holds Python's global lock, filters of
warnings belong to a process, and where a driver crashes it is known whose it was.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from clradar.errors import ClusterError, DeviceError, ModelError, warn
from clradar.jobs.outcome import Outcome, outcome_of
from clradar.jobs.resources import (
    WorkerResources,
    check_alike,
    listed,
    own_cores,
    worker_resources,
)
from clradar.model.progress import Progress, part_of
from clradar.opencl import Device, DeviceInfo, open_device
from clradar.opencl.choice import select_devices, several
from clradar.opencl.program import compiled
from clradar.opencl.self_test import self_test

if TYPE_CHECKING:
    from clradar.jobs.distributed import Distributed

AHEAD = 4
"""Items per device that may be made before the turn of their results: these are kept."""

Item = TypeVar("Item")
Result = TypeVar("Result")

Work = Callable[[Any, Device, Progress], Iterable[Result]]
"""Makes the results of an item on a device; says by the last argument how far it is."""


@dataclass(frozen=True, slots=True)
class Devices:
    """The devices of a batch, the first of which is opened in this process.

    A single one makes all items here; each of several has a worker process.
    """

    infos: tuple[DeviceInfo, ...]
    first: Device

    @property
    def text(self) -> str:
        """Their names, for a person."""
        return self.first.info.label if len(self.infos) == 1 else listed(self.infos)

    def check_alike(self, what: str) -> None:
        """Raise `DeviceError` unless all are of one name and driver, so that bits are the same."""
        check_alike(self.infos, what)

    def made(
        self, work: Work[Result], items: Iterable[Any], progress: Progress | None = None
    ) -> Iterator[tuple[int, Result]]:
        """Make the results of all items; yields the number of an item with each, in their order.

        With several devices `work` and the items are pickled. The first error ends the batch; a
        warning of workers is given once.
        """
        items = list(items)
        if len(self.infos) > 1 and len(items) > 1:
            yield from self._on_workers(work, items, progress)
            return
        for i, item in enumerate(items):
            part = part_of(progress, i / len(items), (i + 1) / len(items))
            for result in work(item, self.first, part or _silent):
                yield i, result
            if part is not None:
                part(1, 1)

    def _on_workers(
        self, work: Work[Result], items: list[Any], progress: Progress | None
    ) -> Iterator[tuple[int, Result]]:
        with _dask():
            from distributed import as_completed

            from clradar.jobs.cluster import DEVICE, local_cluster
        infos = self.infos[: len(items)]
        cores = own_cores()
        threads = max(1, len(cores) // len(infos))
        each = [WorkerResources(info.selector, tuple(cores), threads) for info in infos]
        said: set[str] = set()
        with local_cluster(each) as (client, _):
            finished = as_completed([], loop=client.loop)
            numbers: dict[Any, int] = {}
            ready: dict[int, list[Result]] = {}
            for i in range(len(items)):
                for number in range(len(numbers), min(len(items), i + AHEAD * len(infos))):
                    task = partial(_results, work, items[number])
                    future = client.submit(task, pure=False, resources={DEVICE: 1})
                    numbers[future.key] = number
                    finished.add(future)
                while i not in ready:
                    future = next(finished)
                    number = numbers[future.key]
                    ready[number], warned = self._result(future, number, infos)
                    for text in (text for text in warned if text not in said):
                        warn(text)
                        said.add(text)
                for result in ready.pop(i):
                    yield i, result
                if progress is not None:
                    progress(i + 1, len(items))

    def _result(self, future: Any, i: int, infos: tuple[DeviceInfo, ...]) -> Outcome:
        from distributed import KilledWorker

        try:
            results, warned, selector = future.result()
        except KilledWorker as error:
            name = listed([infos[int(str(error.last_worker.name))]])
            raise DeviceError(
                f"device {name}: its process died at item {i}; choose other devices, see "
                "`clradar devices`"
            ) from error
        if type(results) is DeviceError:  # with its selector: names may be the same
            (info,) = (one for one in infos if one.selector == selector)
            text = str(results).removeprefix(f"device {info.label}: ")
            raise DeviceError(f"device {listed([info])}: {text}")
        if isinstance(results, BaseException):
            raise results
        return results, warned


def _results(work: Work[Any], item: Any) -> tuple[Any, list[str], str]:
    """All results of an item: what a worker of a device runs."""
    device = _tested_device()
    results, warned = outcome_of(lambda: list(work(item, device, _silent)))
    return results, warned, device.info.selector


@lru_cache(maxsize=1)
def _tested_device() -> Device:
    device = open_device()
    self_test(device, compiled)
    return device


def _silent(done: int, total: int) -> None:
    pass


def open_devices(device: Devices | Device | str | Sequence[str] | None = "all") -> Devices:
    """Choose the devices of a batch; `Devices` are returned as they are.

    "all": all GPUs, those of one name by the first driver that offers them; without GPUs the CPU
    device that is used anyway, and others of its name and driver. A sequence, or names with commas
    between them: those, each once. Else as `clradar.open_device`.
    """
    if isinstance(device, Devices):
        return device
    if isinstance(device, Device):
        return Devices((device.info,), device)
    infos = select_devices(device)
    return Devices(tuple(infos), open_device(infos[0].selector))


def map_devices(
    function: Callable[[Any, Device], Result],
    items: Iterable[Any],
    *,
    device: Device | str | Sequence[str] | None = "all",
    progress: Progress | None = None,
) -> Iterator[Result]:
    """Call a function for every item, on several devices at the same time.

    Every device has a process of its own, which takes the next item when it is free; a single
    device works in this process. Frames, alphas or samples of a batch come out as from one device:
    the same bits from devices of one name and driver, else what differs between runtimes.

    Parameters
    ----------
    function : callable
        Called with an item and an opened device. With several devices, which need Dask (pip install
        'dask[distributed]'), function, items and results are pickled, and a script that calls this
        has its own code under ``if __name__ == "__main__":``.
    items : iterable
    device : Device, str, sequence of str or None
        "all": all GPUs, or without one the CPU device that is used anyway; names with commas, or a
        sequence of names: those; else as `clradar.open_device`.
    progress : callable, optional
        Called with (done, total) units of work.

    Yields
    ------
    object
        What the function returns, in the order of the items. Up to four items per device are made
        ahead of the one that is waited for.

    Raises
    ------
    DeviceError
        There is no such device, it fails its test, or it fails; the message names it.
    Exception
        What the function raises. The other processes are ended.

    Examples
    --------
    >>> import clradar
    >>> def lanes(item, device):
    ...     return item * device.width
    >>> list(clradar.map_devices(lanes, [1, 2, 3], device="pocl"))
    [8, 16, 24]
    """
    made = open_devices(device).made(_Plain(function), items, progress)
    return (result for _, result in made)


@dataclass(frozen=True, slots=True)
class _Plain:
    """Work by a function that returns one result and says nothing meanwhile."""

    function: Callable[[Any, Device], Any]

    def __call__(self, item: Any, device: Device, progress: Progress) -> list[Any]:
        return [self.function(item, device)]


@dataclass(frozen=True, slots=True)
class Where:
    """Where the items of a job are worked on; workers of a scheduler have to see the files."""

    device: str | None = None  # as of `open_devices`: each of several has a worker process
    workers: int | None = None  # processes of this machine, each with its own device and cores
    scheduler: str | None = None  # the address of a Dask scheduler
    files: tuple[Path, ...] = ()  # files and folders that are read

    def __post_init__(self) -> None:
        if self.workers is not None and self.scheduler is not None:
            raise ModelError("workers, scheduler: expected one of the two: a scheduler has its own")

    @property
    def here(self) -> bool:
        """Whether all is done by this process."""
        if self.workers is not None or self.scheduler is not None:
            return False
        return len(select_devices(self.device)) == 1

    def outcomes(
        self, steps: Any, items: Sequence[Item], folder: Path, progress: Progress | None = None
    ) -> Iterator[tuple[Item, Outcome]]:
        """Run the steps of every item; yield items with their outcomes, as they are done.

        `steps` is a dataclass with a field `device` and a method `run`, which is called with an
        item and a progress callback or None, and writes into `folder`. It can be pickled, and so
        can the items.
        """
        if not items:
            return
        if self.here:
            opened = open_devices(self.device).first
            for i, item in enumerate(items):
                part = part_of(progress, i / len(items), (i + 1) / len(items))
                yield item, outcome_of(replace(steps, device=opened).run, item, part)
                if part is not None:
                    part(1, 1)
            return
        elsewhere = replace(steps, device=None)  # each opens the device that it is given
        files = [str(path.absolute()) for path in self.files]
        with self._engine(len(items)) as engine:
            made = engine.outcomes(elsewhere, items, folder, files)
            for done, (number, outcome) in enumerate(made, start=1):
                yield items[number], outcome
                if progress is not None:
                    progress(done, len(items))

    @contextmanager
    def _engine(self, n_items: int) -> Iterator[Distributed]:
        """The workers, for so many items; they are stopped at the end."""
        with _dask():
            from clradar.jobs.cluster import local_cluster, running_cluster
            from clradar.jobs.distributed import Distributed
        with ExitStack() as stack:
            if self.scheduler is not None:
                client = stack.enter_context(running_cluster(self.scheduler))
                # Of several devices each worker has its own, in CLRADAR_DEVICE.
                engine = Distributed(client, None if several(self.device) else self.device)
            else:
                each = worker_resources(self.workers, self.device, n_items)
                client, end = stack.enter_context(local_cluster(each))
                engine = Distributed(client, end_workers=end)  # whose device is in CLRADAR_DEVICE
            try:
                yield engine
            finally:
                engine.stop()


@contextmanager
def _dask() -> Iterator[None]:
    try:
        yield
    except ImportError as error:
        raise ClusterError(
            f"several processes need Dask: pip install 'dask[distributed]' ({error})"
        ) from error
