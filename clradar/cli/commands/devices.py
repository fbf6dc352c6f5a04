"""``clradar devices``: list the OpenCL devices, whether they work, and which of them is used."""

from __future__ import annotations

from typing import TYPE_CHECKING

from clradar.cli.console import print_line, print_table

if TYPE_CHECKING:
    from clradar.opencl import DeviceInfo


def command() -> None:
    """The one that a command would use is marked with an asterisk. Choose another with --device
    or the environment variable CLRADAR_DEVICE: its selector, or part of its name. Every device is
    tested: does it build kernels and compute as it must?
    """
    from clradar.errors import DeviceError
    from clradar.opencl.choice import default_device, fault
    from clradar.opencl.device import INSTALL_HINT, list_devices

    devices = list_devices()
    chosen = failure = None
    try:
        chosen = default_device()
    except DeviceError as error:  # printed after the table, which helps to find the cause
        failure = error
    faults = {info.selector: fault(info.selector) for info in devices}
    rows = [
        (
            "*" if info == chosen else "",
            info.selector,
            info.name,
            info.platform,
            info.kind,
            f"{info.memory_bytes / 2**30:.1f} GiB",
            str(info.compute_units),
            "no" if faults[info.selector] else "yes",
            good_for(info),
        )
        for info in devices
    ]
    columns = ("", "selector", "name", "platform", "kind", "memory", "units", "works", "good for")
    print_table(columns, rows, right=("memory", "units"))
    for info in devices:
        if faults[info.selector]:
            print_line(f"{info.selector} {info.label}: {faults[info.selector]}")
        elif info.target:
            print_line(
                f"{info.selector} {info.label}: this PoCL does not know the processor; it compiles "
                f"for {info.target} (docs/install.md)"
            )
    if failure is not None:
        raise failure
    assert chosen is not None
    if faults[chosen.selector]:
        raise DeviceError(
            f"the device that would be used, {chosen.selector} {chosen.label}, does not work; "
            f"choose another with CLRADAR_DEVICE=..., or {INSTALL_HINT}"
        )
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
        return "any CPU"
    return "untried"
