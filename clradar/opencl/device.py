"""Enumeration, selection and opening of OpenCL devices."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import pyopencl as cl

from clradar.errors import DeviceError
from clradar.model import checks
from clradar.opencl.runtimes import platforms

INSTALL_HINT = (
    "install the embedded CPU device with: pip install 'pyopencl[pocl]', "
    "or your GPU vendor's OpenCL driver"
)

MEMORY_SHARE = 0.75
"""Fraction of a device's memory that one call may plan to use; the rest is the runtime's."""

ALL = "all"

VARIABLES = ("CLRADAR_DEVICE", "PYOPENCL_CTX")
"""Each names a device; the first that is set counts."""

GPU_LAUNCH_WORK = 4e9
"""Operations of one launch on a GPU, roughly; more are split. A tenth of a second where 0.4 TFLOP/s
are used to a tenth: one that drives a display stops what takes some seconds."""

GPU_GROUP_ITEMS = 64
"""Items of a work-group on a GPU: two warps of NVIDIA's, one or two wavefronts of AMD's."""

_ALIASES = {
    "pocl": "portable computing language",
    "intel": "intel",
    "nvidia": "nvidia",
    "oclgrind": "oclgrind",
}


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """One OpenCL device of this machine.

    Attributes
    ----------
    selector : str
        "platform:device", the pair of indices that selects it by ``CLRADAR_DEVICE``.
    name, platform, version : str
        As the driver gives them.
    kind : str
        "gpu", "cpu" or "other".
    memory_bytes, max_alloc_bytes : int
        Global memory and the largest single buffer.
    compute_units : int

    Examples
    --------
    >>> import clradar
    >>> info = clradar.open_device("pocl").info
    >>> info.kind, info.is_interpreter, info.max_alloc_bytes <= info.memory_bytes
    ('cpu', False, True)
    """

    selector: str
    name: str
    platform: str
    version: str
    kind: str
    memory_bytes: int
    max_alloc_bytes: int
    compute_units: int

    @property
    def label(self) -> str:
        return f"{self.name} [{self.platform}]"

    def is_like(self, other: DeviceInfo) -> bool:
        """Whether both have the same name and driver."""
        own, others = (
            (info.name, info.platform, info.version, info.kind) for info in (self, other)
        )
        return own == others

    @property
    def is_interpreter(self) -> bool:
        """Oclgrind: a memory checker, chosen by name only."""
        return "oclgrind" in self.platform.lower()


@dataclass(frozen=True, slots=True, eq=False)
class Device:
    """An opened device: one context, one in-order queue, and the programs built for it.

    Make one with `open_device`.

    Attributes
    ----------
    info : DeviceInfo
    budget_bytes : int
        Memory that one call may have allocated at a time; larger problems are tiled.
    width : int
        Lanes per work-item: 8 on a CPU, where wide vectors pay, and 1 on a GPU, where neighbouring
        items are the lanes.
    group_items : int
        Most items of a work-group: 64 on a GPU; 1 on a CPU, where an item is 8 lanes wide and PoCL
        keeps the private arrays of a whole group on the stack.
    launch_work : float
        Operations, roughly, from which on `Program.start` splits a launch; none on a CPU.
    launched : list or None
        Of a device that was opened with ``profiling=True``: the events of its kernels.

    Examples
    --------
    >>> import clradar
    >>> device = clradar.open_device("pocl", memory_limit_bytes=10**6)
    >>> device.budget_bytes, device.width
    (1000000, 8)
    """

    info: DeviceInfo
    context: Any
    queue: Any
    budget_bytes: int
    width: int
    group_items: int = 1
    launch_work: float = math.inf
    programs: dict[Any, Any] = field(default_factory=dict, repr=False)
    launched: list[Any] | None = None

    @property
    def max_buffer_bytes(self) -> int:
        """Largest single buffer that one call may plan with."""
        return min(self.budget_bytes, self.info.max_alloc_bytes)

    def kernel_time_s(self) -> float:
        """Seconds that the device has run kernels since the previous call.

        Raises
        ------
        DeviceError
            The device was not opened with ``profiling=True``.
        """
        if self.launched is None:
            raise DeviceError(f"device {self.info.label}: expected it opened with profiling=True")
        self.queue.finish()
        time_s = sum(1e-9 * (event.profile.end - event.profile.start) for event in self.launched)
        self.launched.clear()
        return time_s

    def describe(self) -> dict[str, str]:
        """Device, platform and version, for a file's provenance."""
        return {
            "device": self.info.name,
            "platform": self.info.platform,
            "version": self.info.version,
        }


def list_devices() -> list[DeviceInfo]:
    """All OpenCL devices of this machine, in the order of platforms.

    Raises
    ------
    DeviceError
        There is no OpenCL platform.

    Examples
    --------
    >>> import clradar
    >>> any("Portable Computing Language" in info.platform for info in clradar.list_devices())
    True
    """
    return [info for info, _ in _found()]


def open_device(
    device: Device | str | None = None,
    *,
    memory_limit_bytes: int | None = None,
    width: int | None = None,
    group_items: int | None = None,
    launch_work: float | None = None,
    profiling: bool = False,
) -> Device:
    """Open a device, or return the one that is open already.

    Parameters
    ----------
    device : Device, str or None
        A device is returned as it is. A string is "platform:device" (indices), "gpu", "cpu", or
        part of a device's or platform's name ("pocl", "nvidia", ...). None means: the environment
        variable ``CLRADAR_DEVICE``, else ``PYOPENCL_CTX``, else the first GPU, else Intel's CPU
        runtime, else PoCL.
    memory_limit_bytes : int, optional
        Plan with at most this much device memory; three quarters of the device's by default.
    width : 1 or 8, optional
        Build the kernels for this many lanes per work-item instead of what suits the device's kind.
    group_items : int, optional
        Run at most this many items in a work-group instead of what suits the device's kind.
    launch_work : float, optional
        Split launches of more operations than this instead of what suits the device's kind.
    profiling : bool
        Measure how long kernels run, see `Device.kernel_time_s`.

    Raises
    ------
    DeviceError
        No such device, or it cannot be opened. There is no fallback to another one.

    Examples
    --------
    >>> import clradar
    >>> device = clradar.open_device("pocl")
    >>> device is clradar.open_device(device.info.selector)
    True
    """
    if isinstance(device, Device):
        settled = (memory_limit_bytes, width, group_items, launch_work)
        if profiling or any(value is not None for value in settled):
            raise DeviceError(
                "device: expected its name together with memory_limit_bytes, width, group_items, "
                "launch_work or profiling, got a clradar.Device, for which they are settled"
            )
        return device
    if device is not None and not isinstance(device, str):
        raise DeviceError(
            f"device: expected a clradar.Device, a string or None, got {type(device).__name__}"
        )
    if memory_limit_bytes is not None:
        memory_limit_bytes = checks.whole("memory_limit_bytes", memory_limit_bytes, 1)
    if width not in (None, 1, 8):
        checks.fail("width", "1 or 8 lanes per work-item", repr(width))
    if group_items is not None:
        group_items = checks.whole("group_items", group_items, 1)
    if launch_work is not None:
        launch_work = checks.positive("launch_work", launch_work)
    info = default_device() if device is None else _select(device, "device")
    return _open(info.selector, memory_limit_bytes, width, group_items, launch_work, profiling)


def cpu_beside(device: Device) -> Device | None:
    """A CPU for what one thread does best: the device itself, else one of this machine, or None.

    The memory checker stands for itself.

    Examples
    --------
    >>> import clradar
    >>> from clradar.opencl import cpu_beside
    >>> device = clradar.open_device("pocl")
    >>> cpu_beside(device) is device
    True
    """
    if device.info.kind == "cpu" or device.info.is_interpreter:
        return device
    try:
        return open_device("cpu")
    except DeviceError:
        return None


def forget_devices() -> None:
    """Make `open_device` open every device anew; `Device` objects stay valid.

    After a failed launch a driver may refuse every command in the same context.

    Examples
    --------
    >>> from clradar.opencl import forget_devices, open_device
    >>> before = open_device("pocl")
    >>> forget_devices()
    >>> open_device("pocl") is before
    False
    """
    _open.cache_clear()


def devices_like(device: str | None = None) -> list[DeviceInfo]:
    """The device that `open_device` would open, and all others of its name and driver.

    Parameters
    ----------
    device : str or None
        As for `open_device`. A selector means that device alone.

    Raises
    ------
    DeviceError
        No such device.

    Examples
    --------
    >>> from clradar.opencl import devices_like
    >>> {info.kind for info in devices_like("pocl")}
    {'cpu'}
    """
    chosen = default_device() if device is None else _select(device, "device")
    named = _named()
    wanted = device or (named[1] if named else "")
    if wanted.strip().replace(":", "").isdigit():
        return [chosen]
    return [info for info in list_devices() if info.is_like(chosen)]


def several(device: str | None) -> bool:
    """Whether it may mean several devices: "all", or names with commas between them.

    None stands for what the environment names.
    """
    named = _named()
    text = device or (named[1] if named else "")
    return text.strip().lower() == ALL or "," in text


def select_devices(device: str | Sequence[str] | None) -> list[DeviceInfo]:
    """The devices that `clradar.opencl.open_devices` names.

    Raises
    ------
    DeviceError
        No such device, or one is named twice.
    """
    origin, named = "device", _named()
    if device is None and named is not None:
        origin, device = named
    if device is None:
        return [default_device()]
    names = device.split(",") if isinstance(device, str) else list(device)
    if len(names) == 1 and names[0].strip().lower() == ALL:
        return _all()
    infos = [_select(name, origin) for name in names]
    twice = next((info for i, info in enumerate(infos) if info in infos[:i]), None)
    if twice is not None or not infos:
        got = f"{twice.selector} {twice.label} twice" if twice else "none"
        raise DeviceError(f"{origin}: expected devices, each once, got {got}")
    return infos


def _all() -> list[DeviceInfo]:
    """All GPUs, those of one name by one driver; without GPUs what is used anyway, and its like.

    Two drivers of one device share it, so there is nothing to win by both.
    """
    gpus = [info for info in list_devices() if info.kind == "gpu" and not info.is_interpreter]
    first: dict[str, str] = {}
    for info in gpus:
        first.setdefault(info.name, info.platform)
    if gpus:
        return [info for info in gpus if info.platform == first[info.name]]
    named = _named()
    if named is not None and several(named[1]):
        named = None
    default = _select(None, "device") if named is None else _select(*reversed(named))
    return [info for info in list_devices() if info.is_like(default)]


def _named() -> tuple[str, str] | None:
    """The environment variable that names a device, and what it says."""
    for variable in VARIABLES:
        if os.environ.get(variable):
            return variable, os.environ[variable]
    return None


def default_device() -> DeviceInfo:
    """The device that `open_device` opens for None."""
    named = _named()
    return _select(None, "device") if named is None else _select(*reversed(named))


def _found() -> list[tuple[DeviceInfo, Any]]:
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
            kind = "other"
            if dev.type & cl.device_type.GPU:
                kind = "gpu"
            elif dev.type & cl.device_type.CPU:
                kind = "cpu"
            info = DeviceInfo(
                selector=f"{i}:{j}",
                name=dev.name.strip(),
                platform=platform.name.strip(),
                version=dev.version.strip(),
                kind=kind,
                memory_bytes=int(dev.global_mem_size),
                max_alloc_bytes=int(dev.max_mem_alloc_size),
                compute_units=int(dev.max_compute_units),
            )
            found.append((info, dev))
    if not found:
        raise DeviceError(f"no OpenCL device was found; {INSTALL_HINT}")
    return found


def _select(wanted: str | None, origin: str) -> DeviceInfo:
    infos = [info for info, _ in _found()]
    usable = [info for info in infos if not info.is_interpreter]
    if wanted is None:
        ranked = sorted(usable, key=_rank)
        if not ranked:
            raise DeviceError(f"no OpenCL device but a memory checker was found; {INSTALL_HINT}")
        return ranked[0]
    key = wanted.strip().lower()
    if several(wanted):
        raise DeviceError(
            f"{origin}: expected one device, got {wanted!r}: what is asked for is not split over "
            "several; see docs/runtimes.md for what is"
        )
    if key in ("gpu", "cpu"):
        matches = [info for info in usable if info.kind == key]
    elif key.replace(":", "").isdigit():
        exact = key if ":" in key else f"{key}:0"
        matches = [info for info in infos if info.selector == exact]
    elif key in _ALIASES:
        # By platform only: an Intel processor driven by PoCL is not Intel's runtime.
        matches = [info for info in infos if _ALIASES[key] in info.platform.lower()]
    else:
        # PYOPENCL_CTX may be "platform:device" by name.
        parts = [_ALIASES.get(part, part) for part in key.split(":") if part]
        matches = [info for info in infos if parts and all(p in info.label.lower() for p in parts)]
    if not matches:
        listing = "; ".join(f"{info.selector} {info.label}" for info in infos)
        raise DeviceError(
            f"{origin}: expected one of the devices here ({listing}), got {wanted!r}; "
            f"see `clradar devices`, or {INSTALL_HINT}"
        )
    return matches[0]


def _rank(info: DeviceInfo) -> int:
    platform = info.platform.lower()
    if info.kind == "gpu":
        return 0
    if info.kind == "cpu" and "intel" in platform:
        return 1
    if "portable computing language" in platform:
        return 2
    return 3


@lru_cache(maxsize=32)
def _open(
    selector: str,
    memory_limit_bytes: int | None,
    width: int | None,
    group_items: int | None,
    launch_work: float | None,
    profiling: bool,
) -> Device:
    info, dev = next(pair for pair in _found() if pair[0].selector == selector)
    try:
        context = cl.Context([dev])
        properties = cl.command_queue_properties.PROFILING_ENABLE if profiling else 0
        queue = cl.CommandQueue(context, properties=properties)
    except cl.Error as error:
        raise DeviceError(
            f"device {info.label} cannot be opened ({error}); choose another with "
            f"CLRADAR_DEVICE=..., see `clradar devices`"
        ) from error
    budget = int(info.memory_bytes * MEMORY_SHARE)
    if memory_limit_bytes is not None:
        budget = min(budget, memory_limit_bytes)
    if width is None:
        width = 1 if info.kind == "gpu" else 8
    if group_items is None:
        group_items = GPU_GROUP_ITEMS if info.kind == "gpu" else 1
    if launch_work is None:
        launch_work = GPU_LAUNCH_WORK if info.kind == "gpu" else math.inf
    launched: list[Any] | None = [] if profiling else None
    return Device(info, context, queue, budget, width, group_items, launch_work, launched=launched)
