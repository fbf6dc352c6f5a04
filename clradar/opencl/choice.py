"""Which device: by name, kind or index, else the first that works."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

from clradar.errors import DeviceError, quoted, warn
from clradar.model import checks
from clradar.opencl.device import INSTALL_HINT, Device, DeviceInfo, list_devices, opened
from clradar.opencl.pocl_target import POCL
from clradar.opencl.program import self_test

ALL = "all"

VARIABLES = ("CLRADAR_DEVICE", "PYOPENCL_CTX")  # each names a device; the first that is set counts
_PLATFORMS = {"pocl": POCL, **{name: name for name in ("intel", "nvidia", "oclgrind")}}


def open_device(
    device: Device | str | None = None,
    *,
    memory_limit_bytes: int | None = None,
    width: int | None = None,
    launch_work: float | None = None,
) -> Device:
    """Open a device, or return the one that is open already.

    Parameters
    ----------
    device : Device, str or None
        "platform:device" (indices), "gpu", "cpu", or part of a device's or platform's name ("pocl",
        "nvidia", ...). None: ``CLRADAR_DEVICE``, else ``PYOPENCL_CTX``, else the first GPU, else
        Intel's CPU runtime, else PoCL. Of several that are meant, the first that builds and passes
        its test, with a warning of those before it (docs/install.md); an error if none does.
    memory_limit_bytes : int, optional
        Most device memory to plan with; three quarters of the device's by default.
    width, launch_work : optional
        Those of `Device`, instead of what suits its kind; a width of 1 or 8.

    Examples
    --------
    >>> device = clradar.open_device("pocl")
    >>> device is clradar.open_device(device.info.selector)
    True
    """
    if isinstance(device, Device):
        if any(value is not None for value in (memory_limit_bytes, width, launch_work)):
            raise DeviceError(
                "device: expected its name together with memory_limit_bytes, width or launch_work, "
                "got a clradar.Device, for which they are settled"
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
    if launch_work is not None:
        launch_work = checks.positive("launch_work", launch_work)
    return opened(chosen_device(device).selector, memory_limit_bytes, width, launch_work)


def chosen_device(device: str | None = None) -> DeviceInfo:
    """The device that `open_device` opens."""
    return _first_working(_meant(*_wanted(device)))


def cpu_beside(device: Device) -> Device | None:
    """A CPU for what one thread does best: the device itself, else one of this machine, or None."""
    if device.info.kind == "cpu" or device.info.is_interpreter:
        return device
    cpus = [info for info in list_devices() if info.kind == "cpu" and not info.is_interpreter]
    info = _working(sorted(cpus, key=_rank))
    if info is None:
        _tell_skipped(cpus, "numpy")
        return None
    return opened(info.selector)


@lru_cache(maxsize=64)
def fault(selector: str) -> str | None:
    """Why a device cannot be used, in a few words, tested once; None if nothing is wrong."""
    try:
        self_test(opened(selector))
    except DeviceError as error:
        return quoted(str(error).split("; ")[0].split("]: ", 1)[-1], 120)
    return None


def _first_working(meant: Sequence[DeviceInfo]) -> DeviceInfo:
    """The first that passes its test; a single one is tested when it is used."""
    working = meant[0] if len(meant) == 1 else _working(meant)
    if working is None:
        faults = "; ".join(f"{info.selector} {info.label} {fault(info.selector)}" for info in meant)
        raise DeviceError(f"no OpenCL device works: {faults}; {INSTALL_HINT}")
    return working


def _working(ranked: Sequence[DeviceInfo]) -> DeviceInfo | None:
    """The first that passes its test; a warning names those before it."""
    for i, info in enumerate(ranked):
        if fault(info.selector) is None:
            _tell_skipped(ranked[:i], info.label)
            return info
    return None


_told: set[str] = set()


def _tell_skipped(skipped: Sequence[DeviceInfo], instead: str) -> None:
    """Warn of devices that do not work, each once in a process."""
    for info in skipped:
        if info.selector not in _told:
            _told.add(info.selector)
            warn(
                f"device {info.selector} {info.label} {fault(info.selector)}; {instead} is used "
                "instead, see `clradar devices`"
            )


def devices_like(device: str | None = None) -> list[DeviceInfo]:
    """The device that `open_device` would open, and its like; of a selector that one alone."""
    own = chosen_device(device)
    if _is_selector(_wanted(device)[0] or ""):
        return [own]
    return [info for info in list_devices() if info.is_like(own)]


def several(device: str | None) -> bool:
    """Whether it may mean several devices: "all", or names with commas between them.

    None stands for what the environment names.
    """
    text = _wanted(device)[0] or ""
    return text.strip().lower() == ALL or "," in text


def select_devices(device: str | Sequence[str] | None) -> list[DeviceInfo]:
    """The devices that a name means which may mean several (`several`), each once."""
    wanted, origin = _wanted(device)
    if wanted is None:
        return [chosen_device()]
    names = wanted.split(",") if isinstance(wanted, str) else list(wanted)
    if len(names) == 1 and names[0].strip().lower() == ALL:
        return _all()
    infos = [_first_working(_meant(name, origin)) for name in names]
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
    if gpus and _first_working(_meant(None, "device")).kind == "gpu":
        return [info for info in gpus if info.platform == first[info.name]]
    default = _first_working(_meant(None, "device")) if several(None) else chosen_device()
    return [info for info in list_devices() if info.is_like(default)]


def _wanted(device: Any) -> tuple[Any, str]:
    """What names the device, the environment for None, and where that is said."""
    named = ((os.environ[name], name) for name in VARIABLES if os.environ.get(name))
    return next(named, (None, "device")) if device is None else (device, "device")


def _is_selector(text: str) -> bool:
    return text.strip().replace(":", "").isdigit()


def _meant(wanted: str | None, origin: str) -> list[DeviceInfo]:
    """All devices that a name means, the preferred one first."""
    infos = list_devices()
    usable = [info for info in infos if not info.is_interpreter]
    if wanted is None:
        if not usable:
            raise DeviceError(f"no OpenCL device but a memory checker was found; {INSTALL_HINT}")
        return sorted(usable, key=_rank)
    key = wanted.strip().lower()
    if several(wanted):
        raise DeviceError(
            f"{origin}: expected one device, got {wanted!r}: what is asked for is not split over "
            "several; see docs/install.md for what is"
        )
    if key in ("gpu", "cpu"):
        matches = [info for info in usable if info.kind == key]
    elif _is_selector(key):
        exact = key if ":" in key else f"{key}:0"
        matches = [info for info in infos if info.selector == exact]
    elif key in _PLATFORMS:
        # By platform only: an Intel processor driven by PoCL is not Intel's runtime.
        matches = [info for info in infos if _PLATFORMS[key] in info.platform.lower()]
    else:
        # PYOPENCL_CTX may be "platform:device" by name.
        parts = [_PLATFORMS.get(part, part) for part in key.split(":") if part]
        matches = [info for info in infos if parts and all(p in info.label.lower() for p in parts)]
    if not matches:
        listing = "; ".join(f"{info.selector} {info.label}" for info in infos)
        raise DeviceError(
            f"{origin}: expected one of the devices here ({listing}), got {wanted!r}; "
            f"see `clradar devices`, or {INSTALL_HINT}"
        )
    return matches


def _rank(info: DeviceInfo) -> int:
    platform = info.platform.lower()
    ranks = info.kind == "gpu", info.kind == "cpu" and "intel" in platform, POCL in platform
    return (*ranks, True).index(True)
