"""Where items are worked on: here, or by the workers of one Dask client.

Processes and not threads: the host's part of a simulation holds Python's global lock, filters of
warnings belong to a process, and where a driver crashes it is known whose it was.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from clradar.errors import ClusterError, DeviceError, ModelError, warn
from clradar.jobs.outcome import Outcome, Result, Work, outcome_of, silent
from clradar.model.progress import Progress, part_of
from clradar.opencl import Device, DeviceInfo, devices_like, open_device
from clradar.opencl.choice import select_devices, several

if TYPE_CHECKING:
    from clradar.jobs.workers import Workers

Item = TypeVar("Item")

DeviceLike = Device | str | Sequence[str] | None


@dataclass(frozen=True)
class Where:
    """The devices of a batch, and the processes that have them: by default this one, or one each.

    "all" are all GPUs, those of one name by the first driver that offers them; without GPUs the CPU
    device that is used anyway, and others of its name and driver. A sequence, or names with commas
    between them: those, each once. Else as `clradar.open_device`.
    """

    device: Any = None
    workers: int | None = None  # processes of this machine, each with its own device and cores
    scheduler: str | None = None  # of Dask, whose workers have to see the files
    files: tuple[Path, ...] = ()  # files and folders that are read

    def __post_init__(self) -> None:
        own = self.workers is None and isinstance(self.device, str | None)
        if self.scheduler is not None and not own:  # its workers are there, and open their devices
            raise ModelError("scheduler: expected no workers beside it, and a device by its name")

    @cached_property
    def infos(self) -> tuple[DeviceInfo, ...]:
        """The devices, of which a single one works in this process."""
        one = isinstance(self.device, Device)
        return (self.device.info,) if one else tuple(select_devices(self.device))

    @property
    def first(self) -> Device:
        """The first device, opened in this process."""
        one = isinstance(self.device, Device)
        return open_device(self.device if one else self.infos[0].selector)

    @property
    def text(self) -> str:
        return self.first.info.label if len(self.infos) == 1 else _listed(self.infos)

    @property
    def here(self) -> bool:
        return self.workers is None and self.scheduler is None and len(self.infos) == 1

    def check_alike(self, what: str) -> None:
        """Raise `DeviceError` unless all are of one name and driver, so that bits are the same."""
        if not all(info.is_like(self.infos[0]) for info in self.infos[1:]):
            raise DeviceError(
                f"device: expected devices of one name and driver for {what}, since those of "
                f"others give other bits, got {_listed(self.infos)}; name those of one kind, as in "
                "0:0,0:1"
            )

    def made(
        self, work: Work[Iterable[Result]], items: Iterable[Any], progress: Progress | None = None
    ) -> Iterator[tuple[int, Result]]:
        """Yield the results of all items in order, each with its item's number; or an error."""
        items = list(items)
        if self.here or len(items) < 2:
            numbered = _with_progress(items, progress)
            yield from ((i, r) for i, item, part in numbered for r in work(item, self.first, part))
            return
        said: set[str] = set()
        with self._started(len(items), None) as started:
            for i, (results, warned) in enumerate(started.in_order(partial(_all_of, work), items)):
                for text in (text for text in warned if text not in said):
                    warn(text)
                    said.add(text)
                for result in results:
                    yield i, result
                if progress is not None:
                    progress(i + 1, len(items))

    def outcomes(
        self, work: Work[Any], items: Sequence[Item], folder: Path, progress: Progress | None = None
    ) -> Iterator[tuple[Item, Outcome]]:
        """Work on every item; yield items with their outcomes, as they are done.

        `work` writes into `folder`, and can be pickled, and so can the items.
        """
        if self.here:
            for _, item, part in _with_progress(items, progress):
                yield item, outcome_of(work, item, self.first, part)
        elif items:
            with self._started(len(items), folder) as started:
                found = started.outcomes(work, items)
                for done, (number, outcome) in enumerate(found, start=1):
                    yield items[number], outcome
                    if progress is not None:
                        progress(done, len(items))

    @contextmanager
    def _started(self, n_items: int, folder: Path | None) -> Iterator[Workers]:
        """The workers, for so many items, which may write into a folder; ended with the block."""
        try:
            from clradar.jobs import workers as dask
        except ImportError as error:
            raise ClusterError(
                f"several processes need Dask: pip install 'dask[distributed]' ({error})"
            ) from error
        if self.scheduler is not None:
            files = [str(path.absolute()) for path in self.files]
            # Of several devices each worker has its own, in CLRADAR_DEVICE.
            device = None if several(self.device) else self.device
            of = (self.scheduler, folder or Path(), files, device)
            with dask.Workers.of_scheduler(*of) as started:
                yield started
            return
        infos: Sequence[DeviceInfo] = self.infos
        if self.workers is not None and len(infos) == 1:
            infos = devices_like(self.device)
        elif folder is not None:
            self.check_alike("worker processes")
        n_workers = min(self.workers or len(infos), n_items)
        shares = dask.partition(n_workers, infos, dask.own_cores())
        names = [_listed([infos[i % len(infos)]]) for i in range(n_workers)]
        with dask.local_client(shares) as client:
            yield dask.Workers(client, names=names)


def open_devices(device: Where | DeviceLike = "all") -> Where:
    """Choose the devices of a batch, which have to be there; `Where` is returned as it is."""
    where = device if isinstance(device, Where) else Where(device)
    _ = where.infos  # raises now where there is none
    return where


def map_devices(
    function: Callable[[Any, Device], Result],
    items: Iterable[Any],
    *,
    device: DeviceLike = "all",
    progress: Progress | None = None,
) -> Iterator[Result]:
    """Call a function for every item, on several devices at the same time.

    Every device has a process of its own, which takes the next item when it is free; a single
    device works in this process. Devices of one name and driver give the same bits.

    Parameters
    ----------
    function : callable
        Called with an item and an opened device. With several devices, which need Dask (pip install
        'dask[distributed]'), function, items and results are pickled, and a script that calls this
        has its own code under ``if __name__ == "__main__":``.
    items : iterable
    device : Device, str, sequence of str or None
        "all": all GPUs, or without one the CPU device that is used anyway; several names, as a
        sequence or with commas; else as `clradar.open_device`.
    progress : callable, optional
        Called with (done, total) units of work.

    Yields
    ------
    object
        What the function returns, in the order of the items; up to four items per device are made
        ahead. Its first error ends the other processes.

    Examples
    --------
    >>> def lanes(item, device):
    ...     return item * device.width
    >>> list(clradar.map_devices(lanes, [1, 2, 3], device="pocl"))
    [8, 16, 24]
    """
    made = open_devices(device).made(partial(_plain, function), items, progress)
    return (result for _, result in made)


# Of modules, so that they can be pickled.


def _plain(function: Any, item: Any, device: Device, progress: Progress) -> list[Any]:
    """Work by a function that returns one result and says nothing meanwhile."""
    return [function(item, device)]


def _all_of(work: Any, item: Any, device: Device, progress: Progress) -> list[Any]:
    """All results of work at once, as a worker returns them."""
    return list(work(item, device, progress))


def _with_progress(
    items: Sequence[Item], progress: Progress | None
) -> Iterator[tuple[int, Item, Progress]]:
    """Number each item, with the progress of its share, which is complete at the next one."""
    for i, item in enumerate(items):
        part = part_of(progress, i / len(items), (i + 1) / len(items)) or silent
        yield i, item, part
        part(1, 1)


def _listed(infos: Sequence[DeviceInfo]) -> str:
    return ", ".join(f"{info.selector} {info.label}" for info in infos)
