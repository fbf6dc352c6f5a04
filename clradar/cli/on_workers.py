"""Work on worker processes by Dask, or on devices: errors and warnings come back with it."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from clradar.errors import ClradarError, ClradarWarning, ClusterError
from clradar.files.work_folder import scratch_folder

if TYPE_CHECKING:
    from clradar import Device
    from clradar.dataset.engine.distributed import Distributed
    from clradar.model.progress import Progress

Item = TypeVar("Item")
Outcome = tuple[Any, list[str]]
"""What a function returned, or its `ClradarError`; and its warnings, each once."""


@dataclass(frozen=True, slots=True)
class Cluster:
    """A running Dask cluster, and what its workers have to see under the same names.

    Attributes
    ----------
    scheduler : str
        Its address.
    folder : Path
        Where the work is written; it is there.
    files : sequence of Path
        What it reads: files and folders.
    """

    scheduler: str
    folder: Path
    files: Sequence[Path]


@dataclass(frozen=True, slots=True)
class _OnDevice:
    """Steps on a device: work of `clradar.opencl.Devices`."""

    steps: Any

    def __call__(self, item: Any, device: Device, _: Progress) -> Iterator[Any]:
        yield outcome_of(replace(self.steps, device=device).run, item)


@dataclass(frozen=True, slots=True)
class _OnCluster:
    """Steps on the device of a worker, of several one that is free."""

    steps: Any
    device: str | None

    def __call__(self, item: Any) -> Any:
        from clradar.dataset.engine.worker_resources import own_device

        return replace(self.steps, device=own_device(self.device)).run(item)


def each_made(
    steps: Any,
    items: Sequence[Item],
    workers: int | Cluster | None,
    device: str | None,
    what: str,
) -> Iterator[tuple[Item, Outcome]]:
    """Run the steps of every item; yield items as they are done.

    Parameters
    ----------
    steps : dataclass
        With a field `device` and a method `run`, which is called with an item. They can be sent.
    items : sequence
        Of values that can be sent.
    workers : int, Cluster or None
        Worker processes; None: in this one, or in one for each of several devices.
    device : str or None
        As of `clradar.opencl.open_devices`.
    what : str
        For which the devices have to be alike.
    """
    from clradar.opencl import open_devices

    elsewhere = replace(steps, device=None)  # each opens the device that it is given
    if isinstance(workers, Cluster):
        yield from each_on_workers(_OnCluster(elsewhere, device), items, workers, device)
        return
    if workers is not None:
        yield from each_on_workers(elsewhere.run, items, workers, device)
        return
    devices = open_devices(device)
    devices.check_alike(what)
    for i, outcome in devices.made(_OnDevice(elsewhere), items):
        yield items[i], outcome


def each_on_workers(
    function: Callable[[Item], Any],
    items: Sequence[Item],
    workers: int | Cluster,
    device: str | None,
) -> Iterator[tuple[Item, Outcome]]:
    """Call a function with every item on workers; yield items as they are done.

    An item whose worker dies is done again; it is an error of the item where that dies each time.

    Parameters
    ----------
    function : callable
        Importable, as it is sent to processes that were started afresh.
    items : sequence
        Of values that can be sent.
    workers : int or Cluster
        At most so many, each with its own device and cores (`worker_resources`); or those of a
        running cluster.
    device : str or None
        See `clradar.open_device`.

    Raises
    ------
    ModelError
        More workers than a CPU device has cores.
    ClusterError
        The workers do not start, differ from each other, or do not see the files.
    """
    with scratch_folder() as own, _engine(workers, len(items), device) as engine:
        # Workers of this machine see what this process sees.
        shared = workers if isinstance(workers, Cluster) else Cluster("", own, ())
        files = tuple(str(path.absolute()) for path in shared.files)
        folder = shared.folder.absolute()
        make = _Numbered(function, dict(enumerate(items)), folder, engine.device, files)
        for made in engine.outcomes(range(len(items)), make):
            if isinstance(made, tuple):
                number, outcome = made
                yield items[number], outcome
            else:
                yield items[made.sample], (ClradarError(made.reason), [])
        engine.stop()


@contextmanager
def _engine(workers: int | Cluster, items: int, device: str | None) -> Iterator[Distributed]:
    try:
        from clradar.dataset.engine.cluster import local_cluster, running_cluster, silence
        from clradar.dataset.engine.distributed import Distributed
    except ImportError as error:
        raise ClusterError(
            f"workers need Dask: pip install 'clradar[dataset]' ({error})"
        ) from error
    from clradar.dataset.engine.worker_resources import worker_resources

    silence()
    if isinstance(workers, Cluster):
        with running_cluster(workers.scheduler) as client:
            engine = Distributed(client, device)
            try:
                yield engine
            finally:
                engine.stop()
        return
    with local_cluster(worker_resources(min(workers, items), device)) as (client, end):
        # Each worker has its device in CLRADAR_DEVICE.
        yield Distributed(client, end_workers=end)


@dataclass(frozen=True, slots=True)
class _Numbered:
    """A function and its items by their numbers: work of `Distributed`."""

    function: Callable[[Any], Any]
    items: Mapping[int, Any]
    folder: Path
    device: str | None
    files: tuple[str, ...]

    def alone(self, sample: int) -> _Numbered:
        return replace(self, items={sample: self.items[sample]})

    def __call__(self, sample: int) -> tuple[int, Outcome]:
        return sample, outcome_of(self.function, self.items[sample])


def outcome_of(function: Callable[[Item], Any], item: Item) -> Outcome:
    """Call a function; an error keeps its type on its way back."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ClradarWarning)
        try:
            result = function(item)
        except ClradarError as error:
            result = error
    ours = (str(one.message) for one in caught if issubclass(one.category, ClradarWarning))
    return result, list(dict.fromkeys(ours))
