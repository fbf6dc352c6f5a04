"""Partition of this machine's OpenCL devices and processor cores among worker processes."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from clradar.errors import DeviceError, ModelError
from clradar.opencl import Device, DeviceInfo, devices_like
from clradar.opencl.choice import select_devices, several
from clradar.versions import own_version, package_versions


def check_alike(infos: Sequence[DeviceInfo], what: str) -> None:
    """Raise `DeviceError` unless all devices are of one name and driver."""
    if not all(info.is_like(infos[0]) for info in infos[1:]):
        raise DeviceError(
            f"device: expected devices of one name and driver for {what}, since those of others "
            f"give other bits, got {listed(infos)}; name those of one kind, as in 0:0,0:1"
        )


def listed(infos: Sequence[DeviceInfo]) -> str:
    """Selectors and names of devices."""
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


def worker_resources(
    workers: int | None, device: str | None = None, most: int | None = None
) -> list[WorkerResources]:
    """Assign devices and cores to worker processes, at most `most`; None: one for each device.

    Devices of one kind are assigned in turn, so there may be more workers than GPUs. The cores of
    CPU devices are divided as equally as possible.
    """
    if several(device):
        infos = select_devices(device)
        check_alike(infos, "worker processes")
    else:
        infos = devices_like(device)
    workers = len(infos) if workers is None else workers
    return partition(workers if most is None else min(workers, most), infos, own_cores())


def own_cores() -> list[int]:
    """The processors that this process may use; all where the system does not tell."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def partition(workers: int, devices: list[DeviceInfo], cores: list[int]) -> list[WorkerResources]:
    """Assign these devices and these cores to `workers` processes."""
    is_gpu, n_cores = devices[0].kind == "gpu", len(cores)
    if not is_gpu and workers > n_cores:
        raise ModelError(
            f"workers: expected at most {n_cores}, one per core of the CPU device, got {workers}"
        )
    found, first = [], 0
    for i in range(workers):
        n = max(1, n_cores // workers) if is_gpu else n_cores // workers + (i < n_cores % workers)
        own = tuple(cores if is_gpu else cores[first : first + n])
        found.append(WorkerResources(devices[i % len(devices)].selector, own, n))
        first += n
    return found
