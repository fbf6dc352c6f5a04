"""Partition of this machine's OpenCL devices and processor cores among worker processes."""

from __future__ import annotations

import atexit
import os
import platform
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, lru_cache
from getpass import getuser
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clradar.errors import DeviceError, ModelError
from clradar.jobs.lock import locked, unlock
from clradar.opencl import Device, DeviceInfo, devices_like, open_device
from clradar.opencl.choice import select_devices, several
from clradar.versions import own_version, package_versions

if TYPE_CHECKING:
    from filelock import BaseFileLock

_leases: list[BaseFileLock] = []
"""Of this process: the system lets go of them when it ends, however it ends."""


def own_device(device: str | None) -> Device:
    """Open the device of this process; of several one that no other process here has leased.

    Workers that were started apart, such as those of one `dask worker` for each GPU, find their
    own by it. If there are more of them than devices, devices get a second one, and so on.
    """
    return open_device(_leased(device) if several(device) else device)


@lru_cache(maxsize=4)
def _leased(device: str | None) -> str:
    infos = select_devices(device)
    if len(infos) == 1:
        return infos[0].selector
    try:
        folder = Path(tempfile.gettempdir()) / f"clradar-devices-{getuser()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        for turn in count():
            for info in infos:
                lease = locked(folder / f"{info.selector.replace(':', '-')}.{turn}", wait_s=0)
                if lease is not None:
                    _leases.append(lease)
                    atexit.register(_ended, lease)
                    return info.selector
    except OSError as error:
        raise DeviceError(
            f"device: cannot lease one of several ({error}); name one for each worker by "
            "CLRADAR_DEVICE"
        ) from error
    raise AssertionError("unreachable")


def _ended(lease: BaseFileLock) -> None:
    unlock(lease)
    with suppress(OSError):  # others have theirs there
        Path(lease.lock_file).parent.rmdir()


def check_alike(infos: Sequence[DeviceInfo], what: str) -> None:
    """Raise `DeviceError` unless all devices are of one name and driver."""
    if not all(info.is_like(infos[0]) for info in infos[1:]):
        raise DeviceError(
            f"device: expected devices of one name and driver for {what}, since those of others "
            f"give other bits, got {listed(infos)}; name those of one kind, as in 0:0,0:1"
        )


def listed(infos: Sequence[DeviceInfo]) -> str:
    """Devices in words."""
    return ", ".join(f"{info.selector} {info.label}" for info in infos)


def made_with(device: Device) -> dict[str, Any]:
    """The versions and the device on which the bits of a result depend."""
    return {
        "clradar": own_version(),
        "packages": dict(_packages()),
        "python": platform.python_version(),
        "device": dict(device.describe()),
    }


@cache
def _packages() -> dict[str, str]:
    return package_versions()  # reads files, for every item


def divided(workers: int | None, device: str | None) -> tuple[int | None, str | None]:
    """How many worker processes there are, None for none, and on what.

    Where several devices are named, and no number of workers, each gets one.
    """
    if not several(device):
        return workers, device
    infos = select_devices(device)
    check_alike(infos, "worker processes")
    if len(infos) > 1 and workers is None:
        workers = len(infos)
    return workers, ",".join(info.selector for info in infos)


@dataclass(frozen=True, slots=True)
class WorkerResources:
    """The device and the cores of one worker process."""

    device: str
    cores: tuple[int, ...]
    threads: int

    def environment(self) -> dict[str, str]:
        """Return the environment variables that limit OpenCL; set before the process starts.

        PoCL reads POCL_CPU_MAX_CU_COUNT from version 4 on and POCL_MAX_PTHREAD_COUNT before; with
        either it reports so many compute units. Other runtimes use the cores that the process has.
        """
        return {
            "CLRADAR_DEVICE": self.device,
            "POCL_MAX_PTHREAD_COUNT": str(self.threads),
            "POCL_CPU_MAX_CU_COUNT": str(self.threads),
        }


def worker_resources(workers: int, device: str | None = None) -> list[WorkerResources]:
    """Assign devices and cores to worker processes.

    Devices of one kind are assigned in turn, so there may be more workers than GPUs. The cores of
    CPU devices are divided as equally as possible.
    """
    if several(device):
        infos = select_devices(device)
        check_alike(infos, "worker processes")
    else:
        infos = devices_like(device)
    return partition(workers, infos, own_cores())


def own_cores() -> list[int]:
    """The processors that this process may use; all where the system does not tell."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def partition(workers: int, devices: list[DeviceInfo], cores: list[int]) -> list[WorkerResources]:
    """Assign these devices and these cores to `workers` processes."""
    if devices[0].kind == "gpu":
        threads = max(1, len(cores) // workers)
        return [
            WorkerResources(devices[i % len(devices)].selector, tuple(cores), threads)
            for i in range(workers)
        ]
    if workers > len(cores):
        raise ModelError(
            f"workers: expected at most {len(cores)}, one per core of the CPU device, got {workers}"
        )
    found, first = [], 0
    for i in range(workers):
        n = len(cores) // workers + (i < len(cores) % workers)
        own = tuple(cores[first : first + n])
        found.append(WorkerResources(devices[i % len(devices)].selector, own, n))
        first += n
    return found
