"""Which device and which cores each process of this machine gets."""

from __future__ import annotations

import os
from dataclasses import dataclass

from clradar.errors import ModelError
from clradar.opencl import DeviceInfo, devices_like


@dataclass(frozen=True, slots=True)
class Share:
    """What one process may use.

    Attributes
    ----------
    device : str
        Selector, see `clradar.opencl.DeviceInfo`.
    cores : tuple of int
        Processors of this machine. Of a GPU's process they are not exclusive: drivers have threads
        of their own that wait more than they work.
    threads : int
        How many threads its OpenCL CPU device and its numpy may have.
    """

    device: str
    cores: tuple[int, ...]
    threads: int

    def environment(self) -> dict[str, str]:
        """Return the variables by which OpenCL finds its limits; to be set before it is asked.

        PoCL reads POCL_CPU_MAX_CU_COUNT from version 4 on and POCL_MAX_PTHREAD_COUNT before; with
        either it says so many compute units. Other runtimes keep to the cores that the process has.
        """
        return {
            "CLRADAR_DEVICE": self.device,
            "POCL_MAX_PTHREAD_COUNT": str(self.threads),
            "POCL_CPU_MAX_CU_COUNT": str(self.threads),
        }


def shares(workers: int, device: str | None = None) -> list[Share]:
    """Deal devices and cores to processes.

    GPUs of one kind are dealt in turn, so there may be more processes than GPUs. A CPU device is
    cut by cores, as equally as they allow.

    Parameters
    ----------
    workers : int
    device : str or None
        See `clradar.open_device`. Any other device of the same name and driver is taken, too; a
        selector such as "0:1" means that one alone.

    Raises
    ------
    ModelError
        A CPU device has fewer cores than processes are wanted.
    DeviceError
        No such device.
    """
    return _dealt(workers, devices_like(device), sorted(os.sched_getaffinity(0)))


def _dealt(workers: int, devices: list[DeviceInfo], cores: list[int]) -> list[Share]:
    if devices[0].kind == "gpu":
        threads = max(1, len(cores) // workers)
        return [
            Share(devices[i % len(devices)].selector, tuple(cores), threads) for i in range(workers)
        ]
    if workers > len(cores):
        raise ModelError(
            f"workers: expected at most {len(cores)}, one per core of the CPU device, got {workers}"
        )
    found, first = [], 0
    for i in range(workers):
        count = len(cores) // workers + (i < len(cores) % workers)
        own = tuple(cores[first : first + count])
        found.append(Share(devices[0].selector, own, count))
        first += count
    return found
