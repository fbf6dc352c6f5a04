"""``clradar devices``: list the OpenCL devices, whether they work, and which of them is used."""

from __future__ import annotations

from clradar.cli.console import print_line, print_table

COLUMNS = ("", "selector", "name", "platform", "kind", "memory", "units", "works")


def command() -> None:
    """An asterisk marks what a command would use; --device or the environment variable
    CLRADAR_DEVICE choose another, by its selector or part of its name. Every device is tested: does
    it build kernels and compute as it must?
    """
    from clradar.errors import DeviceError
    from clradar.opencl.choice import fault, select_devices
    from clradar.opencl.device import INSTALL_HINT, list_devices

    devices, chosen, failure = list_devices(), [], None
    try:
        chosen = select_devices(None)
    except DeviceError as error:  # printed after the table, which helps to find the cause
        failure = error
    faults = {info.selector: fault(info.selector) for info in devices}
    rows = [
        (
            "*" if info in chosen else "", info.selector, info.name, info.platform, info.kind,
            f"{info.memory_bytes / 2**30:.1f} GiB", str(info.compute_units),
            "no" if faults[info.selector] else "yes",
        )
        for info in devices
    ]  # fmt: skip
    print_table(COLUMNS, rows, right=("memory", "units"))
    for info in devices:
        text = faults[info.selector]
        if text is None and info.target:
            text = (
                f"this PoCL does not know the processor; it compiles for {info.target} "
                "(docs/install.md)"
            )
        if text is not None:
            print_line(f"{info.selector} {info.label}: {text}")
    if failure is not None:
        raise failure
    for info in chosen:
        if faults[info.selector]:
            raise DeviceError(
                f"a device that would be used, {info.selector} {info.label}, does not work; choose "
                f"another with CLRADAR_DEVICE=..., or {INSTALL_HINT}"
            )
    print_line(f"used: {', '.join(f'{info.selector} {info.label}' for info in chosen)}")
