"""Partition of this machine's OpenCL devices and processor cores among worker processes."""

from __future__ import annotations

import os
from dataclasses import dataclass

from clradar.errors import ModelError
from clradar.opencl import DeviceInfo, devices_like


@dataclass(frozen=True, slots=True)
class WorkerResources:
    """The device and the cores of one worker process.

    Attributes
    ----------
    device : str
        Selector, see `clradar.opencl.DeviceInfo`.
    cores : tuple of int
        Processors of this machine. Workers on GPUs have all of them: the threads of a GPU's driver
        wait more than they work.
    threads : int
        Threads of its OpenCL CPU device and of its numpy.
    """

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

    GPUs of one kind are assigned in turn, so there may be more workers than GPUs. The cores of a
    CPU device are divided as equally as possible.

    Parameters
    ----------
    workers : int
    device : str or None
        See `clradar.open_device`. All devices of the same name and driver are used; a selector such
        as "0:1" means that one alone.

    Raises
    ------
    ModelError
        More workers than a CPU device has cores.
    DeviceError
        No such device.
    """
    return partition(workers, devices_like(device), own_cores())


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
        count = len(cores) // workers + (i < len(cores) % workers)
        own = tuple(cores[first : first + count])
        found.append(WorkerResources(devices[0].selector, own, count))
        first += count
    return found
