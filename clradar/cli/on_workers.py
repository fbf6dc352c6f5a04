"""Work on worker processes by Dask, or on devices: errors and warnings come back with it."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

from clradar.errors import ClradarError, ClradarWarning

if TYPE_CHECKING:
    from clradar import Device
    from clradar.model.progress import Progress

Item = TypeVar("Item")
Outcome = tuple[Any, list[str]]
"""What a function returned, or its `ClradarError`; and its warnings, each once."""


@dataclass(frozen=True, slots=True)
class _OnDevice:
    """Steps on a device: work of `clradar.opencl.Devices`."""

    steps: Any

    def __call__(self, item: Any, device: Device, _: Progress) -> Iterator[Any]:
        yield outcome_of(replace(self.steps, device=device).run, item)


def each_made(
    steps: Any, items: Sequence[Item], workers: int | None, device: str | None, what: str
) -> Iterator[tuple[Item, Outcome]]:
    """Run the steps of every item; yield items as they are done.

    Parameters
    ----------
    steps : dataclass
        With a field `device` and a method `run`, which is called with an item. They can be sent.
    items : sequence
        Of values that can be sent.
    workers : int or None
        Worker processes; None: in this one, or in one for each of several devices.
    device : str or None
        As of `clradar.opencl.open_devices`.
    what : str
        For which the devices have to be alike.
    """
    from clradar.opencl import open_devices

    elsewhere = replace(steps, device=None)  # each opens the device that it is given
    if workers is not None:
        yield from each_on_workers(elsewhere.run, items, workers, device)
        return
    devices = open_devices(device)
    devices.check_alike(what)
    for i, outcome in devices.made(_OnDevice(elsewhere), items):
        yield items[i], outcome


def each_on_workers(
    function: Callable[[Item], Any], items: Sequence[Item], workers: int, device: str | None
) -> Iterator[tuple[Item, Outcome]]:
    """Call a function with every item on workers; yield items as they are done.

    Parameters
    ----------
    function : callable
        Importable, as it is sent to processes that were started afresh.
    items : sequence
        Of values that can be sent.
    workers : int
        At most so many, each with its own device and cores (`worker_resources`).
    device : str or None
        See `clradar.open_device`.

    Raises
    ------
    ModelError
        More workers than a CPU device has cores.
    ClusterError
        The workers do not start.
    """
    from distributed import as_completed

    from clradar.dataset.engine.cluster import DEVICE, local_cluster
    from clradar.dataset.engine.worker_resources import worker_resources

    resources = worker_resources(min(workers, len(items)), device)
    with local_cluster(resources) as (client, end), client.as_current():
        futures = {
            client.submit(outcome_of, function, item, resources={DEVICE: 1}, pure=False): item
            for item in items
        }
        for future in as_completed(futures):
            yield futures[future], future.result()
            future.release()
        end()


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
