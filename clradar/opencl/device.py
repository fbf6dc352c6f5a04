"""The OpenCL devices of this machine, and opening them."""

from __future__ import annotations

import math
import os
import threading
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any
from weakref import WeakSet

import pyopencl as cl

from clradar.errors import DeviceError
from clradar.opencl.pocl_target import named_target
from clradar.opencl.runtimes import platforms

INSTALL_HINT = (
    "install one: pip install 'pyopencl[pocl]' (Linux on x86-64) or intel-opencl-rt (any x86), "
    "conda-forge's pocl, the system's PoCL from 5.0 on, or a GPU's driver; see docs/install.md"
)

MEMORY_SHARE = 0.75  # of a device's memory that a call may plan with; the rest is the runtime's
GPU_LAUNCH_WORK = 4e9
"""Operations of one launch on a GPU, roughly; more are split. A tenth of a second where 0.4 TFLOP/s
are used to a tenth: one that drives a display stops what takes some seconds."""

GPU_GROUP_ITEMS = 64  # of a work-group: two warps of NVIDIA's, one or two wavefronts of AMD's


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """One OpenCL device of this machine.

    Attributes
    ----------
    selector : str
        "platform:device", the indices by which ``CLRADAR_DEVICE`` names it.
    name, platform, version : str
        As the driver gives them.
    kind : str
        "gpu", "cpu" or "other".
    memory_bytes, max_alloc_bytes : int
        Global memory and the largest single buffer.
    compute_units : int
    target : str or None
        The processor that a PoCL was told to compile for, where it does not know this one.
    """

    selector: str
    name: str
    platform: str
    version: str
    kind: str
    memory_bytes: int
    max_alloc_bytes: int
    compute_units: int
    target: str | None = None

    @property
    def label(self) -> str:
        return f"{self.name} [{self.platform}]"

    def is_like(self, other: DeviceInfo) -> bool:
        """Whether both have the same name and driver."""
        names = ("name", "platform", "version", "kind")
        return all(getattr(self, name) == getattr(other, name) for name in names)

    @property
    def is_interpreter(self) -> bool:
        """Whether it is Oclgrind, a memory checker, chosen by name only."""
        return "oclgrind" in self.platform.lower()


@dataclass(frozen=True, slots=True, eq=False)
class Device:
    """An opened device: one context, one in-order queue, and the programs built for it.

    Make one with `open_device`. Several threads may use it.

    Attributes
    ----------
    info : DeviceInfo
    budget_bytes : int
        Memory that may be allocated at a time; larger problems are tiled.
    width : int
        Lanes per work-item: 8 on a CPU, 1 on a GPU.
    group_items : int
        Most items of a work-group: 64 on a GPU; 1 on a CPU, where PoCL keeps the private arrays of
        a whole group on the stack.
    launch_work : float
        Operations, roughly, from which on a launch is split; none on a CPU.
    buffers : WeakSet
        The open `clradar.opencl.Buffers`.
    lock : RLock
        Held to build a program, start a kernel with its arguments, and count memory.
    """

    info: DeviceInfo
    context: Any
    queue: Any
    budget_bytes: int
    width: int
    group_items: int = 1
    launch_work: float = math.inf
    programs: dict[Any, Any] = field(default_factory=dict, repr=False)
    buffers: WeakSet[Any] = field(default_factory=WeakSet, repr=False)
    lock: Any = field(default_factory=threading.RLock, repr=False)

    @property
    def max_buffer_bytes(self) -> int:
        """Largest single buffer that one call may plan with."""
        return min(self.budget_bytes, self.info.max_alloc_bytes)

    @property
    def used_bytes(self) -> int:
        """Memory that is allocated at present."""
        with self.lock:
            return sum(buffers.used_bytes for buffers in self.buffers)

    def describe(self) -> dict[str, str]:
        """Device, platform and version, for a file's provenance."""
        info = self.info
        return {"device": info.name, "platform": info.platform, "version": info.version}


def list_devices() -> list[DeviceInfo]:
    """All OpenCL devices of this machine, in the order of platforms.

    Examples
    --------
    >>> any("Portable Computing Language" in info.platform for info in clradar.list_devices())
    True
    """
    return [info for info, _ in _found()]


def forget_devices() -> None:
    """Make `open_device` open every device anew; `Device` objects stay valid.

    After a failed launch a driver may refuse every command in the same context.

    Examples
    --------
    >>> before = clradar.open_device("pocl")
    >>> clradar.opencl.forget_devices()
    >>> clradar.open_device("pocl") is before
    False
    """
    _open.cache_clear()


def _found() -> list[tuple[DeviceInfo, Any]]:
    global _process
    check_process()
    _process = os.getpid()
    try:
        found_platforms = platforms()
    except cl.Error as error:
        raise DeviceError(f"no OpenCL platform was found ({error}); {INSTALL_HINT}") from error
    found = []
    for i, platform in enumerate(found_platforms):
        try:
            devices = platform.get_devices()
        except cl.Error:
            continue  # a driver without a device, such as a GPU's on a machine without one
        for j, dev in enumerate(devices):
            kinds = {"gpu": cl.device_type.GPU, "cpu": cl.device_type.CPU}
            info = DeviceInfo(
                selector=f"{i}:{j}",
                name=dev.name.strip(),
                platform=platform.name.strip(),
                version=dev.version.strip(),
                kind=next((kind for kind, bit in kinds.items() if dev.type & bit), "other"),
                memory_bytes=int(dev.global_mem_size),
                max_alloc_bytes=int(dev.max_mem_alloc_size),
                compute_units=int(dev.max_compute_units),
                target=named_target(dev),
            )
            found.append((info, dev))
    if not found:
        raise DeviceError(f"no OpenCL device was found; {INSTALL_HINT}")
    return found


_lock = threading.RLock()

_process: int | None = None
"""The process that has listed devices: drivers start threads then, which a fork does not have."""


def check_process() -> None:
    """Raise `DeviceError` in a process that was forked from one that uses OpenCL."""
    if _process not in (None, os.getpid()):
        raise DeviceError(
            f"device: expected it in the process that found it ({_process}), got a fork of it, in "
            "which OpenCL hangs; start processes with multiprocessing.get_context('spawn'), "
            "torch's DataLoader(multiprocessing_context='spawn'), or fork before devices are used"
        )


def opened(
    selector: str,
    memory_limit_bytes: int | None = None,
    width: int | None = None,
    launch_work: float | None = None,
) -> Device:
    """The device of a selector; parameters and errors as those of `open_device`."""
    check_process()
    with _lock:
        return _open(selector, memory_limit_bytes, width, launch_work)


@lru_cache(maxsize=32)
def _open(
    selector: str, memory_limit_bytes: int | None, width: int | None, launch_work: float | None
) -> Device:
    info, dev = next(pair for pair in _found() if pair[0].selector == selector)
    try:
        context = cl.Context([dev])
        queue = cl.CommandQueue(context)
    except cl.Error as error:
        raise DeviceError(
            f"device {info.label} cannot be opened ({error}); choose another with "
            f"CLRADAR_DEVICE=..., see `clradar devices`"
        ) from error
    budget = int(info.memory_bytes * MEMORY_SHARE)
    if memory_limit_bytes is not None:
        budget = min(budget, memory_limit_bytes)
    suits = (1, GPU_GROUP_ITEMS, GPU_LAUNCH_WORK) if info.kind == "gpu" else (8, 1, math.inf)
    return Device(
        info, context, queue, budget, width or suits[0], suits[1], launch_work or suits[2]
    )
