"""``clradar devices``: list the OpenCL devices, and which of them is used."""

from __future__ import annotations

from typing import TYPE_CHECKING

from clradar.cli.console import print_line, print_table

if TYPE_CHECKING:
    from clradar.opencl import DeviceInfo


def command() -> None:
    """The one that a command would use is marked with an asterisk. Choose another with --device
    or the environment variable CLRADAR_DEVICE: its selector, or part of its name.
    """
    from clradar.opencl.device import default_device, list_devices

    devices = list_devices()
    chosen = None
    failure = None
    try:
        chosen = default_device()
    except Exception as error:  # printed after the table, which helps to find the cause
        failure = error
    rows = [
        (
            "*" if info == chosen else "",
            info.selector,
            info.name,
            info.platform,
            info.kind,
            f"{info.memory_bytes / 2**30:.1f} GiB",
            str(info.compute_units),
            good_for(info),
        )
        for info in devices
    ]
    columns = ("", "selector", "name", "platform", "kind", "memory", "units", "good for")
    print_table(columns, rows, right=("memory", "units"))
    if failure is not None:
        raise failure
    assert chosen is not None
    print_line(f"used: {chosen.selector} {chosen.label}")


def good_for(info: DeviceInfo) -> str:
    """The use of a device, in a few words."""
    if info.is_interpreter:
        return "checking kernels"
    if info.kind == "gpu":
        return "everything; first choice"
    if "intel" in info.platform.lower():
        return "any x86 CPU"
    if "portable computing language" in info.platform.lower():
        return "any CPU; always there"
    return "untried"
